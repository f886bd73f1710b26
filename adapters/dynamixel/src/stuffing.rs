//! Byte stuffing: inside a packet, `FF FF FD` is followed by one `FD` more, so that no header appears in it.

/// Bytes as they go over the wire: one `FD` after each `FF FF FD`.
pub fn stuff(bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(bytes.len() + bytes.len() / 3);
    for byte in bytes {
        out.push(*byte);
        if out.ends_with(&[0xFF, 0xFF, 0xFD]) {
            out.push(0xFD);
        }
    }
    out
}

/// Bytes as they were meant: without the `FD` after each `FF FF FD`. Anything else passes unchanged.
pub fn unstuff(bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(bytes.len());
    let mut after_marker = false;
    for byte in bytes {
        if after_marker && *byte == 0xFD {
            after_marker = false;
            continue;
        }
        out.push(*byte);
        after_marker = out.ends_with(&[0xFF, 0xFF, 0xFD]);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_header_inside_gets_one_more_byte() {
        assert_eq!(stuff(&[0xFF, 0xFF, 0xFD, 0x00]), [0xFF, 0xFF, 0xFD, 0xFD, 0x00]);
        assert_eq!(stuff(&[0xFF, 0xFF, 0xFF, 0xFD]), [0xFF, 0xFF, 0xFF, 0xFD, 0xFD]);
        assert_eq!(unstuff(&[0xFF, 0xFF, 0xFD, 0xFD, 0xFD]), [0xFF, 0xFF, 0xFD, 0xFD]);
    }

    proptest! {
        #[test]
        fn stuffed_bytes_come_back(bytes in proptest::collection::vec(prop_oneof![Just(0xFFu8), Just(0xFD), any::<u8>()], 0..200)) {
            let wire = stuff(&bytes);
            prop_assert!(!wire.windows(4).any(|w| w == [0xFF, 0xFF, 0xFD, 0x00]));
            prop_assert_eq!(unstuff(&wire), bytes);
        }
    }
}
