//! One packet: address, instruction, parameters.

use crate::{PacketError, crc16, stuff, unstuff};

/// How every packet begins; the byte after it is the address.
pub const HEADER: [u8; 4] = [0xFF, 0xFF, 0xFD, 0x00];
/// Address of all devices.
pub const BROADCAST: u8 = 0xFE;
/// Highest address of one device.
pub const MAX_ID: u8 = 252;
/// Longest packet that is read or written, bytes: 253 devices with 10 bytes each in one answer, and room.
pub const MAX_PACKET: usize = 4096;
/// Bytes before the instruction: header, address, length.
pub(crate) const BEFORE: usize = 7;
/// Shortest length field: instruction and check.
pub(crate) const LEAST_LENGTH: usize = 3;

/// A packet. `params` are as meant, without stuffing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Packet {
    /// Device, or [`BROADCAST`].
    pub id: u8,
    /// Instruction code; 0x55 for an answer.
    pub instruction: u8,
    /// Parameters; of an answer, the error byte first.
    pub params: Vec<u8>,
}

impl Packet {
    /// Bytes on the wire: stuffed, with length and check.
    ///
    /// # Errors
    /// [`PacketError::Length`] for parameters that no packet carries.
    pub fn encode(&self) -> Result<Vec<u8>, PacketError> {
        let mut body = Vec::with_capacity(1 + self.params.len());
        body.push(self.instruction);
        body.extend_from_slice(&self.params);
        frame(self.id, &stuff(&body))
    }

    /// The packet in `bytes`, which begin with a header and end with the check.
    ///
    /// # Errors
    /// [`PacketError::Length`], [`PacketError::Crc`].
    pub fn decode(bytes: &[u8]) -> Result<Self, PacketError> {
        let found = bytes.len().saturating_sub(BEFORE);
        let wrong = || PacketError::Length { found, least: LEAST_LENGTH, most: MAX_PACKET - BEFORE };
        let (checked, check) = bytes.split_last_chunk::<2>().ok_or_else(wrong)?;
        if !bytes.starts_with(&HEADER) || checked.len() < BEFORE + 1 {
            return Err(wrong());
        }
        let said = usize::from(u16::from_le_bytes([bytes[5], bytes[6]]));
        if said != found {
            return Err(PacketError::Length { found: said, least: found, most: found });
        }
        let (found, expected) = (u16::from_le_bytes(*check), crc16(checked));
        if found != expected {
            return Err(PacketError::Crc { found, expected });
        }
        // An answer to a fast sync read is put together by many devices, which stuff nothing.
        let raw = &checked[BEFORE..];
        let fast = bytes[4] == BROADCAST && raw[0] == crate::code::STATUS;
        let mut body = if fast { raw.to_vec() } else { unstuff(raw) };
        let instruction = body.remove(0);
        Ok(Self { id: bytes[4], instruction, params: body })
    }
}

/// Header, address, length and check around a body that is stuffed already.
pub(crate) fn frame(id: u8, body: &[u8]) -> Result<Vec<u8>, PacketError> {
    let length = body.len() + 2;
    let most = MAX_PACKET - BEFORE;
    let wrong = PacketError::Length { found: length, least: LEAST_LENGTH, most };
    let field = u16::try_from(length).ok().filter(|_| length <= most).ok_or(wrong)?;
    let mut out = Vec::with_capacity(BEFORE + length);
    out.extend_from_slice(&HEADER);
    out.push(id);
    out.extend_from_slice(&field.to_le_bytes());
    out.extend_from_slice(body);
    let check = crc16(&out);
    out.extend_from_slice(&check.to_le_bytes());
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_stuffed_goal_is_the_published_packet() {
        // Goal position (116) 0x00FDFFFF to motor 3.
        let packet = Packet { id: 3, instruction: 3, params: vec![0x74, 0, 0xFF, 0xFF, 0xFD, 0] };
        let wire = [0xFF, 0xFF, 0xFD, 0, 3, 0x0A, 0, 3, 0x74, 0, 0xFF, 0xFF, 0xFD, 0xFD, 0, 0xA2, 0x4D];
        assert_eq!(packet.encode().unwrap(), wire);
        assert_eq!(Packet::decode(&wire).unwrap(), packet);
    }

    #[test]
    fn what_no_packet_carries_is_refused() {
        let packet = Packet { id: 1, instruction: 3, params: vec![0; MAX_PACKET] };
        assert!(matches!(packet.encode(), Err(PacketError::Length { .. })));
        let mut wire = Packet { id: 1, instruction: 1, params: vec![] }.encode().unwrap();
        wire[8] ^= 1;
        let error = Packet::decode(&wire).unwrap_err();
        assert_eq!(error.to_string(), "CRC: found 0x4e18, expected 0x4e19");
        assert!(matches!(Packet::decode(&wire[..9]), Err(PacketError::Length { .. })));
    }

    proptest! {
        #[test]
        fn any_packet_comes_back(
            id in 0u8..=252,
            instruction in 1u8..0x50,
            params in proptest::collection::vec(prop_oneof![Just(0xFFu8), Just(0xFD), any::<u8>()], 0..100),
        ) {
            let packet = Packet { id, instruction, params };
            prop_assert_eq!(Packet::decode(&packet.encode().unwrap()).unwrap(), packet);
        }

        #[test]
        fn no_bytes_panic(bytes in proptest::collection::vec(any::<u8>(), 0..40)) {
            let _ = Packet::decode(&bytes);
            let mut headed = HEADER.to_vec();
            headed.extend(bytes);
            let _ = Packet::decode(&headed);
        }
    }
}
