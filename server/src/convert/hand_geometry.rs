//! The shape of a hand on the wire.

use graspd_hands::{CollisionShape, Hand, JointKind, Pad, Shape, Tree};
use graspd_proto::v1;
use graspd_proto::v1::hand_shape;
use nalgebra::Vector3;

use super::count_message;
use super::geometry::{bare_pose_message, vector_message};

/// Bodies, links and shapes of a hand on the wire.
pub(crate) fn geometry_message(hand: &Hand) -> v1::GetHandGeometryResponse {
    let tree = &hand.tree;
    let shapes = |all: &[CollisionShape]| all.iter().filter_map(|s| shape_message(tree, s)).collect();
    v1::GetHandGeometryResponse {
        revision: hand.revision.clone(),
        bodies: tree.bodies.iter().map(|body| body_message(tree, body)).collect(),
        links: (tree.links.iter())
            .map(|link| v1::HandLink {
                name: link.name.clone(),
                body: count_message(link.body),
                body_from_link: Some(bare_pose_message(&link.body_from_link)),
            })
            .collect(),
        visual_shapes: shapes(if hand.visuals.is_empty() { &hand.collision } else { &hand.visuals }),
        collision_shapes: shapes(&hand.collision),
        pads: hand.pads.iter().filter_map(|pad| pad_message(tree, pad)).collect(),
    }
}

/// `None` for a pad of a link that there is not, which no validated hand has.
fn pad_message(tree: &Tree, pad: &Pad) -> Option<v1::PadShape> {
    let link = tree.links.get(pad.link)?;
    let placed = |v: &Vector3<f64>| Some(vector_message(&(link.body_from_link.rotation * v)));
    Some(v1::PadShape {
        name: pad.name.clone(),
        body: count_message(link.body),
        center_m: Some(vector_message(&(link.body_from_link * pad.center).coords)),
        half_u_m: placed(&pad.half_u),
        half_v_m: placed(&pad.half_v),
        normal: placed(&pad.normal),
    })
}

fn body_message(tree: &Tree, body: &graspd_hands::Body) -> v1::HandBody {
    let moved = body.joint.and_then(|j| tree.joints.get(j)).zip(body.parent);
    let Some((joint, parent)) = moved else { return v1::HandBody::default() };
    v1::HandBody {
        parent: Some(count_message(parent)),
        joint: joint.name.clone(),
        joint_type: match joint.kind {
            JointKind::Revolute => v1::JointType::Revolute,
            JointKind::Prismatic => v1::JointType::Prismatic,
        }
        .into(),
        axis: Some(vector_message(&joint.axis)),
        parent_from_joint: Some(bare_pose_message(&body.parent_from_joint)),
    }
}

/// `None` for a shape of a link that there is not, which no validated hand has.
fn shape_message(tree: &Tree, shape: &CollisionShape) -> Option<v1::HandShape> {
    let link = tree.links.get(shape.link)?;
    let form = match &shape.shape {
        Shape::Box { half_extents } => {
            hand_shape::Shape::Box(v1::BoxShape { half_extents_m: Some(vector_message(half_extents)) })
        }
        &Shape::Cylinder { radius, half_length } => {
            hand_shape::Shape::Cylinder(v1::CylinderShape { radius_m: radius, half_length_m: half_length })
        }
        &Shape::Sphere { radius } => hand_shape::Shape::Sphere(v1::SphereShape { radius_m: radius }),
        Shape::Mesh { vertices, triangles } => hand_shape::Shape::Mesh(v1::MeshShape {
            // Single precision: a tenth of a micrometre on a hand.
            vertices_m: vertices.iter().flat_map(|v| [v.x as f32, v.y as f32, v.z as f32]).collect(),
            triangles: triangles.iter().flatten().copied().collect(),
        }),
    };
    Some(v1::HandShape {
        link: link.name.clone(),
        body: count_message(link.body),
        body_from_shape: Some(bare_pose_message(&(link.body_from_link * shape.link_from_shape))),
        shape: Some(form),
    })
}

#[cfg(test)]
mod tests {
    use graspd_hands::library;
    use nalgebra::{Isometry3, Point3};

    use super::super::geometry;
    use super::*;

    #[test]
    fn every_library_hand_can_be_put_together_from_its_message() {
        for id in library::ids() {
            let hand = library::hand(id).unwrap();
            let message = geometry_message(hand);
            let joints: Vec<f64> = (hand.tree.joints.iter()).map(|j| 0.3 * j.lower + 0.7 * j.upper).collect();
            let mut poses: Vec<Isometry3<f64>> = Vec::new();
            for body in &message.bodies {
                let Some(parent) = body.parent else {
                    assert!(poses.is_empty() && body.joint.is_empty());
                    poses.push(Isometry3::identity());
                    continue;
                };
                let index = hand.tree.joint(&body.joint).unwrap();
                let axis = geometry::direction(body.axis, "axis").unwrap().into_inner() * joints[index];
                let motion = match body.joint_type() {
                    v1::JointType::Revolute => Isometry3::rotation(axis),
                    v1::JointType::Prismatic => Isometry3::translation(axis.x, axis.y, axis.z),
                    v1::JointType::Unspecified => panic!("{id}: a joint without a type"),
                };
                let fixed = geometry::pose(body.parent_from_joint.as_ref(), "parent_from_joint").unwrap();
                let parent = poses[usize::try_from(parent).unwrap()];
                poses.push(parent * fixed * motion);
            }
            let expected = hand.tree.body_poses(&joints);
            assert_eq!(poses.len(), expected.len());
            for (pose, body) in poses.iter().zip(&expected) {
                assert!((pose.to_homogeneous() - body.to_homogeneous()).norm() < 1e-9, "{id}");
            }
            assert_eq!(message.collision_shapes.len(), hand.collision.len());
            assert!(!message.visual_shapes.is_empty(), "{id}");
            for (sent, shape) in message.collision_shapes.iter().zip(&hand.collision) {
                let link = hand.tree.link(&sent.link).unwrap();
                assert_eq!(link, shape.link);
                let placed = geometry::pose(sent.body_from_shape.as_ref(), "body_from_shape").unwrap();
                let expected = hand.tree.links[link].body_from_link * shape.link_from_shape;
                assert!((placed.to_homogeneous() - expected.to_homogeneous()).norm() < 1e-9);
            }
        }
    }

    #[test]
    fn pads_are_where_the_hand_has_them() {
        for id in library::ids() {
            let hand = library::hand(id).unwrap();
            let message = geometry_message(hand);
            assert_eq!(message.pads.len(), hand.pads.len(), "{id}");
            let joints: Vec<f64> = (hand.tree.joints.iter()).map(|j| 0.5 * (j.lower + j.upper)).collect();
            let bodies = hand.tree.body_poses(&joints);
            for (sent, pad) in message.pads.iter().zip(&hand.pads) {
                let link = &hand.tree.links[pad.link];
                let placed = bodies[link.body] * link.body_from_link;
                let part = |v: Option<v1::Vector3>| geometry::vector(v, "pad").unwrap();
                let body = bodies[usize::try_from(sent.body).unwrap()];
                for (sign, corner) in [(-1.0, 0), (1.0, 2)] {
                    let at = part(sent.center_m) + (part(sent.half_u_m) + part(sent.half_v_m)) * sign;
                    assert!((body * Point3::from(at) - placed * pad.corners()[corner]).norm() < 1e-9, "{id}");
                }
                assert!((part(sent.normal).norm() - 1.0).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn a_mesh_keeps_its_triangles() {
        let mut hand = library::hand("antipodal").unwrap().clone();
        let vertices: Vec<_> = (0..4).map(|i| Point3::new(f64::from(i), 0.25, -1.5)).collect();
        hand.visuals = vec![CollisionShape {
            link: 0,
            link_from_shape: Isometry3::identity(),
            shape: Shape::Mesh { vertices, triangles: vec![[0, 1, 2], [3, 2, 1]] },
        }];
        let message = geometry_message(&hand);
        let Some(hand_shape::Shape::Mesh(mesh)) = &message.visual_shapes[0].shape else { panic!("no mesh") };
        assert_eq!(mesh.vertices_m[9..], [3.0, 0.25, -1.5]);
        assert_eq!(mesh.triangles, [0, 1, 2, 3, 2, 1]);
    }
}
