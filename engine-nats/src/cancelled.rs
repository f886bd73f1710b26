//! Jobs that were cancelled lately: a worker may hear of a cancellation before it gets the job.

use std::collections::{HashSet, VecDeque};

/// At most so many are remembered.
const MOST: usize = 4096;

/// Names of cancelled jobs, the latest [`MOST`].
#[derive(Debug, Default)]
pub(crate) struct Cancelled {
    known: HashSet<String>,
    order: VecDeque<String>,
}

impl Cancelled {
    /// Remembers one.
    pub(crate) fn insert(&mut self, job: &str) {
        if self.known.insert(job.to_owned()) {
            self.order.push_back(job.to_owned());
        }
        if self.order.len() > MOST
            && let Some(oldest) = self.order.pop_front()
        {
            self.known.remove(&oldest);
        }
    }

    /// True if it was cancelled.
    pub(crate) fn contains(&self, job: &str) -> bool {
        self.known.contains(job)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_latest_are_remembered_and_no_more() {
        let mut cancelled = Cancelled::default();
        for i in 0..MOST + 10 {
            cancelled.insert(&i.to_string());
            cancelled.insert(&i.to_string());
        }
        assert!(!cancelled.contains("9") && cancelled.contains("10"));
        assert_eq!((cancelled.known.len(), cancelled.order.len()), (MOST, MOST));
    }
}
