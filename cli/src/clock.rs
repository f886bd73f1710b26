//! Time for the planner, which has no clock of its own.

use std::time::{Duration, Instant};

use graspd_planner::budget::{Budget, Stop};

/// A budget on the computer's monotonic clock.
#[derive(Debug)]
pub(crate) struct StdBudget {
    start: Instant,
    limit: Option<Duration>,
}

impl StdBudget {
    /// Starts now and ends after `limit`, or never.
    pub(crate) fn new(limit: Option<Duration>) -> Self {
        Self { start: Instant::now(), limit }
    }
}

impl Budget for StdBudget {
    fn elapsed(&self) -> Duration {
        self.start.elapsed()
    }

    fn stop(&self) -> Option<Stop> {
        self.limit.filter(|&limit| self.start.elapsed() >= limit).map(|_| Stop::Deadline)
    }

    fn remaining(&self) -> Option<Duration> {
        self.limit.map(|limit| limit.saturating_sub(self.start.elapsed()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stops_after_its_limit() {
        assert_eq!(StdBudget::new(None).stop(), None);
        assert_eq!(StdBudget::new(Some(Duration::ZERO)).stop(), Some(Stop::Deadline));
        let budget = StdBudget::new(Some(Duration::from_secs(3600)));
        assert_eq!(budget.stop(), None);
        assert!(budget.remaining().is_some_and(|left| left > Duration::from_secs(3599)));
        assert_eq!(StdBudget::new(None).remaining(), None);
        assert_eq!(StdBudget::new(Some(Duration::ZERO)).remaining(), Some(Duration::ZERO));
    }
}
