//! The force that an arm feels at the wrist: the one measure by which guarded moves stop, in trials and in mock arms.

use nalgebra::Vector3;

use super::{HandId, Touched};
use crate::world::{ObjectId, World};

/// What a force sensor at the wrist measures: the sum, as vectors, of all that presses on the hand from outside,
/// smoothed. What fingers hold presses on them from all sides and cancels; what stands in the hand's way does not.
///
/// Of contacts only the normal forces are known, and pads that meet an object askew hold it with much friction. An
/// object that nothing but the hand touches is therefore felt by its weight, whatever the fingers squeeze it with.
#[derive(Debug, Clone)]
pub struct WristForce {
    filter_s: f64,
    /// From table and tray, newtons, world frame.
    fixed: Vector3<f64>,
    /// From objects and other hands.
    movable: Vector3<f64>,
}

impl WristForce {
    /// Time over which arms smooth the force where nothing else is said, seconds.
    pub const FILTER_S: f64 = 0.02;

    /// A sensor that smooths over a time in seconds and has felt nothing yet.
    pub fn new(filter_s: f64) -> Self {
        Self { filter_s, fixed: Vector3::zeros(), movable: Vector3::zeros() }
    }

    /// Takes in the world's last step; to be called after each. The force now, newtons.
    pub fn feel(&mut self, world: &World, hand: HandId) -> f64 {
        self.feel_vector(world, hand).norm()
    }

    /// The same as a vector: what presses on the hand, world frame.
    pub fn feel_vector(&mut self, world: &World, hand: HandId) -> Vector3<f64> {
        let (mut fixed, mut movable) = (Vector3::zeros(), Vector3::zeros());
        let mut hanging: Vec<(ObjectId, bool)> = Vec::new();
        for contact in world.hand_contacts(hand) {
            if let Touched::Object(id) = contact.touched {
                let known = hanging.iter().find(|h| h.0 == id).map(|h| h.1);
                let hangs = known.unwrap_or_else(|| {
                    let hangs = world.hangs_in(hand, id);
                    hanging.push((id, hangs));
                    if hangs {
                        let mass = world.object(id).map_or(0.0, |o| o.mass_kg);
                        movable -= Vector3::z() * mass * world.settings().gravity;
                    }
                    hangs
                });
                if hangs {
                    continue;
                }
            }
            let force = -contact.normal * contact.force_n;
            match contact.touched {
                Touched::Table | Touched::Tray => fixed += force,
                Touched::Hand(id) if id == hand => {}
                Touched::Object(_) | Touched::Hand(_) => movable += force,
            }
        }
        let dt = world.settings().dt_s;
        let blend = dt / self.filter_s.max(dt);
        self.fixed += (fixed - self.fixed) * blend;
        self.movable += (movable - self.movable) * blend;
        self.fixed + self.movable
    }

    /// True when table and tray have the greater part in the force.
    pub fn is_mostly_fixed(&self) -> bool {
        let sum = self.fixed + self.movable;
        self.fixed.dot(&sum) > self.movable.dot(&sum)
    }
}
