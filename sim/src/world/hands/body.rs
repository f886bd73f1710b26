//! A hand as the physics engine sees it: one rigid body per body of the tree, joined in reduced coordinates.
//!
//! The root is a heavy dynamic body whose velocity the arm sets in every step: a kinematic root would be
//! teleported with zero velocity, and friction would not carry what the hand holds.

use graspd_hands::{CollisionShape, Hand, Joint, JointKind, Shape, Tree};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use parry3d_f64::mass_properties::MassProperties;
use rapier3d_f64::dynamics::SpringCoefficients;
use rapier3d_f64::prelude::{
    CoefficientCombineRule, ColliderBuilder, ColliderHandle, GenericJoint, GenericJointBuilder,
    JointAxesMask, JointAxis, Multibody, MultibodyDofCoupling, MultibodyJointHandle, PhysicsWorld,
    RigidBodyBuilder, RigidBodyHandle, SharedShape,
};

use super::drive::{Drives, Role};
use crate::world::HandSettings;
use crate::{convert, hull};

/// How a joint that has overrun its stop is brought back: nearly rigid, but by a tenth of the way in each of the
/// solver's small steps. All of it at once, the engine's default, throws the joint off its stop in the next step; a
/// phalanx that an object presses against its stop then rattles, and shakes light objects out of the fingers.
const STOP: SpringCoefficients<f64> = SpringCoefficients { natural_frequency: 2000.0, damping_ratio: 30.0 };

/// A convex solid and its pose in the frame of its body.
type Solid = (Isometry3<f64>, SharedShape);

/// The parts of a hand in the physics engine.
#[derive(Debug)]
pub(super) struct HandBody {
    /// One per body of the tree.
    pub(super) bodies: Vec<RigidBodyHandle>,
    /// Colliders and the link that each belongs to.
    pub(super) colliders: Vec<(ColliderHandle, usize)>,
    /// One joint per joint of the tree.
    pub(super) joints: Vec<MultibodyJointHandle>,
}

/// Index of a joint's axis in the engine's six coordinates.
pub(super) fn axis(joint: &Joint) -> usize {
    match joint.kind {
        JointKind::Prismatic => 0,
        JointKind::Revolute => 3,
    }
}

impl HandBody {
    /// Puts a hand's bodies, colliders and joints into the engine, at joint positions `q`.
    pub(super) fn insert(
        physics: &mut PhysicsWorld,
        hand: &Hand,
        drives: &Drives,
        settings: &HandSettings,
        world_from_hand: &Isometry3<f64>,
        q: &[f64],
    ) -> Self {
        let tree = &hand.tree;
        let poses = tree.body_poses(q);
        let mut out = Self { bodies: Vec::new(), colliders: Vec::new(), joints: Vec::new() };
        let shapes: Vec<(usize, usize, Vec<Solid>)> =
            hand.collision.iter().map(|c| (tree.links[c.link].body, c.link, solids(tree, c))).collect();
        for (index, pose) in poses.iter().enumerate() {
            let own = shapes.iter().filter(|s| s.0 == index).flat_map(|s| &s.2);
            let mass = mass_of(own, index == 0, settings);
            let body = RigidBodyBuilder::dynamic()
                .pose(convert::pose(&(world_from_hand * pose)))
                .gravity_scale(0.0)
                .can_sleep(false)
                .additional_mass_properties(mass);
            out.bodies.push(physics.insert_body(body));
        }
        let padded: Vec<usize> = hand.pads.iter().map(|p| p.link).collect();
        for (body, link, solids) in shapes {
            let friction =
                if padded.contains(&link) { settings.pad_friction } else { settings.link_friction };
            for (body_from_shape, shape) in solids {
                let collider = ColliderBuilder::new(shape)
                    .position(convert::pose(&body_from_shape))
                    .density(0.0)
                    .friction(friction)
                    .friction_combine_rule(CoefficientCombineRule::Average);
                out.colliders.push((physics.insert_collider(collider, Some(out.bodies[body])), link));
            }
        }
        out.join(physics, hand, drives, settings, q);
        out
    }

    fn join(
        &mut self,
        physics: &mut PhysicsWorld,
        hand: &Hand,
        drives: &Drives,
        settings: &HandSettings,
        q: &[f64],
    ) {
        let tree = &hand.tree;
        let mut handles: Vec<Option<MultibodyJointHandle>> = vec![None; tree.joints.len()];
        for (index, body) in tree.bodies.iter().enumerate() {
            let (Some(parent), Some(j)) = (body.parent, body.joint) else { continue };
            let follower = matches!(drives.roles[j], Role::Follower { .. });
            let joint = generic(&tree.joints[j], &body.parent_from_joint, !follower);
            handles[j] = physics.insert_multibody_joint(self.bodies[parent], self.bodies[index], joint);
        }
        self.joints = handles.into_iter().flatten().collect();
        let Some(multibody) = multibody(physics, &self.joints) else { return };
        multibody.set_self_contacts_enabled(false);
        let mut start = vec![0.0; multibody.ndofs()];
        multibody.damping_mut().fill(0.0);
        for (j, joint) in tree.joints.iter().enumerate() {
            let Some(at) = index_of(physics, &self.joints, j) else { continue };
            let Some((multibody, _)) = physics.multibody_joints.get_mut(self.joints[j]) else { continue };
            start[at.0] = q[j];
            multibody.armature_mut()[at.0] = match joint.kind {
                JointKind::Revolute => settings.armature_kg_m2,
                JointKind::Prismatic => settings.armature_kg,
            };
            multibody.damping_mut()[at.0] = match &drives.roles[j] {
                Role::Follower { pulled_by: None, .. } => 0.0,
                Role::Adaptive(a) => {
                    let driving = drives.servos[a.driver.unwrap_or(j)].effort;
                    settings.adaptive_stiffness * driving * settings.adaptive_time_s
                }
                _ => drives.servos[j].damping,
            };
        }
        for (j, role) in drives.roles.iter().enumerate() {
            let Role::Follower { lead, ratio, offset, .. } = role else { continue };
            let (Some(own), Some(leading)) =
                (index_of(physics, &self.joints, j), index_of(physics, &self.joints, *lead))
            else {
                continue;
            };
            let coupling = MultibodyDofCoupling {
                link1: leading.1,
                dof1: 0,
                axis1: axis(&tree.joints[*lead]),
                link2: own.1,
                dof2: 0,
                axis2: axis(&tree.joints[j]),
                coeff: *ratio,
                offset: *offset,
            };
            if let Some((multibody, _)) = physics.multibody_joints.get_mut(self.joints[j]) {
                multibody.add_dof_coupling(coupling);
            }
        }
        let PhysicsWorld { multibody_joints, bodies, .. } = physics;
        if let Some((multibody, _)) = self.joints.first().and_then(|&h| multibody_joints.get_mut(h)) {
            multibody.forward_kinematics(bodies, true);
            multibody.apply_displacements(&start);
            multibody.forward_kinematics(bodies, true);
            multibody.update_rigid_bodies(bodies, true);
        }
    }

    /// The multibody of the hand.
    pub(super) fn multibody_mut<'a>(&self, physics: &'a mut PhysicsWorld) -> Option<&'a mut Multibody> {
        multibody(physics, &self.joints)
    }

    /// What acts on a joint in the next step besides contacts: a spring of this stiffness about a rest position.
    pub(super) fn spring(
        &self,
        physics: &mut PhysicsWorld,
        j: usize,
        axis: usize,
        stiffness: f64,
        rest: f64,
    ) {
        if let Some((multibody, link)) = physics.multibody_joints.get_mut(self.joints[j])
            && let Some(link) = multibody.link_mut(link)
        {
            link.joint.set_spring(axis, stiffness, rest);
        }
    }

    /// Damping of a joint in the next step.
    pub(super) fn damp(&self, physics: &mut PhysicsWorld, j: usize, damping: f64) {
        if let Some((at, _)) = index_of(physics, &self.joints, j)
            && let Some((multibody, _)) = physics.multibody_joints.get_mut(self.joints[j])
        {
            multibody.damping_mut()[at] = damping;
        }
    }

    /// Joint positions.
    pub(super) fn positions(&self, physics: &PhysicsWorld, tree: &Tree) -> Vec<f64> {
        self.joints
            .iter()
            .zip(&tree.joints)
            .map(|(&h, joint)| {
                let link = physics.multibody_joints.get(h).and_then(|(multibody, link)| multibody.link(link));
                link.map_or(0.0, |l| l.joint.coords()[axis(joint)])
            })
            .collect()
    }

    /// Takes everything out of the engine.
    pub(super) fn remove(&self, physics: &mut PhysicsWorld) {
        for &body in self.bodies.iter().rev() {
            physics.remove_body(body);
        }
    }
}

fn multibody<'a>(
    physics: &'a mut PhysicsWorld,
    joints: &[MultibodyJointHandle],
) -> Option<&'a mut Multibody> {
    joints.first().and_then(|&h| physics.multibody_joints.get_mut(h)).map(|(m, _)| m)
}

/// Index of a joint's freedom among the multibody's, and its link there.
fn index_of(physics: &PhysicsWorld, joints: &[MultibodyJointHandle], j: usize) -> Option<(usize, usize)> {
    let (multibody, link) = physics.multibody_joints.get(*joints.get(j)?)?;
    Some((multibody.link(link)?.assembly_id(), link))
}

/// A joint along or about x of its frames; followers have no limits of their own.
fn generic(joint: &Joint, parent_from_joint: &Isometry3<f64>, limited: bool) -> GenericJoint {
    let turn = UnitQuaternion::rotation_between(&Vector3::x(), &joint.axis)
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI));
    let turn = Isometry3::from_parts(nalgebra::Translation3::identity(), turn);
    let (free, axis) = match joint.kind {
        JointKind::Prismatic => (JointAxesMask::LIN_X, JointAxis::LinX),
        JointKind::Revolute => (JointAxesMask::ANG_X, JointAxis::AngX),
    };
    let builder = GenericJointBuilder::new(JointAxesMask::all() & !free)
        .local_frame1(convert::pose(&(parent_from_joint * turn)))
        .local_frame2(convert::pose(&turn))
        .contacts_enabled(false);
    if limited {
        builder.limits(axis, [joint.lower, joint.upper]).softness(STOP).build()
    } else {
        builder.build()
    }
}

/// A collision shape as convex solids in the frame of its body.
fn solids(tree: &Tree, collision: &CollisionShape) -> Vec<Solid> {
    let at = tree.links[collision.link].body_from_link * collision.link_from_shape;
    match &collision.shape {
        Shape::Box { half_extents: h } => vec![(at, SharedShape::cuboid(h.x, h.y, h.z))],
        Shape::Sphere { radius } => vec![(at, SharedShape::ball(*radius))],
        Shape::Cylinder { radius, half_length } => {
            // The engine's cylinders stand along y.
            let upright = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2);
            vec![(at * upright, SharedShape::cylinder(*half_length, *radius))]
        }
        Shape::Mesh { vertices, triangles } => {
            mesh(vertices, triangles).into_iter().map(|shape| (at, shape)).collect()
        }
    }
}

/// A mesh as its convex hull where that adds little, else decomposed.
pub(super) fn mesh(vertices: &[Point3<f64>], triangles: &[[u32; 3]]) -> Vec<SharedShape> {
    let points: Vec<_> = vertices.iter().map(convert::point).collect();
    let Some(hull) = hull::shape(vertices) else { return Vec::new() };
    let volume: f64 = triangles
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(|i| vertices[i as usize].coords);
            a.dot(&b.cross(&c)) / 6.0
        })
        .sum();
    let hull_volume = hull.mass_properties(1.0).mass();
    // Open or inside-out meshes enclose nothing that could be decomposed.
    if volume <= 0.1 * hull_volume || volume > hull_volume / 1.5 {
        return vec![hull];
    }
    let whole = SharedShape::convex_decomposition(&points, triangles);
    match whole.as_compound() {
        Some(compound) => compound.shapes().iter().map(|(_, shape)| shape.clone()).collect(),
        None => vec![hull],
    }
}

/// Mass, centre and inertia of a body from its volume; the root weighs what the arm shows at the wrist.
fn mass_of<'a>(
    solids: impl Iterator<Item = &'a Solid>,
    root: bool,
    settings: &HandSettings,
) -> MassProperties {
    if root {
        let mass = settings.arm_mass_kg;
        // A ball of 10 cm radius of gyration about the frame's origin.
        let inertia = convert::vector(&Vector3::repeat(mass * 0.01));
        return MassProperties::new(convert::vector(&Vector3::zeros()), mass, inertia);
    }
    let sum = solids.fold(MassProperties::default(), |sum, (pose, shape)| {
        sum + shape.mass_properties(settings.link_density).transform_by(&convert::pose(pose))
    });
    let mass = sum.mass().max(settings.link_mass_kg);
    // No axis is lighter than a ball of 5 mm.
    let floor = mass * 0.4 * 0.005_f64.powi(2);
    let inertia = convert::from_vector(sum.principal_inertia()) * (mass / sum.mass().max(1e-9));
    let inertia = inertia.map(|i| if i.is_finite() { i.max(floor) } else { floor });
    MassProperties::with_principal_inertia_frame(
        sum.local_com,
        mass,
        convert::vector(&inertia),
        sum.principal_inertia_local_frame,
    )
}
