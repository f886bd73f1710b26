//! Time for the planner, which has no clock of its own.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use graspd_planner::budget::{Budget, Stop};

/// A budget on the computer's monotonic clock.
#[derive(Debug)]
pub(crate) struct StdBudget {
    start: Instant,
    limit: Option<Duration>,
    cancelled: AtomicBool,
}

impl StdBudget {
    /// Starts now and ends after `limit`, or never.
    pub(crate) fn new(limit: Option<Duration>) -> Self {
        Self { start: Instant::now(), limit, cancelled: AtomicBool::new(false) }
    }

    /// Asks the work to stop.
    pub(crate) fn cancel(&self) {
        self.cancelled.store(true, Ordering::Relaxed);
    }
}

impl Budget for StdBudget {
    fn elapsed(&self) -> Duration {
        self.start.elapsed()
    }

    fn stop(&self) -> Option<Stop> {
        if self.cancelled.load(Ordering::Relaxed) {
            return Some(Stop::Cancelled);
        }
        self.limit.filter(|&limit| self.start.elapsed() >= limit).map(|_| Stop::Deadline)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stops_after_its_limit_and_when_cancelled() {
        assert_eq!(StdBudget::new(None).stop(), None);
        assert_eq!(StdBudget::new(Some(Duration::ZERO)).stop(), Some(Stop::Deadline));
        let budget = StdBudget::new(Some(Duration::from_secs(3600)));
        assert_eq!(budget.stop(), None);
        budget.cancel();
        assert_eq!(budget.stop(), Some(Stop::Cancelled));
    }
}
