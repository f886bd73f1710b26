//! How fingers close on whatever is between them: all at once, until each is held.
//!
//! A finger with one motor goes on until its force limit holds it (or it can go no further). A finger with several
//! motors would curl into itself that way; it goes to the commanded squeeze and presses with its servos' springs,
//! and, where it has met nothing by then, on in the same direction until it does.

use graspd_hands::{CoordinateKind, Hand};

use super::GraspCommand;

/// A finger that has met nothing goes on in steps of this share of its squeeze ...
const STEP: f64 = 0.05;
/// ... for at most this many squeezes.
const FARTHEST: f64 = 12.0;
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
    /// True when another closing actuator moves one of its fingers too.
    shared: bool,
    /// How far it has gone beyond the commanded squeeze, in squeezes.
    beyond: f64,
    /// True once a shared closer has met something.
    met: bool,
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
            fingers.dedup();
            let limit = if sign > 0.0 { c.upper } else { c.lower };
            closers.push(Closer {
                actuator: a,
                links,
                fingers,
                limit,
                squeeze,
                shared: false,
                beyond: 0.0,
                met: false,
            });
        }
        for at in 0..closers.len() {
            closers[at].shared = (0..closers.len()).any(|other| {
                other != at && closers[other].fingers.iter().any(|f| closers[at].fingers.contains(f))
            });
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

    /// Lets fingers that have met nothing go on. `touching` are the links that touch an object. `true` when a
    /// target has changed.
    pub(super) fn go_on(&mut self, touching: &[usize]) -> bool {
        let mut changed = false;
        let met: Vec<usize> = self
            .closers
            .iter()
            .filter(|c| c.shared && c.links.iter().any(|l| touching.contains(l)))
            .flat_map(|c| c.fingers.clone())
            .collect();
        for closer in self.closers.iter_mut().filter(|c| c.shared) {
            let touches = closer.fingers.iter().any(|f| met.contains(f));
            let step = match (touches, closer.met) {
                (true, false) if closer.beyond > 0.0 => 1.0,
                (false, false) if closer.beyond < FARTHEST => STEP,
                _ => 0.0,
            };
            closer.met |= touches;
            if step > 0.0 {
                closer.beyond += step;
                let next = self.targets[closer.actuator] + step * closer.squeeze;
                let next = if closer.squeeze > 0.0 { next.min(closer.limit) } else { next.max(closer.limit) };
                changed |= next != self.targets[closer.actuator];
                self.targets[closer.actuator] = next;
            }
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
