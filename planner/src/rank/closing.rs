//! Closing the fingers of an optimized configuration until they touch, and the postures around that moment.
//!
//! The optimizer brings pads near focal contacts; a robot closes its fingers until they feel the object.
//! This does the same against the signed distance field, so that the returned joint targets are what the
//! hand will have at contact, not what an objective found agreeable.

use graspd_hands::{Actuation, CoordinateKind, SoftCoupling};
use nalgebra::Vector3;

use super::regrip;
use crate::budget::Budget;
use crate::configuration::Configuration;
use crate::hand_model::HandModel;
use crate::objective::{Objective, Scratch};

/// Fingertip motion of the smallest closing step, metres.
pub(super) const STEP_M: f64 = 0.001;
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
pub(super) const SHIFT_M: f64 = 0.02;
/// Fingers close no nearer to the table than this, metres: a depth camera knows the table's height no better.
pub(super) const TABLE_ROOM_M: f64 = 0.003;
/// The hand is drawn back by this much at a time where the table stops its fingers, metres.
const DRAW_STEP_M: f64 = 0.005;
/// The hand is drawn back at most this far, metres.
pub(super) const DRAW_M: f64 = 0.05;
/// How far beyond contact the squeeze command goes, metres of fingertip motion.
const SQUEEZE_M: f64 = 0.010;

/// One coordinate that closes, and the fingers that it moves.
#[derive(Debug)]
pub(super) struct Closer {
    coordinate: usize,
    /// +1 or −1: the direction of closing.
    sign: f64,
    /// Candidates that move with it, by finger.
    fingers: Vec<Vec<usize>>,
    /// Spheres that move with it.
    spheres: Vec<usize>,
    /// Pairs for self-collision of which at least one sphere moves with it.
    pairs: Vec<(usize, usize)>,
    /// Adaptive coordinates that its mechanism moves along until something stops them, and how far.
    followers: Vec<(usize, f64)>,
}

impl Closer {
    /// Closes by so many metres of fingertip motion; negative opens. False at the end of the range.
    pub(super) fn move_by(
        &self,
        model: &HandModel<'_>,
        configuration: &mut Configuration,
        metres: f64,
    ) -> bool {
        let c = self.coordinate;
        let coordinates = &model.hand.actuation.coordinates;
        let per_metre = model.step_scale[c] * self.sign;
        let before = configuration.coordinates[c];
        let next = (before + metres * per_metre).clamp(coordinates[c].lower, coordinates[c].upper);
        configuration.coordinates[c] = next;
        for &(i, ratio) in &self.followers {
            let along = configuration.coordinates[i] + ratio * (next - before);
            configuration.coordinates[i] = along.clamp(coordinates[i].lower, coordinates[i].upper);
        }
        next != before
    }
}

pub(super) fn closers(model: &HandModel<'_>) -> Vec<Closer> {
    let hand = model.hand;
    let actuation = &hand.actuation;
    actuation
        .coordinates
        .iter()
        .enumerate()
        .filter(|(_, c)| c.closed != c.open && c.kind == CoordinateKind::Actuator)
        .map(|(coordinate, c)| {
            let followers = followers(actuation, coordinate);
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
            let sign = (c.closed - c.open).signum();
            Closer { coordinate, sign, fingers, spheres, pairs, followers }
        })
        .filter(|c| !c.fingers.is_empty())
        .collect()
}

/// Adaptive coordinates that a soft coupling ties to an actuator, with their motion per motion of the actuator.
fn followers(actuation: &Actuation, actuator: usize) -> Vec<(usize, f64)> {
    let slope = |coupling: &SoftCoupling, coordinate: usize| -> f64 {
        coupling
            .terms
            .iter()
            .flat_map(|&(joint, c)| actuation.rows[joint].terms.iter().map(move |&(i, a)| (i, c * a)))
            .filter(|&(i, _)| i == coordinate)
            .map(|(_, slope)| slope)
            .sum()
    };
    let adaptive = |c: &&usize| actuation.coordinates[**c].kind == CoordinateKind::Adaptive;
    let all: Vec<usize> = (0..actuation.coordinates.len()).collect();
    actuation
        .couplings
        .iter()
        .filter_map(|coupling| {
            let driven = slope(coupling, actuator);
            // The last adaptive coordinate of a coupling is the one that it decides.
            let own = *all.iter().filter(adaptive).rfind(|&&i| slope(coupling, i) != 0.0)?;
            (driven != 0.0).then(|| (own, -driven / slope(coupling, own)))
        })
        .collect()
}

/// What closing feels: the gaps of the fingers' pads, and the room of the moved parts.
pub(super) struct Feel {
    /// Smallest signed distance of each finger's candidates to the scene, metres; what is no object is never
    /// touched.
    pub(super) gaps: Vec<f64>,
    /// How much deeper than allowed the moved parts are in scene, table or each other, metres; negative is room.
    pub(super) over: f64,
    /// Mean outward normal of the pads that touch, volume frame.
    pub(super) touching: Vector3<f64>,
    /// Outward normals of the candidates nearest to the scene, by finger, added up, volume frame.
    pub(super) nearest: Vector3<f64>,
    /// True when it is the scene that the moved parts are deepest in.
    pub(super) in_scene: bool,
    /// True when it is the table that the moved parts are deepest in.
    pub(super) on_table: bool,
}

impl Feel {
    pub(super) fn is_too_deep(&self) -> bool {
        self.over > 0.0
    }

    pub(super) fn all_touch(&self) -> bool {
        self.gaps.iter().all(|&g| g <= TOUCH_M)
    }

    fn none_touches(&self) -> bool {
        self.gaps.iter().all(|&g| g > TOUCH_M)
    }

    /// A step that cannot jump through anything: nothing that moves is nearer than this.
    pub(super) fn safe_step(&self) -> f64 {
        let nearest = self.gaps.iter().copied().fold(-self.over, f64::min);
        (SHARE_OF_ROOM * nearest).clamp(STEP_M, LARGEST_STEP_M)
    }
}

/// Closes the hand as a robot does: every actuator moves from where the optimizer left it until its fingers touch.
///
/// Fingers that turn about their knuckles swing lower than they were before they meet. Where the table stops a
/// finger before it has touched anything, the hand is drawn back along its approach, a little at a time, and closed
/// again, as long as that brings more fingers into touch.
///
/// Where nobody waits for it any more, it ends at once and somewhere.
pub(crate) fn close(
    objective: &Objective<'_>,
    configuration: &mut Configuration,
    scratch: &mut Scratch,
    budget: &dyn Budget,
) {
    let closers = closers(objective.model);
    let start = configuration.clone();
    let back = -(start.rotation * objective.model.approach);
    let mut best: Option<(usize, Configuration)> = None;
    let mut drawn = 0.0;
    loop {
        configuration.copy_from(&start);
        configuration.translation += back * drawn;
        let closed = close_once(objective, &closers, configuration, scratch, budget);
        if best.as_ref().is_none_or(|(touching, _)| closed.touching > *touching) {
            best = Some((closed.touching, configuration.clone()));
        }
        drawn += DRAW_STEP_M;
        if !closed.stopped_by_table || drawn > DRAW_M || budget.is_cancelled() {
            break;
        }
    }
    if let Some((_, best)) = best {
        configuration.copy_from(&best);
    }
    if regrip::hold(objective, configuration, scratch) == 0.0 {
        regrip::regrip(objective, &closers, &start, configuration, scratch, budget);
    }
}

/// What one closing came to.
struct Closed {
    /// Fingers whose pads touch.
    touching: usize,
    /// True when the table stopped a finger that does not touch.
    stopped_by_table: bool,
}

/// Moves every closing coordinate until its fingers touch; a finger that finds nothing within reach
/// stays where the optimizer left it.
///
/// Where one motor closes the whole hand and one finger touches before another, the hand is shifted
/// sideways so that all touch together: the planner chooses the pose that the closing would push for.
fn close_once(
    objective: &Objective<'_>,
    all: &[Closer],
    configuration: &mut Configuration,
    scratch: &mut Scratch,
    budget: &dyn Budget,
) -> Closed {
    let model = objective.model;
    let may_shift = all.len() == 1 && all[0].fingers.len() > 1;
    let mut closed = Closed { touching: 0, stopped_by_table: false };
    for closer in all {
        let move_by =
            |configuration: &mut Configuration, metres: f64| closer.move_by(model, configuration, metres);
        let start = configuration.clone();
        let mut feel = feel(objective, configuration, closer, scratch);
        let mut opened = 0.0;
        let goes_on = || !budget.is_cancelled();
        while feel.is_too_deep() && opened < TRAVEL_M && goes_on() && move_by(configuration, -STEP_M) {
            opened += STEP_M;
            feel = self::feel(objective, configuration, closer, scratch);
        }
        closed.stopped_by_table |= feel.is_too_deep() && feel.on_table;
        let (mut shifted, mut travelled) = (0.0, 0.0);
        while !feel.all_touch() && !feel.is_too_deep() && travelled < TRAVEL_M && goes_on() {
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
                closed.stopped_by_table |= feel.on_table;
                configuration.copy_from(&before);
                feel = self::feel(objective, configuration, closer, scratch);
                break;
            }
        }
        if feel.none_touches() {
            configuration.copy_from(&start);
        }
        closed.touching += feel.gaps.iter().filter(|&&g| g <= TOUCH_M).count();
    }
    closed
}

pub(super) fn feel(
    objective: &Objective<'_>,
    configuration: &Configuration,
    closer: &Closer,
    scratch: &mut Scratch,
) -> Feel {
    scratch.kinematics.forward(objective.model, configuration);
    let kinematics = &scratch.kinematics;
    let deepest = DEEPEST_VOXELS * objective.obstacles.grid.voxel_m();
    let mut touching = Vector3::zeros();
    let mut nearest = Vector3::zeros();
    let mut over = f64::NEG_INFINITY;
    let mut in_table = f64::NEG_INFINITY;
    let mut most_in_scene = f64::NEG_INFINITY;
    let gaps: Vec<f64> = closer
        .fingers
        .iter()
        .map(|candidates| {
            let mut least = f64::INFINITY;
            let mut normal = Vector3::zeros();
            for &i in candidates {
                let p = &objective.model.points[i];
                let point = kinematics.point(p.body, &p.point);
                let (mut gap, slope) = objective.obstacles.scene(&point);
                over = over.max(-gap - deepest);
                if gap <= TOUCH_M && !is_object(objective, &point, gap, &slope) {
                    gap = 2.0 * TOUCH_M;
                }
                if gap < least {
                    least = gap;
                    normal = kinematics.direction(p.body, &p.normal);
                }
            }
            nearest += normal;
            if least <= TOUCH_M {
                touching += normal;
            }
            least
        })
        .collect();
    let center = |i: usize| {
        let s = &objective.model.spheres[i];
        (kinematics.point(s.body, &s.center), s.radius)
    };
    for &i in &closer.spheres {
        let (center, radius) = center(i);
        let in_scene = radius - objective.obstacles.scene(&center).0 - deepest;
        over = over.max(in_scene);
        most_in_scene = most_in_scene.max(in_scene);
        if let Some(table) = objective.obstacles.table_m {
            let into = radius - (center.z - table) + TABLE_ROOM_M;
            over = over.max(into);
            // What is solid just above the table top may be the table as it was seen.
            if into > -objective.obstacles.grid.voxel_m() {
                in_table = in_table.max(into.max(in_scene));
            }
        }
    }
    for &(a, b) in &closer.pairs {
        let ((a, radius_a), (b, radius_b)) = (center(a), center(b));
        over = over.max(radius_a + radius_b - (a - b).norm() - OVERLAP_M);
    }
    Feel { gaps, over, touching, nearest, in_scene: most_in_scene >= over, on_table: in_table >= over }
}

/// True when the surface next to a point is an object's; the noise of a table's surface is none.
pub(super) fn is_object(
    objective: &Objective<'_>,
    point: &Vector3<f64>,
    gap: f64,
    slope: &Vector3<f64>,
) -> bool {
    slope.try_normalize(1e-3).is_some_and(|away| {
        let surface = point - away * gap;
        objective.obstacles.object_behind(&surface, &-away) > 0
    })
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
