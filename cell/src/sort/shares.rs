//! Where an arm's time goes.

use serde::{Deserialize, Serialize};

use super::table::Doing;
use crate::steps::Step;

/// Seconds of one arm on the clock of its devices, by what it did.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Shares {
    /// Going home with an empty hand.
    pub homing_s: f64,
    /// At home, with nothing that it could take: nothing lies there for it, or it waits for a look.
    pub idle_s: f64,
    /// At home, because others are in the way of all that it could take.
    pub blocked_s: f64,
    /// Opening its hand, and on its way above the pre-grasp and down to it.
    pub reaching_s: f64,
    /// Among the objects: approach, closing, lift, and the way out after a failure.
    pub grasping_s: f64,
    /// Carrying to its bin, and letting go.
    pub delivering_s: f64,
    /// Lost, or out of the run.
    pub away_s: f64,
}

impl Shares {
    /// Counts some seconds of doing this; `blocked` says of an idle arm that others are in its way.
    pub(super) fn add(&mut self, doing: &Doing, blocked: bool, seconds: f64) {
        let share = match doing {
            Doing::Homing => &mut self.homing_s,
            Doing::Idle { .. } if blocked => &mut self.blocked_s,
            Doing::Idle { .. } => &mut self.idle_s,
            Doing::Picking { step: Step::Open | Step::Pregrasp, .. } => &mut self.reaching_s,
            Doing::Picking { step: Step::Carry | Step::CheckDelivered | Step::Release, .. } => {
                &mut self.delivering_s
            }
            Doing::Picking { .. } => &mut self.grasping_s,
            Doing::Lost { .. } | Doing::Out { .. } => &mut self.away_s,
        };
        *share += seconds;
    }

    /// The sum of two.
    pub fn plus(&self, other: &Self) -> Self {
        Self {
            homing_s: self.homing_s + other.homing_s,
            idle_s: self.idle_s + other.idle_s,
            blocked_s: self.blocked_s + other.blocked_s,
            reaching_s: self.reaching_s + other.reaching_s,
            grasping_s: self.grasping_s + other.grasping_s,
            delivering_s: self.delivering_s + other.delivering_s,
            away_s: self.away_s + other.away_s,
        }
    }

    /// All of it.
    pub fn total_s(&self) -> f64 {
        self.homing_s
            + self.idle_s
            + self.blocked_s
            + self.reaching_s
            + self.grasping_s
            + self.delivering_s
            + self.away_s
    }
}

impl std::fmt::Display for Shares {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let percent = |part: f64| 100.0 * part / self.total_s().max(1e-9);
        write!(
            f,
            "idle {:.0} %, in others' way {:.0} %, reaching {:.0} %, grasping {:.0} %, delivering {:.0} %, going home {:.0} %",
            percent(self.idle_s + self.away_s),
            percent(self.blocked_s),
            percent(self.reaching_s),
            percent(self.grasping_s),
            percent(self.delivering_s),
            percent(self.homing_s)
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_second_is_counted_once() {
        let picking = |step| Doing::Picking { object: 0, bin: String::new(), step };
        let mut shares = Shares::default();
        for (i, step) in Step::ALL.into_iter().enumerate() {
            shares.add(&picking(step), i % 2 == 0, 1.0);
        }
        shares.add(&Doing::Idle { why: String::new() }, true, 2.0);
        shares.add(&Doing::Idle { why: String::new() }, false, 3.0);
        shares.add(&Doing::Lost { why: String::new() }, true, 4.0);
        assert_eq!((shares.blocked_s, shares.idle_s, shares.away_s), (2.0, 3.0, 4.0));
        assert_eq!((shares.reaching_s, shares.delivering_s), (2.0, 3.0));
        assert_eq!(shares.total_s(), Step::ALL.len() as f64 + 9.0);
        assert_eq!(shares.plus(&shares).total_s(), 2.0 * shares.total_s());
    }
}
