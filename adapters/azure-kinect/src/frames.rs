//! Depth images as frames of a cell, whatever their source.

use std::time::Duration;

use graspd_adapters_core::{DepthFrame, Lens};

/// Counts exposures by their stamps: one that is two periods after the one before was two exposures later.
#[derive(Debug, Clone)]
pub(crate) struct Counter {
    period: Duration,
    last: Option<Duration>,
    sequence: u64,
}

impl Counter {
    pub(crate) fn new(period: Duration) -> Self {
        Self { period, last: None, sequence: 0 }
    }

    /// Number of the exposure with this stamp. A clock that goes back, or far ahead, is another one.
    pub(crate) fn count(&mut self, stamp: Duration) -> u64 {
        let passed = self.last.replace(stamp).and_then(|last| stamp.checked_sub(last));
        let periods = passed.map_or(1.0, |passed| passed.as_secs_f64() / self.period.as_secs_f64());
        let by = if periods.is_finite() && periods < 1e6 { periods.round().max(1.0) as u64 } else { 1 };
        self.sequence += by;
        self.sequence
    }
}

/// A frame of millimetres, row major; 0 stays 0.
pub(crate) fn frame(
    size: (usize, usize),
    mm: &[u16],
    lens: Lens,
    sequence: u64,
    stamp: Duration,
) -> DepthFrame {
    DepthFrame {
        width: size.0,
        height: size.1,
        depth_m: mm.iter().map(|mm| f32::from(*mm) * 1e-3).collect(),
        lens,
        world_from_camera: None,
        sequence,
        stamp,
        age: Duration::ZERO,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exposures_are_counted_by_their_stamps() {
        let mut counter = Counter::new(Duration::from_micros(33_333));
        let mut at = |us: u64| counter.count(Duration::from_micros(us));
        assert_eq!([at(5_000_000), at(5_033_340), at(5_099_990), at(5_100_000)], [1, 2, 4, 5]);
        // A device that was restarted, and nonsense.
        assert_eq!([at(10), at(33_343), at(u64::MAX)], [6, 7, 8]);
    }
}
