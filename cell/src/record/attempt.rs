//! One attempt, as a line of `attempts.jsonl`.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::outcome::Outcome;
use crate::plan::{Answer, NoGrasp, PlannedGrasp, Question};
use crate::recovery::Recovery;
use crate::steps::{Step, Trouble};
use crate::witness::Witnessed;

/// Trouble that a step met, and what was done about it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TroubleRecord {
    /// Kind.
    pub trouble: Trouble,
    /// The device's or planner's words.
    pub text: String,
    /// What was done: [`Recovery::text`].
    pub recovery: String,
}

impl TroubleRecord {
    /// A record of trouble and recovery.
    pub fn new(trouble: Trouble, text: &str, recovery: Recovery) -> Self {
        Self { trouble, text: text.to_owned(), recovery: recovery.text().to_owned() }
    }
}

/// One step of an attempt.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StepRecord {
    /// Step.
    pub step: Step,
    /// Begin, seconds since the begin of the run.
    pub began_s: f64,
    /// Duration with all tries, seconds.
    pub took_s: f64,
    /// True when it was done in the end.
    pub done: bool,
    /// What went wrong, in order.
    pub troubles: Vec<TroubleRecord>,
}

/// What the planner answered, in figures.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AnswerRecord {
    /// Number of ranked grasps.
    pub grasps: usize,
    /// Why there is none.
    pub no_grasp: Option<NoGrasp>,
    /// Candidates that did not become a grasp, by reason.
    pub rejected: BTreeMap<String, i32>,
    /// Planning time as the server measured it, seconds.
    pub plan_s: f64,
    /// Revision of the hand's description.
    pub hand_revision: String,
    /// Contact estimator.
    pub estimator: String,
}

impl From<&Answer> for AnswerRecord {
    fn from(answer: &Answer) -> Self {
        Self {
            grasps: answer.grasps.len(),
            no_grasp: answer.no_grasp.clone(),
            rejected: answer.rejected.clone(),
            plan_s: answer.plan_s,
            hand_revision: answer.hand_revision.clone(),
            estimator: answer.estimator.clone(),
        }
    }
}

/// The grasp that was executed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Chosen {
    /// Place in the ranking, 0 for the best.
    pub rank: usize,
    /// The grasp.
    pub grasp: PlannedGrasp,
}

/// A grasp that was left out because the arm does not reach it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OutOfReach {
    /// Place in the ranking, 0 for the best.
    pub rank: usize,
    /// Which motion the arm would refuse: `above`, `pregrasp` or `grasp`.
    pub to: String,
    /// The arm's words.
    pub why: String,
}

/// What a servo did on the way to a grasp.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ServoRecord {
    /// Frames that were sent.
    pub frames: u64,
    /// Answers that came.
    pub answers: u64,
    /// Of these, answers that tracked.
    pub tracking: u64,
    /// Grasps that were announced as others, the first included.
    pub replanned: u64,
    /// Frames that the planner did not answer.
    pub unanswered: u64,
    /// From the first frame to the last answer, seconds.
    pub took_s: f64,
    /// How far the grasp has come from the first one, metres.
    pub drift_m: f64,
    /// The last stand-off, metres.
    pub standoff_m: f64,
    /// What the last answer said besides.
    pub last: String,
}

/// One attempt: from the look into the tray to the open hand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AttemptRecord {
    /// Counts from 1.
    pub attempt: u32,
    /// Stem of the frame's files, for example `frames/0001`; `None` when no frame came.
    pub frame: Option<String>,
    /// What was asked of the planner.
    pub question: Option<Question>,
    /// What it answered.
    pub answer: Option<AnswerRecord>,
    /// Grasps that were left out before anything moved.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub out_of_reach: Vec<OutOfReach>,
    /// The grasp that was executed, or was going to be.
    pub chosen: Option<Chosen>,
    /// What the servo did, where a camera in the palm refined the grasp.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub servo: Option<ServoRecord>,
    /// Every step.
    pub steps: Vec<StepRecord>,
    /// True when the straight approach began: it counts as a grasp trial.
    pub trial: bool,
    /// True when the hand felt the object at the drop pose.
    pub felt: bool,
    /// What a witness saw.
    pub witnessed: Option<Witnessed>,
    /// How it ended.
    pub outcome: Outcome,
}
