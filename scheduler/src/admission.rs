//! When waiting jobs would begin and end if nothing else came: list scheduling on the slots.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::time::Duration;

use crate::types::{Ask, Time};

/// When each slot is free.
#[derive(Debug, Clone)]
pub(crate) struct Forecast {
    now: Time,
    free: BinaryHeap<Reverse<Time>>,
}

impl Forecast {
    /// Slots of which some are busy until then.
    pub(crate) fn new(now: Time, slots: usize, mut busy: Vec<Time>) -> Self {
        // More may run than there are slots here (servo jobs in slots of their own): the first to end count least.
        busy.sort_unstable();
        let skip = busy.len().saturating_sub(slots);
        let mut free: BinaryHeap<_> = busy.into_iter().skip(skip).map(Reverse).collect();
        free.extend(std::iter::repeat_n(Reverse(now), slots.saturating_sub(free.len())));
        Self { now, free }
    }

    /// How long until a slot is free.
    pub(crate) fn next_free(&self) -> Duration {
        self.free.peek().map_or(Duration::ZERO, |Reverse(at)| at.saturating_sub(self.now))
    }

    /// When the least of job `at` of these, which begin in this order, would be done.
    pub(crate) fn finish(&self, jobs: &[&Ask], at: usize) -> Time {
        let least = jobs.get(at).map_or(Duration::ZERO, |job| job.estimate.least);
        self.starts(jobs).nth(at).unwrap_or(self.now) + least
    }

    /// Which of these jobs would meet their deadlines.
    pub(crate) fn meets(&self, jobs: &[&Ask]) -> Vec<bool> {
        let starts = self.starts(jobs).zip(jobs);
        starts.map(|(start, job)| job.deadline.is_none_or(|d| start + job.estimate.least <= d)).collect()
    }

    fn starts<'a>(&self, jobs: &'a [&'a Ask]) -> impl Iterator<Item = Time> + use<'a> {
        let mut free = self.free.clone();
        let now = self.now;
        jobs.iter().map(move |job| {
            let Some(Reverse(start)) = free.pop() else { return now };
            // What has expired by then takes nothing; what ends at its deadline takes no more than until then.
            let end = start + job.estimate.expected;
            let end = job.deadline.map_or(end, |d| end.min(d.max(start)));
            free.push(Reverse(end));
            start
        })
    }
}
