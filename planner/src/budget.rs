//! Time and cancellation, passed in: the planner has no clock of its own.

use std::time::Duration;

/// Why planning has to stop before its end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stop {
    /// The time is used up: return the best so far.
    Deadline,
    /// Nobody waits for the answer any more: return quickly, the result is thrown away.
    Cancelled,
}

/// What the planner asks while it works; called from several threads, at least every iteration of every
/// candidate, so it must be cheap.
pub trait Budget: Sync {
    /// Time since the call began, for stage durations. May stand still (then durations are zero).
    fn elapsed(&self) -> Duration;

    /// `Some` once work has to stop, and from then on: what is left out for it is never put in again.
    fn stop(&self) -> Option<Stop>;

    /// Time left until [`Stop::Deadline`], where there is one and it is known: a search that cannot do all of its
    /// iterations begins early with the last of them, those that keep the hand out of things.
    fn remaining(&self) -> Option<Duration> {
        None
    }

    /// [`Budget::stop`] as an error, for work of several steps that each take milliseconds.
    ///
    /// # Errors
    /// [`Stop`] once work has to stop.
    fn check(&self) -> Result<(), Stop> {
        self.stop().map_or(Ok(()), Err)
    }

    /// True once nobody waits for the answer any more: for work whose result still counts after a deadline.
    fn is_cancelled(&self) -> bool {
        self.stop() == Some(Stop::Cancelled)
    }
}

/// Never stops and has no clock.
#[derive(Debug, Clone, Copy, Default)]
pub struct Unlimited;

impl Budget for Unlimited {
    fn elapsed(&self) -> Duration {
        Duration::ZERO
    }

    fn stop(&self) -> Option<Stop> {
        None
    }
}
