//! The depth camera in the palm: where it sits, and what it sees.

use graspd_hands::Hand;
use graspd_planner::frame::{DepthImage, Frame, Intrinsics};
use graspd_sim::render::Renderer;
use graspd_sim::sensor::Sensor;
use graspd_sim::world::World;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// The camera stands this far out of the palm, metres.
const CLEAR_M: f64 = 0.004;
/// It is looked for in steps of this length, metres, ...
const STEP_M: f64 = 0.002;
/// ... from the middle of the pads up to so far back.
const FARTHEST_M: f64 = 0.25;

/// Pose of a palm camera in the hand's root frame: it looks along the approach from the first part of the open hand that
/// lies behind the middle of its pads, upper edge of the picture along the hand's y axis (z, where the approach is along
/// y).
pub fn hand_from_camera(hand: &Hand) -> Isometry3<f64> {
    let poses = hand.tree.body_poses(&hand.actuation.joints(&hand.actuation.open()));
    let points = hand.candidates_at(&poses);
    let sum: Vector3<f64> = points.iter().map(|(p, _)| p.coords).sum();
    let middle = Point3::from(sum / points.len().max(1) as f64);
    let z = hand.approach.into_inner();
    let covered = |at: &Point3<f64>| {
        hand.spheres
            .iter()
            .any(|s| poses.get(s.body).is_some_and(|pose| (pose * s.center - at).norm() < s.radius + CLEAR_M))
    };
    let steps = (FARTHEST_M / STEP_M) as usize;
    let at = |k: usize| middle - z * (k as f64 * STEP_M);
    // A middle that lies within a finger is no palm: the way back begins where it is free.
    let free = (0..steps).find(|&k| !covered(&at(k))).unwrap_or(0);
    let palm = (free..steps).find(|&k| covered(&at(k))).unwrap_or(steps);
    let eye = at(palm.saturating_sub(1));
    let up = if z.y.abs() < 0.9 { Vector3::y() } else { Vector3::z() };
    let y = -(up - z * z.dot(&up)).normalize();
    let axes = Matrix3::from_columns(&[y.cross(&z), y, z]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    Isometry3::from_parts(Translation3::from(eye.coords), rotation)
}

/// A depth camera that a hand carries.
#[derive(Debug)]
pub struct PalmCamera {
    sensor: Sensor,
    /// Where it sits.
    pub hand_from_camera: Isometry3<f64>,
    renderer: Renderer,
}

impl PalmCamera {
    /// This camera in the palm of a hand.
    pub fn new(hand: &Hand, sensor: Sensor) -> Self {
        Self { sensor, hand_from_camera: hand_from_camera(hand), renderer: Renderer::new() }
    }

    /// One noisy frame, with the pose that the arm reports.
    pub fn look(&mut self, world: &World, world_from_hand: &Isometry3<f64>, noise_seed: u64) -> Frame {
        let world_from_camera = world_from_hand * self.hand_from_camera;
        let lens = self.sensor.lens;
        let view = self.renderer.capture(world, &lens, &world_from_camera);
        let seen = self.sensor.observe(view, noise_seed);
        Frame {
            image: DepthImage { width: seen.width, height: seen.height, depth_m: seen.depth_m },
            intrinsics: Intrinsics {
                fx_px: lens.fx_px,
                fy_px: lens.fy_px,
                cx_px: lens.cx_px,
                cy_px: lens.cy_px,
                distortion: [0.0; 8],
            },
            world_from_camera: Some(world_from_camera),
            labels: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use graspd_hands::library;

    use super::*;

    #[test]
    fn a_palm_camera_looks_out_of_every_hand_between_its_fingers() {
        for id in library::ids() {
            let hand = library::hand(id).expect("a library hand");
            let pose = hand_from_camera(hand);
            let z = pose.rotation * Vector3::z();
            assert!((z - hand.approach.into_inner()).norm() < 1e-9, "{id} looks along its approach");
            let poses = hand.tree.body_poses(&hand.actuation.joints(&hand.actuation.open()));
            let eye = Point3::from(pose.translation.vector);
            let inside = hand.spheres.iter().any(|s| (poses[s.body] * s.center - eye).norm() < s.radius);
            assert!(!inside, "{id}: the camera is in the hand");
        }
    }
}
