//! Names of files: the time of their beginning, so that their order is that of time.

use std::path::Path;

/// Every file of a recording begins with this.
const PREFIX: &str = "graspd-";

/// The name of a file that begins at this time, milliseconds since 1970, for example
/// `graspd-20260131T235959.123Z.mcap`.
pub(crate) fn file_name(unix_ms: u64) -> String {
    let (days, ms) = (unix_ms / 86_400_000, unix_ms % 86_400_000);
    let (year, month, day) = civil(days);
    let (h, m, s, ms) = (ms / 3_600_000, ms / 60_000 % 60, ms / 1000 % 60, ms % 1000);
    format!("{PREFIX}{year:04}{month:02}{day:02}T{h:02}{m:02}{s:02}.{ms:03}Z.mcap")
}

/// True for the name of a file of a recording.
pub(crate) fn is_recording(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    name.starts_with(PREFIX) && name.ends_with("Z.mcap") && name.len() == file_name(0).len()
}

/// Year, month and day of a day since 1970 (Howard Hinnant, "chrono-compatible low-level date algorithms").
fn civil(days: u64) -> (u64, u64, u64) {
    let z = days + 719_468;
    let (era, day_of_era) = (z / 146_097, z % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * shifted + 2) / 5 + 1;
    let month = if shifted < 10 { shifted + 3 } else { shifted - 9 };
    (era * 400 + year_of_era + u64::from(month <= 2), month, day)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_those_of_the_calendar() {
        let cases = [
            (0, "graspd-19700101T000000.000Z.mcap"),
            (951_782_399_999, "graspd-20000228T235959.999Z.mcap"),
            (951_782_400_000, "graspd-20000229T000000.000Z.mcap"),
            (1_767_225_599_123, "graspd-20251231T235959.123Z.mcap"),
            (4_107_542_400_000, "graspd-21000301T000000.000Z.mcap"),
        ];
        for (ms, expected) in cases {
            assert_eq!(file_name(ms), expected);
            assert!(is_recording(Path::new("/x").join(expected).as_path()));
        }
        for other in ["graspd-.mcap", "other.mcap", "graspd-20000228T235959.999Z.mcap.part", ""] {
            assert!(!is_recording(Path::new(other)), "{other}");
        }
    }
}
