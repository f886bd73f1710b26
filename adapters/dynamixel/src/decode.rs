//! Packets out of a stream of bytes.

use crate::packet::{BEFORE, LEAST_LENGTH};
use crate::{BROADCAST, HEADER, MAX_PACKET, Packet, PacketError, code};

/// What a stream held.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Event {
    /// A packet whose check is right.
    Packet(Packet),
    /// Bytes that were no packet, and why; the stream goes on after them.
    Broken(PacketError),
    /// So many bytes between packets.
    Skipped(usize),
}

/// Finds packets in bytes that come in any pieces. Keeps no more than one packet's bytes, whatever a length field says.
#[derive(Debug, Clone, Default)]
pub struct Decoder {
    bytes: Vec<u8>,
}

impl Decoder {
    /// A decoder that has seen nothing.
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes bytes as they come.
    pub fn push(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    /// Forgets what is not a whole packet yet.
    pub fn clear(&mut self) {
        self.bytes.clear();
    }

    /// Bytes of a packet that is not whole yet.
    pub fn pending(&self) -> usize {
        self.bytes.len()
    }

    /// The next thing in the stream; `None` when more bytes are needed.
    pub fn next_event(&mut self) -> Option<Event> {
        let start = self.header_at();
        if start > 0 {
            self.bytes.drain(..start);
            return Some(Event::Skipped(start));
        }
        if self.bytes.len() < BEFORE {
            return None;
        }
        let length = usize::from(u16::from_le_bytes([self.bytes[5], self.bytes[6]]));
        let most = MAX_PACKET - BEFORE;
        if !(LEAST_LENGTH..=most).contains(&length) {
            self.skip_header();
            return Some(Event::Broken(PacketError::Length { found: length, least: LEAST_LENGTH, most }));
        }
        let whole = BEFORE + length;
        if self.bytes.len() < whole {
            // A header in what should be this packet's inside: bytes of it were lost, another packet follows.
            // Inside a whole packet stuffing keeps headers out, except in the answer to a fast sync read.
            if self.bytes[4] == BROADCAST && self.bytes.get(BEFORE).is_none_or(|i| *i == code::STATUS) {
                return None;
            }
            let lost = self.bytes[BEFORE..].windows(HEADER.len()).position(|w| w == HEADER)?;
            let found = lost + BEFORE;
            self.bytes.drain(..found);
            return Some(Event::Broken(PacketError::Length { found: length, least: found, most: found }));
        }
        match Packet::decode(&self.bytes[..whole]) {
            Ok(packet) => {
                self.bytes.drain(..whole);
                Some(Event::Packet(packet))
            }
            Err(error) => {
                // The length itself may be garbled: look for a header right after this one.
                self.skip_header();
                Some(Event::Broken(error))
            }
        }
    }

    /// Where the next header begins, or may begin with the bytes that are still to come.
    fn header_at(&self) -> usize {
        (0..self.bytes.len())
            .find(|&i| {
                let rest = &self.bytes[i..];
                let n = rest.len().min(HEADER.len());
                rest[..n] == HEADER[..n]
            })
            .unwrap_or(self.bytes.len())
    }

    fn skip_header(&mut self) {
        self.bytes.drain(..HEADER.len());
    }
}

impl Iterator for Decoder {
    type Item = Event;

    fn next(&mut self) -> Option<Event> {
        self.next_event()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{FastBlock, StatusError, encode_fast_sync};
    use proptest::prelude::*;

    fn ping(id: u8) -> Packet {
        Packet { id, instruction: 1, params: vec![] }
    }

    fn packets(decoder: &mut Decoder) -> Vec<Packet> {
        decoder.filter_map(|e| if let Event::Packet(p) = e { Some(p) } else { None }).collect()
    }

    #[test]
    fn packets_are_found_between_noise_and_after_damage() {
        let mut decoder = Decoder::new();
        let mut bytes = vec![0xFF, 0x00, 0xFF, 0xFF];
        bytes.extend(ping(1).encode().unwrap());
        let mut garbled = ping(2).encode().unwrap();
        garbled[8] ^= 0x40;
        bytes.extend(&garbled);
        // Cut short: the next packet follows at once.
        bytes.extend(&ping(3).encode().unwrap()[..8]);
        bytes.extend(ping(4).encode().unwrap());
        decoder.push(&bytes);
        let events: Vec<Event> = decoder.by_ref().collect();
        let found: Vec<u8> =
            events.iter().filter_map(|e| if let Event::Packet(p) = e { Some(p.id) } else { None }).collect();
        assert_eq!(found, [1, 4], "{events:?}");
        assert!(matches!(events[0], Event::Skipped(_)));
        assert!(events.iter().any(|e| matches!(e, Event::Broken(PacketError::Crc { .. }))));
        assert_eq!(decoder.pending(), 0);
    }

    #[test]
    fn a_length_that_no_packet_has_costs_no_memory_and_no_time() {
        let mut decoder = Decoder::new();
        decoder.push(&[0xFF, 0xFF, 0xFD, 0x00, 0x01, 0xFF, 0xFF]);
        assert!(matches!(
            decoder.next_event(),
            Some(Event::Broken(PacketError::Length { found: 65535, .. }))
        ));
        decoder.push(&ping(7).encode().unwrap());
        assert_eq!(packets(&mut decoder), [ping(7)]);
    }

    #[test]
    fn a_header_in_the_data_of_a_fast_answer_is_data() {
        let block = FastBlock { id: 1, error: StatusError::default(), data: vec![0xFF, 0xFF, 0xFD, 0x00] };
        let wire = encode_fast_sync(&[block], 1).unwrap();
        let mut decoder = Decoder::new();
        for byte in &wire {
            assert_eq!(decoder.next_event(), None);
            decoder.push(&[*byte]);
        }
        assert_eq!(packets(&mut decoder).len(), 1);
    }

    proptest! {
        #[test]
        fn pieces_make_no_difference(cuts in proptest::collection::vec(1usize..9, 1..40), ids in proptest::collection::vec(0u8..=252, 1..6)) {
            let sent: Vec<Packet> = ids.into_iter().map(|id| Packet { id, instruction: 3, params: vec![0xFF, 0xFF, 0xFD, id] }).collect();
            let bytes: Vec<u8> = sent.iter().flat_map(|p| p.encode().unwrap()).collect();
            let (mut decoder, mut found, mut rest) = (Decoder::new(), Vec::new(), &bytes[..]);
            let mut cuts = cuts.into_iter().cycle();
            while !rest.is_empty() {
                let n = cuts.next().unwrap().min(rest.len());
                decoder.push(&rest[..n]);
                found.extend(packets(&mut decoder));
                rest = &rest[n..];
            }
            prop_assert_eq!(found, sent);
        }

        #[test]
        fn no_stream_panics_or_hoards(bytes in proptest::collection::vec(prop_oneof![Just(0xFFu8), Just(0xFD), Just(0), any::<u8>()], 0..3000)) {
            let mut decoder = Decoder::new();
            for piece in bytes.chunks(97) {
                decoder.push(piece);
                while decoder.next_event().is_some() {}
                prop_assert!(decoder.pending() <= MAX_PACKET);
            }
        }

        #[test]
        fn after_any_noise_a_packet_is_found_in_the_end(noise in proptest::collection::vec(any::<u8>(), 0..64)) {
            let mut decoder = Decoder::new();
            decoder.push(&noise);
            // Noise may look like the beginning of a long packet: what it swallows is bounded by its length.
            for _ in 0..2 * MAX_PACKET / 10 {
                decoder.push(&ping(9).encode().unwrap());
            }
            prop_assert!(packets(&mut decoder).contains(&ping(9)));
        }
    }
}
