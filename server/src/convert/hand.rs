//! Hands on the wire, and their names.

use std::time::SystemTime;

use graspd_hands::{CoordinateKind, Hand, JointKind};
use graspd_proto::v1;
use nalgebra::Vector3;

use super::geometry::vector_message;
use super::{count_message, quoted};
use crate::error::FieldError;
use crate::registry::{Origin, is_hand_id};

/// The id in a resource name `hands/{hand}`.
pub(crate) fn hand_id(name: &str, path: &str) -> Result<String, FieldError> {
    if name.is_empty() {
        return Err(FieldError::missing(path, "a resource name such as \"hands/leap\""));
    }
    match name.strip_prefix("hands/") {
        Some(id) if is_hand_id(id) => Ok(id.to_owned()),
        _ => Err(FieldError::value(
            path,
            quoted(name),
            "\"hands/\" and an id of lower-case letters, digits and hyphens that starts with a letter",
        )),
    }
}

/// The resource name of an id.
pub(crate) fn hand_name(id: &str) -> String {
    format!("hands/{id}")
}

/// A hand on the wire.
pub(crate) fn hand_message(hand: &Hand, origin: Origin, created: Option<SystemTime>) -> v1::Hand {
    let link_name = |link: usize| hand.tree.links.get(link).map_or_else(String::new, |l| l.name.clone());
    let finger_name = |finger: usize| hand.fingers.get(finger).map_or_else(String::new, |f| f.name.clone());
    v1::Hand {
        name: hand_name(&hand.id),
        display_name: hand.display_name.clone(),
        revision: hand.revision.clone(),
        origin: match origin {
            Origin::Library => v1::HandOrigin::Library,
            Origin::Folder => v1::HandOrigin::Folder,
            Origin::Created => v1::HandOrigin::Created,
        }
        .into(),
        create_time: created.map(prost_types::Timestamp::from),
        wrist_link: link_name(0),
        approach: Some(vector_message(&hand.approach)),
        lateral_axis: Some(vector_message(&lateral_axis(&hand.approach))),
        tool_point: Some(vector_message(&hand.tool_point.coords)),
        joints: hand.tree.joints.iter().map(joint_message).collect(),
        actuators: (hand.actuation.coordinates.iter())
            .filter(|c| c.kind == CoordinateKind::Actuator)
            .map(actuator_message)
            .collect(),
        fingers: hand.fingers.iter().map(|f| f.name.clone()).collect(),
        pads: hand
            .pads
            .iter()
            .map(|p| v1::Pad { name: p.name.clone(), finger: finger_name(p.finger), link: link_name(p.link) })
            .collect(),
        contact_candidate_count: count_message(hand.candidates.len()),
        opening: hand.opening.map(|o| v1::Opening { min_m: o.min_m, max_m: o.max_m }),
        warnings: hand.warnings.clone(),
    }
}

/// The axis from which the protocol measures a roll: x, or y where the hand reaches along x.
fn lateral_axis(approach: &Vector3<f64>) -> Vector3<f64> {
    if approach.x.abs() >= 0.9 { Vector3::y() } else { Vector3::x() }
}

fn joint_message(joint: &graspd_hands::Joint) -> v1::Joint {
    v1::Joint {
        name: joint.name.clone(),
        r#type: match joint.kind {
            JointKind::Revolute => v1::JointType::Revolute,
            JointKind::Prismatic => v1::JointType::Prismatic,
        }
        .into(),
        min_position: joint.lower,
        max_position: joint.upper,
        max_effort: joint.effort,
    }
}

fn actuator_message(actuator: &graspd_hands::Coordinate) -> v1::Actuator {
    v1::Actuator {
        name: actuator.name.clone(),
        min_position: actuator.lower,
        max_position: actuator.upper,
        open_position: actuator.open,
        closed_position: actuator.closed,
        max_effort: actuator.effort,
    }
}
