//! Time for the planner, which has no clock of its own.

use std::time::{Duration, Instant};

use graspd_planner::budget::{Budget, Stop};

/// Measures, and never stops: an evaluation's answers do not depend on how fast the machine is.
#[derive(Debug)]
pub(crate) struct Stopwatch(Instant);

impl Stopwatch {
    /// Starts now.
    pub(crate) fn start() -> Self {
        Self(Instant::now())
    }
}

impl Budget for Stopwatch {
    fn elapsed(&self) -> Duration {
        self.0.elapsed()
    }

    fn stop(&self) -> Option<Stop> {
        None
    }
}
