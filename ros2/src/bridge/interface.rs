//! What a bridge is told: how to plan, what comes in, what goes out.

use std::time::Duration;

use tokio::sync::oneshot;

use crate::answer::Answer;
use crate::depth::Lens;
use crate::messages::{CameraInfo, DiagnosticArray, Image, MarkerArray, PointStamped, TriggerResponse};
use crate::pairing::PairingRules;

/// How the bridge plans.
#[derive(Debug, Clone, PartialEq)]
pub struct BridgeConfig {
    /// The node's full name, for what it says of itself.
    pub node: String,
    /// The server's address, likewise.
    pub server: String,
    /// Hands by id, the default one first; at least one.
    pub hands: Vec<String>,
    /// Which messages belong together.
    pub pairing: PairingRules,
    /// Which of the camera's matrices counts.
    pub lens: Lens,
    /// A frame that has come longer ago is not planned on; `None`: however old.
    pub max_age: Option<Duration>,
    /// Grasps of an answer where a goal says nothing.
    pub max_grasps: u32,
    /// Grasps that are drawn.
    pub drawn_grasps: usize,
    /// Goals at the same time.
    pub max_goals: usize,
    /// From one posture of the trajectory to the next.
    pub step: Duration,
    /// Names of the topics, for messages to people.
    pub topics: TopicNames,
}

/// Where frames come from, for messages to people.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TopicNames {
    /// Depth images.
    pub image: String,
    /// Camera infos.
    pub info: String,
    /// Label images.
    pub labels: Option<String>,
}

/// What comes in.
#[derive(Debug)]
pub enum Incoming {
    /// A depth image.
    Image(Image),
    /// A camera info.
    Info(Box<CameraInfo>),
    /// A label image.
    Labels(Image),
    /// A goal as JSON.
    Goal(String),
    /// A goal as a point.
    Point(PointStamped),
    /// The id of a goal to cancel; empty: all.
    Cancel(String),
    /// A call of a service `plan_grasps`.
    Service {
        /// The service's hand; `None`: the default one.
        hand: Option<String>,
        /// Where its answer goes.
        reply: oneshot::Sender<TriggerResponse>,
    },
}

/// What goes out.
#[derive(Debug, Clone, PartialEq)]
pub enum Outgoing {
    /// A plan, with or without grasps.
    Plan(Box<(Answer, MarkerArray)>),
    /// What a goal under way tells, as JSON.
    Feedback(String),
    /// How a goal has ended, as JSON: exactly one for each goal.
    Result(String),
    /// How the bridge is, as JSON.
    Status(String),
    /// The same for monitors.
    Diagnostics(DiagnosticArray),
}
