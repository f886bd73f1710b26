//! A hand with a depth camera in its palm above a synthetic clutter, which goes exactly where a servo wants it.

use std::sync::Arc;
use std::time::Duration;

use graspd_hands::{Hand, library};
use graspd_planner::budget::Unlimited;
use graspd_planner::estimator::Geometric;
use graspd_planner::frame::{Frame, Intrinsics};
use graspd_planner::servo::{Answer, HandNow, Refused, Servo, ServoFrame, ServoOptions};
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::clutter::{Object, look_from};

/// 30 frames a second.
pub(crate) const FRAME: Duration = Duration::from_millis(33);

/// The lens of a 224 x 172 palm camera.
pub(crate) fn palm_lens() -> Intrinsics {
    Intrinsics { fx_px: 212.0, fy_px: 212.0, cx_px: 111.5, cy_px: 85.5, distortion: [0.0; 8] }
}

/// Pose of a camera in the palm that looks along the approach, `back` metres before the middle of the pads.
fn hand_from_camera(hand: &Hand, back: f64) -> Isometry3<f64> {
    let poses = hand.tree.body_poses(&hand.actuation.joints(&hand.actuation.open()));
    let points = hand.candidates_at(&poses);
    let middle = points.iter().map(|(p, _)| p.coords).sum::<Vector3<f64>>() / points.len() as f64;
    let z = hand.approach.into_inner();
    let side = if z.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
    let x = (side - z * z.dot(&side)).normalize();
    let axes = Matrix3::from_columns(&[x, z.cross(&x), z]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    Isometry3::from_parts(Translation3::from(middle - z * back), rotation)
}

/// A hand, its servo, and what is before it.
pub(crate) struct Rig {
    pub(crate) servo: Servo,
    pub(crate) objects: Vec<Object>,
    pub(crate) world_from_hand: Isometry3<f64>,
    hand_from_camera: Isometry3<f64>,
    pub(crate) frames: u64,
}

impl Rig {
    /// The camera begins 0.45 m above the middle of the table.
    pub(crate) fn new(hand: &str, objects: Vec<Object>, options: ServoOptions) -> Self {
        let hand = Arc::new(library::hand(hand).expect("a library hand").clone());
        let hand_from_camera = hand_from_camera(&hand, 0.11);
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let world_from_camera = Isometry3::from_parts(Translation3::new(0.0, 0.0, 0.45), down);
        let world_from_hand = world_from_camera * hand_from_camera.inverse();
        let options = ServoOptions { hand_from_camera: Some(hand_from_camera), ..options };
        let servo = Servo::new(hand, options, Arc::new(Geometric)).expect("valid options");
        Self { servo, objects, world_from_hand, hand_from_camera, frames: 0 }
    }

    pub(crate) fn world_from_camera(&self) -> Isometry3<f64> {
        self.world_from_hand * self.hand_from_camera
    }

    /// What the camera sees now.
    pub(crate) fn look(&self) -> Frame {
        look_from(&self.objects, &self.world_from_camera(), palm_lens(), [224, 172])
    }

    /// The next frame.
    pub(crate) fn frame(&mut self) -> ServoFrame {
        self.frames += 1;
        let hand = Some(HandNow { world_from_hand: self.world_from_hand, joints: Vec::new() });
        let captured = FRAME * u32::try_from(self.frames).expect("few frames");
        ServoFrame { sequence: self.frames, captured, frame: self.look(), hand }
    }

    /// One frame, and the hand goes where it is wanted, at 0.3 m/s at most.
    pub(crate) fn step(&mut self) -> Result<Answer, Refused> {
        let frame = self.frame();
        self.take(frame)
    }

    /// Gives a frame to the servo, and the hand goes where it is wanted.
    pub(crate) fn take(&mut self, frame: ServoFrame) -> Result<Answer, Refused> {
        let answer = self.servo.step(frame, &Unlimited)?;
        if let Some(wanted) = answer.world_from_standoff {
            self.go(&wanted);
        }
        Ok(answer)
    }

    fn go(&mut self, wanted: &Isometry3<f64>) {
        let apart = (wanted.translation.vector - self.world_from_hand.translation.vector).norm();
        let turned = wanted.rotation.angle_to(&self.world_from_hand.rotation);
        let share = (0.01 / apart.max(1e-9)).min(0.08 / turned.max(1e-9)).min(1.0);
        self.world_from_hand = self.world_from_hand.try_lerp_slerp(wanted, share, 1e-9).unwrap_or(*wanted);
    }
}

/// Where an object's middle is.
pub(crate) fn middle(object: &Object) -> Point3<f64> {
    Point3::new(object.0[0], object.0[1], object.1)
}
