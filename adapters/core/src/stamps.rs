//! A device's clock against ours.
//!
//! A frame carries the time of its exposure on the device's clock and arrives some time later. The frames that arrive soonest
//! tell how far the clocks are apart; what others need longer is delay on the way, and counts as age.

use std::time::{Duration, Instant};

/// A window of frames that tells how far the clocks are apart. Two are kept, so that slow drift is followed.
const WINDOW: Duration = Duration::from_secs(10);
/// A stamp that lies further behind the one before it is another clock: the device was restarted.
const RESTART_NS: i128 = 500_000_000;

/// Turns stamps of a device into instants of ours.
#[derive(Debug, Clone)]
pub struct DeviceClock {
    began: Instant,
    /// What even the soonest frame needs from exposure to arrival: no clock can tell.
    latency: Duration,
    window_began: Instant,
    /// Least of (arrival - stamp) in this window and in the one before, nanoseconds.
    least_ns: Option<i128>,
    before_ns: Option<i128>,
    last_stamp_ns: Option<i128>,
}

impl DeviceClock {
    /// Of a device whose frames take at least `latency` from exposure to arrival.
    pub fn new(latency: Duration) -> Self {
        let now = Instant::now();
        Self { began: now, latency, window_began: now, least_ns: None, before_ns: None, last_stamp_ns: None }
    }

    /// When a frame of this stamp that arrived at `arrived` was exposed; never after its arrival.
    pub fn exposed(&mut self, stamp: Duration, arrived: Instant) -> Instant {
        let stamp_ns = nanoseconds(stamp);
        if self.last_stamp_ns.is_some_and(|last| stamp_ns < last - RESTART_NS) {
            (self.least_ns, self.before_ns) = (None, None);
        }
        self.last_stamp_ns = Some(stamp_ns);
        if arrived.saturating_duration_since(self.window_began) > WINDOW {
            self.window_began = arrived;
            self.before_ns = self.least_ns.take();
        }
        let offset_ns = nanoseconds(arrived.saturating_duration_since(self.began)) - stamp_ns;
        let least_ns = self.least_ns.map_or(offset_ns, |least| least.min(offset_ns));
        self.least_ns = Some(least_ns);
        let offset_ns = self.before_ns.map_or(least_ns, |before| before.min(least_ns));
        let delay_ns = nanoseconds(arrived.saturating_duration_since(self.began)) - (stamp_ns + offset_ns);
        let delay = Duration::from_nanos(u64::try_from(delay_ns).unwrap_or(0)) + self.latency;
        // An instant before this machine's own beginning cannot be told, nor does anybody ask for it.
        arrived.checked_sub(delay).unwrap_or(self.began.min(arrived))
    }
}

/// Counts exposures by their stamps, for devices that do not: one that is two periods after the one before was two exposures
/// later.
#[derive(Debug, Clone)]
pub struct ExposureCounter {
    period: Duration,
    last: Option<Duration>,
    sequence: u64,
}

impl ExposureCounter {
    /// Of a device that exposes once in this time.
    pub fn new(period: Duration) -> Self {
        Self { period, last: None, sequence: 0 }
    }

    /// Number of the exposure with this stamp. A clock that goes back, or far ahead, is another one.
    pub fn count(&mut self, stamp: Duration) -> u64 {
        let passed = self.last.replace(stamp).and_then(|last| stamp.checked_sub(last));
        let periods = passed.map_or(1.0, |passed| passed.as_secs_f64() / self.period.as_secs_f64());
        let by = if periods.is_finite() && periods < 1e6 { periods.round().max(1.0) as u64 } else { 1 };
        self.sequence += by;
        self.sequence
    }
}

fn nanoseconds(time: Duration) -> i128 {
    i128::try_from(time.as_nanos()).unwrap_or(i128::MAX / 4)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn delay_on_the_way_counts_as_age() {
        let mut clock = DeviceClock::new(5 * MS);
        let base = Instant::now();
        let stamp = |frame: u32| Duration::from_secs(1000) + 33 * MS * frame;
        for frame in 0..20u32 {
            let delay = if frame == 12 { 40 } else { frame % 3 };
            let arrived = base + 33 * MS * frame + MS * delay;
            let exposed = clock.exposed(stamp(frame), arrived);
            assert_eq!(arrived - exposed, (5 + delay) * MS, "frame {frame}");
        }
    }

    #[test]
    fn a_restarted_device_is_a_new_clock() {
        let mut clock = DeviceClock::new(Duration::ZERO);
        let base = Instant::now();
        clock.exposed(Duration::from_secs(5000), base);
        let arrived = base + Duration::from_secs(3);
        assert_eq!(clock.exposed(Duration::from_secs(1), arrived), arrived);
        let later = arrived + 50 * MS;
        assert_eq!(later - clock.exposed(Duration::from_secs(1) + 33 * MS, later), 17 * MS);
    }

    #[test]
    fn exposures_are_counted_by_their_stamps() {
        let mut counter = ExposureCounter::new(Duration::from_micros(33_333));
        let mut at = |us: u64| counter.count(Duration::from_micros(us));
        assert_eq!([at(5_000_000), at(5_033_340), at(5_099_990), at(5_100_000)], [1, 2, 4, 5]);
        // A device that was restarted, and nonsense.
        assert_eq!([at(10), at(33_343), at(u64::MAX)], [6, 7, 8]);
    }

    #[test]
    fn slow_drift_is_followed() {
        // The device's clock loses 100 us a second: without forgetting, frames would look 60 ms old after ten minutes.
        let mut clock = DeviceClock::new(Duration::ZERO);
        let base = Instant::now();
        let mut oldest = Duration::ZERO;
        for second in 0..600u32 {
            let arrived = base + Duration::from_secs(u64::from(second));
            let stamp = Duration::from_secs(u64::from(second)) - Duration::from_micros(100) * second;
            oldest = oldest.max(arrived - clock.exposed(stamp, arrived));
        }
        assert!(oldest <= 3 * MS, "{oldest:?}");
    }

    proptest! {
        #[test]
        fn nothing_is_exposed_after_it_arrived(
            frames in proptest::collection::vec((any::<u64>(), 0u64..100_000), 1..50), latency in 0u64..1000,
        ) {
            let mut clock = DeviceClock::new(MS * u32::try_from(latency).unwrap());
            let mut arrived = Instant::now();
            for (stamp_us, later_ms) in frames {
                arrived += Duration::from_millis(later_ms);
                prop_assert!(clock.exposed(Duration::from_micros(stamp_us), arrived) <= arrived);
            }
        }
    }
}
