//! Asking for grasps: the question, the answer, and who answers.

mod answer;
mod client;
mod question;
mod servo;
mod servo_client;

use std::fmt::Debug;
use std::time::Duration;

use async_trait::async_trait;

pub use answer::{Answer, EmptyReason, NoGrasp, PlannedGrasp};
pub use client::PlannerClient;
pub use question::{BoxRecord, Question, ReachingChoice, WorkspaceRecord};
pub use servo::{GraspServo, ServoAnswer, ServoFrame, ServoQuestion, ServoState};

use crate::frame::Frame;
use crate::steps::Trouble;

/// Why a planner has no answer.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PlannerError {
    /// Nobody is there, or there is no room: the same question may be answered a moment later.
    #[error("planner away: {0}")]
    Away(String),
    /// It is there and failed, or was too late.
    #[error("planner failed: {0}")]
    Failed(String),
    /// It refuses the question, and would do so again.
    #[error("planner refused: {0}")]
    Refused(String),
}

impl PlannerError {
    /// What kind of trouble this is.
    pub fn trouble(&self) -> Trouble {
        match self {
            Self::Away(_) => Trouble::PlannerAway,
            Self::Failed(_) => Trouble::PlannerFailed,
            Self::Refused(_) => Trouble::PlannerRefused,
        }
    }
}

/// What a cell has to know of its hand; told by the planner, so that both mean the same hand.
#[derive(Debug, Clone, PartialEq)]
pub struct HandFacts {
    /// Id, for example `leap`.
    pub id: String,
    /// Revision of its description.
    pub revision: String,
    /// Direction in the hand frame along which it reaches for objects, unit length.
    pub approach: nalgebra::Unit<nalgebra::Vector3<f64>>,
    /// Axis in the hand frame from which its rotation about the approach is measured.
    pub lateral: nalgebra::Vector3<f64>,
    /// Point in the hand frame between the half-closed fingers, metres.
    pub tool_point: nalgebra::Vector3<f64>,
    /// Its actuators.
    pub actuators: Vec<ActuatorFacts>,
    /// Number of its fingers.
    pub fingers: usize,
}

/// What a cell has to know of an actuator; radians or metres.
#[derive(Debug, Clone, PartialEq)]
pub struct ActuatorFacts {
    /// Name.
    pub name: String,
    /// Position with the hand open.
    pub open: f64,
    /// Position with the hand closed on nothing; that of `open` for one that does not close.
    pub closed: f64,
    /// Smallest and largest position.
    pub limits: [f64; 2],
}

impl ActuatorFacts {
    /// The end of its range in the direction of closing; `None` for one that does not close.
    pub fn farthest(&self) -> Option<f64> {
        let [least, most] = self.limits;
        (self.closed != self.open).then_some(if self.closed > self.open { most } else { least })
    }
}

impl HandFacts {
    /// [`ActuatorFacts::farthest`] of the actuator of that name; `None` also where there is none.
    pub fn farthest(&self, actuator: &str) -> Option<f64> {
        self.actuators.iter().find(|a| a.name == actuator)?.farthest()
    }

    /// True when no finger has more than one motor that closes it. Such fingers close until they are held; fingers of
    /// several motors would curl into themselves that way.
    pub fn one_motor_a_finger(&self) -> bool {
        self.actuators.iter().filter(|a| a.open != a.closed).count() <= self.fingers
    }
}

/// Who plans grasps.
#[async_trait]
pub trait GraspPlanner: Send + Sync + Debug {
    /// Facts about a hand.
    ///
    /// # Errors
    /// [`PlannerError`].
    async fn hand(&self, id: &str, timeout: Duration) -> Result<HandFacts, PlannerError>;

    /// Ranked grasps for one frame. No grasp is not an error: the answer says why.
    ///
    /// # Errors
    /// [`PlannerError`].
    async fn plan(
        &self,
        frame: &Frame,
        question: &Question,
        timeout: Duration,
    ) -> Result<Answer, PlannerError>;

    /// Ranked grasps of several hands for one frame, in the order of the questions, which read the scene alike (they differ in
    /// nothing of workspace, region and estimator). An error is one of all. This default asks one question after the
    /// other.
    ///
    /// # Errors
    /// [`PlannerError`].
    async fn plan_together(
        &self,
        frame: &Frame,
        questions: &[Question],
        timeout: Duration,
    ) -> Result<Vec<Answer>, PlannerError> {
        let mut answers = Vec::with_capacity(questions.len());
        for question in questions {
            answers.push(self.plan(frame, question, timeout).await?);
        }
        Ok(answers)
    }

    /// Begins to carry one grasp on from frame to frame. A planner that cannot says so, as this default does.
    ///
    /// # Errors
    /// [`PlannerError`].
    async fn servo(
        &self,
        asked: &ServoQuestion,
        timeout: Duration,
    ) -> Result<Box<dyn GraspServo>, PlannerError> {
        let _ = (asked, timeout);
        Err(PlannerError::Refused("this planner has no servo".to_owned()))
    }
}
