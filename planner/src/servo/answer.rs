//! What a servo says about a frame.

use std::time::Duration;

use nalgebra::Isometry3;

use crate::grasp::{EmptyReason, Grasp, RejectReason};

/// What a robot should do with an answer: follow it, wait, or retreat.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    /// The grasp is the one of the answer before, refined: follow.
    Tracking,
    /// Another grasp than before is announced, or is being searched: wait for what comes, stay where you are.
    Replanning(Replan),
    /// There is nothing to follow: retreat.
    Lost(Loss),
}

/// Why a grasp is another one than before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Replan {
    /// There was none before.
    First,
    /// The target has moved further than a grasp follows from frame to frame.
    TargetMoved,
    /// What is seen now speaks against the grasp.
    Rejected(RejectReason),
    /// Another grasp of the target is clearly better.
    Better,
    /// The grasp scores clearly less than when it was taken, and another one was found that scores more.
    Worse,
    /// The best grasp has moved further than counts as the same.
    Jump,
    /// The camera stands somewhere else than it can have gone.
    CameraMoved,
    /// The target had been lost.
    FoundAgain,
}

impl Replan {
    /// The reason as it appears on the wire and in tables, for example `target_moved`.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::First => "first",
            Self::TargetMoved => "target_moved",
            Self::Rejected(reason) => reason.as_str(),
            Self::Better => "better",
            Self::Worse => "worse",
            Self::Jump => "jump",
            Self::CameraMoved => "camera_moved",
            Self::FoundAgain => "found_again",
        }
    }
}

/// Why there is nothing to follow.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Loss {
    /// No grasp was found, for this reason.
    NoGrasp(EmptyReason),
    /// Where the target was is nothing any more, nor near by.
    TargetGone,
    /// Nothing was seen of the target for long: the hand itself or something else is before it, or it is out of the
    /// picture.
    Hidden,
}

impl Loss {
    /// The reason as it appears on the wire and in tables, for example `target_gone`.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::NoGrasp(reason) => reason.as_str(),
            Self::TargetGone => "target_gone",
            Self::Hidden => "hidden",
        }
    }
}

/// By how much a grasp differs from that of the answer before.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Change {
    /// Of the middle of the hand's contact candidates, metres.
    pub translation_m: f64,
    /// Radians.
    pub rotation_rad: f64,
}

/// What was counted since the servo began.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counters {
    /// Frames that were answered.
    pub answered: u64,
    /// Frames older than one that was answered.
    pub late: u64,
    /// Frames that came twice.
    pub repeated: u64,
    /// Frames from where the camera cannot have gone.
    pub wild: u64,
    /// Frames that cannot be read.
    pub invalid: u64,
    /// Times that a grasp was announced that is another one than before, the first included.
    pub replanned: u64,
}

/// What a servo says about a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// The frame that this answers.
    pub sequence: u64,
    /// When it was taken, as the frame said.
    pub captured: Duration,
    /// Follow, wait or retreat.
    pub state: State,
    /// The grasp; where it is being searched anew or is lost, the last one there was.
    pub grasp: Option<Grasp>,
    /// Against the answer before.
    pub change: Change,
    /// False while the grasp is on its way to a better one further off than it may change at once, or is held though
    /// the newest frame speaks against it.
    pub is_settled: bool,
    /// Distance from the grasp at which the hand should be now, metres against the approach.
    pub standoff_m: f64,
    /// Pose of the hand's root link there, world frame.
    pub world_from_standoff: Option<Isometry3<f64>>,
    /// True when the hand may go straight in and grip.
    pub go: bool,
    /// Share of the target's place in the picture that shows something, 0 to 1.
    pub visible: f64,
    /// Counted since the beginning.
    pub counters: Counters,
    /// Durations of the stages, in order.
    pub stages: Vec<(&'static str, Duration)>,
}
