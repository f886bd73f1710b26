//! Grasp quality, measured: planner and simulated world play against each other, and every trial is counted.

// What an evaluation is set up with.
mod clock;
mod items;
pub(crate) mod seeds;
mod station;
mod workers;

// Trays cleared by every hand.
mod attempt;
mod clear;
mod contents;
mod replay;
mod report;

// What a score says about success.
pub mod calibration;

// What grasps touch objects with.
pub mod diversity;

// Average precision of the parallel jaw.
pub mod ap;

// Dynamic against static grasping.
pub mod servo;

// How well networks find contacts.
pub mod contact_picture;
pub mod contacts;

// Numbers and how they are shown.
pub mod picture;
pub mod statistics;
pub mod svg;
mod table;

pub use attempt::{Attempt, Class, Figures, Nothing, command};
pub use clear::{ClearSettings, Item, Observer, Run, Setup, Silent, clear};
pub use items::{draw, fits};
pub use replay::{FailedTrial, Replay, plan_again, replay};
pub use report::{Cell, Report};
pub use station::Station;

#[cfg(test)]
mod tests;

/// Why an evaluation cannot go on.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EvaluationError {
    /// A setting is of no use.
    #[error("{field}: found {found}, expected {expected}")]
    Setting {
        /// The setting.
        field: &'static str,
        /// Found value.
        found: String,
        /// What is expected.
        expected: String,
    },
    /// The planner cannot read the scene.
    #[error("the planner cannot read the scene")]
    Scene(#[from] graspd_planner::scene::SceneError),
    /// A world's file cannot be read.
    #[error("the world cannot be read")]
    World(#[from] graspd_sim::scene::SceneError),
    /// A trial's file cannot be read.
    #[error("the trial cannot be read")]
    Trial(#[from] serde_json::Error),
    /// The objects find no place in the tray.
    #[error("the objects cannot be poured")]
    Arrange(#[from] graspd_sim::clutter::ArrangeError),
    /// The system gives no threads.
    #[error("no threads")]
    Threads(#[from] rayon::ThreadPoolBuildError),
}
