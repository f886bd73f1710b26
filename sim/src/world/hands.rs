//! Hands in the world: where their wrists go, what their motors are told, what they feel.

use std::sync::Arc;

use graspd_hands::Hand;
use nalgebra::{Isometry3, Point3, Vector3};

use super::{ObjectId, World};

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

#[derive(Debug)]
pub(super) struct PlacedHand {
    id: HandId,
    hand: Arc<Hand>,
}

impl World {
    /// Ids of the hands in the world.
    pub fn hand_ids(&self) -> Vec<HandId> {
        self.hands.iter().map(|h| h.id).collect()
    }

    /// A hand; `None` when it is not in the world.
    pub fn hand(&self, id: HandId) -> Option<&Arc<Hand>> {
        self.hands.iter().find(|h| h.id == id).map(|h| &h.hand)
    }

    /// Pose of every link of a hand, world frame, in the order of its tree's links.
    pub fn hand_links(&self, id: HandId) -> Option<Vec<Isometry3<f64>>> {
        unimplemented!("{id:?}")
    }

    /// Puts a hand into the world, its wrist at a pose, its coordinates (`hand.actuation.coordinates`) at values.
    pub fn add_hand(
        &mut self,
        hand: Arc<Hand>,
        world_from_hand: &Isometry3<f64>,
        coordinates: &[f64],
    ) -> HandId {
        unimplemented!("{hand} {world_from_hand} {coordinates:?}")
    }

    /// Takes a hand out of the world; `false` when it is not there.
    pub fn remove_hand(&mut self, id: HandId) -> bool {
        unimplemented!("{id:?}")
    }

    /// Tells a hand what to do from now on; a new command of one kind replaces the last of that kind.
    pub fn command(&mut self, id: HandId, command: Command) -> bool {
        unimplemented!("{id:?} {command:?}")
    }

    /// What a hand reports now; `None` when it is not in the world.
    pub fn hand_state(&self, id: HandId) -> Option<HandState> {
        unimplemented!("{id:?}")
    }

    /// What a hand touches now.
    pub fn hand_contacts(&self, id: HandId) -> Vec<HandContact> {
        unimplemented!("{id:?}")
    }
}
