//! What the planner is asked, and how the question changes while it has no grasp or its grasps fail.

use super::Run;
use crate::config::{CellConfig, TrayConfig};
use crate::plan::{Question, ReachingChoice};

/// Most candidates that a planner accepts at once.
const MOST_CANDIDATES: u32 = 4096;
/// The candidates are doubled at most so often.
const MOST_DOUBLINGS: u32 = 4;

/// One way of asking.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Rung {
    /// Any reaching direction instead of the configured one.
    free: bool,
    /// Where the planner is told that the floor is: this share of `[tray] floor_clearance_m` above it. Flat things
    /// disappear under a floor that is told too high; under one that is told too low, hands reach beneath their edges
    /// until the guarded approach meets the floor.
    floor: f64,
}

/// The ways of asking, one after the other, and again from the start.
const RUNGS: [Rung; 8] = [
    Rung { free: false, floor: 1.0 },
    Rung { free: true, floor: 0.0 },
    Rung { free: false, floor: 0.0 },
    Rung { free: true, floor: -1.0 },
    Rung { free: false, floor: -1.0 },
    Rung { free: true, floor: 1.0 },
    Rung { free: false, floor: 0.0 },
    Rung { free: true, floor: -1.0 },
];

/// The way of asking after so many plans without a grasp and so many failed trials, both since the last success. A
/// failed trial may have been bad luck: it takes two to ask otherwise.
fn rung(idle: u32, failures: u32) -> (Rung, u32) {
    let steps = idle.saturating_add(failures / 2);
    (RUNGS[steps as usize % RUNGS.len()], steps.min(MOST_DOUBLINGS))
}

/// What a question depends on besides the configuration.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Asked {
    /// Added to the configured seed.
    pub(crate) number: u64,
    /// Plans without a grasp since the last success.
    pub(crate) idle: u32,
    /// Failed trials since the last success.
    pub(crate) failures: u32,
    /// Nothing was seen the last time.
    pub(crate) seemed_empty: bool,
}

impl Run<'_> {
    /// The question for this attempt. Each has a seed of its own.
    pub(super) fn question(&self) -> Question {
        let asked = Asked {
            number: u64::from(self.attempt.number) - 1,
            idle: self.idle_since_success,
            failures: self.tally.failures_in_a_row,
            seemed_empty: self.empty_frames > 0,
        };
        asked.question(self.config)
    }
}

impl Asked {
    /// The question, as a cell of this configuration asks it.
    pub(crate) fn question(&self, config: &CellConfig) -> Question {
        let (planner, tray) = (&config.planner, &config.tray);
        let (rung, doublings) = rung(self.idle, self.failures);
        // An empty tray is asked about as it is.
        let floor = if self.seemed_empty { 0.0 } else { rung.floor };
        let tray = TrayConfig { floor_clearance_m: floor * tray.floor_clearance_m, ..tray.clone() };
        Question {
            hand: config.hand.id.clone(),
            seed: config.run.seed.wrapping_add(self.number),
            reaching: if rung.free { ReachingChoice::Free } else { planner.reaching },
            max_tilt_rad: planner.max_tilt_rad.filter(|_| !rung.free),
            workspace: tray.workspace(),
            region: Some(tray.region()),
            keep_out: tray.walls(),
            estimator: planner.estimator.clone(),
            // What is left may be hard to reach.
            batch: planner.batch.saturating_mul(1 << doublings).min(MOST_CANDIDATES),
            scheme: planner.scheme,
            max_grasps: planner.max_grasps,
            min_score: planner.min_score,
            friction: planner.friction,
            pregrasp_offset_m: planner.pregrasp_offset_m,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_question_is_the_configured_one_and_every_rung_is_reached() {
        assert_eq!(rung(0, 0), (Rung { free: false, floor: 1.0 }, 0));
        assert_eq!(rung(0, 1), rung(0, 0), "one failure may be bad luck");
        assert_eq!(rung(0, 2), rung(1, 0));
        for (idle, expected) in RUNGS.iter().enumerate() {
            assert_eq!(rung(idle as u32, 0).0, *expected);
        }
        assert_eq!(rung(u32::MAX, u32::MAX).1, MOST_DOUBLINGS);
    }
}
