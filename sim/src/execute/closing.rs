//! How fingers close on whatever is between them: all at once, until each is held.
//!
//! Fingers with one motor each go on until their force limits hold them (or they can go no further). Fingers with
//! several motors would curl into themselves that way; in a hand that has such fingers each goes to the commanded
//! squeeze, where its servos press like springs, and on in the same direction, all joints in proportion, until one
//! of its motors is held.

use graspd_hands::{CoordinateKind, Hand};

use super::GraspCommand;

/// A finger that is not held goes on in steps of this share of its squeeze ...
const STEP: f64 = 0.1;
/// ... for at most this many squeezes.
const FARTHEST: f64 = 12.0;
/// A motor is held by its force limit when it gives this share of it.
const HELD: f64 = 0.95;
/// Squeeze of an actuator that was given none, radians or metres as a share of its range.
const LEAST: f64 = 0.02;

/// One actuator that closes.
#[derive(Debug, Clone)]
struct Closer {
    /// Index among the actuators.
    actuator: usize,
    /// The links that it moves.
    links: Vec<usize>,
    /// Fingers that it moves, by their pads.
    fingers: Vec<usize>,
    /// Farthest position in the direction of closing.
    limit: f64,
    /// What the command goes beyond contact, with its sign.
    squeeze: f64,
    /// True when the hand has fingers of several motors.
    shared: bool,
    /// How far it has gone beyond the commanded squeeze, in squeezes.
    beyond: f64,
}

/// The closing of one hand.
#[derive(Debug, Clone)]
pub(super) struct Closing {
    closers: Vec<Closer>,
    targets: Vec<f64>,
}

impl Closing {
    pub(super) fn new(hand: &Hand, grasp: &GraspCommand) -> Self {
        let actuators: Vec<usize> = (0..hand.actuation.coordinates.len())
            .filter(|&i| hand.actuation.coordinates[i].kind == CoordinateKind::Actuator)
            .collect();
        let mut targets: Vec<f64> = actuators
            .iter()
            .enumerate()
            .map(|(a, &i)| grasp.squeezed.get(a).copied().unwrap_or(hand.actuation.coordinates[i].closed))
            .collect();
        let mut closers = Vec::new();
        for (a, &i) in actuators.iter().enumerate() {
            let c = &hand.actuation.coordinates[i];
            if c.closed == c.open {
                continue;
            }
            let sign = (c.closed - c.open).signum();
            let contact = grasp.contact.get(a).copied().unwrap_or(targets[a]);
            let asked = (targets[a] - contact) * sign;
            let squeeze = sign * if asked > 0.0 { asked } else { LEAST * (c.upper - c.lower) };
            let links = moved(hand, i);
            let mut fingers: Vec<usize> =
                hand.pads.iter().filter(|p| links.contains(&p.link)).map(|p| p.finger).collect();
            fingers.sort_unstable();
            fingers.dedup();
            let limit = if sign > 0.0 { c.upper } else { c.lower };
            closers.push(Closer { actuator: a, links, fingers, limit, squeeze, shared: false, beyond: 0.0 });
        }
        let several = (0..closers.len())
            .any(|a| (0..a).any(|b| closers[b].fingers.iter().any(|f| closers[a].fingers.contains(f))));
        if several {
            // One hand, one way: a thumb that pressed with all its force at once would push the object away from
            // where fingers that press like springs expect it.
            closers.iter_mut().for_each(|c| c.shared = true);
        }
        for closer in closers.iter().filter(|c| !c.shared) {
            targets[closer.actuator] = closer.limit;
        }
        Self { closers, targets }
    }

    /// What to command now.
    pub(super) fn targets(&self) -> &[f64] {
        &self.targets
    }

    /// Lets fingers of several motors go on: those that have met nothing until they do, those that touch until one
    /// of their motors is held by its force limit. `touching` are the links that touch an object, `loads` the
    /// efforts of the actuators as shares of what they were allowed. `true` when a target has changed.
    pub(super) fn go_on(&mut self, touching: &[usize], loads: &[f64]) -> bool {
        let full = |c: &&Closer| {
            let touches = c.links.iter().any(|l| touching.contains(l));
            touches && loads.get(c.actuator).is_some_and(|&load| load >= HELD)
        };
        let held: Vec<usize> = self.closers.iter().filter(full).flat_map(|c| c.fingers.clone()).collect();
        let mut changed = false;
        for closer in self.closers.iter_mut().filter(|c| c.shared && c.beyond < FARTHEST) {
            if closer.fingers.iter().any(|f| held.contains(f)) {
                continue;
            }
            closer.beyond += STEP;
            let next = self.targets[closer.actuator] + STEP * closer.squeeze;
            let next = if closer.squeeze > 0.0 { next.min(closer.limit) } else { next.max(closer.limit) };
            changed |= next != self.targets[closer.actuator];
            self.targets[closer.actuator] = next;
        }
        changed
    }
}

/// The links that a coordinate moves.
fn moved(hand: &Hand, coordinate: usize) -> Vec<usize> {
    let tree = &hand.tree;
    let depends = |j: usize| hand.actuation.rows[j].terms.iter().any(|&(i, _)| i == coordinate);
    let carried = |body: usize| {
        (0..tree.bodies.len()).any(|b| tree.bodies[b].joint.is_some_and(depends) && tree.carries(b, body))
    };
    (0..tree.links.len()).filter(|&l| carried(tree.links[l].body)).collect()
}
