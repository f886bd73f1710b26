//! The packet check: CRC-16 with polynomial 0x8005, start 0, not reflected (also known as CRC-16/UMTS).

const TABLE: [u16; 256] = table();

const fn table() -> [u16; 256] {
    let mut table = [0u16; 256];
    let mut i = 0;
    while i < 256 {
        let mut crc = (i as u16) << 8;
        let mut bit = 0;
        while bit < 8 {
            crc = if crc & 0x8000 == 0 { crc << 1 } else { (crc << 1) ^ 0x8005 };
            bit += 1;
        }
        table[i] = crc;
        i += 1;
    }
    table
}

/// Check of `bytes`: everything from the first byte of the header to the last parameter, after stuffing.
pub fn crc16(bytes: &[u8]) -> u16 {
    crc16_more(0, bytes)
}

/// Check of what came before with check `crc`, and `bytes` after it.
pub fn crc16_more(crc: u16, bytes: &[u8]) -> u16 {
    bytes.iter().fold(crc, |crc, byte| {
        let [high, _] = crc.to_be_bytes();
        (crc << 8) ^ TABLE[usize::from(high ^ byte)]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_check_is_the_published_one() {
        assert_eq!(TABLE[1], 0x8005);
        // CRC-16/UMTS's check value in catalogues of such functions.
        assert_eq!(crc16(b"123456789"), 0xFEE8);
        // The manual's ping of motor 1.
        assert_eq!(crc16(&[0xFF, 0xFF, 0xFD, 0x00, 0x01, 0x03, 0x00, 0x01]), 0x4E19);
    }

    #[test]
    fn a_check_goes_on_where_it_stopped() {
        assert_eq!(crc16_more(crc16(b"1234"), b"56789"), crc16(b"123456789"));
    }
}
