//! Grasps as a cloud of coloured points, for viewers that draw no scene entities, as Rerun.

use graspd_hands::Hand;
use graspd_recording::{Bundle, Schema, foxglove};
use nalgebra::{Isometry3, Point3};

use super::{AT_CONTACT, CONTACT, Shown, approach_line, field, placed, pose_message, score_color, shapes};

/// Distance between points of a hand, metres.
const SPACING_M: f64 = 0.004;
/// Points of a hand that are drawn.
const MOST_POINTS: usize = 6000;
/// Distance between points of a line, and between those of a contact's cross, metres.
const LINE_M: f64 = 0.0025;
/// Three floats and four bytes of colour.
const STRIDE: u32 = 16;

/// Grasps as dotted lines along their approach, the best one's contacts, and the hand at that grasp.
pub(super) fn cloud(bundle: &mut Bundle, topic: String, shown: &Shown<'_>) {
    let timestamp = Some(bundle.timestamp());
    bundle.add(topic, Schema::PointCloud, || {
        let bytes = foxglove::packed_element_field::NumericType::Uint8;
        let color = ["red", "green", "blue", "alpha"].into_iter().zip(12..);
        let floats = foxglove::packed_element_field::NumericType::Float32;
        let place = ["x", "y", "z"].into_iter().zip((0..).step_by(4));
        let fields = place.map(|(name, at)| field(name, at, floats));
        foxglove::PointCloud {
            timestamp,
            frame_id: shown.world.clone(),
            pose: Some(pose_message(&Isometry3::identity())),
            point_stride: STRIDE,
            fields: fields.chain(color.map(|(name, at)| field(name, at, bytes))).collect(),
            data: points(shown),
        }
    });
}

fn points(shown: &Shown<'_>) -> Vec<u8> {
    let mut data = Vec::new();
    let mut put = |p: Point3<f64>, color: &foxglove::Color| {
        for value in [p.x, p.y, p.z] {
            data.extend((value as f32).to_le_bytes());
        }
        data.extend([color.r, color.g, color.b, 1.0].map(|share| (255.0 * share).round() as u8));
    };
    for grasp in shown.grasps {
        let Some(world_from_hand) = placed(grasp.wrist_pose.as_ref()) else { continue };
        let (tip, direction, length) = approach_line(&world_from_hand, shown.hand);
        let color = score_color(grasp, shown.grasps);
        for i in 0..=(length / LINE_M) as u32 {
            put(tip - direction * (f64::from(i) * LINE_M), &color);
        }
    }
    let Some(best) = shown.grasps.first() else { return data };
    for point in best.contacts.iter().filter_map(|c| c.point.as_ref()) {
        let at = Point3::new(point.x, point.y, point.z);
        for axis in nalgebra::Matrix3::<f64>::identity().column_iter() {
            (-2..=2).for_each(|i| put(at + axis * (f64::from(i) * LINE_M), &CONTACT));
        }
    }
    let joints = best.joints.as_ref().map_or(&[][..], |joints| &joints.contact);
    if let (Some(hand), Some(pose)) = (shown.hand, placed(best.wrist_pose.as_ref()))
        && joints.len() == hand.tree.joints.len()
    {
        let all = surface(hand, &pose, joints);
        let step = all.len().div_ceil(MOST_POINTS).max(1);
        all.into_iter().step_by(step).for_each(|p| put(p, &AT_CONTACT));
    }
    data
}

/// Points on the outside of a hand, world frame.
fn surface(hand: &Hand, world_from_hand: &Isometry3<f64>, joints: &[f64]) -> Vec<Point3<f64>> {
    let bodies = hand.tree.body_poses(joints);
    let mut out = Vec::new();
    for shape in shapes(hand) {
        let Some(link) = hand.tree.links.get(shape.link) else { continue };
        let Some(body) = bodies.get(link.body) else { continue };
        let pose = world_from_hand * body * link.body_from_link * shape.link_from_shape;
        out.extend(shape.shape.surface(SPACING_M).iter().map(|p| pose * p));
    }
    out
}
