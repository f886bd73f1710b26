//! Hands in the world: where their wrists go, what their motors are told, what they feel.

mod body;
mod drive;
mod force;
mod motors;
mod overlap;
#[cfg(test)]
mod tests;
mod wrist;

use std::sync::Arc;

use graspd_hands::{CoordinateKind, Hand};
use nalgebra::{Isometry3, Point3, Vector3};
use rapier3d_f64::prelude::{ColliderHandle, PhysicsWorld};

use super::{HandSettings, ObjectId, TRAY, World};
use crate::convert;
use body::HandBody;
use drive::Drives;
pub use force::WristForce;
use motors::Motors;
use wrist::Wrist;

/// Names a hand of a [`World`]; never used twice.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct HandId(pub(crate) u32);

/// What a hand is told to do. The wrist moves on a straight line, turning evenly.
#[derive(Debug, Clone, PartialEq)]
pub enum Command {
    /// Take the wrist (the URDF's root link) to this pose, world frame.
    Move {
        /// Target.
        world_from_hand: Isometry3<f64>,
        /// Speed along the line, metres per second.
        speed_m_s: f64,
        /// Largest angular speed, radians per second.
        turn_rad_s: f64,
    },
    /// Take the actuators to these positions, each until it arrives or its force limit holds it.
    Close {
        /// One per actuator of the hand, in its order.
        actuators: Vec<f64>,
        /// Share of each actuator's effort, 0 to 1.
        force: f64,
        /// Share of each actuator's speed, 0 to 1.
        speed: f64,
    },
}

/// What a hand may touch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Touched {
    /// An object.
    Object(ObjectId),
    /// The table.
    Table,
    /// The tray's walls.
    Tray,
    /// Another hand, or another part of the same.
    Hand(HandId),
}

/// One contact between a hand and something.
#[derive(Debug, Clone, PartialEq)]
pub struct HandContact {
    /// The hand's link; index into its tree's links.
    pub link: usize,
    /// What it touches.
    pub touched: Touched,
    /// Where, world frame.
    pub point: Point3<f64>,
    /// Normal from the hand outwards, world frame.
    pub normal: Vector3<f64>,
    /// Normal force, newtons, averaged over the last step.
    pub force_n: f64,
}

/// What a hand reports.
#[derive(Debug, Clone, PartialEq)]
pub struct HandState {
    /// Pose of the root link, world frame.
    pub world_from_hand: Isometry3<f64>,
    /// Joint positions, in the order of the tree's joints.
    pub joints: Vec<f64>,
    /// Actuator positions, in the order of the hand's actuators.
    pub actuators: Vec<f64>,
    /// Effort of each actuator, newtons or newton metres; positive towards closed.
    pub efforts: Vec<f64>,
    /// True when the wrist has reached its target pose.
    pub arrived: bool,
    /// True when no actuator moves any more: each is at its target or held by its force limit.
    pub settled: bool,
}

/// A hand in the world.
#[derive(Debug)]
pub(super) struct PlacedHand {
    id: HandId,
    hand: Arc<Hand>,
    drives: Drives,
    body: HandBody,
    wrist: Wrist,
    motors: Motors,
}

impl PlacedHand {
    fn root(&self, physics: &PhysicsWorld) -> Option<Isometry3<f64>> {
        Some(convert::from_pose(physics.bodies.get(*self.body.bodies.first()?)?.position()))
    }

    /// Before a step of the engine: what arm and motors do in it.
    pub(super) fn drive(&mut self, physics: &mut PhysicsWorld, settings: &HandSettings, dt: f64) {
        let Some(at) = self.root(physics) else { return };
        self.motors.step(physics, &self.hand, &self.drives, &self.body, settings, dt);
        let Some(multibody) = self.body.multibody_mut(physics) else { return };
        let mut velocity = multibody.generalized_velocity_mut();
        let now = (
            Vector3::new(velocity[0], velocity[1], velocity[2]),
            Vector3::new(velocity[3], velocity[4], velocity[5]),
        );
        let (linear, angular) = self.wrist.step(&at, &now, dt, settings);
        for i in 0..3 {
            velocity[i] = linear[i];
            velocity[3 + i] = angular[i];
        }
    }
}

impl World {
    /// Ids of the hands in the world.
    pub fn hand_ids(&self) -> Vec<HandId> {
        self.hands.iter().map(|h| h.id).collect()
    }

    /// A hand; `None` when it is not in the world.
    pub fn hand(&self, id: HandId) -> Option<&Arc<Hand>> {
        self.placed_hand(id).map(|h| &h.hand)
    }

    /// Pose of every link of a hand, world frame, in the order of its tree's links.
    pub fn hand_links(&self, id: HandId) -> Option<Vec<Isometry3<f64>>> {
        let placed = self.placed_hand(id)?;
        let bodies: Option<Vec<Isometry3<f64>>> = placed
            .body
            .bodies
            .iter()
            .map(|&b| Some(convert::from_pose(self.physics.bodies.get(b)?.position())))
            .collect();
        Some(placed.hand.tree.link_poses(&bodies?))
    }

    /// Puts a hand into the world, its wrist at a pose, its coordinates (`hand.actuation.coordinates`) at values.
    /// Missing values are those of the open posture; each is held within its limits.
    pub fn add_hand(
        &mut self,
        hand: Arc<Hand>,
        world_from_hand: &Isometry3<f64>,
        coordinates: &[f64],
    ) -> HandId {
        let u: Vec<f64> = hand
            .actuation
            .coordinates
            .iter()
            .enumerate()
            .map(|(i, c)| {
                let value = coordinates.get(i).copied().filter(|v| v.is_finite()).unwrap_or(c.open);
                value.clamp(c.lower, c.upper)
            })
            .collect();
        let drives = Drives::new(&hand, &self.settings.hands);
        let q = hand.actuation.joints(&u);
        let body =
            HandBody::insert(&mut self.physics, &hand, &drives, &self.settings.hands, world_from_hand, &q);
        let id = HandId(self.next);
        self.next += 1;
        let motors = Motors::new(&hand, &u);
        self.hands.push(PlacedHand { id, hand, drives, body, wrist: Wrist::new(world_from_hand), motors });
        id
    }

    /// Takes a hand out of the world; `false` when it is not there.
    pub fn remove_hand(&mut self, id: HandId) -> bool {
        let Some(at) = self.hands.iter().position(|h| h.id == id) else { return false };
        let placed = self.hands.remove(at);
        placed.body.remove(&mut self.physics);
        true
    }

    /// Tells a hand what to do from now on; a new command of one kind replaces the last of that kind.
    /// `false` when the hand is not there or the command is not for it (a wrong number of actuators, a value that
    /// is not finite).
    pub fn command(&mut self, id: HandId, command: Command) -> bool {
        let Some(placed) = self.hands.iter_mut().find(|h| h.id == id) else { return false };
        match command {
            Command::Move { world_from_hand: to, speed_m_s, turn_rad_s } => {
                let numbers = to.translation.vector.iter().chain(to.rotation.coords.iter());
                let finite = numbers.chain([&speed_m_s, &turn_rad_s]).all(|v| v.is_finite());
                let Some(at) = placed.root(&self.physics).filter(|_| finite) else { return false };
                placed.wrist.go(&at, &to, speed_m_s, turn_rad_s);
                true
            }
            Command::Close { actuators, force, speed } => {
                placed.motors.command(&placed.hand, &actuators, force, speed)
            }
        }
    }

    /// Bounds each actuator alone: shares, 0 to 1, of the force that [`Command::Close`] allows all of them; one per
    /// actuator, in the hand's order. They hold until they are given anew; at first all are 1. `false` when the hand is
    /// not there or the shares are not for it.
    pub fn share_forces(&mut self, id: HandId, shares: &[f64]) -> bool {
        let placed = self.hands.iter_mut().find(|h| h.id == id);
        placed.is_some_and(|placed| placed.motors.share_forces(&placed.hand, shares))
    }

    /// Leads the wrist along a path of one's own: where it should be after the next step, and the force with which it
    /// goes there at most, newtons (never more than [`HandSettings::arm_force_n`]). `false` when the hand is not there or a
    /// number is not finite; an infinite force is fine.
    pub fn guide(&mut self, id: HandId, world_from_hand: &Isometry3<f64>, force_n: f64) -> bool {
        let numbers = world_from_hand.translation.vector.iter().chain(world_from_hand.rotation.coords.iter());
        let finite = numbers.copied().all(f64::is_finite) && !force_n.is_nan();
        let Some(placed) = self.hands.iter_mut().find(|h| h.id == id).filter(|_| finite) else {
            return false;
        };
        placed.wrist.guide(world_from_hand, force_n);
        true
    }

    /// Velocity of the point of a hand's root link that is at `point` (world frame), metres per second; `None` when
    /// the hand is not in the world.
    pub fn hand_velocity_at(&self, id: HandId, point: &Point3<f64>) -> Option<Vector3<f64>> {
        let body = self.physics.bodies.get(*self.placed_hand(id)?.body.bodies.first()?)?;
        Some(convert::from_vector(body.velocity_at_point(convert::point(point))))
    }

    /// What a hand reports now; `None` when it is not in the world.
    pub fn hand_state(&self, id: HandId) -> Option<HandState> {
        let placed = self.placed_hand(id)?;
        let world_from_hand = placed.root(&self.physics)?;
        let joints = placed.body.positions(&self.physics, &placed.hand.tree);
        Some(HandState {
            world_from_hand,
            actuators: placed.motors.actuators(&placed.hand, &placed.drives, &joints),
            efforts: placed.motors.efforts(&placed.hand),
            arrived: placed.wrist.arrived(&world_from_hand),
            settled: placed.motors.settled(),
            joints,
        })
    }

    /// [`HandState::settled`] alone; `None` when the hand is not in the world.
    pub fn hand_settled(&self, id: HandId) -> Option<bool> {
        Some(self.placed_hand(id)?.motors.settled())
    }

    /// Full effort of each actuator, newtons or newton metres: as published, or what its fingertip force makes of it.
    pub fn full_efforts(&self, id: HandId) -> Option<Vec<f64>> {
        let placed = self.placed_hand(id)?;
        let coordinates = placed.hand.actuation.coordinates.iter().zip(&placed.drives.leads);
        let of = |lead: &Option<usize>| {
            lead.map_or(0.0, |j| {
                placed.drives.servos[j].effort * placed.hand.actuation.rows[j].terms[0].1.abs()
            })
        };
        let driven = coordinates.filter(|(c, _)| c.kind == CoordinateKind::Actuator);
        Some(driven.map(|(_, lead)| of(lead)).collect())
    }

    /// What a hand touches now.
    pub fn hand_contacts(&self, id: HandId) -> Vec<HandContact> {
        let Some(placed) = self.placed_hand(id) else { return Vec::new() };
        let mut out = Vec::new();
        for &(collider, link) in &placed.body.colliders {
            for pair in self.physics.contact_pairs_with(collider) {
                let first = pair.collider1 == collider;
                let other = if first { pair.collider2 } else { pair.collider1 };
                let Some(touched) = self.touched(other) else { continue };
                for manifold in pair.solver_manifolds() {
                    let impulse = manifold.points.iter().map(|p| p.data.impulse).sum::<f64>();
                    let count = manifold.data.solver_contacts.len();
                    if impulse <= 0.0 || count == 0 {
                        continue;
                    }
                    let sum = manifold.data.solver_contacts.iter().fold(Vector3::zeros(), |sum, contact| {
                        let (a, b) = manifold.data.solver_contact_world_points(contact, &self.physics.bodies);
                        sum + (convert::from_vector(a) + convert::from_vector(b)) / 2.0
                    });
                    let normal = convert::from_vector(manifold.data.normal);
                    out.push(HandContact {
                        link,
                        touched,
                        point: Point3::from(sum / count as f64),
                        normal: if first { normal } else { -normal },
                        force_n: impulse / self.settings.dt_s,
                    });
                }
            }
        }
        out
    }

    /// True when nothing but the hand touches an object: all that it does to the hand is to weigh.
    pub(crate) fn hangs_in(&self, hand: HandId, id: ObjectId) -> bool {
        let Some(placed) = self.objects.iter().find(|p| p.id == id) else { return false };
        let Some(body) = self.physics.bodies.get(placed.body) else { return false };
        body.colliders().iter().all(|&collider| {
            self.physics.contact_pairs_with(collider).all(|pair| {
                let other = if pair.collider1 == collider { pair.collider2 } else { pair.collider1 };
                let presses =
                    pair.solver_manifolds().iter().any(|m| m.points.iter().any(|p| p.data.impulse > 0.0));
                !presses || self.touched(other) == Some(Touched::Hand(hand))
            })
        })
    }

    fn touched(&self, collider: ColliderHandle) -> Option<Touched> {
        let collider = self.physics.colliders.get(collider)?;
        let body = collider.parent()?;
        if let Some(object) = self.objects.iter().find(|p| p.body == body) {
            return Some(Touched::Object(object.id));
        }
        if let Some(hand) = self.hands.iter().find(|h| h.body.bodies.contains(&body)) {
            return Some(Touched::Hand(hand.id));
        }
        Some(if collider.user_data == TRAY { Touched::Tray } else { Touched::Table })
    }

    fn placed_hand(&self, id: HandId) -> Option<&PlacedHand> {
        self.hands.iter().find(|h| h.id == id)
    }
}
