//! `trajectory_msgs`.

use serde::{Deserialize, Serialize};

use super::{Duration, Header};

/// `trajectory_msgs/JointTrajectoryPoint`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct JointTrajectoryPoint {
    /// Radians or metres, in the order of the names.
    pub positions: Vec<f64>,
    /// Left empty here.
    pub velocities: Vec<f64>,
    /// Left empty here.
    pub accelerations: Vec<f64>,
    /// Left empty here.
    pub effort: Vec<f64>,
    /// When it is reached, from the trajectory's start.
    pub time_from_start: Duration,
}

/// `trajectory_msgs/JointTrajectory`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct JointTrajectory {
    /// A stamp of 0 lets controllers start at once.
    pub header: Header,
    /// Joints by name.
    pub joint_names: Vec<String>,
    /// Points in the order of their times.
    pub points: Vec<JointTrajectoryPoint>,
}
