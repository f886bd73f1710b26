//! A box on a table, seen by a camera: depth by casting a ray through each pixel.

use graspd_client::{CameraIntrinsics, DepthFrame, depth_frame_f32, depth_frame_u16};
use graspd_proto::v1;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

/// Name of the scene's world frame.
pub const SCENE_FRAME: &str = "table";
/// Half extents of the box, metres.
pub const BOX_HALF_M: Vector3<f64> = Vector3::new(0.02, 0.035, 0.04);

const WIDTH: i32 = 320;
const HEIGHT: i32 = 240;
const FOCAL_PX: f64 = 300.0;

/// A box of [`BOX_HALF_M`] standing on the table `z = 0` of the world, and a camera that looks at it.
#[derive(Debug, Clone)]
pub struct BoxScene {
    /// Takes camera coordinates to world coordinates.
    pub world_from_camera: Isometry3<f64>,
    /// Centre of the box, world frame; `None` leaves the table empty.
    pub box_center: Option<Point3<f64>>,
}

impl Default for BoxScene {
    fn default() -> Self {
        // Above the table and a little to the side, looking at the foot of the box.
        let (eye, target) = (Point3::new(0.05, -0.30, 0.55), Point3::new(0.0, 0.0, 0.02));
        let forward = target - eye;
        let rotation = UnitQuaternion::face_towards(&forward, &-Vector3::z());
        Self {
            world_from_camera: Isometry3::from_parts(Translation3::from(eye), rotation),
            box_center: Some(Point3::new(0.0, 0.0, BOX_HALF_M.z)),
        }
    }
}

impl BoxScene {
    /// The same camera over an empty table.
    pub fn empty() -> Self {
        Self { box_center: None, ..Self::default() }
    }

    /// Depth along the optical axis of each pixel, metres, row major.
    pub fn depth_m(&self) -> Vec<f32> {
        let pixel = |row: i32, column: i32| {
            let ray = Vector3::new(
                (f64::from(column) + 0.5 - f64::from(WIDTH) / 2.0) / FOCAL_PX,
                (f64::from(row) + 0.5 - f64::from(HEIGHT) / 2.0) / FOCAL_PX,
                1.0,
            );
            // The ray has unit length along the optical axis, so its parameter is the depth.
            let eye = self.world_from_camera * Point3::origin();
            let ray = self.world_from_camera.rotation * ray;
            let table = -eye.z / ray.z;
            self.box_hit(eye, ray).map_or(table, |hit| hit.min(table)) as f32
        };
        (0..HEIGHT)
            .flat_map(|row| (0..WIDTH).map(move |column| (row, column)))
            .map(|(r, c)| pixel(r, c))
            .collect()
    }

    /// Where a ray enters the box (the slab method).
    fn box_hit(&self, eye: Point3<f64>, ray: Vector3<f64>) -> Option<f64> {
        let center = self.box_center?;
        let (mut enter, mut leave) = (0.0_f64, f64::INFINITY);
        for axis in 0..3 {
            let near = (center[axis] - BOX_HALF_M[axis] - eye[axis]) / ray[axis];
            let far = (center[axis] + BOX_HALF_M[axis] - eye[axis]) / ray[axis];
            enter = enter.max(near.min(far));
            leave = leave.min(near.max(far));
        }
        (enter < leave).then_some(enter)
    }

    /// Object labels: 1 on the box, 0 on the table.
    pub fn labels(&self) -> Vec<u8> {
        let bare = Self { box_center: None, ..self.clone() }.depth_m();
        self.depth_m().iter().zip(bare).map(|(with, without)| u8::from(with + 1e-6 < without)).collect()
    }

    /// The lens.
    pub fn intrinsics() -> CameraIntrinsics {
        CameraIntrinsics {
            fx_px: FOCAL_PX,
            fy_px: FOCAL_PX,
            cx_px: f64::from(WIDTH) / 2.0 - 0.5,
            cy_px: f64::from(HEIGHT) / 2.0 - 0.5,
            distortion: Vec::new(),
        }
    }

    /// The frame with nothing known of the camera but its lens: 16-bit millimetres.
    pub fn frame_without_pose(&self) -> DepthFrame {
        let millimetres: Vec<u16> = self.depth_m().iter().map(|d| (d * 1000.0).round() as u16).collect();
        depth_frame_u16(WIDTH, HEIGHT, 0.001, &millimetres, Self::intrinsics())
    }

    /// The frame with the camera's pose: floats.
    pub fn frame(&self) -> DepthFrame {
        let pose = self.world_from_camera;
        let (t, q) = (pose.translation.vector, pose.rotation.quaternion());
        let pose = v1::Pose {
            position: Some(v1::Vector3 { x: t.x, y: t.y, z: t.z }),
            orientation: Some(v1::Quaternion { x: q.i, y: q.j, z: q.k, w: q.w }),
        };
        DepthFrame {
            camera_frame_id: "eye".to_owned(),
            camera_pose: Some(v1::PoseInFrame { frame_id: SCENE_FRAME.to_owned(), pose: Some(pose) }),
            ..depth_frame_f32(WIDTH, HEIGHT, &self.depth_m(), Self::intrinsics())
        }
    }
}
