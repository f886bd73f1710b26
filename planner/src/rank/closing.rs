//! Closing the fingers of an optimized configuration until they touch, and the postures around that moment.
//!
//! The optimizer brings pads near focal contacts; a robot closes its fingers until they feel the object.
//! This does the same against the signed distance field, so that the returned joint targets are what the
//! hand will have at contact, not what an objective found agreeable.

use graspd_hands::CoordinateKind;

use crate::configuration::Configuration;
use crate::hand_model::HandModel;
use crate::objective::{Objective, Scratch};

/// Fingertip motion of one closing step, metres.
const STEP_M: f64 = 0.001;
/// A pad touches when one of its candidates is this close to the surface, metres.
const TOUCH_M: f64 = 0.001;
/// Closing stops when a pad is this deep although another finger of the same motor does not touch, metres.
const TOO_DEEP_M: f64 = 0.004;
/// Fingers close at most this far to find a surface, metres of fingertip motion.
const TRAVEL_M: f64 = 0.03;
/// How far beyond contact the squeeze command goes, metres of fingertip motion.
const SQUEEZE_M: f64 = 0.010;

/// One coordinate that closes, and the fingers that it moves.
#[derive(Debug)]
struct Closer {
    coordinate: usize,
    /// +1 or −1: the direction of closing.
    sign: f64,
    /// Candidates that move with it, by finger.
    fingers: Vec<Vec<usize>>,
}

fn closers(model: &HandModel<'_>) -> Vec<Closer> {
    let hand = model.hand;
    let actuation = &hand.actuation;
    actuation
        .coordinates
        .iter()
        .enumerate()
        .filter(|(_, c)| c.closed != c.open)
        .map(|(coordinate, c)| {
            let bodies: Vec<usize> = (0..hand.tree.bodies.len())
                .filter(|&b| {
                    hand.tree.bodies[b]
                        .joint
                        .is_some_and(|j| actuation.rows[j].terms.iter().any(|t| t.0 == coordinate))
                })
                .collect();
            let mut fingers = vec![Vec::new(); hand.fingers.len()];
            for (i, candidate) in hand.candidates.iter().enumerate() {
                if bodies.iter().any(|&b| hand.tree.carries(b, candidate.body)) {
                    fingers[hand.pads[candidate.pad].finger].push(i);
                }
            }
            fingers.retain(|f| !f.is_empty());
            Closer { coordinate, sign: (c.closed - c.open).signum(), fingers }
        })
        .filter(|c| !c.fingers.is_empty())
        .collect()
}

/// Moves every closing coordinate until its fingers touch; a finger that finds nothing within reach
/// stays where the optimizer left it.
pub(crate) fn close(objective: &Objective<'_>, configuration: &mut Configuration, scratch: &mut Scratch) {
    let model = objective.model;
    for closer in closers(model) {
        let c = closer.coordinate;
        let limits = &model.hand.actuation.coordinates[c];
        let step = STEP_M * model.step_scale[c] * closer.sign;
        let start = configuration.coordinates[c];
        let mut gaps = finger_gaps(objective, configuration, &closer, scratch);
        let mut travelled = 0.0;
        while gaps.iter().any(|&g| g < -TOUCH_M) && travelled < TRAVEL_M {
            let next = (configuration.coordinates[c] - step).clamp(limits.lower, limits.upper);
            if next == configuration.coordinates[c] {
                break;
            }
            configuration.coordinates[c] = next;
            travelled += STEP_M;
            gaps = finger_gaps(objective, configuration, &closer, scratch);
        }
        travelled = 0.0;
        while gaps.iter().any(|&g| g > TOUCH_M)
            && gaps.iter().all(|&g| g > -TOO_DEEP_M)
            && travelled < TRAVEL_M
        {
            let next = (configuration.coordinates[c] + step).clamp(limits.lower, limits.upper);
            if next == configuration.coordinates[c] {
                break;
            }
            configuration.coordinates[c] = next;
            travelled += STEP_M;
            gaps = finger_gaps(objective, configuration, &closer, scratch);
        }
        if gaps.iter().all(|&g| g > TOUCH_M) {
            configuration.coordinates[c] = start;
        }
    }
}

/// Smallest signed distance of each finger's candidates to the scene, metres.
fn finger_gaps(
    objective: &Objective<'_>,
    configuration: &Configuration,
    closer: &Closer,
    scratch: &mut Scratch,
) -> Vec<f64> {
    scratch.kinematics.forward(objective.model, configuration);
    closer
        .fingers
        .iter()
        .map(|candidates| {
            candidates
                .iter()
                .map(|&i| {
                    let p = &objective.model.points[i];
                    objective.obstacles.scene(&scratch.kinematics.point(p.body, &p.point)).0
                })
                .fold(f64::INFINITY, f64::min)
        })
        .collect()
}

/// Coordinates opened by `share` of the way from contact to the open posture; coordinates that do not
/// close (a spread) keep their value, so that the approach ends in the same hand shape.
pub(crate) fn opened(model: &HandModel<'_>, contact: &[f64], share: f64) -> Vec<f64> {
    contact
        .iter()
        .zip(&model.hand.actuation.coordinates)
        .map(|(&u, c)| if c.closed == c.open { u } else { u + share * (c.open - u) })
        .collect()
}

/// What to command so that the fingers press: actuators go on beyond contact, adaptive joints follow.
pub(crate) fn squeezed(model: &HandModel<'_>, contact: &[f64]) -> Vec<f64> {
    contact
        .iter()
        .zip(&model.hand.actuation.coordinates)
        .zip(&model.step_scale)
        .map(|((&u, c), scale)| {
            if c.closed == c.open || c.kind == CoordinateKind::Adaptive {
                return u;
            }
            let beyond = u + (c.closed - c.open).signum() * SQUEEZE_M * scale;
            beyond.clamp(c.lower, c.upper)
        })
        .collect()
}
