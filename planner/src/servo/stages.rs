//! How long the parts of a frame took.

use std::time::Duration;

use crate::budget::Budget;

/// Stage durations from a budget's clock.
pub(super) struct Stages<'a> {
    budget: &'a dyn Budget,
    since: Duration,
    pub(super) done: Vec<(&'static str, Duration)>,
}

impl<'a> Stages<'a> {
    pub(super) fn new(budget: &'a dyn Budget) -> Self {
        Self { budget, since: budget.elapsed(), done: Vec::with_capacity(4) }
    }

    pub(super) fn end(&mut self, name: &'static str) {
        let now = self.budget.elapsed();
        self.done.push((name, now.saturating_sub(self.since)));
        self.since = now;
    }
}
