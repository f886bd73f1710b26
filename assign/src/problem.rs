//! What is asked: arms with their grasps, what is occupied, and how the search behaves.

use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Vector3};

use crate::swept::Swept;
use crate::volume::OrientedBox;

/// Which object a grasp takes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ObjectKey {
    /// The object of this label or number. Two grasps take the same object when the numbers are equal.
    Id(i64),
    /// The object whose centroid is near this point. Two grasps take the same object when their points are nearer than
    /// [`Settings::same_object_m`].
    At(Point3<f64>),
}

impl ObjectKey {
    /// True when both are, or must be taken for, the same object. A number and a point cannot be compared.
    pub fn is_same(&self, other: &Self, same_object_m: f64) -> bool {
        match (self, other) {
            (Self::Id(a), Self::Id(b)) => a == b,
            (Self::At(a), Self::At(b)) => (a - b).norm() < same_object_m,
            _ => false,
        }
    }
}

/// Whether an arm reaches a grasp.
#[derive(Debug, Clone, PartialEq)]
pub enum Reach {
    /// It does, so well: 1 anywhere comfortable, less near the ends of its reach, more than 0.
    Within(f64),
    /// It does not.
    Beyond(String),
    /// Nobody has asked the arm: [`Arm::region`] decides.
    Unknown,
}

/// A planned grasp of one arm's hand.
#[derive(Debug, Clone, PartialEq)]
pub struct Grasp {
    /// Pose of the hand's root link before the straight approach.
    pub world_from_pregrasp: Isometry3<f64>,
    /// Pose of the hand's root link at the grasp.
    pub world_from_hand: Isometry3<f64>,
    /// The planner's score, 0 to 1.
    pub score: f64,
    /// What it grasps.
    pub object: ObjectKey,
    /// How far the hand must open for the object, metres, where that is known.
    pub width_m: Option<f64>,
    /// Whether the arm gets there.
    pub reach: Reach,
    /// Why this arm must not take it (a rule of the task), if so.
    pub barred: Option<String>,
    /// The space that the approach sweeps, from the arm's own kinematics; `None`: [`crate::corridor`] of [`Arm::body`].
    pub corridor: Option<Arc<Swept>>,
}

/// Where an arm reaches, for arms whose kinematics nobody has asked.
#[derive(Debug, Clone, PartialEq)]
pub enum ReachRegion {
    /// Everywhere.
    Anywhere,
    /// The hand's root link between two distances from a point.
    Shell {
        /// The arm's base, or better its shoulder.
        middle: Point3<f64>,
        /// Nearest, metres.
        min_m: f64,
        /// Farthest, metres.
        max_m: f64,
    },
    /// The hand's root link in a box.
    Box(OrientedBox),
}

/// Space where an arm must not be.
#[derive(Debug, Clone, PartialEq)]
pub struct KeepOut {
    /// Shown to people.
    pub name: String,
    /// The space.
    pub volume: OrientedBox,
}

/// An arm's body, as far as it is known without its kinematics.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Body {
    /// Where the arm comes from.
    pub shoulder: Point3<f64>,
    /// The hand and what it is mounted on are within this of the line from its root link to its tool point, metres.
    pub hand_radius_m: f64,
    /// The arm is within this of the line from the shoulder to the hand's root link, metres; 0: not looked at.
    pub arm_radius_m: f64,
    /// The hand comes from so far above its pre-grasp, metres.
    pub lift_m: f64,
    /// Point between the fingers, hand frame.
    pub tool_point: Point3<f64>,
}

impl Default for Body {
    fn default() -> Self {
        Self {
            shoulder: Point3::origin(),
            hand_radius_m: 0.08,
            arm_radius_m: 0.06,
            lift_m: 0.1,
            tool_point: Point3::origin(),
        }
    }
}

/// An arm with its hand.
#[derive(Debug, Clone, PartialEq)]
pub struct Arm {
    /// Shown to people.
    pub name: String,
    /// Narrowest and widest object that the hand takes, metres; `None`: any.
    pub opening_m: Option<(f64, f64)>,
    /// Where it reaches.
    pub region: ReachRegion,
    /// Where it must not be.
    pub keep_out: Vec<KeepOut>,
    /// Its body.
    pub body: Body,
    /// The hand's grasps.
    pub grasps: Vec<Grasp>,
}

impl Arm {
    /// An arm of which nothing else is known.
    pub fn new(name: &str, grasps: Vec<Grasp>) -> Self {
        Self {
            name: name.to_owned(),
            opening_m: None,
            region: ReachRegion::Anywhere,
            keep_out: Vec::new(),
            body: Body { arm_radius_m: 0.0, ..Body::default() },
            grasps,
        }
    }
}

/// Space that somebody is in already.
#[derive(Debug, Clone, PartialEq)]
pub struct Occupied {
    /// Who.
    pub by: String,
    /// Where.
    pub space: Arc<Swept>,
}

/// An object that somebody has already.
#[derive(Debug, Clone, PartialEq)]
pub struct Taken {
    /// Who.
    pub by: String,
    /// Which.
    pub object: ObjectKey,
}

/// What is asked.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Problem<'a> {
    /// Arms that are free.
    pub arms: &'a [Arm],
    /// Space that others are in.
    pub occupied: &'a [Occupied],
    /// Objects that others have.
    pub taken: &'a [Taken],
}

/// How the search behaves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Points nearer than this are the same object, metres.
    pub same_object_m: f64,
    /// Room left between corridors, to keep-out volumes and to occupied space, metres.
    pub clearance_m: f64,
    /// Grasps worth less than this are not taken.
    pub least_value: f64,
    /// The search ends after so many nodes with the best so far.
    pub nodes: u64,
    /// Grasps of one arm that are searched at most; of more the best are taken, some of each object.
    pub grasps_per_arm: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self { same_object_m: 0.03, clearance_m: 0.02, least_value: 1e-3, nodes: 50_000, grasps_per_arm: 64 }
    }
}

impl ReachRegion {
    /// Whether a hand at this pose is within, and how well.
    pub(crate) fn reach(&self, at: &Vector3<f64>) -> Reach {
        match self {
            Self::Anywhere => Reach::Within(1.0),
            Self::Shell { middle, min_m, max_m } => {
                let far = (at - middle.coords).norm();
                if far < *min_m || far > *max_m {
                    let text = format!("{far:.3} m from the arm, expected {min_m} to {max_m}");
                    return Reach::Beyond(text);
                }
                // Arms are slow and imprecise where they are stretched: the last tenth counts down to a half.
                let edge = 0.1 * (max_m - min_m).max(1e-9);
                Reach::Within(0.5 + 0.5 * ((max_m - far) / edge).clamp(0.0, 1.0))
            }
            Self::Box(volume) if volume.contains(&Point3::from(*at)) => Reach::Within(1.0),
            Self::Box(_) => {
                Reach::Beyond(format!("the hand at {:.3?} is outside the box that it reaches", at.as_slice()))
            }
        }
    }
}
