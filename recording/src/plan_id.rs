//! Names of plans: UUIDs of version 7 (RFC 9562), which begin with the time, so that a plan's file can be found.

use std::fmt;

/// The name of a plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PlanId([u8; 16]);

impl PlanId {
    /// The name of a plan that begins at this time, milliseconds since 1970; `random` makes it unique.
    pub fn new(unix_ms: u64, random: [u8; 10]) -> Self {
        let mut id = [0; 16];
        let (time, rest) = id.split_at_mut(6);
        time.copy_from_slice(&unix_ms.to_be_bytes()[2..]);
        rest.copy_from_slice(&random);
        id[6] = 0x70 | (id[6] & 0x0f);
        id[8] = 0x80 | (id[8] & 0x3f);
        Self(id)
    }

    /// A name as it is written, for example `019ab2c4-73b1-7c10-9f26-3d2f0a61d9f0`; `None` for anything else.
    pub fn parse(text: &str) -> Option<Self> {
        let bytes = text.as_bytes();
        if bytes.len() != 36 {
            return None;
        }
        let mut digits = [0u8; 32];
        let mut at = 0;
        for (i, &byte) in bytes.iter().enumerate() {
            match (i, byte) {
                (8 | 13 | 18 | 23, b'-') => {}
                (8 | 13 | 18 | 23, _) => return None,
                (_, b'0'..=b'9') => {
                    digits[at] = byte - b'0';
                    at += 1;
                }
                (_, b'a'..=b'f') => {
                    digits[at] = byte - b'a' + 10;
                    at += 1;
                }
                _ => return None,
            }
        }
        let mut id = [0; 16];
        for (byte, pair) in id.iter_mut().zip(digits.chunks(2)) {
            *byte = pair[0] << 4 | pair[1];
        }
        (id[6] >> 4 == 7 && id[8] >> 6 == 2).then_some(Self(id))
    }

    /// When the plan began, milliseconds since 1970.
    pub fn unix_ms(self) -> u64 {
        self.0[..6].iter().fold(0, |ms, &byte| ms << 8 | u64::from(byte))
    }
}

impl fmt::Display for PlanId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, byte) in self.0.iter().enumerate() {
            if matches!(i, 4 | 6 | 8 | 10) {
                f.write_str("-")?;
            }
            write!(f, "{byte:02x}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_name_is_read_as_it_was_written(ms in 0u64..1 << 48, random: [u8; 10]) {
            let id = PlanId::new(ms, random);
            prop_assert_eq!(PlanId::parse(&id.to_string()), Some(id));
            prop_assert_eq!(id.unix_ms(), ms);
        }

        #[test]
        fn any_text_is_a_name_or_none(text in "[0-9a-f-]{30,40}") {
            if let Some(id) = PlanId::parse(&text) {
                prop_assert_eq!(id.to_string(), text);
            }
        }
    }

    #[test]
    fn names_are_in_the_order_of_time_and_others_are_refused() {
        let (first, second) = (PlanId::new(999, [255; 10]), PlanId::new(1000, [0; 10]));
        assert!(first < second && first.to_string() < second.to_string());
        assert_eq!(second.to_string(), "00000000-03e8-7000-8000-000000000000");
        for wrong in ["", "x", "00000000-03e8-4000-8000-000000000000", "00000000-03E8-7000-8000-00000000000F"]
        {
            assert_eq!(PlanId::parse(wrong), None, "{wrong}");
        }
        assert_eq!(PlanId::parse("00000000003e8-7000-8000-00000000000-"), None);
    }
}
