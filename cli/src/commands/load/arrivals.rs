//! When calls are due: fixed before the first is sent.

use std::time::Duration;

use super::Spacing;
use super::mix::Draw;

/// Due times between zero and an end, at a rate that grows evenly.
#[derive(Debug, Clone, Copy)]
pub(super) struct Arrivals {
    /// Rate at the beginning, calls a second.
    pub(super) from: f64,
    /// Rate at the end.
    pub(super) to: f64,
    pub(super) over: Duration,
    pub(super) spacing: Spacing,
    pub(super) seed: u64,
}

impl Arrivals {
    /// The due times, in order.
    pub(super) fn due_times(self) -> impl Iterator<Item = Duration> {
        let whole = self.over.as_secs_f64();
        // Unit-rate arrivals, taken through the inverse of the expected number of calls until a time.
        let mut expected = 0.0;
        let mut number = 0u64;
        std::iter::from_fn(move || {
            expected += match self.spacing {
                Spacing::Constant => 1.0,
                Spacing::Poisson => -(1.0 - Draw::of(self.seed, number, 0).share()).ln(),
            };
            number += 1;
            let at = self.when(expected, whole);
            (at < whole).then(|| Duration::from_secs_f64(at))
        })
    }

    /// The time by which so many calls are expected: solves `from·t + (to − from)·t²/(2·whole) = expected`.
    fn when(&self, expected: f64, whole: f64) -> f64 {
        let growth = (self.to - self.from) / whole;
        if growth.abs() < 1e-12 {
            return expected / self.from;
        }
        let root = self.from * self.from + 2.0 * growth * expected;
        if root < 0.0 { f64::INFINITY } else { 2.0 * expected / (self.from + root.sqrt()) }
    }
}
