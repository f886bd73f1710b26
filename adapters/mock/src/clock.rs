//! The world's clock as others read it: without waiting for the world's thread.

use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::time::Duration;

/// Time of a world, written by its thread after each step.
#[derive(Debug, Default)]
pub(crate) struct Clock {
    time_bits: AtomicU64,
    paused: AtomicBool,
    holds: AtomicUsize,
}

impl Clock {
    /// Seconds on the world's clock.
    pub(crate) fn now_s(&self) -> f64 {
        f64::from_bits(self.time_bits.load(Ordering::Acquire))
    }

    pub(crate) fn set(&self, time_s: f64) {
        self.time_bits.store(time_s.to_bits(), Ordering::Release);
    }

    fn is_paused(&self) -> bool {
        self.paused.load(Ordering::Acquire)
    }

    /// True while the world must not step.
    pub(crate) fn stands(&self) -> bool {
        self.is_paused() || self.holds.load(Ordering::Acquire) > 0
    }

    pub(crate) fn hold(&self) {
        self.holds.fetch_add(1, Ordering::AcqRel);
    }

    pub(crate) fn release(&self) {
        self.holds.fetch_sub(1, Ordering::AcqRel);
    }

    pub(crate) fn pause(&self, paused: bool) {
        self.paused.store(paused, Ordering::Release);
    }
}

/// Seconds as a duration; nothing for what is negative or not a number.
pub(crate) fn duration(seconds: f64) -> Duration {
    Duration::try_from_secs_f64(seconds.max(0.0)).unwrap_or(Duration::ZERO)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_clock_says_what_was_set() {
        let clock = Clock::default();
        assert_eq!(clock.now_s(), 0.0);
        clock.set(1.25);
        clock.pause(true);
        assert!(clock.now_s() == 1.25 && clock.is_paused());
        clock.pause(false);
        clock.hold();
        assert!(clock.stands());
        clock.release();
        assert!(!clock.stands());
        assert_eq!(duration(-1.0), Duration::ZERO);
        assert_eq!(duration(f64::NAN), Duration::ZERO);
        assert_eq!(duration(0.5), Duration::from_millis(500));
    }
}
