//! Grasps as a cloud of coloured points, for viewers that draw no scene entities, as Rerun.

use graspd_recording::{Bundle, Schema, foxglove};
use nalgebra::{Isometry3, Point3};

use super::{
    AT_CONTACT, CONTACT, Shown, approach_line, field, placed, placed_shapes, pose_message, score_color,
};

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
        let shapes = placed_shapes(hand, &pose, joints);
        let all: Vec<_> = shapes
            .flat_map(|(shape, pose)| shape.surface(SPACING_M).into_iter().map(move |p| pose * p))
            .collect();
        let step = all.len().div_ceil(MOST_POINTS).max(1);
        all.into_iter().step_by(step).for_each(|p| put(p, &AT_CONTACT));
    }
    data
}
