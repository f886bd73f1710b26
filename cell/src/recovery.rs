//! What is done about trouble: one table, which the loop obeys and the documentation prints.

use std::fmt::Write as _;
use std::time::Duration;

use crate::steps::{Step, Trouble};

/// What the loop does next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Recovery {
    /// Wait (a back-off that doubles) and do the step again.
    Retry,
    /// Clear the device's fault and do the step again.
    ClearAndRetry,
    /// Clear the fault, feel whether the object is still held; go on if it is, else the attempt has failed.
    ClearAndFeel,
    /// Wait and do the step again for as long as the run may last.
    Wait,
    /// Take the next ranked grasp; after the last one look and plan again.
    NextGrasp,
    /// Lift less: back along the approach to the pre-grasp, which is known to be in reach.
    LiftToPregrasp,
    /// The attempt has failed: stop, clear the fault, open the hand, straight back along the approach; plan again.
    Retreat,
    /// Straight back along the approach to where it began; look and plan again.
    BackOff,
    /// Look and plan again: with another seed, then with any reaching direction.
    PlanAgain,
    /// End the run where everything stands, and say why.
    End,
}

impl Recovery {
    /// For people.
    pub fn text(self) -> &'static str {
        match self {
            Self::Retry => "wait (back-off), try again",
            Self::ClearAndRetry => "clear the fault, try again",
            Self::ClearAndFeel => {
                "clear the fault; go on if the hand still feels the object, else the attempt has failed: open \
                 (over the tray after a lift, at the drop pose when carrying), plan again"
            }
            Self::Wait => "wait (back-off), try again until the run's time limit",
            Self::NextGrasp => "take the next ranked grasp; after the last one plan again",
            Self::LiftToPregrasp => "lift to the pre-grasp instead",
            Self::Retreat => {
                "attempt failed: stop, clear the fault, open the hand, straight back; plan again"
            }
            Self::BackOff => {
                "straight back to where the approach began; look and plan again, as after no grasp"
            }
            Self::PlanAgain => {
                "look and plan again, with another seed, every second time with any reaching direction, with the floor told \
                 as it is and lower, with up to 16 times as many candidates"
            }
            Self::End => "end the run where everything stands, and say why",
        }
    }
}

/// One line of the table.
#[derive(Debug, Clone, Copy)]
pub struct Row {
    /// The steps that it is for.
    pub steps: &'static [Step],
    /// The trouble.
    pub trouble: Trouble,
    /// What is done first, up to `[recovery] tries` times.
    pub first: Recovery,
    /// What is done when that did not help.
    pub then: Recovery,
}

const EMPTY_HANDED: &[Step] = &[Step::ClearView];
const ALL_DEVICES: &[Step] = &Step::ALL;

/// The table, first match wins; trouble that no line names ends the run.
pub const TABLE: &[Row] = &[
    Row { steps: ALL_DEVICES, trouble: Trouble::Emergency, first: Recovery::End, then: Recovery::End },
    Row { steps: ALL_DEVICES, trouble: Trouble::Broken, first: Recovery::End, then: Recovery::End },
    Row { steps: EMPTY_HANDED, trouble: Trouble::NoAnswer, first: Recovery::Retry, then: Recovery::End },
    Row { steps: EMPTY_HANDED, trouble: Trouble::Stop, first: Recovery::ClearAndRetry, then: Recovery::End },
    Row { steps: EMPTY_HANDED, trouble: Trouble::OutOfReach, first: Recovery::End, then: Recovery::End },
    Row { steps: &[Step::Capture], trouble: Trouble::NoAnswer, first: Recovery::Retry, then: Recovery::End },
    Row { steps: &[Step::Plan], trouble: Trouble::PlannerAway, first: Recovery::Wait, then: Recovery::Wait },
    Row {
        steps: &[Step::Plan],
        trouble: Trouble::PlannerFailed,
        first: Recovery::Retry,
        then: Recovery::End,
    },
    Row {
        steps: &[Step::Plan, Step::Follow],
        trouble: Trouble::PlannerRefused,
        first: Recovery::End,
        then: Recovery::End,
    },
    Row { steps: &[Step::Plan], trouble: Trouble::NoGrasp, first: Recovery::PlanAgain, then: Recovery::End },
    Row {
        steps: &[Step::Open],
        trouble: Trouble::NoAnswer,
        first: Recovery::ClearAndRetry,
        then: Recovery::End,
    },
    Row { steps: &[Step::Open], trouble: Trouble::Stop, first: Recovery::ClearAndRetry, then: Recovery::End },
    Row {
        steps: &[Step::Open, Step::Pregrasp, Step::Approach],
        trouble: Trouble::OutOfReach,
        first: Recovery::NextGrasp,
        then: Recovery::NextGrasp,
    },
    Row { steps: &[Step::Pregrasp], trouble: Trouble::NoAnswer, first: Recovery::Retry, then: Recovery::End },
    Row {
        steps: &[Step::Pregrasp],
        trouble: Trouble::Stop,
        first: Recovery::Retreat,
        then: Recovery::Retreat,
    },
    // The stream is broken: the arm stands by then, and the next try begins another one from where the approach began.
    Row {
        steps: &[Step::Follow],
        trouble: Trouble::PlannerAway,
        first: Recovery::Retry,
        then: Recovery::BackOff,
    },
    Row {
        steps: &[Step::Follow],
        trouble: Trouble::PlannerFailed,
        first: Recovery::Retry,
        then: Recovery::BackOff,
    },
    Row {
        steps: &[Step::Follow],
        trouble: Trouble::TargetLost,
        first: Recovery::BackOff,
        then: Recovery::BackOff,
    },
    Row {
        steps: &[Step::Follow],
        trouble: Trouble::OutOfReach,
        first: Recovery::BackOff,
        then: Recovery::BackOff,
    },
    Row { steps: &[Step::Follow], trouble: Trouble::NoAnswer, first: Recovery::Retry, then: Recovery::End },
    Row { steps: &[Step::Follow], trouble: Trouble::Stop, first: Recovery::Retreat, then: Recovery::Retreat },
    Row {
        steps: &[Step::Approach],
        trouble: Trouble::NoAnswer,
        first: Recovery::Retreat,
        then: Recovery::Retreat,
    },
    Row {
        steps: &[Step::Approach],
        trouble: Trouble::Stop,
        first: Recovery::Retreat,
        then: Recovery::Retreat,
    },
    Row {
        steps: &[Step::Close, Step::Release],
        trouble: Trouble::NoAnswer,
        first: Recovery::ClearAndRetry,
        then: Recovery::End,
    },
    Row {
        steps: &[Step::Close],
        trouble: Trouble::Stop,
        first: Recovery::ClearAndRetry,
        then: Recovery::Retreat,
    },
    Row {
        steps: &[Step::Close],
        trouble: Trouble::OutOfReach,
        first: Recovery::Retreat,
        then: Recovery::Retreat,
    },
    Row {
        steps: &[Step::CheckContact, Step::CheckHeld, Step::CheckDelivered],
        trouble: Trouble::NoAnswer,
        first: Recovery::ClearAndRetry,
        then: Recovery::End,
    },
    Row {
        steps: &[Step::CheckContact, Step::CheckHeld, Step::CheckDelivered],
        trouble: Trouble::Stop,
        first: Recovery::ClearAndRetry,
        then: Recovery::End,
    },
    Row {
        steps: &[Step::CheckContact, Step::CheckHeld, Step::CheckDelivered],
        trouble: Trouble::NothingHeld,
        first: Recovery::Retreat,
        then: Recovery::Retreat,
    },
    Row {
        steps: &[Step::Lift, Step::Carry],
        trouble: Trouble::NoAnswer,
        first: Recovery::Retry,
        then: Recovery::End,
    },
    // The hand holds something that does not come up, such as the tray's wall: over the tray it may let go.
    Row {
        steps: &[Step::Lift],
        trouble: Trouble::Stop,
        first: Recovery::ClearAndFeel,
        then: Recovery::Retreat,
    },
    Row { steps: &[Step::Carry], trouble: Trouble::Stop, first: Recovery::ClearAndFeel, then: Recovery::End },
    Row {
        steps: &[Step::Lift],
        trouble: Trouble::OutOfReach,
        first: Recovery::LiftToPregrasp,
        then: Recovery::End,
    },
    Row { steps: &[Step::Carry], trouble: Trouble::OutOfReach, first: Recovery::End, then: Recovery::End },
    Row {
        steps: &[Step::Release],
        trouble: Trouble::Stop,
        first: Recovery::ClearAndRetry,
        then: Recovery::End,
    },
    Row {
        steps: &[Step::Retreat],
        trouble: Trouble::NoAnswer,
        first: Recovery::ClearAndRetry,
        then: Recovery::End,
    },
    // An arm may refuse to move because of what presses on it: opened fingers that are wedged, for example.
    Row {
        steps: &[Step::Retreat],
        trouble: Trouble::Stop,
        first: Recovery::ClearAndRetry,
        then: Recovery::End,
    },
    Row {
        steps: &[Step::Retreat],
        trouble: Trouble::OutOfReach,
        first: Recovery::ClearAndRetry,
        then: Recovery::End,
    },
];

/// What is done about `trouble` in `step` that has happened `before` times already, where `tries` are allowed.
pub fn recovery(step: Step, trouble: Trouble, before: u32, tries: u32) -> Recovery {
    let row = TABLE.iter().find(|row| row.trouble == trouble && row.steps.contains(&step));
    match row {
        Some(row) if before < tries => row.first,
        Some(row) => row.then,
        None => Recovery::End,
    }
}

/// The wait before trying again for the `before`-th time: doubles from `first`, never above `longest`.
pub fn backoff(before: u32, first: Duration, longest: Duration) -> Duration {
    first.saturating_mul(1 << before.min(16)).min(longest)
}

/// The table as Markdown, as it stands in `docs/cell.md`.
pub fn markdown() -> String {
    let mut text = String::from("| step | trouble | first | when that did not help |\n|---|---|---|---|\n");
    for row in TABLE {
        let steps = if row.steps.len() == Step::ALL.len() {
            "any".to_owned()
        } else {
            row.steps.iter().map(|s| format!("`{s}`")).collect::<Vec<_>>().join(", ")
        };
        let then = if row.then == row.first { "the same" } else { row.then.text() };
        // Writing to a string cannot fail.
        let _ = writeln!(text, "| {steps} | {} | {} | {then} |", row.trouble.name(), row.first.text());
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_documentation_has_this_table() {
        let docs = include_str!("../../docs/cell.md");
        assert!(docs.contains(&markdown()), "docs/cell.md should contain:\n{}", markdown());
    }

    #[test]
    fn an_emergency_stop_ends_the_run_in_every_step() {
        for step in Step::ALL {
            assert_eq!(recovery(step, Trouble::Emergency, 0, 5), Recovery::End);
        }
    }

    #[test]
    fn with_something_in_the_hand_nothing_is_left_behind_without_retreat() {
        // No line lets the loop forget an object: from closing on, the way out is to go on, to retreat, or to end.
        for row in TABLE.iter().filter(|r| r.steps.iter().any(|s| s.may_hold())) {
            for recovery in [row.first, row.then] {
                assert!(!matches!(recovery, Recovery::NextGrasp | Recovery::PlanAgain), "{row:?}");
            }
        }
    }

    #[test]
    fn retries_are_bounded_and_back_off_grows_to_its_limit() {
        assert_eq!(recovery(Step::Capture, Trouble::NoAnswer, 2, 3), Recovery::Retry);
        assert_eq!(recovery(Step::Capture, Trouble::NoAnswer, 3, 3), Recovery::End);
        let wait = |n| backoff(n, Duration::from_millis(100), Duration::from_secs(2));
        assert_eq!((wait(0), wait(1), wait(40)), (wait(0), 2 * wait(0), Duration::from_secs(2)));
    }
}
