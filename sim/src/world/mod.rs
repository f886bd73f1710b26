//! The physics world: a table, a tray, objects, hands; time goes in fixed steps.

mod hands;
mod settings;

pub use hands::{Command, HandContact, HandId, HandState, Touched, WristForce};
pub use settings::{HandSettings, Tray, WorldSettings};

use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Vector3};
use rapier3d_f64::prelude::{
    CoefficientCombineRule, ColliderBuilder, FrictionModel, PhysicsWorld, RigidBodyBuilder, RigidBodyHandle,
};

use crate::convert;
use crate::hull;
use crate::object::Object;

/// Names an object of a [`World`]; never used twice.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ObjectId(pub(crate) u32);

impl ObjectId {
    /// A number from 1, also its value in instance masks.
    pub fn number(self) -> u32 {
        self.0
    }
}

/// Marks the colliders of the tray; the table's have 0.
const TRAY: u128 = 1;

/// An object in the world.
#[derive(Debug)]
struct Placed {
    id: ObjectId,
    object: Arc<Object>,
    body: RigidBodyHandle,
}

/// A world in which things fall, collide and are held.
///
/// Deterministic: the same calls in the same order give the same poses, bit for bit, on one machine type.
pub struct World {
    settings: WorldSettings,
    physics: PhysicsWorld,
    objects: Vec<Placed>,
    hands: Vec<hands::PlacedHand>,
    next: u32,
    steps: u64,
}

impl std::fmt::Debug for World {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("World")
            .field("objects", &self.objects)
            .field("time_s", &self.time_s())
            .finish_non_exhaustive()
    }
}

impl World {
    /// A table, with the tray of the settings on it where there is one.
    pub fn new(settings: WorldSettings) -> Self {
        let mut physics = PhysicsWorld {
            gravity: convert::vector(&Vector3::new(0.0, 0.0, -settings.gravity)),
            ..Default::default()
        };
        let p = &mut physics.integration_parameters;
        p.dt = settings.dt_s;
        // Things here are centimetres, not metres: tolerances follow.
        p.length_unit = 0.1;
        p.num_solver_iterations = settings.solver_iterations;
        p.contact_softness.natural_frequency = settings.contact_hz;
        p.static_contact_softness.natural_frequency = 2.0 * settings.contact_hz;
        p.friction_model = FrictionModel::Coulomb;
        // Recycled contacts save half of the time, but some things then creep or rock for seconds.
        p.contact_recycling = false;
        let half = settings.table_half_extent_m;
        let table = RigidBodyBuilder::fixed().translation(convert::vector(&Vector3::new(0.0, 0.0, -0.05)));
        physics.insert(table, ColliderBuilder::cuboid(half, half, 0.05).friction(settings.table_friction));
        if let Some(tray) = &settings.tray {
            for (center, half) in tray.walls() {
                let wall = RigidBodyBuilder::fixed().translation(convert::vector(&center));
                physics.insert(
                    wall,
                    ColliderBuilder::cuboid(half.x, half.y, half.z)
                        .friction(settings.table_friction)
                        .user_data(TRAY),
                );
            }
        }
        Self { settings, physics, objects: Vec::new(), hands: Vec::new(), next: 1, steps: 0 }
    }

    /// How the world was made.
    pub fn settings(&self) -> &WorldSettings {
        &self.settings
    }

    /// Simulated seconds since the world began.
    pub fn time_s(&self) -> f64 {
        self.steps as f64 * self.settings.dt_s
    }

    /// Puts an object into the world, at rest.
    pub fn add(&mut self, object: Arc<Object>, world_from_object: &Isometry3<f64>) -> ObjectId {
        let shapes: Vec<_> = object.parts.iter().filter_map(|part| hull::shape(part)).collect();
        // The engine has no rolling friction: without some damping, round things would roll for ever.
        let body = RigidBodyBuilder::dynamic().angular_damping(1.0).ccd_enabled(true);
        let body = body.pose(convert::pose(world_from_object));
        let body = self.physics.insert_body(body);
        let volume: f64 = shapes.iter().map(|s| s.mass_properties(1.0).mass()).sum();
        for shape in shapes {
            let collider = ColliderBuilder::new(shape)
                .density(object.mass_kg / volume.max(1e-9))
                .friction(object.friction)
                .friction_combine_rule(CoefficientCombineRule::Average);
            self.physics.insert_collider(collider, Some(body));
        }
        let id = ObjectId(self.next);
        self.next += 1;
        self.objects.push(Placed { id, object, body });
        id
    }

    /// Takes an object out of the world; `false` when it is not there.
    pub fn remove(&mut self, id: ObjectId) -> bool {
        let Some(at) = self.objects.iter().position(|p| p.id == id) else { return false };
        let placed = self.objects.remove(at);
        self.physics.remove_body(placed.body).is_some()
    }

    /// Ids of the objects in the world, in the order they were added.
    pub fn ids(&self) -> Vec<ObjectId> {
        self.objects.iter().map(|p| p.id).collect()
    }

    /// An object; `None` when it is not in the world (any more).
    pub fn object(&self, id: ObjectId) -> Option<&Arc<Object>> {
        self.placed(id).map(|p| &p.object)
    }

    /// Pose of an object, world frame.
    pub fn pose(&self, id: ObjectId) -> Option<Isometry3<f64>> {
        let body = self.physics.bodies.get(self.placed(id)?.body)?;
        Some(convert::from_pose(body.position()))
    }

    /// Linear (m/s) and angular (rad/s) velocity of an object, world frame.
    pub fn velocity(&self, id: ObjectId) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let body = self.physics.bodies.get(self.placed(id)?.body)?;
        Some((convert::from_vector(body.linvel()), convert::from_vector(body.angvel())))
    }

    /// Moves an object, and stops it; `false` when it is not there.
    pub fn place(&mut self, id: ObjectId, world_from_object: &Isometry3<f64>) -> bool {
        let Some(handle) = self.placed(id).map(|p| p.body) else { return false };
        let Some(body) = self.physics.bodies.get_mut(handle) else { return false };
        body.set_position(convert::pose(world_from_object), true);
        body.set_linvel(convert::vector(&Vector3::zeros()), true);
        body.set_angvel(convert::vector(&Vector3::zeros()), true);
        true
    }

    /// Distance from a point (world frame) to an object, metres; 0 inside; `None` when it is not in the world.
    pub fn distance(&self, id: ObjectId, point: &Point3<f64>) -> Option<f64> {
        let body = self.physics.bodies.get(self.placed(id)?.body)?;
        let colliders = body.colliders().iter().filter_map(|&c| self.physics.colliders.get(c));
        colliders
            .map(|c| c.shape().distance_to_point(c.position(), convert::point(point), true))
            .reduce(f64::min)
    }

    /// Mechanical energy of the objects, joules: kinetic, and potential above the table.
    pub fn energy(&self) -> f64 {
        self.objects
            .iter()
            .filter_map(|p| self.physics.bodies.get(p.body))
            .map(|b| b.kinetic_energy() + b.mass() * self.settings.gravity * b.center_of_mass().z)
            .sum()
    }

    /// One step of [`WorldSettings::dt_s`].
    pub fn step(&mut self) {
        // Fingers squeeze light links between stiff springs: one more pass takes the velocities that pushing apart
        // overlaps has left in their joints.
        let passes = if self.hands.is_empty() { 1 } else { 2 };
        self.physics.integration_parameters.num_internal_stabilization_iterations = passes;
        for hand in &mut self.hands {
            hand.drive(&mut self.physics, &self.settings.hands, self.settings.dt_s);
        }
        self.physics.step();
        self.steps += 1;
    }

    fn placed(&self, id: ObjectId) -> Option<&Placed> {
        self.objects.iter().find(|p| p.id == id)
    }
}

/// Objects for the tests of this crate's worlds.
#[cfg(test)]
pub(crate) mod samples {
    use super::*;
    use crate::mesh::Mesh;
    use crate::object::{Source, Surface};

    /// A convex object from its corners.
    pub(crate) fn convex(name: &str, points: Vec<Point3<f64>>, mass_kg: f64, friction: f64) -> Arc<Object> {
        let mesh = Mesh { vertices: points.clone(), triangles: Vec::new() };
        let surface = Surface::default();
        Arc::new(Object {
            name: name.into(),
            mesh: mesh.into(),
            parts: vec![points],
            mass_kg,
            friction,
            surface,
            source: Source::Mesh,
        })
    }

    /// A box with these half extents.
    pub(crate) fn cuboid(half: [f64; 3], mass_kg: f64, friction: f64) -> Arc<Object> {
        convex("box", Mesh::cuboid(half.into()).vertices, mass_kg, friction)
    }

    /// A cylinder along z.
    pub(crate) fn cylinder(radius: f64, half: f64, mass_kg: f64) -> Arc<Object> {
        let ring = (0..32).map(|k| f64::from(k) * std::f64::consts::TAU / 32.0);
        let at = |a: f64, z: f64| Point3::new(radius * a.cos(), radius * a.sin(), z);
        convex("cylinder", ring.flat_map(|a| [at(a, -half), at(a, half)]).collect(), mass_kg, 0.5)
    }

    /// A ball.
    pub(crate) fn ball(radius: f64, mass_kg: f64) -> Arc<Object> {
        let step = std::f64::consts::PI / 16.0;
        let at = |i: i32, k: i32| {
            let (a, b) = (f64::from(i) * step, f64::from(k) * step);
            Point3::from(radius * Vector3::new(a.sin() * b.cos(), a.sin() * b.sin(), a.cos()))
        };
        convex("ball", (0..=16).flat_map(|i| (0..32).map(move |k| at(i, k))).collect(), mass_kg, 0.5)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cube() -> Arc<Object> {
        Arc::new(Object::cuboid("box", Vector3::new(0.03, 0.02, 0.025)).unwrap())
    }

    #[test]
    fn a_dropped_box_comes_to_rest_on_the_table_and_loses_energy() {
        let mut world = World::new(WorldSettings::default());
        let id = world.add(cube(), &Isometry3::translation(0.0, 0.0, 0.10));
        let mut highest = world.energy();
        for _ in 0..(2.0 / world.settings().dt_s) as usize {
            world.step();
            let energy = world.energy();
            assert!(energy < highest + 1e-4, "energy from nothing: {highest} J, then {energy} J");
            highest = highest.min(energy.max(0.0));
        }
        let z = world.pose(id).unwrap().translation.z;
        assert!((z - 0.025).abs() < 1e-3, "rests at {z} m");
        assert!(world.velocity(id).unwrap().0.norm() < 1e-3);
        assert!(world.remove(id) && !world.remove(id) && world.pose(id).is_none());
    }
}
