//! Watching a run, and asking it to end.

use crate::record::{AttemptRecord, StepRecord};
use crate::recovery::Recovery;
use crate::report::{Report, Tally};
use crate::steps::{Step, Trouble};

/// What happens in a run.
#[derive(Debug)]
pub enum Event<'a> {
    /// A step begins.
    StepBegan {
        /// Attempt, from 1.
        attempt: u32,
        /// The step.
        step: Step,
    },
    /// A step met trouble.
    Trouble {
        /// Attempt.
        attempt: u32,
        /// The step.
        step: Step,
        /// Kind.
        trouble: Trouble,
        /// The device's or planner's words.
        text: &'a str,
        /// What is done about it.
        recovery: Recovery,
    },
    /// A step ended.
    StepEnded {
        /// Attempt.
        attempt: u32,
        /// How.
        record: &'a StepRecord,
    },
    /// An attempt ended.
    AttemptEnded {
        /// How.
        record: &'a AttemptRecord,
        /// Everything counted so far.
        tally: &'a Tally,
    },
    /// The run ended.
    Ended(&'a Report),
}

/// Somebody who watches a run.
pub trait Observer: Send + Sync {
    /// Sees what happens; must be quick.
    fn on(&mut self, event: &Event<'_>);

    /// True when the run shall end: it delivers what is in the hand, begins no further attempt, and reports.
    fn wants_end(&self) -> bool {
        false
    }
}

/// Watches nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Observer for Silent {
    fn on(&mut self, _event: &Event<'_>) {}
}
