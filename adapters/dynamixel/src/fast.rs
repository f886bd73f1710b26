//! The one answer to a fast sync read, which devices write one after the other: a header by the first, then of each
//! its error byte, address, data and the check of everything so far.

use crate::packet::BEFORE;
use crate::{BROADCAST, HEADER, MAX_PACKET, Packet, PacketError, StatusError, code, crc16};

/// What one device wrote.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FastBlock {
    /// Who.
    pub id: u8,
    /// Its error byte.
    pub error: StatusError,
    /// What was read.
    pub data: Vec<u8>,
}

/// Length field of the answer of `devices` devices with `len` bytes each.
pub fn fast_sync_len(devices: usize, len: usize) -> usize {
    1 + devices * (len + 4)
}

/// The answer as it goes over the wire. `expected` devices were asked: when fewer answer, the packet ends early and
/// its length field is wrong, as on a real bus where a device is missing.
///
/// # Errors
/// [`PacketError::Length`] when it would be too long, [`PacketError::Parameters`] when data are not equally long.
pub fn encode_fast_sync(blocks: &[FastBlock], expected: usize) -> Result<Vec<u8>, PacketError> {
    let len = blocks.first().map_or(0, |b| b.data.len());
    let length = fast_sync_len(expected, len);
    let most = MAX_PACKET - BEFORE;
    let wrong = PacketError::Length { found: length, least: 5, most };
    let field = u16::try_from(length).ok().filter(|_| length <= most && expected > 0).ok_or(wrong)?;
    let mut out = HEADER.to_vec();
    out.push(BROADCAST);
    out.extend_from_slice(&field.to_le_bytes());
    out.push(code::STATUS);
    for block in blocks {
        if block.data.len() != len {
            let (found, expected) = (block.data.len(), len.to_string());
            return Err(PacketError::Parameters { field: "FAST SYNC READ block", found, expected });
        }
        out.extend_from_slice(&[block.error.to_byte(), block.id]);
        out.extend_from_slice(&block.data);
        let check = crc16(&out);
        out.extend_from_slice(&check.to_le_bytes());
    }
    Ok(out)
}

/// The blocks of an answer's packet, each with `len` bytes of data; the check of every block is looked at.
///
/// # Errors
/// [`PacketError::Instruction`] for a packet that is no answer, [`PacketError::Parameters`] when the blocks do not fit,
/// [`PacketError::Crc`] for a block whose check is wrong.
pub fn fast_sync_blocks(packet: &Packet, len: usize) -> Result<Vec<FastBlock>, PacketError> {
    if packet.instruction != code::STATUS {
        return Err(PacketError::Instruction { found: packet.instruction });
    }
    let block = len + 4;
    // The packet's own check, the last block's, is not among its parameters.
    let found = packet.params.len() + 2;
    if !found.is_multiple_of(block) {
        let expected = format!("a multiple of {block}, less 2");
        return Err(PacketError::Parameters { field: "FAST SYNC READ", found: found - 2, expected });
    }
    let length = u16::try_from(fast_sync_len(found / block, len)).unwrap_or(u16::MAX);
    let mut before = HEADER.to_vec();
    before.push(packet.id);
    before.extend_from_slice(&length.to_le_bytes());
    before.push(packet.instruction);
    let start = before.len();
    before.extend_from_slice(&packet.params);
    let mut blocks = Vec::with_capacity(found / block);
    for at in (start..before.len()).step_by(block) {
        let end = at + 2 + len;
        if let Some([low, high]) = before.get(end..end + 2) {
            let (found, expected) = (u16::from_le_bytes([*low, *high]), crc16(&before[..end]));
            if found != expected {
                return Err(PacketError::Crc { found, expected });
            }
        }
        let error = StatusError::from_byte(before[at]);
        blocks.push(FastBlock { id: before[at + 1], error, data: before[at + 2..end].to_vec() });
    }
    Ok(blocks)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Decoder, Event};
    use proptest::prelude::*;

    fn block(id: u8, data: &[u8]) -> FastBlock {
        FastBlock { id, error: StatusError::default(), data: data.to_vec() }
    }

    #[test]
    fn each_block_carries_the_check_of_everything_before_it() {
        let blocks = [block(3, &[0xA6, 0, 0, 0]), block(7, &[0x1F, 8, 0, 0])];
        let wire = encode_fast_sync(&blocks, 2).unwrap();
        // The manual's layout: header, FE, length 0x0011, 55; then error, address, four bytes and check of each.
        assert_eq!(wire[..14], [0xFF, 0xFF, 0xFD, 0, 0xFE, 0x11, 0, 0x55, 0, 3, 0xA6, 0, 0, 0]);
        assert_eq!(wire.len(), 7 + 0x11);
        assert_eq!(u16::from_le_bytes([wire[14], wire[15]]), crc16(&wire[..14]));
        assert_eq!(u16::from_le_bytes([wire[22], wire[23]]), crc16(&wire[..22]));
        let packet = Packet::decode(&wire).unwrap();
        assert_eq!(fast_sync_blocks(&packet, 4).unwrap(), blocks);
        assert!(matches!(fast_sync_blocks(&packet, 10), Err(PacketError::Parameters { .. })));
    }

    #[test]
    fn a_missing_device_leaves_the_packet_open() {
        let wire = encode_fast_sync(&[block(3, &[1, 2])], 2).unwrap();
        let mut decoder = Decoder::new();
        decoder.push(&wire);
        assert_eq!(decoder.next_event(), None);
        assert_eq!(decoder.pending(), wire.len());
    }

    proptest! {
        #[test]
        fn data_is_not_stuffed_and_comes_back(data in proptest::collection::vec(proptest::collection::vec(prop_oneof![Just(0xFFu8), Just(0xFD), any::<u8>()], 10), 1..17)) {
            let blocks: Vec<FastBlock> = (0u8..).zip(&data).map(|(id, d)| block(id, d)).collect();
            let wire = encode_fast_sync(&blocks, blocks.len()).unwrap();
            let mut decoder = Decoder::new();
            decoder.push(&wire);
            let Some(Event::Packet(packet)) = decoder.next_event() else { panic!("no packet") };
            prop_assert_eq!(fast_sync_blocks(&packet, 10).unwrap(), blocks);
        }

        #[test]
        fn no_answer_panics(params in proptest::collection::vec(any::<u8>(), 0..100), len in 0usize..20) {
            let packet = Packet { id: BROADCAST, instruction: code::STATUS, params };
            let _ = fast_sync_blocks(&packet, len);
        }
    }
}
