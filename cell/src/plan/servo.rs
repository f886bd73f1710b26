//! A grasp that the planner carries on from frame to frame: what is asked, what comes back, and who answers.

use std::fmt::Debug;
use std::time::Duration;

use async_trait::async_trait;
use nalgebra::Isometry3;

use super::{PlannedGrasp, PlannerError, Question};
use crate::config::ServoConfig;
use crate::frame::Frame;
use crate::pose::PoseRecord;

/// What is asked of a servo.
#[derive(Debug, Clone, PartialEq)]
pub struct ServoQuestion {
    /// How the scene is read, how the first grasp is searched, what every later one must keep to.
    pub question: Question,
    /// How it is carried on.
    pub servo: ServoConfig,
}

/// A frame of a servo.
#[derive(Debug, Clone, Copy)]
pub struct ServoFrame<'a> {
    /// Rises with every frame.
    pub sequence: u64,
    /// Time of exposure on the camera's clock; none where the camera has no clock.
    pub captured: Option<Duration>,
    /// The frame, with its pose.
    pub frame: &'a Frame,
    /// Pose of the hand's root link when it was taken, world frame.
    pub world_from_hand: &'a Isometry3<f64>,
    /// Positions of the hand's joints then, in the planner's order; empty: open.
    pub joints: &'a [f64],
}

/// What the hand should do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ServoState {
    /// Follow.
    Tracking,
    /// Another grasp is announced or searched: come no nearer than the stand-off.
    Replanning,
    /// There is nothing to follow.
    Lost,
}

/// The answer to a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct ServoAnswer {
    /// The frame that it answers.
    pub sequence: u64,
    /// From the frame's arrival at the planner until the answer left.
    pub age: Duration,
    /// What to do.
    pub state: ServoState,
    /// Why it is replanning or lost.
    pub reason: String,
    /// The grasp; while it is searched or lost the last one there was.
    pub grasp: Option<PlannedGrasp>,
    /// Joint positions of the open hand that the grasp asks for, in the planner's order.
    pub open_joints: Vec<f64>,
    /// Pose of the hand's root link at the stand-off, world frame.
    pub world_from_standoff: Option<PoseRecord>,
    /// Distance from the grasp at which the hand should be, metres.
    pub standoff_m: f64,
    /// The hand may go straight in.
    pub go: bool,
    /// Times that another grasp was announced, the first included.
    pub replanned: u64,
    /// Frames that the planner did not answer: late, twice, wild, unreadable, replaced, no room.
    pub unanswered: u64,
    /// Why the last of these was not.
    pub refused: String,
}

/// A grasp that is being carried on. Dropping it ends the planner's work.
#[async_trait]
pub trait GraspServo: Send + Sync + Debug {
    /// Hands a frame over. The newest counts: one that waits is replaced.
    ///
    /// # Errors
    /// [`PlannerError`] when the stream has ended.
    async fn send(&mut self, frame: ServoFrame<'_>) -> Result<(), PlannerError>;

    /// The next answer. Loses nothing when it is dropped.
    ///
    /// # Errors
    /// [`PlannerError`] when the stream has ended.
    async fn next(&mut self) -> Result<ServoAnswer, PlannerError>;
}
