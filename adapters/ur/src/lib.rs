//! Universal Robots arms (CB3 and e-Series) for a graspd cell.
//!
//! State comes over RTDE at up to 500 Hz. Motion is done by a control script that is uploaded when the first motion is
//! asked for, and told what to do through registers; it stops the arm when the heartbeat from here ends, when a force
//! is exceeded, when a stream of targets dries up. Power, brakes and protective stops go through the dashboard.
//! Nothing moves unless `armed` is set, and every motion is bounded before it begins: see [`UrLimits`].

mod arm;
mod config;
mod dashboard;
mod diagnose;
mod events;
mod follow;
pub mod kinematics;
mod plan;
mod primary;
mod program;
pub mod rtde;
mod script;
mod servo;
mod session;
mod state;
mod upload;

pub use arm::UrArm;
pub use config::{Arrival, BasePose, Heartbeat, Payload, Ports, UrConfig, UrLimits, Workspace};
pub use dashboard::{Dashboard, DashboardError, dashboard_line};
pub use diagnose::diagnose;
pub use events::UrEvent;
pub use primary::{PrimaryError, PrimaryMessage, PrimaryReader};
pub use servo::{ServoSettings, ServoStream};
pub use state::{RobotMode, RobotState, SafetyStatus, pose_from, pose_to};
