//! Planning an attempt again from its record.

use std::path::Path;
use std::time::Duration;

use super::folder::{RecordError, read_attempts, read_frame};
use super::{AttemptRecord, Chosen};
use crate::plan::{Answer, GraspPlanner, PlannedGrasp, PlannerError};

/// Why an attempt cannot be planned again.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The record.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The planner.
    #[error(transparent)]
    Planner(#[from] PlannerError),
    /// There is no such attempt.
    #[error("attempt: found {found}, expected 1 to {last}")]
    NoAttempt {
        /// As asked.
        found: u32,
        /// The last one.
        last: u32,
    },
    /// The attempt ended before it was planned.
    #[error("attempt {attempt} ended before anything was asked of the planner")]
    NotPlanned {
        /// The attempt.
        attempt: u32,
    },
}

/// An attempt, and what the planner says to it now.
#[derive(Debug, Clone, PartialEq)]
pub struct Replay {
    /// As recorded.
    pub recorded: AttemptRecord,
    /// The answer now.
    pub answer: Answer,
    /// True when the same grasp came out at the same rank, bit for bit (or again none, for the same reason).
    pub same: bool,
    /// Distance of the grasp now from the recorded one: metres and radians; `None` where one of them is missing.
    pub apart: Option<(f64, f64)>,
    /// True when the hand's description has changed since: then another answer is no wonder.
    pub hand_changed: bool,
}

/// Plans an attempt of a recorded run again.
///
/// # Errors
/// [`ReplayError`].
pub async fn replay(
    planner: &dyn GraspPlanner,
    folder: &Path,
    attempt: u32,
    timeout: Duration,
) -> Result<Replay, ReplayError> {
    let attempts = read_attempts(folder)?.records;
    let last = attempts.last().map_or(0, |a| a.attempt);
    let recorded = attempts.into_iter().find(|a| a.attempt == attempt);
    let recorded = recorded.ok_or(ReplayError::NoAttempt { found: attempt, last })?;
    let (Some(question), Some(before)) = (&recorded.question, &recorded.answer) else {
        return Err(ReplayError::NotPlanned { attempt });
    };
    let frame = read_frame(folder, attempt)?;
    let answer = planner.plan(&frame, question, timeout).await?;
    let hand_changed = answer.hand_revision != before.hand_revision;
    let reason = |why: &Option<crate::plan::NoGrasp>| why.as_ref().map(|w| w.reason);
    let (same, apart) = match &recorded.chosen {
        Some(Chosen { rank, grasp }) => {
            let now = answer.grasps.get(*rank).map(as_recorded).transpose();
            let now =
                now.map_err(|e| RecordError::Content { file: "grasp".into(), problem: e.to_string() })?;
            (now.as_ref() == Some(grasp), now.map(|now| apart(&now, grasp)))
        }
        None => {
            let count = answer.grasps.len() == before.grasps;
            (count && reason(&answer.no_grasp) == reason(&before.no_grasp), None)
        }
    };
    Ok(Replay { recorded, answer, same, apart, hand_changed })
}

/// A grasp as a reader of its record has it.
fn as_recorded(grasp: &PlannedGrasp) -> Result<PlannedGrasp, serde_json::Error> {
    serde_json::from_str(&serde_json::to_string(grasp)?)
}

fn apart(a: &PlannedGrasp, b: &PlannedGrasp) -> (f64, f64) {
    let between = a.world_from_hand.isometry().inverse() * b.world_from_hand.isometry();
    (between.translation.vector.norm(), between.rotation.angle())
}
