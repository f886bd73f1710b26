//! What a sorting cell is made of, and why it may not begin.

use std::sync::Arc;

use async_trait::async_trait;
use graspd_adapters_core::{Arm, DepthCamera, Hand};
use graspd_assign::Capsule;
use nalgebra::Point3;

use crate::config::ConfigError;
use crate::plan::{GraspPlanner, PlannerError};
use crate::record::RecordError;
use crate::run::CellError;
use crate::sort::clock::Clock;
use crate::sort::report::SortWitness;
use crate::sort::way::ArmShape;

/// One arm of a cell.
#[derive(Debug, Clone)]
pub struct ArmCell {
    /// Carries the hand.
    pub arm: Arc<dyn Arm>,
    /// Grasps.
    pub hand: Arc<dyn Hand>,
    /// The space that the arm takes.
    pub shape: Arc<dyn ArmShape>,
    /// Bodies that hold all of the hand, however its fingers stand, hand frame. Not used for a hand whose `hand_radius_m` the
    /// configuration says.
    pub hand_bodies: Vec<Capsule>,
}

/// Tells classes of objects, where somebody does: a detector in another camera, a scale, a simulation.
#[async_trait]
pub trait Recognizer: Send + Sync + std::fmt::Debug {
    /// Classes of what lies in the tray now, each with a point on or over the object, world frame.
    async fn classes(&self) -> Vec<(Point3<f64>, String)>;
}

/// A cell with several arms.
#[derive(Debug, Clone)]
pub struct SortCell {
    /// Sees the tray.
    pub camera: Arc<dyn DepthCamera>,
    /// In the order of the configuration.
    pub arms: Vec<ArmCell>,
    /// Plans grasps.
    pub planner: Arc<dyn GraspPlanner>,
    /// Tells classes.
    pub recognizer: Option<Arc<dyn Recognizer>>,
    /// The clock of the devices.
    pub clock: Arc<dyn Clock>,
    /// Knows what became of objects, and who met whom.
    pub witness: Option<Arc<dyn SortWitness>>,
}

/// Why a sorting run does not begin.
#[derive(Debug, thiserror::Error)]
pub enum SortError {
    /// The configuration.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// One arm's part of the cell.
    #[error("{arm}: {source}")]
    Arm {
        /// The arm.
        arm: String,
        /// What is wrong.
        source: CellError,
    },
    /// A hand of which nobody says how large it is: neither the configuration nor who has made the cell.
    #[error("{arm}: hand_radius_m: found none, expected one: the cell does not know the bodies of this hand")]
    Hand {
        /// The arm.
        arm: String,
    },
    /// The planner.
    #[error(transparent)]
    Planner(#[from] PlannerError),
    /// Arms that stand in each other's way at home or over their bins.
    #[error(
        "{first} and {second} stand in each other's way, at home or over their bins; set them farther apart"
    )]
    Ground {
        /// One.
        first: String,
        /// The other.
        second: String,
    },
    /// An arm that does not reach its own places.
    #[error("{arm}: {why}")]
    Home {
        /// The arm.
        arm: String,
        /// Which place, and why.
        why: String,
    },
    /// The folder of the record.
    #[error(transparent)]
    Record(#[from] RecordError),
}
