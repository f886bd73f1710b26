//! What a client asks of the devices on a bus.

use crate::{BROADCAST, MAX_ID, Packet, PacketError};

/// Instruction codes of protocol 2.0.
pub mod code {
    /// Ping.
    pub const PING: u8 = 0x01;
    /// Read.
    pub const READ: u8 = 0x02;
    /// Write.
    pub const WRITE: u8 = 0x03;
    /// Write that waits for [`ACTION`].
    pub const REG_WRITE: u8 = 0x04;
    /// Do what was written with [`REG_WRITE`].
    pub const ACTION: u8 = 0x05;
    /// Factory reset.
    pub const FACTORY_RESET: u8 = 0x06;
    /// Reboot.
    pub const REBOOT: u8 = 0x08;
    /// Clear the turns of a multi-turn position, or an error.
    pub const CLEAR: u8 = 0x10;
    /// An answer.
    pub const STATUS: u8 = 0x55;
    /// Read the same registers of many devices; each answers.
    pub const SYNC_READ: u8 = 0x82;
    /// Write the same registers of many devices; none answers.
    pub const SYNC_WRITE: u8 = 0x83;
    /// As [`SYNC_READ`], with one answer that all write together.
    pub const FAST_SYNC_READ: u8 = 0x8A;
    /// Read other registers of each device.
    pub const BULK_READ: u8 = 0x92;
    /// Write other registers of each device; none answers.
    pub const BULK_WRITE: u8 = 0x93;
}

/// An instruction and its parameters.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Instruction {
    /// Who is there? The answer holds model and firmware.
    Ping,
    /// Reads `len` bytes from `addr`.
    Read {
        /// First register.
        addr: u16,
        /// Bytes.
        len: u16,
    },
    /// Writes `data` from `addr` on.
    Write {
        /// First register.
        addr: u16,
        /// Bytes.
        data: Vec<u8>,
    },
    /// As a write, done on [`Instruction::Action`].
    RegWrite {
        /// First register.
        addr: u16,
        /// Bytes.
        data: Vec<u8>,
    },
    /// Does what was staged.
    Action,
    /// Sets everything to its initial value; `what` as in the manual.
    FactoryReset {
        /// 0xFF all, 0x01 all but the address, 0x02 all but address and baud rate.
        what: u8,
    },
    /// Starts the device anew; clears hardware errors.
    Reboot,
    /// Clears what the parameters say (manual: `01 44 58 4C 22` the turns).
    Clear {
        /// Parameters as they are.
        what: Vec<u8>,
    },
    /// Reads the same registers of several devices, one answer each, in this order.
    SyncRead {
        /// First register.
        addr: u16,
        /// Bytes of each.
        len: u16,
        /// Devices.
        ids: Vec<u8>,
    },
    /// Writes the same registers of several devices. No answer.
    SyncWrite {
        /// First register.
        addr: u16,
        /// Bytes of each.
        len: u16,
        /// Device and its `len` bytes.
        blocks: Vec<(u8, Vec<u8>)>,
    },
    /// As a sync read, answered in one packet.
    FastSyncRead {
        /// First register.
        addr: u16,
        /// Bytes of each.
        len: u16,
        /// Devices.
        ids: Vec<u8>,
    },
    /// Reads registers of several devices: device, first register, bytes.
    BulkRead {
        /// Device, first register, bytes.
        blocks: Vec<(u8, u16, u16)>,
    },
    /// Writes registers of several devices: device, first register, bytes. No answer.
    BulkWrite {
        /// Device, first register, data.
        blocks: Vec<(u8, u16, Vec<u8>)>,
    },
}

impl Instruction {
    /// The packet that says this to `id`; those for several devices go to [`BROADCAST`].
    ///
    /// # Errors
    /// [`PacketError::Id`] for an address that no device has; [`PacketError::Parameters`] for blocks of a sync write
    /// that are not as long as its field.
    pub fn to_packet(&self, id: u8) -> Result<Packet, PacketError> {
        let mut params = Vec::new();
        let u16s = |params: &mut Vec<u8>, values: &[u16]| {
            values.iter().for_each(|v| params.extend_from_slice(&v.to_le_bytes()));
        };
        let mut to = id;
        let instruction = match self {
            Self::Ping => code::PING,
            Self::Read { addr, len } => {
                u16s(&mut params, &[*addr, *len]);
                code::READ
            }
            Self::Write { addr, data } | Self::RegWrite { addr, data } => {
                u16s(&mut params, &[*addr]);
                params.extend_from_slice(data);
                if matches!(self, Self::Write { .. }) { code::WRITE } else { code::REG_WRITE }
            }
            Self::Action => code::ACTION,
            Self::FactoryReset { what } => {
                params.push(*what);
                code::FACTORY_RESET
            }
            Self::Reboot => code::REBOOT,
            Self::Clear { what } => {
                params.extend_from_slice(what);
                code::CLEAR
            }
            Self::SyncRead { addr, len, ids } | Self::FastSyncRead { addr, len, ids } => {
                to = BROADCAST;
                u16s(&mut params, &[*addr, *len]);
                ids.iter().try_for_each(|id| device(*id))?;
                params.extend_from_slice(ids);
                if matches!(self, Self::SyncRead { .. }) { code::SYNC_READ } else { code::FAST_SYNC_READ }
            }
            Self::SyncWrite { addr, len, blocks } => {
                to = BROADCAST;
                u16s(&mut params, &[*addr, *len]);
                for (id, data) in blocks {
                    device(*id)?;
                    exactly("SYNC WRITE block", data.len(), usize::from(*len))?;
                    params.push(*id);
                    params.extend_from_slice(data);
                }
                code::SYNC_WRITE
            }
            Self::BulkRead { blocks } => {
                to = BROADCAST;
                for (id, addr, len) in blocks {
                    device(*id)?;
                    params.push(*id);
                    u16s(&mut params, &[*addr, *len]);
                }
                code::BULK_READ
            }
            Self::BulkWrite { blocks } => {
                to = BROADCAST;
                for (id, addr, data) in blocks {
                    device(*id)?;
                    let len = u16::try_from(data.len()).unwrap_or(u16::MAX);
                    exactly("BULK WRITE block", data.len(), usize::from(len))?;
                    params.push(*id);
                    u16s(&mut params, &[*addr, len]);
                    params.extend_from_slice(data);
                }
                code::BULK_WRITE
            }
        };
        if to != BROADCAST {
            device(to)?;
        }
        Ok(Packet { id: to, instruction, params })
    }

    /// What a packet asks.
    ///
    /// # Errors
    /// [`PacketError::Instruction`], [`PacketError::Parameters`].
    pub fn from_packet(packet: &Packet) -> Result<Self, PacketError> {
        let params = &packet.params[..];
        let addressed = |field: &'static str| match params {
            [a, b, rest @ ..] => Ok((u16::from_le_bytes([*a, *b]), rest)),
            _ => Err(wrong(field, params.len(), "2 or more")),
        };
        let range = |field: &'static str| match params {
            [a, b, c, d, rest @ ..] => Ok((u16::from_le_bytes([*a, *b]), u16::from_le_bytes([*c, *d]), rest)),
            _ => Err(wrong(field, params.len(), "4 or more")),
        };
        Ok(match packet.instruction {
            code::PING => Self::Ping,
            code::READ => {
                let (addr, len, rest) = range("READ")?;
                exactly("READ", rest.len() + 4, 4)?;
                Self::Read { addr, len }
            }
            code::WRITE => {
                let (addr, data) = addressed("WRITE")?;
                Self::Write { addr, data: data.to_vec() }
            }
            code::REG_WRITE => {
                let (addr, data) = addressed("REG WRITE")?;
                Self::RegWrite { addr, data: data.to_vec() }
            }
            code::ACTION => Self::Action,
            code::FACTORY_RESET => {
                exactly("FACTORY RESET", params.len(), 1)?;
                Self::FactoryReset { what: params[0] }
            }
            code::REBOOT => Self::Reboot,
            code::CLEAR => Self::Clear { what: params.to_vec() },
            code::SYNC_READ => {
                let (addr, len, ids) = range("SYNC READ")?;
                Self::SyncRead { addr, len, ids: ids.to_vec() }
            }
            code::FAST_SYNC_READ => {
                let (addr, len, ids) = range("FAST SYNC READ")?;
                Self::FastSyncRead { addr, len, ids: ids.to_vec() }
            }
            code::SYNC_WRITE => {
                let (addr, len, rest) = range("SYNC WRITE")?;
                let block = usize::from(len) + 1;
                if !rest.len().is_multiple_of(block) {
                    return Err(wrong("SYNC WRITE", rest.len(), format!("a multiple of {block}")));
                }
                let blocks = rest.chunks_exact(block).map(|b| (b[0], b[1..].to_vec())).collect();
                Self::SyncWrite { addr, len, blocks }
            }
            code::BULK_READ => {
                if !params.len().is_multiple_of(5) {
                    return Err(wrong("BULK READ", params.len(), "a multiple of 5"));
                }
                let block =
                    |b: &[u8]| (b[0], u16::from_le_bytes([b[1], b[2]]), u16::from_le_bytes([b[3], b[4]]));
                Self::BulkRead { blocks: params.chunks_exact(5).map(block).collect() }
            }
            code::BULK_WRITE => Self::BulkWrite { blocks: bulk_blocks(params)? },
            found => return Err(PacketError::Instruction { found }),
        })
    }
}

fn bulk_blocks(mut rest: &[u8]) -> Result<Vec<(u8, u16, Vec<u8>)>, PacketError> {
    let mut blocks = Vec::new();
    while let [id, a, b, c, d, data @ ..] = rest {
        let len = usize::from(u16::from_le_bytes([*c, *d]));
        let (data, after) = data
            .split_at_checked(len)
            .ok_or_else(|| wrong("BULK WRITE block", data.len(), len.to_string()))?;
        blocks.push((*id, u16::from_le_bytes([*a, *b]), data.to_vec()));
        rest = after;
    }
    if rest.is_empty() { Ok(blocks) } else { Err(wrong("BULK WRITE", rest.len(), "5 or more a block")) }
}

fn device(id: u8) -> Result<(), PacketError> {
    if id <= MAX_ID { Ok(()) } else { Err(PacketError::Id { found: id, expected: format!("0 to {MAX_ID}") }) }
}

fn exactly(field: &'static str, found: usize, expected: usize) -> Result<(), PacketError> {
    if found == expected { Ok(()) } else { Err(wrong(field, found, expected.to_string())) }
}

fn wrong(field: &'static str, found: usize, expected: impl Into<String>) -> PacketError {
    PacketError::Parameters { field, found, expected: expected.into() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Bytes as they are printed in manuals.
    fn hex(text: &str) -> Vec<u8> {
        text.split_whitespace().map(|b| u8::from_str_radix(b, 16).unwrap()).collect()
    }

    #[test]
    fn instructions_are_the_published_packets() {
        let goal = |v: i32| v.to_le_bytes().to_vec();
        for (id, instruction, wire) in [
            (1, Instruction::Ping, "FF FF FD 00 01 03 00 01 19 4E"),
            (1, Instruction::Read { addr: 132, len: 4 }, "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"),
            (
                1,
                Instruction::Write { addr: 116, data: goal(512) },
                "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89",
            ),
            (0, Instruction::Write { addr: 64, data: vec![1] }, "FF FF FD 00 00 06 00 03 40 00 01 C8 E7"),
            (0, Instruction::Write { addr: 11, data: vec![5] }, "FF FF FD 00 00 06 00 03 0B 00 05 4F 62"),
            (
                BROADCAST,
                Instruction::SyncRead { addr: 126, len: 10, ids: vec![0, 1, 2, 3] },
                "FF FF FD 00 FE 0B 00 82 7E 00 0A 00 00 01 02 03 2F DE",
            ),
            (
                BROADCAST,
                Instruction::SyncWrite { addr: 116, len: 4, blocks: vec![(0, goal(2048)), (1, goal(2048))] },
                "FF FF FD 00 FE 11 00 83 74 00 04 00 00 00 08 00 00 01 00 08 00 00 F7 AC",
            ),
            (
                3,
                Instruction::Write { addr: 116, data: goal(0x00FD_FFFF) },
                "FF FF FD 00 03 0A 00 03 74 00 FF FF FD FD 00 A2 4D",
            ),
        ] {
            let packet = instruction.to_packet(id).unwrap();
            assert_eq!(packet.encode().unwrap(), hex(wire), "{instruction:?}");
            let read = Packet::decode(&hex(wire)).unwrap();
            assert_eq!((read.id, Instruction::from_packet(&read).unwrap()), (id, instruction));
        }
    }

    #[test]
    fn what_is_wrong_is_named() {
        let block = Instruction::SyncWrite { addr: 116, len: 4, blocks: vec![(0, vec![1])] };
        let error = block.to_packet(BROADCAST).unwrap_err().to_string();
        assert_eq!(error, "SYNC WRITE block: found 1 bytes, expected 4");
        let error = Instruction::Ping.to_packet(253).unwrap_err().to_string();
        assert_eq!(error, "ID: found 253, expected 0 to 252");
        let packet = |instruction, params: &[u8]| Packet { id: 1, instruction, params: params.to_vec() };
        let error = |p| Instruction::from_packet(&p).unwrap_err().to_string();
        assert_eq!(error(packet(2, &[1, 0])), "READ: found 2 bytes, expected 4 or more");
        assert_eq!(error(packet(0x77, &[])), "INSTRUCTION: found 0x77, expected a code of protocol 2.0");
    }

    proptest! {
        #[test]
        fn no_parameters_panic(instruction in any::<u8>(), params in proptest::collection::vec(any::<u8>(), 0..64)) {
            let packet = Packet { id: 1, instruction, params };
            if let Ok(asked) = Instruction::from_packet(&packet) {
                let to_all = matches!(
                    packet.instruction,
                    code::SYNC_READ | code::SYNC_WRITE | code::FAST_SYNC_READ | code::BULK_READ | code::BULK_WRITE
                );
                if let Ok(again) = asked.to_packet(1) && !matches!(asked, Instruction::Ping | Instruction::Action | Instruction::Reboot) {
                    prop_assert_eq!(again.params, packet.params);
                    prop_assert_eq!(again.id == BROADCAST, to_all);
                }
            }
        }
    }
}
