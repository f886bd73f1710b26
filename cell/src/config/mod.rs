//! `cell.toml`: everything that a run is set up with. Every value has a default that works with the mock devices.

mod check;
mod devices;
mod load;
mod places;
mod rules;
mod servo;

use serde::{Deserialize, Serialize};

pub use devices::{ArmConfig, CameraConfig, HandConfig, PlannerConfig};
pub use load::{ConfigError, ENVIRONMENT};
pub use places::{DropConfig, MotionConfig, TrayConfig};
pub(crate) use rules::seconds;
pub use rules::{RecordingConfig, RecoveryConfig, RunConfig, TimeoutConfig};
pub use servo::{ServoConfig, ServoMode};

/// The whole file.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CellConfig {
    /// Who plans.
    pub planner: PlannerConfig,
    /// The depth camera.
    pub camera: CameraConfig,
    /// The robot arm.
    pub arm: ArmConfig,
    /// The hand.
    pub hand: HandConfig,
    /// Where objects are picked.
    pub tray: TrayConfig,
    /// Where they are dropped.
    pub drop: DropConfig,
    /// How the arm moves between them.
    pub motion: MotionConfig,
    /// The dynamic grasp servo; left out: each grasp is planned from one frame of a camera above the tray.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub servo: Option<ServoConfig>,
    /// How long each call may take.
    pub timeouts: TimeoutConfig,
    /// How much is tried before giving up.
    pub recovery: RecoveryConfig,
    /// When the run ends.
    pub run: RunConfig,
    /// What is kept of it.
    pub recording: RecordingConfig,
    /// The simulated world, for mock devices; read by who wires them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub simulation: Option<toml::Table>,
}
