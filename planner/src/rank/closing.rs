//! Closing the fingers of an optimized configuration until they touch, and the postures around that moment.
//!
//! The optimizer brings pads near focal contacts; a robot closes its fingers until they feel the object.
//! This does the same against the signed distance field, so that the returned joint targets are what the
//! hand will have at contact, not what an objective found agreeable.

use graspd_hands::CoordinateKind;
use nalgebra::Vector3;

use crate::configuration::Configuration;
use crate::hand_model::HandModel;
use crate::objective::{Objective, Scratch};

/// Fingertip motion of the smallest closing step, metres.
const STEP_M: f64 = 0.001;
/// Larger steps go this share of the way to the nearest thing.
const SHARE_OF_ROOM: f64 = 0.7;
/// No step is longer than this, metres.
const LARGEST_STEP_M: f64 = 0.01;
/// Spheres of different fingers may overlap by this much, metres: under the tolerance of the collision check.
const OVERLAP_M: f64 = 0.002;
/// A pad touches when one of its candidates is this close to the surface, metres.
const TOUCH_M: f64 = 0.001;
/// Closing stops when a pad, or any moved part, is this deep in the scene, voxels: under the resolution of what
/// was seen.
const DEEPEST_VOXELS: f64 = 0.8;
/// Fingers close at most this far to find a surface, metres of fingertip motion.
const TRAVEL_M: f64 = 0.25;
/// A hand with one motor is shifted at most this far so that its fingers touch together, metres.
const SHIFT_M: f64 = 0.02;
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
    /// Spheres that move with it.
    spheres: Vec<usize>,
    /// Pairs for self-collision of which at least one sphere moves with it.
    pairs: Vec<(usize, usize)>,
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
            let moves = |body: usize| bodies.iter().any(|&b| hand.tree.carries(b, body));
            let mut fingers = vec![Vec::new(); hand.fingers.len()];
            for (i, candidate) in hand.candidates.iter().enumerate() {
                if moves(candidate.body) {
                    fingers[hand.pads[candidate.pad].finger].push(i);
                }
            }
            fingers.retain(|f| !f.is_empty());
            let spheres = (0..hand.spheres.len()).filter(|&i| moves(hand.spheres[i].body)).collect();
            let moved = |i: usize| moves(hand.spheres[i].body);
            let pairs = hand.self_pairs.iter().copied().filter(|&(a, b)| moved(a) || moved(b)).collect();
            Closer { coordinate, sign: (c.closed - c.open).signum(), fingers, spheres, pairs }
        })
        .filter(|c| !c.fingers.is_empty())
        .collect()
}

/// What closing feels: the gaps of the fingers' pads, and the room of the moved parts.
struct Feel {
    /// Smallest signed distance of each finger's candidates to the scene, metres.
    gaps: Vec<f64>,
    /// How much deeper than allowed the moved parts are in scene, table or each other, metres; negative is room.
    over: f64,
    /// Mean outward normal of the pads that touch, volume frame.
    touching: Vector3<f64>,
}

impl Feel {
    fn is_too_deep(&self) -> bool {
        self.over > 0.0
    }

    fn all_touch(&self) -> bool {
        self.gaps.iter().all(|&g| g <= TOUCH_M)
    }

    fn none_touches(&self) -> bool {
        self.gaps.iter().all(|&g| g > TOUCH_M)
    }

    /// A step that cannot jump through anything: nothing that moves is nearer than this.
    fn safe_step(&self) -> f64 {
        let nearest = self.gaps.iter().copied().fold(-self.over, f64::min);
        (SHARE_OF_ROOM * nearest).clamp(STEP_M, LARGEST_STEP_M)
    }
}

/// Moves every closing coordinate until its fingers touch; a finger that finds nothing within reach
/// stays where the optimizer left it.
///
/// Where one motor closes the whole hand and one finger touches before another, the hand is shifted
/// sideways so that all touch together: the planner chooses the pose that the closing would push for.
pub(crate) fn close(objective: &Objective<'_>, configuration: &mut Configuration, scratch: &mut Scratch) {
    let model = objective.model;
    let all = closers(model);
    let may_shift = all.len() == 1 && all[0].fingers.len() > 1;
    for closer in &all {
        let c = closer.coordinate;
        let limits = &model.hand.actuation.coordinates[c];
        let per_metre = model.step_scale[c] * closer.sign;
        let move_by = |configuration: &mut Configuration, metres: f64| {
            let next = (configuration.coordinates[c] + metres * per_metre).clamp(limits.lower, limits.upper);
            let moved = next != configuration.coordinates[c];
            configuration.coordinates[c] = next;
            moved
        };
        let start = configuration.clone();
        let mut feel = feel(objective, configuration, closer, scratch);
        let mut opened = 0.0;
        while feel.is_too_deep() && opened < TRAVEL_M && move_by(configuration, -STEP_M) {
            opened += STEP_M;
            feel = self::feel(objective, configuration, closer, scratch);
        }
        let (mut shifted, mut travelled) = (0.0, 0.0);
        while !feel.all_touch() && !feel.is_too_deep() && travelled < TRAVEL_M {
            let before = configuration.clone();
            if may_shift
                && shifted < SHIFT_M
                && let Some(away) = feel.touching.try_normalize(1e-6)
            {
                configuration.translation -= away * STEP_M;
                shifted += STEP_M;
            }
            let step = feel.safe_step();
            travelled += step;
            if !move_by(configuration, step) {
                break;
            }
            feel = self::feel(objective, configuration, closer, scratch);
            if feel.is_too_deep() {
                configuration.copy_from(&before);
                feel = self::feel(objective, configuration, closer, scratch);
                break;
            }
        }
        if feel.none_touches() {
            configuration.copy_from(&start);
        }
    }
}

fn feel(
    objective: &Objective<'_>,
    configuration: &Configuration,
    closer: &Closer,
    scratch: &mut Scratch,
) -> Feel {
    scratch.kinematics.forward(objective.model, configuration);
    let kinematics = &scratch.kinematics;
    let deepest = DEEPEST_VOXELS * objective.obstacles.grid.voxel_m();
    let mut touching = Vector3::zeros();
    let mut over = f64::NEG_INFINITY;
    let gaps: Vec<f64> = closer
        .fingers
        .iter()
        .map(|candidates| {
            let mut least = f64::INFINITY;
            let mut normal = Vector3::zeros();
            for &i in candidates {
                let p = &objective.model.points[i];
                let gap = objective.obstacles.scene(&kinematics.point(p.body, &p.point)).0;
                if gap < least {
                    least = gap;
                    normal = kinematics.direction(p.body, &p.normal);
                }
            }
            if least <= TOUCH_M {
                touching += normal;
            }
            over = over.max(-least - deepest);
            least
        })
        .collect();
    let center = |i: usize| {
        let s = &objective.model.spheres[i];
        (kinematics.point(s.body, &s.center), s.radius)
    };
    for &i in &closer.spheres {
        let (center, radius) = center(i);
        over = over.max(radius - objective.obstacles.scene(&center).0 - deepest);
        if let Some(table) = objective.obstacles.table_m {
            over = over.max(radius - (center.z - table));
        }
    }
    for &(a, b) in &closer.pairs {
        let ((a, radius_a), (b, radius_b)) = (center(a), center(b));
        over = over.max(radius_a + radius_b - (a - b).norm() - OVERLAP_M);
    }
    Feel { gaps, over, touching }
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
