//! A hand as a viewer draws it: rigid parts, how joints move them, and shapes on the parts.

use std::collections::HashMap;

use graspd_client::wire::{
    GetHandGeometryResponse, Hand, HandShape, JointType, MeshShape, Vector3 as WireVector, hand_shape,
};
use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};

use crate::poses;

/// Most triangles of a mesh that is sent as it is; a larger one is drawn as the box around it.
pub const MAX_TRIANGLES: usize = 20_000;

/// What a hand is and looks like.
#[derive(Debug, Clone, PartialEq)]
pub struct HandModel {
    /// Revision of the description.
    pub revision: String,
    /// The root link: poses are its.
    pub wrist_link: String,
    /// Along which the hand reaches, hand frame, unit length.
    pub approach: Vector3<f64>,
    /// Between the half-closed fingers, hand frame, metres.
    pub tool_point: Point3<f64>,
    bodies: Vec<Body>,
    shapes: Vec<Placed>,
}

/// A part that moves as one.
#[derive(Debug, Clone, PartialEq)]
struct Body {
    parent: Option<usize>,
    joint: String,
    motion: Motion,
    parent_from_joint: Isometry3<f64>,
}

#[derive(Debug, Clone, PartialEq)]
enum Motion {
    None,
    About(Unit<Vector3<f64>>),
    Along(Unit<Vector3<f64>>),
}

/// A shape on a body.
#[derive(Debug, Clone, PartialEq)]
struct Placed {
    body: usize,
    body_from_shape: Isometry3<f64>,
    shape: Shape,
}

/// A shape about its own origin, metres.
#[derive(Debug, Clone, PartialEq)]
pub enum Shape {
    /// Full edges.
    Box(Vector3<f64>),
    /// Along z: radius and full length.
    Cylinder {
        /// Metres.
        radius_m: f64,
        /// Metres.
        length_m: f64,
    },
    /// Radius.
    Sphere(f64),
    /// Corners of triangles, three for each.
    Mesh(Vec<Point3<f64>>),
}

impl HandModel {
    /// Reads what the server says of a hand. Parts that make no sense are left out: this is for drawing.
    pub fn new(hand: &Hand, geometry: &GetHandGeometryResponse) -> Self {
        let count = geometry.bodies.len();
        let bodies = geometry.bodies.iter().enumerate().map(|(index, b)| {
            let axis = b.axis.as_ref().map(|a| Vector3::new(a.x, a.y, a.z));
            let axis = axis.and_then(|a| Unit::try_new(a, 1e-6));
            let motion = match (b.joint_type(), axis) {
                (JointType::Revolute, Some(axis)) => Motion::About(axis),
                (JointType::Prismatic, Some(axis)) => Motion::Along(axis),
                _ => Motion::None,
            };
            // Parents come before their children.
            let parent = b.parent.and_then(|p| usize::try_from(p).ok()).filter(|p| *p < index);
            let parent_from_joint = poses::of_wire(b.parent_from_joint.as_ref());
            let parent_from_joint = parent_from_joint.unwrap_or_else(Isometry3::identity);
            Body { parent, joint: b.joint.clone(), motion, parent_from_joint }
        });
        let shapes = geometry.visual_shapes.iter().filter_map(|s| placed(s, count));
        let approach = hand.approach.as_ref().map(|a| Vector3::new(a.x, a.y, a.z));
        Self {
            revision: geometry.revision.clone(),
            wrist_link: hand.wrist_link.clone(),
            approach: approach.unwrap_or_else(Vector3::z),
            tool_point: poses::vector(hand.tool_point.as_ref()),
            bodies: bodies.collect(),
            shapes: shapes.collect(),
        }
    }

    /// Every shape with its pose in the hand frame, joints being at these positions (0 where none is given).
    pub fn shapes(&self, joints: &HashMap<&str, f64>) -> Vec<(Isometry3<f64>, &Shape)> {
        let mut poses: Vec<Isometry3<f64>> = Vec::with_capacity(self.bodies.len());
        for body in &self.bodies {
            let position = joints.get(body.joint.as_str()).copied().unwrap_or(0.0);
            let motion = match &body.motion {
                Motion::None => Isometry3::identity(),
                Motion::About(axis) => Isometry3::from_parts(
                    Translation3::identity(),
                    UnitQuaternion::from_axis_angle(axis, position),
                ),
                Motion::Along(axis) => Translation3::from(axis.into_inner() * position).into(),
            };
            let own = body.parent_from_joint * motion;
            poses.push(body.parent.map_or(own, |parent| poses[parent] * own));
        }
        self.shapes.iter().map(|s| (poses[s.body] * s.body_from_shape, &s.shape)).collect()
    }
}

fn placed(shape: &HandShape, bodies: usize) -> Option<Placed> {
    let body = usize::try_from(shape.body).ok().filter(|b| *b < bodies)?;
    let mut body_from_shape = poses::of_wire(shape.body_from_shape.as_ref())?;
    let edges = |half: &WireVector| Vector3::new(half.x, half.y, half.z) * 2.0;
    let shape = match shape.shape.as_ref()? {
        hand_shape::Shape::Box(b) => Shape::Box(edges(b.half_extents_m.as_ref()?)),
        hand_shape::Shape::Cylinder(c) => {
            Shape::Cylinder { radius_m: c.radius_m, length_m: 2.0 * c.half_length_m }
        }
        hand_shape::Shape::Sphere(s) => Shape::Sphere(s.radius_m),
        hand_shape::Shape::Mesh(mesh) => {
            let corners = corners(mesh);
            if mesh.triangles.len() / 3 > MAX_TRIANGLES {
                let (low, high) = bounds(&corners)?;
                body_from_shape *= Translation3::from(nalgebra::center(&low, &high).coords);
                Shape::Box(high - low)
            } else {
                Shape::Mesh(corners)
            }
        }
    };
    Some(Placed { body, body_from_shape, shape })
}

/// Three corners for each triangle whose vertices are there.
fn corners(mesh: &MeshShape) -> Vec<Point3<f64>> {
    let vertices: &[[f32; 3]] = mesh.vertices_m.as_chunks().0;
    let vertex = |index: &u32| {
        let v = vertices.get(*index as usize)?;
        Some(Point3::new(f64::from(v[0]), f64::from(v[1]), f64::from(v[2])))
    };
    let triangles: &[[u32; 3]] = mesh.triangles.as_chunks().0;
    let whole = triangles.iter().filter_map(|t| t.iter().map(vertex).collect::<Option<Vec<_>>>());
    whole.flatten().collect()
}

fn bounds(points: &[Point3<f64>]) -> Option<(Point3<f64>, Point3<f64>)> {
    let first = points.first()?;
    Some(points.iter().fold((*first, *first), |(low, high), p| {
        (Point3::from(low.coords.inf(&p.coords)), Point3::from(high.coords.sup(&p.coords)))
    }))
}

#[cfg(test)]
pub(crate) mod tests {
    use graspd_client::wire::{self, BoxShape, CylinderShape, HandBody};
    use std::f64::consts::FRAC_PI_2;

    use super::*;

    fn pose(x: f64, y: f64, z: f64) -> Option<wire::Pose> {
        let orientation = Some(wire::Quaternion { w: 1.0, ..wire::Quaternion::default() });
        Some(wire::Pose { position: Some(WireVector { x, y, z }), orientation })
    }

    fn body(
        parent: Option<i32>,
        joint: &str,
        kind: JointType,
        axis: [f64; 3],
        at: Option<wire::Pose>,
    ) -> HandBody {
        let [x, y, z] = axis;
        let axis = Some(WireVector { x, y, z });
        HandBody { parent, joint: joint.into(), joint_type: kind.into(), axis, parent_from_joint: at }
    }

    fn on(body: i32, at: Option<wire::Pose>, shape: hand_shape::Shape) -> HandShape {
        HandShape { link: String::new(), body, body_from_shape: at, shape: Some(shape) }
    }

    /// A palm, a finger that turns about y at x = 0.1, and its tip that slides along x.
    pub(crate) fn geometry() -> GetHandGeometryResponse {
        let cube = WireVector { x: 0.01, y: 0.02, z: 0.03 };
        GetHandGeometryResponse {
            revision: "r1".into(),
            bodies: vec![
                HandBody::default(),
                body(Some(0), "turn", JointType::Revolute, [0.0, 1.0, 0.0], pose(0.1, 0.0, 0.0)),
                body(Some(1), "slide", JointType::Prismatic, [1.0, 0.0, 0.0], pose(0.2, 0.0, 0.0)),
            ],
            visual_shapes: vec![
                on(0, pose(0.0, 0.0, 0.0), hand_shape::Shape::Box(BoxShape { half_extents_m: Some(cube) })),
                on(
                    2,
                    pose(0.0, 0.0, 0.0),
                    hand_shape::Shape::Cylinder(CylinderShape { radius_m: 0.01, half_length_m: 0.02 }),
                ),
            ],
            ..GetHandGeometryResponse::default()
        }
    }

    pub(crate) fn hand() -> Hand {
        let (tool_point, approach) =
            (WireVector { x: 0.0, y: 0.0, z: 0.15 }, WireVector { x: 0.0, y: 0.0, z: 1.0 });
        Hand {
            wrist_link: "palm".into(),
            tool_point: Some(tool_point),
            approach: Some(approach),
            ..Hand::default()
        }
    }

    #[test]
    fn joints_move_what_is_behind_them() {
        let model = HandModel::new(&hand(), &geometry());
        assert_eq!((model.wrist_link.as_str(), model.tool_point.z), ("palm", 0.15));
        let straight = model.shapes(&HashMap::new());
        assert_eq!(straight.len(), 2);
        assert_eq!(straight[0].1, &Shape::Box(Vector3::new(0.02, 0.04, 0.06)));
        assert_eq!(straight[1].1, &Shape::Cylinder { radius_m: 0.01, length_m: 0.04 });
        assert!((straight[1].0.translation.vector - Vector3::new(0.3, 0.0, 0.0)).norm() < 1e-12);
        // A quarter turn about y takes x to -z.
        let bent = model.shapes(&[("turn", FRAC_PI_2), ("slide", 0.05)].into());
        assert!((bent[1].0.translation.vector - Vector3::new(0.1, 0.0, -0.25)).norm() < 1e-12);
    }

    #[test]
    fn what_makes_no_sense_is_left_out() {
        let mut geometry = geometry();
        geometry.bodies[1].parent = Some(7);
        geometry.visual_shapes.push(on(
            9,
            pose(0.0, 0.0, 0.0),
            hand_shape::Shape::Mesh(MeshShape::default()),
        ));
        geometry.visual_shapes.push(on(0, None, hand_shape::Shape::Mesh(MeshShape::default())));
        let triangles = MeshShape { vertices_m: vec![0.0; 9], triangles: vec![0, 1, 2, 0, 1, 3] };
        geometry.visual_shapes.push(on(0, pose(0.0, 0.0, 0.0), hand_shape::Shape::Mesh(triangles)));
        let model = HandModel::new(&Hand::default(), &geometry);
        let shapes = model.shapes(&HashMap::new());
        assert_eq!(shapes.len(), 3);
        assert_eq!(shapes[2].1, &Shape::Mesh(vec![Point3::origin(); 3]));
    }

    #[test]
    fn a_large_mesh_is_its_box() {
        let mut geometry = geometry();
        let vertices_m = vec![-1.0, 0.0, 0.0, 3.0, 0.0, 0.0, 0.0, 2.0, 1.0];
        let triangles = [0, 1, 2].repeat(MAX_TRIANGLES + 1);
        let mesh = hand_shape::Shape::Mesh(MeshShape { vertices_m, triangles });
        geometry.visual_shapes = vec![on(0, pose(1.0, 0.0, 0.0), mesh)];
        let model = HandModel::new(&hand(), &geometry);
        let (pose, shape) = model.shapes(&HashMap::new())[0];
        assert_eq!(shape, &Shape::Box(Vector3::new(4.0, 2.0, 1.0)));
        assert!((pose.translation.vector - Vector3::new(2.0, 1.0, 0.5)).norm() < 1e-12);
    }
}
