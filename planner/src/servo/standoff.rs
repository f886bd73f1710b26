//! How near the hand comes, and when it goes straight in.
//!
//! The stand-off is a distance from the grasp against its approach. It shrinks at a steady speed while the grasp is
//! tracked and the hand keeps up with it, stays while it is not, and after a jump it is at least as far beyond its end as
//! the jump was, so that the hand moves sideways where there is room (Supplementary Note 7: from 0.15 m to 0.05 m, the sensing limit of a palm camera, then
//! straight to the grasp).

use std::time::Duration;

/// How the hand comes nearer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StandoffOptions {
    /// Stand-off in the beginning, metres.
    pub start_m: f64,
    /// Where the hand goes straight in, metres.
    pub end_m: f64,
    /// Speed, metres per second.
    pub speed_m_s: f64,
    /// A hand further than this from where it should be is waited for, metres.
    pub lag_m: f64,
}

impl Default for StandoffOptions {
    fn default() -> Self {
        Self { start_m: 0.15, end_m: 0.05, speed_m_s: 0.06, lag_m: 0.04 }
    }
}

/// Frames further apart than this count as so far apart: nobody leaps forward after a pause.
const LONGEST_STEP: Duration = Duration::from_millis(200);
/// So many good frames in a row at the end let the hand go in.
const SURE: usize = 2;

/// What a frame says about coming nearer.
#[derive(Debug, Clone, Copy)]
pub(super) struct Progress {
    /// The grasp is tracked, and nothing speaks against it.
    pub(super) is_good: bool,
    /// How far the grasp has jumped, metres; 0 for one that is tracked.
    pub(super) jump_m: f64,
    /// How far the hand is from where the answer before wanted it, metres, where that is known.
    pub(super) lag_m: Option<f64>,
}

/// The stand-off of one servo.
#[derive(Debug, Clone)]
pub(super) struct Standoff {
    options: StandoffOptions,
    now_m: f64,
    since: Option<Duration>,
    good_at_end: usize,
}

impl Standoff {
    pub(super) fn new(options: StandoffOptions) -> Self {
        Self { now_m: options.start_m, options, since: None, good_at_end: 0 }
    }

    /// The next stand-off, and whether to go straight in.
    pub(super) fn next(&mut self, captured: Duration, progress: &Progress) -> (f64, bool) {
        let o = &self.options;
        let passed = self.since.map_or(Duration::ZERO, |since| captured.saturating_sub(since));
        self.since = Some(captured);
        if progress.jump_m > 0.0 {
            self.now_m = self.now_m.max((o.end_m + progress.jump_m).min(o.start_m));
            self.good_at_end = 0;
            return (self.now_m, false);
        }
        let keeps_up = progress.lag_m.is_none_or(|lag| lag <= o.lag_m);
        if !progress.is_good {
            self.good_at_end = 0;
            return (self.now_m, false);
        }
        if self.now_m <= o.end_m {
            self.good_at_end = if keeps_up { self.good_at_end + 1 } else { 0 };
            return (self.now_m, self.good_at_end >= SURE);
        }
        if keeps_up {
            let step = o.speed_m_s * passed.min(LONGEST_STEP).as_secs_f64();
            self.now_m = (self.now_m - step).max(o.end_m);
        }
        (self.now_m, false)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: Progress = Progress { is_good: true, jump_m: 0.0, lag_m: Some(0.001) };

    #[test]
    fn shrinks_in_time_waits_backs_off_and_goes_in() {
        let mut standoff = Standoff::new(StandoffOptions::default());
        let mut now = Duration::ZERO;
        let mut next = |standoff: &mut Standoff, progress: &Progress| {
            now += Duration::from_millis(100);
            standoff.next(now, progress)
        };
        assert_eq!(next(&mut standoff, &GOOD), (0.15, false), "nothing has passed at the first frame");
        let (at, go) = next(&mut standoff, &GOOD);
        assert!((at - 0.144).abs() < 1e-9 && !go);
        assert_eq!(
            next(&mut standoff, &Progress { lag_m: Some(0.06), ..GOOD }),
            (at, false),
            "waits for the hand"
        );
        assert_eq!(next(&mut standoff, &Progress { is_good: false, ..GOOD }), (at, false));
        for _ in 0..10 {
            next(&mut standoff, &GOOD);
        }
        let near = next(&mut standoff, &GOOD).0;
        let far = Progress { jump_m: 0.08, ..GOOD };
        assert_eq!(next(&mut standoff, &Progress { jump_m: 0.01, ..GOOD }).0, near, "there is room for that");
        assert!((next(&mut standoff, &far).0 - 0.13).abs() < 1e-9, "0.08 m beyond the end");
        assert_eq!(next(&mut standoff, &Progress { jump_m: 1.0, ..GOOD }).0, 0.15, "never beyond the start");
        let frames = (0..100).take_while(|_| !next(&mut standoff, &GOOD).1).count();
        assert_eq!(frames, 18, "100 mm at 6 mm a frame, and one more frame to be sure");
        assert_eq!(standoff.now_m, 0.05);
    }
}
