//! What a device answers.

use crate::{Packet, PacketError, code};

/// Why a device did not do what it was told.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Refusal {
    /// 1: it could not do it.
    Result,
    /// 2: it does not know the instruction.
    Instruction,
    /// 3: the packet came garbled.
    Crc,
    /// 4: the data is outside its range.
    DataRange,
    /// 5: the data is not as long as the registers.
    DataLength,
    /// 6: the data is outside the configured limit.
    DataLimit,
    /// 7: the register is read-only, or locked while torque is on.
    Access,
    /// Any other number.
    Unknown(u8),
}

impl Refusal {
    /// The number on the wire, 1 to 127.
    pub fn number(self) -> u8 {
        match self {
            Self::Result => 1,
            Self::Instruction => 2,
            Self::Crc => 3,
            Self::DataRange => 4,
            Self::DataLength => 5,
            Self::DataLimit => 6,
            Self::Access => 7,
            Self::Unknown(number) => number & 0x7F,
        }
    }

    fn from_number(number: u8) -> Option<Self> {
        Some(match number {
            0 => return None,
            1 => Self::Result,
            2 => Self::Instruction,
            3 => Self::Crc,
            4 => Self::DataRange,
            5 => Self::DataLength,
            6 => Self::DataLimit,
            7 => Self::Access,
            other => Self::Unknown(other),
        })
    }
}

impl std::fmt::Display for Refusal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Result => f.write_str("could not be done"),
            Self::Instruction => f.write_str("instruction not known"),
            Self::Crc => f.write_str("packet came garbled"),
            Self::DataRange => f.write_str("data outside its range"),
            Self::DataLength => f.write_str("data of the wrong length"),
            Self::DataLimit => f.write_str("data outside the configured limit"),
            Self::Access => f.write_str("register is read-only, or locked while torque is on"),
            Self::Unknown(number) => write!(f, "error number {number}"),
        }
    }
}

/// The error byte of an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StatusError {
    /// The device has a hardware error: register 70 says which.
    pub alert: bool,
    /// Why it did not do what it was told.
    pub refusal: Option<Refusal>,
}

impl StatusError {
    /// From the byte on the wire.
    pub fn from_byte(byte: u8) -> Self {
        Self { alert: byte & 0x80 != 0, refusal: Refusal::from_number(byte & 0x7F) }
    }

    /// The byte on the wire.
    pub fn to_byte(self) -> u8 {
        u8::from(self.alert) << 7 | self.refusal.map_or(0, Refusal::number)
    }
}

/// An answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Status {
    /// Who answers.
    pub id: u8,
    /// Its error byte.
    pub error: StatusError,
    /// What was read; of a ping, model (2 bytes) and firmware.
    pub data: Vec<u8>,
}

impl Status {
    /// Its packet.
    pub fn to_packet(&self) -> Packet {
        let mut params = Vec::with_capacity(1 + self.data.len());
        params.push(self.error.to_byte());
        params.extend_from_slice(&self.data);
        Packet { id: self.id, instruction: code::STATUS, params }
    }

    /// The answer that a packet is.
    ///
    /// # Errors
    /// [`PacketError::Instruction`] for a packet that is no answer, [`PacketError::Parameters`] for one without error
    /// byte.
    pub fn from_packet(packet: &Packet) -> Result<Self, PacketError> {
        if packet.instruction != code::STATUS {
            return Err(PacketError::Instruction { found: packet.instruction });
        }
        let [error, data @ ..] = &packet.params[..] else {
            return Err(PacketError::Parameters { field: "STATUS", found: 0, expected: "1 or more".into() });
        };
        Ok(Self { id: packet.id, error: StatusError::from_byte(*error), data: data.to_vec() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_are_the_published_packets() {
        let ok = StatusError::default();
        let access = StatusError { alert: false, refusal: Some(Refusal::Access) };
        for (status, wire) in [
            (
                Status { id: 1, error: ok, data: vec![0x06, 0x04, 0x26] },
                &[0xFF, 0xFF, 0xFD, 0, 1, 7, 0, 0x55, 0, 6, 4, 0x26, 0x65, 0x5D][..],
            ),
            (Status { id: 0, error: ok, data: vec![] }, &[0xFF, 0xFF, 0xFD, 0, 0, 4, 0, 0x55, 0, 0xDA, 0x8C]),
            (
                Status { id: 0, error: access, data: vec![] },
                &[0xFF, 0xFF, 0xFD, 0, 0, 4, 0, 0x55, 7, 0xCB, 0x0C],
            ),
        ] {
            assert_eq!(status.to_packet().encode().unwrap(), wire);
            assert_eq!(Status::from_packet(&Packet::decode(wire).unwrap()).unwrap(), status);
        }
    }

    #[test]
    fn every_error_byte_comes_back() {
        for byte in 0..=255 {
            assert_eq!(StatusError::from_byte(byte).to_byte(), byte);
        }
        let packet = Packet { id: 1, instruction: 1, params: vec![] };
        assert!(matches!(Status::from_packet(&packet), Err(PacketError::Instruction { found: 1 })));
        let empty = Packet { id: 1, instruction: code::STATUS, params: vec![] };
        assert!(matches!(Status::from_packet(&empty), Err(PacketError::Parameters { .. })));
    }
}
