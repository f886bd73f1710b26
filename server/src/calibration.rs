//! From scores to shares of success: a monotone map, as a file, where a score becomes a wire value.
//!
//! The planner's score ranks grasps; how many grasps of a score succeed depends on the site: its objects, its hand,
//! its arm. A calibration says so. It never changes the order of grasps.

mod fit;

pub use fit::{Fitted, LEAST_OF_EACH, LEAST_OUTCOMES, TooLittle, Trial, fit};

use serde::{Deserialize, Serialize};

/// Names the format, and its version.
const FORMAT: &str = "graspd-calibration/1";
/// More knots than this are no smooth map.
const MOST_KNOTS: usize = 4096;

/// A monotone map from a score to the share of grasps of that score that succeeded.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    format: String,
    /// What answers call it.
    pub name: String,
    /// Outcomes that it was learned from.
    pub outcome_count: u32,
    /// Of those, successes.
    pub success_count: u32,
    /// When it was learned, seconds since 1970.
    pub created_unix_s: i64,
    /// Score and share of success, from score 0 to score 1; straight lines between.
    knots: Vec<(f64, f64)>,
}

/// Why a file is no calibration.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("calibration: {field}: found {found}, expected {expected}")]
pub struct WrongCalibration {
    /// The key.
    pub field: String,
    /// What was there.
    pub found: String,
    /// What should have been.
    pub expected: &'static str,
}

impl Calibration {
    /// A calibration from its knots.
    ///
    /// # Errors
    /// [`WrongCalibration`] for knots that are no monotone map from [0, 1] into [0, 1], and a name that is none.
    pub fn new(
        name: impl Into<String>,
        (outcome_count, success_count): (u32, u32),
        created_unix_s: i64,
        knots: Vec<(f64, f64)>,
    ) -> Result<Self, WrongCalibration> {
        let format = FORMAT.to_owned();
        let calibration =
            Self { format, name: name.into(), outcome_count, success_count, created_unix_s, knots };
        calibration.check()?;
        Ok(calibration)
    }

    /// Reads a file's text.
    ///
    /// # Errors
    /// [`WrongCalibration`].
    pub fn parse(json: &str) -> Result<Self, WrongCalibration> {
        let calibration: Self = serde_json::from_str(json).map_err(|e| WrongCalibration {
            field: "file".to_owned(),
            found: e.to_string(),
            expected: "what graspd recalibrate writes",
        })?;
        calibration.check()?;
        Ok(calibration)
    }

    /// The text of its file.
    pub fn to_json(&self) -> String {
        // Numbers and text only: this cannot fail.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }

    /// The share of success of a score; scores beyond 0 and 1 are taken as these.
    pub fn share(&self, score: f64) -> f64 {
        let at = self.knots.partition_point(|(x, _)| *x < score);
        match (at.checked_sub(1).and_then(|i| self.knots.get(i)), self.knots.get(at)) {
            (Some(&(x0, y0)), Some(&(x1, y1))) => y0 + (y1 - y0) * (score - x0) / (x1 - x0),
            (None, Some(&(_, y))) | (Some(&(_, y)), None) => y,
            (None, None) => score,
        }
    }

    /// The least score with that share of success, or 1 where no score has.
    pub fn score(&self, share: f64) -> f64 {
        let at = self.knots.partition_point(|(_, y)| *y < share);
        match (at.checked_sub(1).and_then(|i| self.knots.get(i)), self.knots.get(at)) {
            (Some(&(x0, y0)), Some(&(x1, y1))) => x0 + (x1 - x0) * (share - y0) / (y1 - y0),
            (None, Some(&(x, _))) => x,
            _ => 1.0,
        }
    }

    fn check(&self) -> Result<(), WrongCalibration> {
        let wrong = |field: String, found: String, expected| Err(WrongCalibration { field, found, expected });
        if self.format != FORMAT {
            return wrong("format".to_owned(), format!("{:?}", self.format), FORMAT);
        }
        if self.name.is_empty() || self.name.len() > 128 {
            return wrong("name".to_owned(), format!("{} bytes", self.name.len()), "1 to 128 bytes");
        }
        if !(2..=MOST_KNOTS).contains(&self.knots.len()) {
            return wrong("knots".to_owned(), format!("{} of them", self.knots.len()), "2 to 4096");
        }
        for (i, &(x, y)) in self.knots.iter().enumerate() {
            let last = i + 1 == self.knots.len();
            let before = i.checked_sub(1).and_then(|i| self.knots.get(i));
            let in_place = match before {
                None => x == 0.0,
                Some(&(x0, y0)) => x > x0 && y >= y0,
            };
            if !in_place || !(0.0..=1.0).contains(&y) || (last && x != 1.0) {
                let expected = "scores that rise from 0 to 1, and shares from 0 to 1 that do not fall";
                return wrong(format!("knots[{i}]"), format!("({x}, {y})"), expected);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn bent() -> Calibration {
        Calibration::new("site", (100, 60), 0, vec![(0.0, 0.1), (0.5, 0.2), (0.75, 0.2), (1.0, 0.9)]).unwrap()
    }

    proptest! {
        #[test]
        fn order_never_changes(a in 0.0f64..=1.0, b in 0.0f64..=1.0) {
            let (low, high) = (a.min(b), a.max(b));
            prop_assert!(bent().share(low) <= bent().share(high));
        }

        #[test]
        fn a_least_share_is_a_least_score(share in 0.1f64..=0.9, score in 0.0f64..=1.0) {
            let least = bent().score(share);
            prop_assert!((bent().share(least) - share).abs() < 1e-9);
            // Whoever has that score has that share, and nobody below.
            if (score - least).abs() > 1e-9 {
                prop_assert_eq!(score > least, bent().share(score) >= share);
            }
        }

        #[test]
        fn any_text_is_read_or_refused(text in ".{0,200}") {
            prop_assert!(Calibration::parse(&text).is_err());
        }
    }

    #[test]
    fn ends_and_knots_are_met() {
        let bent = bent();
        for (score, share) in
            [(-1.0, 0.1), (0.0, 0.1), (0.25, 0.15), (0.5, 0.2), (0.6, 0.2), (1.0, 0.9), (2.0, 0.9)]
        {
            assert!((bent.share(score) - share).abs() < 1e-12, "{score}");
        }
        assert_eq!((bent.score(0.0), bent.score(0.95)), (0.0, 1.0));
        assert_eq!(Calibration::parse(&bent.to_json()), Ok(bent));
    }

    #[test]
    fn what_is_no_monotone_map_is_named() {
        let wrong =
            |knots: &[(f64, f64)]| Calibration::new("x", (1, 1), 0, knots.to_vec()).unwrap_err().field;
        assert_eq!(wrong(&[(0.0, 0.5)]), "knots");
        assert_eq!(wrong(&[(0.1, 0.5), (1.0, 0.6)]), "knots[0]");
        assert_eq!(wrong(&[(0.0, 0.5), (1.0, 0.4)]), "knots[1]");
        assert_eq!(wrong(&[(0.0, 0.5), (0.9, 0.6)]), "knots[1]");
        assert_eq!(wrong(&[(0.0, 0.5), (1.0, f64::NAN)]), "knots[1]");
        assert_eq!(Calibration::new("", (1, 1), 0, vec![(0.0, 0.0), (1.0, 1.0)]).unwrap_err().field, "name");
        let newer = bent().to_json().replace("calibration/1", "calibration/2");
        assert_eq!(Calibration::parse(&newer).unwrap_err().field, "format");
    }
}
