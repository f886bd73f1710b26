//! The standard ROS 2 messages that the bridge reads and writes, field by field in their order on the wire (CDR).
//!
//! Nothing here is of graspd's making: whoever has ROS has these types. Sequences are `Vec`, fixed arrays are arrays, and `byte`
//! and `uint8` are `u8`. `visualization_msgs/Marker` is that of Humble and later.

mod diagnostic;
mod geometry;
mod octets;
mod sensor;
mod standard;
mod trajectory;
mod visualization;

pub use diagnostic::{DiagnosticArray, DiagnosticStatus, KeyValue, level};
pub use geometry::{Point, PointStamped, Pose, PoseArray, PoseStamped, Quaternion, Vector3};
pub use sensor::{CameraInfo, Image, JointState, RegionOfInterest};
pub use standard::{Duration, Header, Stamp, Text, TriggerRequest, TriggerResponse};
pub use trajectory::{JointTrajectory, JointTrajectoryPoint};
pub use visualization::{
    ColorRGBA, CompressedImage, Marker, MarkerArray, MeshFile, UVCoordinate, action, shape,
};

/// Package and name of a message's type, as ROS knows it.
pub trait Typed: ros2_client::Message + 'static {
    /// For example `sensor_msgs`.
    const PACKAGE: &'static str;
    /// For example `Image`.
    const NAME: &'static str;
}

macro_rules! typed {
    ($($package:literal: $($message:ident = $name:literal),+;)+) => {$($(
        impl ros2_client::Message for $message {}
        impl Typed for $message {
            const PACKAGE: &'static str = $package;
            const NAME: &'static str = $name;
        }
    )+)+};
}

typed! {
    "std_msgs": Text = "String";
    "sensor_msgs": Image = "Image", CameraInfo = "CameraInfo", JointState = "JointState";
    "geometry_msgs": PointStamped = "PointStamped", PoseArray = "PoseArray", PoseStamped = "PoseStamped";
    "trajectory_msgs": JointTrajectory = "JointTrajectory";
    "visualization_msgs": MarkerArray = "MarkerArray";
    "diagnostic_msgs": DiagnosticArray = "DiagnosticArray";
}

impl ros2_client::Message for TriggerRequest {}
impl ros2_client::Message for TriggerResponse {}

#[cfg(test)]
mod golden;
