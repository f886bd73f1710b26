//! Use cases: the camera's modes, whose names tell what they are.
//!
//! `MODE_9_10FPS_1000`: nine raw phases (two modulation frequencies, long range) or five (one, near), frames a second, longest
//! exposure in microseconds. The camera itself says which it has; firmware adds some with other names.

/// What a name tells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UseCase {
    /// Raw phases of a frame: 9 or 5.
    pub phases: u32,
    /// Frames a second.
    pub hz: u32,
    /// Longest exposure, microseconds.
    pub exposure_us: u32,
}

/// The names that cameras are known to have, and that tell all of it.
pub const KNOWN: [&str; 6] = [
    "MODE_9_5FPS_2000",
    "MODE_9_10FPS_1000",
    "MODE_9_15FPS_700",
    "MODE_9_25FPS_450",
    "MODE_5_35FPS_600",
    "MODE_5_45FPS_500",
];

impl UseCase {
    /// Reads a name; `None` for one that does not tell, such as `MODE_MIXED_30_5`.
    pub fn parse(name: &str) -> Option<Self> {
        let rest = name.strip_prefix("MODE_")?;
        let (phases, rest) = rest.split_once('_')?;
        let (hz, exposure) = rest.split_once("FPS_")?;
        let (phases, hz, exposure_us) = (phases.parse().ok()?, hz.parse().ok()?, exposure.parse().ok()?);
        let possible = matches!(phases, 5 | 9) && (1..=200).contains(&hz);
        possible.then_some(Self { phases, hz, exposure_us })
    }

    /// Closest and farthest depth, metres: 4 m with two frequencies (the data sheet), 1 m with one.
    pub fn range_m(self) -> (f64, f64) {
        (0.1, if self.phases == 9 { 4.0 } else { 1.0 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn names_tell_phases_rate_and_exposure() {
        let case = UseCase::parse("MODE_9_10FPS_1000").unwrap();
        assert_eq!(case, UseCase { phases: 9, hz: 10, exposure_us: 1000 });
        assert_eq!((case.range_m().1, UseCase::parse(KNOWN[5]).unwrap().range_m().1), (4.0, 1.0));
        assert!(KNOWN.iter().all(|name| UseCase::parse(name).is_some()));
        for other in ["MODE_MIXED_30_5", "Low_Noise_Extended", "MODE_9_0FPS_1", "MODE_7_10FPS_1", ""] {
            assert_eq!(UseCase::parse(other), None, "{other}");
        }
    }

    proptest! {
        #[test]
        fn arbitrary_names_end_without_panic(name in "\\PC*", tail in "MODE_[0-9_FPS]{0,20}") {
            let _other = (UseCase::parse(&name), UseCase::parse(&tail));
        }
    }
}
