//! Executing one grasp, as the paper's Task 1 does: approach, close, lift, hold, shake (Supplementary Note 7).

mod closing;
mod place;
mod run;
#[cfg(test)]
mod tests;

use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

use crate::world::ObjectId;
#[cfg(doc)]
use crate::world::WristForce;

pub use closing::{CloseOrder, Closing};
pub use place::set_down;
pub use run::execute;

/// What is to be executed: the answer of a planner, without its opinion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GraspCommand {
    /// Pose of the hand's root link where the straight approach begins, world frame.
    pub world_from_pregrasp: Isometry3<f64>,
    /// Pose of the hand's root link at the grasp, world frame.
    pub world_from_hand: Isometry3<f64>,
    /// Actuator positions during the approach, in the order of the hand's actuators.
    pub open: Vec<f64>,
    /// Actuator positions where contact is expected.
    pub contact: Vec<f64>,
    /// Actuator positions to command when closing, beyond contact.
    pub squeezed: Vec<f64>,
}

/// Why a grasp failed, after Supplementary Fig. 8.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Failure {
    /// The hand hit the table or the tray on its way, or stood in them when it was set down (Fig. 8b).
    CollisionTable,
    /// The hand pushed an object away on its way, or stood in one when it was set down (Fig. 8c).
    CollisionObject,
    /// The object slipped away while the fingers closed (Fig. 8e).
    LostClosing,
    /// Nothing, or too little, was between the fingers: no stable contact (Fig. 8a, d).
    UnstableContact,
    /// The object was dropped while it was lifted or held.
    LostLifting,
    /// The object was dropped while it was shaken.
    LostShaking,
}

/// How a grasp is executed. In a file every field must be there: what a newer program filled in would be another
/// motion than the one that was recorded.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExecuteSettings {
    /// Share of the actuators' effort while gripping.
    pub grip_force: f64,
    /// Speed of the straight approach, metres per second.
    pub approach_m_s: f64,
    /// How far to lift, metres, straight up.
    pub lift_m: f64,
    /// Speed of the lift, metres per second.
    pub lift_m_s: f64,
    /// How long to hold still, seconds.
    pub hold_s: f64,
    /// Amplitude of the shake, metres; 0: no shake.
    pub shake_m: f64,
    /// Frequency of the shake, hertz.
    pub shake_hz: f64,
    /// Cycles of the shake along each of x, y and z.
    pub shake_cycles: f64,
    /// Force at the wrist at which the arm stops its approach, newtons (a guarded move); see [`WristForce`].
    pub stop_force_n: f64,
    /// How far the meant object may be pushed during the approach before that is a collision, metres.
    pub push_m: f64,
    /// Time in which all fingers go from open to where contact is expected, to arrive there together, seconds.
    pub meet_s: f64,
    /// Longest time for closing after that, seconds.
    pub close_s: f64,
}

impl Default for ExecuteSettings {
    fn default() -> Self {
        Self {
            grip_force: 0.7,
            approach_m_s: 0.1,
            lift_m: 0.15,
            lift_m_s: 0.15,
            hold_s: 0.5,
            shake_m: 0.02,
            shake_hz: 3.0,
            shake_cycles: 2.0,
            stop_force_n: 40.0,
            push_m: 0.01,
            meet_s: 0.5,
            close_s: 3.0,
        }
    }
}

/// What came of a grasp.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// `None`: the object is in the hand, lifted, after hold and shake.
    pub failure: Option<Failure>,
    /// The objects that the hand holds at the end, first the one that was meant (closest to the grasp).
    pub held: Vec<ObjectId>,
    /// The object that was meant: the one nearest to the middle of the pads at the grasp; `None` in an empty world.
    pub meant: Option<ObjectId>,
    /// Joint positions when the fingers had closed.
    pub joints_closed: Vec<f64>,
    /// How far the meant object slid in the hand from closing to the end, metres.
    pub slip_m: f64,
    /// Simulated seconds.
    pub duration_s: f64,
}

/// The moments of an execution that a picture is worth taking of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Moment {
    /// At the pre-grasp.
    Before,
    /// After closing.
    Contact,
    /// At the end.
    After,
}
