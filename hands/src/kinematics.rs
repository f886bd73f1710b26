//! The kinematic tree of a hand and its forward kinematics.
//!
//! Links joined by fixed joints move as one: the tree keeps the URDF's links for names and drawings, and
//! *bodies* (the root, and one per movable joint) for computing. Everything that moves with a body
//! (contact candidates, collision spheres) is expressed in that body's frame.

use nalgebra::{Isometry3, Translation3, Unit, UnitQuaternion, Vector3};

/// How a movable joint moves along or about its axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JointKind {
    /// Rotation about the axis, radians.
    Revolute,
    /// Translation along the axis, metres.
    Prismatic,
}

/// A movable joint.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// Name in the URDF.
    pub name: String,
    /// Revolute or prismatic.
    pub kind: JointKind,
    /// Axis in the joint frame (the child body's frame).
    pub axis: Unit<Vector3<f64>>,
    /// Lower limit, radians or metres.
    pub lower: f64,
    /// Upper limit, radians or metres.
    pub upper: f64,
    /// Largest effort, newton metres or newtons; 0 when the URDF names none.
    pub effort: f64,
    /// Largest velocity, radians or metres a second; 0 when the URDF names none.
    pub velocity: f64,
}

/// A link of the URDF, rigidly attached to a body.
#[derive(Debug, Clone, PartialEq)]
pub struct Link {
    /// Name in the URDF.
    pub name: String,
    /// The body that the link moves with; index into [`Tree::bodies`].
    pub body: usize,
    /// Takes coordinates in the link frame to coordinates in the body frame.
    pub body_from_link: Isometry3<f64>,
    /// The parent link; `None` for the root.
    pub parent: Option<usize>,
}

/// A rigid part that moves as one: the root, or whatever one movable joint carries.
#[derive(Debug, Clone, PartialEq)]
pub struct Body {
    /// The body that this one's joint is attached to; `None` for the root. Always smaller than the own index.
    pub parent: Option<usize>,
    /// Joint frame in the parent body at joint position zero; identity for the root.
    pub parent_from_joint: Isometry3<f64>,
    /// Index into [`Tree::joints`]; `None` for the root.
    pub joint: Option<usize>,
}

/// A kinematic tree. Body 0 is the root and its frame is the hand frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Tree {
    /// Links, parents before children; link 0 is the root link.
    pub links: Vec<Link>,
    /// Movable joints; this order is the order of every joint vector.
    pub joints: Vec<Joint>,
    /// Bodies, parents before children.
    pub bodies: Vec<Body>,
}

impl Tree {
    /// Index of the link with this name.
    pub fn link(&self, name: &str) -> Option<usize> {
        self.links.iter().position(|l| l.name == name)
    }

    /// Index of the movable joint with this name.
    pub fn joint(&self, name: &str) -> Option<usize> {
        self.joints.iter().position(|j| j.name == name)
    }

    /// Pose of every body in the hand frame for joint positions `q` (length [`Tree::joints`]).
    ///
    /// # Panics
    /// If `q` has another length.
    pub fn body_poses(&self, q: &[f64]) -> Vec<Isometry3<f64>> {
        assert_eq!(q.len(), self.joints.len(), "one position per movable joint");
        let mut poses: Vec<Isometry3<f64>> = Vec::with_capacity(self.bodies.len());
        for body in &self.bodies {
            let pose = match (body.parent, body.joint) {
                (Some(parent), Some(j)) => {
                    poses[parent] * body.parent_from_joint * joint_motion(&self.joints[j], q[j])
                }
                _ => Isometry3::identity(),
            };
            poses.push(pose);
        }
        poses
    }

    /// Pose of every link in the hand frame, from the poses of the bodies.
    pub fn link_poses(&self, body_poses: &[Isometry3<f64>]) -> Vec<Isometry3<f64>> {
        self.links.iter().map(|l| body_poses[l.body] * l.body_from_link).collect()
    }

    /// True when `ancestor` is `body` or carries it.
    pub fn carries(&self, ancestor: usize, body: usize) -> bool {
        let mut at = Some(body);
        while let Some(b) = at {
            if b == ancestor {
                return true;
            }
            at = self.bodies[b].parent;
        }
        false
    }
}

/// The motion of a joint's child frame for position `q`.
pub(crate) fn joint_motion(joint: &Joint, q: f64) -> Isometry3<f64> {
    match joint.kind {
        JointKind::Revolute => {
            Isometry3::from_parts(Translation3::identity(), UnitQuaternion::from_axis_angle(&joint.axis, q))
        }
        JointKind::Prismatic => {
            Isometry3::from_parts(Translation3::from(joint.axis.into_inner() * q), UnitQuaternion::identity())
        }
    }
}
