//! Sections of where things are and how the arm goes there. World frame, metres; z up.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use crate::plan::{BoxRecord, WorkspaceRecord};
use crate::pose::PoseRecord;

/// Height of the tray's floor in the volume, metres: room below it for noise.
const FLOOR_IN_VOLUME_M: f64 = 0.05;

/// `[tray]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrayConfig {
    /// Middle of the tray's floor.
    pub position_m: [f64; 3],
    /// Rotation of the tray about the vertical, radians.
    pub yaw_rad: f64,
    /// Inner width along the tray's x, metres.
    pub width_m: f64,
    /// Inner length along the tray's y, metres.
    pub length_m: f64,
    /// Height above the floor up to which objects are grasped, metres.
    pub height_m: f64,
    /// Height of its walls above the floor, metres; 0: it has none, and the planner is told of none.
    pub wall_height_m: f64,
    /// Thickness of its walls, outside of width and length, metres.
    pub wall_m: f64,
    /// Contacts nearer than this to a wall are not grasped, metres.
    pub wall_clearance_m: f64,
    /// The planner is told that the floor is so much higher than it is, metres: room for the errors of calibration and
    /// depth that make hands meet the floor (Supplementary Fig. 8b).
    pub floor_clearance_m: f64,
    /// Edge of the volume that the planner looks at, metres.
    pub volume_m: f64,
    /// Let the planner find the floor's height in each frame instead of trusting `position_m` and `floor_clearance_m`.
    pub find_floor: bool,
}

impl Default for TrayConfig {
    /// A flat tray in the middle of the world that fits the planner's volume of 0.4 m.
    fn default() -> Self {
        Self {
            position_m: [0.0; 3],
            yaw_rad: 0.0,
            width_m: 0.36,
            length_m: 0.36,
            height_m: 0.25,
            wall_height_m: 0.03,
            wall_m: 0.008,
            wall_clearance_m: 0.004,
            floor_clearance_m: 0.003,
            volume_m: 0.4,
            find_floor: false,
        }
    }
}

impl TrayConfig {
    fn pose(&self, x: f64, y: f64, z: f64) -> Isometry3<f64> {
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.yaw_rad);
        let offset = yaw * Vector3::new(x, y, z);
        Isometry3::from_parts((Vector3::from(self.position_m) + offset).into(), yaw)
    }

    /// The volume on the tray.
    pub fn workspace(&self) -> WorkspaceRecord {
        let half = self.volume_m / 2.0;
        WorkspaceRecord {
            pose: PoseRecord::from(&self.pose(-half, -half, -FLOOR_IN_VOLUME_M)),
            size_m: self.volume_m,
            table_height_m: (!self.find_floor).then_some(FLOOR_IN_VOLUME_M + self.floor_clearance_m),
        }
    }

    /// The inside of the tray, where objects may be grasped.
    pub fn region(&self) -> BoxRecord {
        let half = |edge: f64| edge / 2.0 - self.wall_clearance_m;
        BoxRecord {
            pose: PoseRecord::from(&self.pose(0.0, 0.0, self.height_m / 2.0)),
            half_extents_m: [half(self.width_m), half(self.length_m), self.height_m / 2.0],
        }
    }

    /// The walls, where no part of a hand may be; none for a tray without walls. Walls this thin
    /// drown in the noise of depth edges: a frame shows them with gaps, into which fingers would come down.
    pub fn walls(&self) -> Vec<BoxRecord> {
        if self.wall_height_m <= 0.0 {
            return Vec::new();
        }
        let (x, y, z) = (self.width_m / 2.0, self.length_m / 2.0, self.wall_height_m / 2.0);
        let t = self.wall_m / 2.0;
        let around = |center: [f64; 2], half: [f64; 2]| BoxRecord {
            pose: PoseRecord::from(&self.pose(center[0], center[1], z)),
            half_extents_m: [half[0], half[1], z],
        };
        let (along_y, along_x) = ([t, y + 2.0 * t], [x + 2.0 * t, t]);
        vec![
            around([x + t, 0.0], along_y),
            around([-x - t, 0.0], along_y),
            around([0.0, y + t], along_x),
            around([0.0, -y - t], along_x),
        ]
    }

    /// How far a point of the world is outside the planner's volume: along the tray's x and y (0 within), and above the
    /// volume's top (negative below).
    pub(super) fn outside_volume(&self, point: &[f64; 3]) -> [f64; 3] {
        let at = self.pose(0.0, 0.0, 0.0).inverse_transform_point(&(*point).into());
        let sideways = |c: f64| (c.abs() - self.volume_m / 2.0).max(0.0);
        [sideways(at.x), sideways(at.y), at.z - (self.volume_m - FLOOR_IN_VOLUME_M)]
    }

    /// Height of the floor, world frame, metres.
    pub fn floor_m(&self) -> f64 {
        self.position_m[2]
    }
}

/// `[drop]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DropConfig {
    /// Where the hand's tool point goes to let go, the hand pointing straight down.
    pub position_m: [f64; 3],
    /// Rotation of the hand about the vertical, radians.
    pub yaw_rad: f64,
}

impl Default for DropConfig {
    fn default() -> Self {
        Self { position_m: [0.40, 0.0, 0.25], yaw_rad: 0.0 }
    }
}

/// `[motion]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MotionConfig {
    /// Height above the tray's floor at which the hand's tool point travels, metres: above everything that stands.
    pub travel_height_m: f64,
    /// Force on the hand at which the straight approach ends and the fingers close where they are, newtons; an arm that
    /// feels no force goes on to the grasp.
    pub contact_force_n: f64,
    /// How far a grasp is lifted before the hand is asked whether it still holds, metres.
    pub lift_m: f64,
    /// Where the tool point waits out of the camera's view; left out: the drop position.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wait_position_m: Option<[f64; 3]>,
}

impl Default for MotionConfig {
    fn default() -> Self {
        Self { travel_height_m: 0.32, contact_force_n: 40.0, lift_m: 0.15, wait_position_m: None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    #[test]
    fn walls_stand_around_what_may_be_grasped() {
        let tray = TrayConfig { position_m: [0.3, -0.2, 0.1], yaw_rad: 0.4, ..TrayConfig::default() };
        let walls = tray.walls();
        assert_eq!(walls.len(), 4);
        let inside = |tray_point: [f64; 3]| {
            let point = tray.pose(tray_point[0], tray_point[1], tray_point[2]) * Point3::origin();
            let holds = |wall: &BoxRecord| {
                let local = wall.pose.isometry().inverse_transform_point(&point);
                local.iter().zip(wall.half_extents_m).all(|(c, half)| c.abs() <= half)
            };
            walls.iter().filter(|wall| holds(wall)).count()
        };
        // Inner faces are at 0.18 m, outer ones at 0.188 m, and the rim is 0.03 m high.
        for side in [1.0, -1.0] {
            for (x, expected) in [(0.179, 0), (0.181, 1), (0.184, 1), (0.187, 1), (0.189, 0)] {
                assert_eq!(inside([side * x, 0.05, 0.015]), expected, "{x}");
                assert_eq!(inside([0.05, side * x, 0.015]), expected, "{x}");
            }
            assert_eq!((inside([side * 0.184, 0.0, 0.0295]), inside([side * 0.184, 0.0, 0.0305])), (1, 0));
        }
        assert_eq!(inside([0.184, 0.184, 0.0]), 2, "corners are closed");
        assert_eq!(TrayConfig { wall_height_m: 0.0, ..tray.clone() }.walls(), []);
    }
}
