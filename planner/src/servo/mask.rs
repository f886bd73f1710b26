//! What a palm camera sees of the hand that carries it: masked, since it is no object.
//!
//! The hand's collision spheres are ray-cast where the hand is; a pixel whose depth lies in one of them, or just before or
//! behind it, shows the hand and says nothing. What is measured nearer than the hand is something before it, and stays.

use graspd_hands::Hand;
use nalgebra::{Isometry3, Point3, Vector3};

use crate::frame::{Frame, Intrinsics};

/// Spheres leave some millimetres of a hand bare, poses and depths are off by some more, metres.
const MARGIN_M: f64 = 0.012;
/// Nearer than this to the camera a sphere fills the picture, metres.
const NEAR_M: f64 = 0.01;

/// Rays of a lens, and the spheres of a hand in its frame: memory that frames share.
#[derive(Debug, Clone, Default)]
pub(super) struct Mask {
    lens: Option<(Intrinsics, usize, usize)>,
    rays: Vec<[f32; 2]>,
    /// Pixels of the last frame that show the hand.
    pub(super) hidden: Vec<bool>,
}

impl Mask {
    /// Makes holes of the pixels that show the hand; how many there were.
    pub(super) fn apply(
        &mut self,
        frame: &mut Frame,
        world_from_camera: &Isometry3<f64>,
        hand: &Hand,
        world_from_hand: &Isometry3<f64>,
        joints: &[f64],
    ) -> usize {
        let (width, height) = (frame.image.width, frame.image.height);
        self.hidden.clear();
        self.hidden.resize(width * height, false);
        if joints.len() != hand.tree.joints.len() || frame.image.depth_m.len() != width * height {
            return 0;
        }
        self.prepare(&frame.intrinsics, width, height);
        let camera_from_hand = world_from_camera.inverse() * world_from_hand;
        let poses = hand.tree.body_poses(joints);
        let mut count = 0;
        for sphere in &hand.spheres {
            let Some(pose) = poses.get(sphere.body) else { continue };
            let center = camera_from_hand * (pose * sphere.center);
            count += self.sphere(
                &mut frame.image.depth_m,
                &frame.intrinsics,
                width,
                height,
                &center,
                sphere.radius,
            );
        }
        count
    }

    fn prepare(&mut self, lens: &Intrinsics, width: usize, height: usize) {
        if self.lens == Some((*lens, width, height)) {
            return;
        }
        self.lens = Some((*lens, width, height));
        self.rays.clear();
        for row in 0..height {
            for column in 0..width {
                let ray = lens.ray([column as f64, row as f64]);
                self.rays.push(ray.map_or([f32::NAN; 2], |[x, y]| [x as f32, y as f32]));
            }
        }
    }

    fn sphere(
        &mut self,
        depth: &mut [f32],
        lens: &Intrinsics,
        width: usize,
        height: usize,
        center: &Point3<f64>,
        radius: f64,
    ) -> usize {
        let radius = radius + MARGIN_M;
        if center.z + radius <= 0.0 {
            return 0;
        }
        let near = center.z - radius;
        let columns_and_rows = if near < NEAR_M {
            Some((0..width, 0..height))
        } else {
            lens.project([center.x, center.y, center.z]).map(|[u, v]| {
                // Off the optical axis a sphere's image is longer than wide, by at most this much in any usual lens.
                let reach = 1.6 * lens.fx_px.max(lens.fy_px) * radius / near + 2.0;
                let range = |at: f64, count: usize| {
                    let clamp = |v: f64| v.clamp(0.0, count as f64) as usize;
                    clamp((at - reach).floor())..clamp((at + reach).ceil() + 1.0)
                };
                (range(u, width), range(v, height))
            })
        };
        let Some((columns, rows)) = columns_and_rows else { return 0 };
        let c = Vector3::new(center.x as f32, center.y as f32, center.z as f32);
        let beyond = c.norm_squared() - (radius * radius) as f32;
        let mut count = 0;
        for row in rows {
            for column in columns.clone() {
                let i = row * width + column;
                let [x, y] = self.rays[i];
                let a = x * x + y * y + 1.0;
                let b = x * c.x + y * c.y + c.z;
                let root = b * b - a * beyond;
                // Not a number for a pixel that no ray of the lens meets.
                if root.is_nan() || root < 0.0 {
                    continue;
                }
                let root = root.sqrt();
                let (enter, leave) = ((b - root) / a, (b + root) / a);
                let d = depth[i];
                if d >= enter && d <= leave && !self.hidden[i] {
                    self.hidden[i] = true;
                    depth[i] = f32::NAN;
                    count += 1;
                }
            }
        }
        count
    }
}

#[cfg(test)]
mod tests {
    use graspd_hands::library;

    use super::*;
    use crate::frame::DepthImage;

    fn frame(depth: f32) -> Frame {
        Frame {
            image: DepthImage { width: 64, height: 48, depth_m: vec![depth; 64 * 48] },
            intrinsics: Intrinsics {
                fx_px: 60.0,
                fy_px: 60.0,
                cx_px: 31.5,
                cy_px: 23.5,
                distortion: [0.0; 8],
            },
            world_from_camera: None,
            labels: None,
        }
    }

    #[test]
    fn the_hand_is_masked_and_what_is_before_or_behind_it_stays() {
        let hand = library::hand("leap").expect("a library hand");
        let joints = hand.actuation.joints(&hand.actuation.open());
        let camera = Isometry3::identity();
        // The hand's root half a metre before the camera.
        let pose = Isometry3::translation(0.0, 0.0, 0.5);
        let poses = hand.tree.body_poses(&joints);
        let middle = pose * (poses[hand.spheres[0].body] * hand.spheres[0].center);
        let [u, v] = frame(1.0).intrinsics.project([middle.x, middle.y, middle.z]).unwrap();
        let pixel = v.round() as usize * 64 + u.round() as usize;
        let mut mask = Mask::default();
        for (depth, is_hand) in [(middle.z as f32, true), (middle.z as f32 - 0.2, false), (2.0, false)] {
            let mut frame = frame(depth);
            let count = mask.apply(&mut frame, &camera, hand, &pose, &joints);
            assert_eq!(mask.hidden[pixel], is_hand, "at {depth}");
            assert_eq!(frame.image.depth_m[pixel].is_nan(), is_hand);
            assert_eq!(count > 0, is_hand, "{count} pixels");
            assert_eq!(count, mask.hidden.iter().filter(|h| **h).count());
        }
    }

    #[test]
    fn joints_of_another_hand_and_a_hand_behind_the_camera_mask_nothing() {
        let hand = library::hand("leap").expect("a library hand");
        let mut mask = Mask::default();
        let mut frame = frame(0.5);
        assert_eq!(mask.apply(&mut frame, &Isometry3::identity(), hand, &Isometry3::identity(), &[0.0]), 0);
        let joints = hand.actuation.joints(&hand.actuation.open());
        let behind = Isometry3::translation(0.0, 0.0, -1.0);
        assert_eq!(mask.apply(&mut frame, &Isometry3::identity(), hand, &behind, &joints), 0);
    }
}
