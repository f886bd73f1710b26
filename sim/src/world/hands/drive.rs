//! What drives each joint of a hand: motors, rigid couplings, adaptive mechanisms.
//!
//! Read from a hand's actuation `q = A·u + b`: one joint of every coordinate leads, the others that depend on it
//! alone follow it rigidly; joints that depend on several coordinates, or on none, are servos of their own.

use graspd_hands::{Coordinate, CoordinateKind, Hand, Joint, JointKind};

use crate::world::HandSettings;

/// What moves a joint.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Role {
    /// The joint that shows an actuator's position: `q = coefficient·u + offset`.
    Lead {
        /// Index of the coordinate.
        coordinate: usize,
    },
    /// Coupled to a leading joint: `q = ratio·q[lead] + offset`.
    Follower {
        /// The leading joint.
        lead: usize,
        /// Ratio to it.
        ratio: f64,
        /// Constant part.
        offset: f64,
        /// The coordinate whose motor also pulls here, because this is the first joint of another chain.
        pulled_by: Option<usize>,
    },
    /// A joint of an adaptive mechanism.
    Adaptive(Adaptive),
    /// A servo that keeps `q` at its row of the actuation.
    Servo,
}

/// A joint that follows the object, and its mechanism.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Adaptive {
    /// Index of the coordinate.
    pub(super) coordinate: usize,
    /// The leading joint of the actuator that drives the finger, if any.
    pub(super) driver: Option<usize>,
    /// Share of the driver's torque that reaches this joint, with the sign of closing.
    pub(super) share: f64,
    /// Rest position: `Σ coefficient·q[joint] + constant`.
    pub(super) rest: Vec<(usize, f64)>,
    /// Constant part of the rest position.
    pub(super) constant: f64,
}

/// A joint's servo: a spring of limited force with damping.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Servo {
    /// Largest torque or force.
    pub(super) effort: f64,
    /// Torque per radian, or force per metre.
    pub(super) stiffness: f64,
    /// Torque per radian per second, or force per metre per second.
    pub(super) damping: f64,
    /// Largest speed.
    pub(super) speed: f64,
}

/// Role, servo and direction of every joint, in the order of the tree's joints.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Drives {
    pub(super) roles: Vec<Role>,
    pub(super) servos: Vec<Servo>,
    /// Leading joint and its coefficient for each coordinate; `None` where no joint depends on it alone.
    pub(super) leads: Vec<Option<usize>>,
    /// For each joint, +1 or −1: the direction in which it moves as the hand closes.
    pub(super) closing: Vec<f64>,
}

impl Drives {
    pub(super) fn new(hand: &Hand, settings: &HandSettings) -> Self {
        let actuation = &hand.actuation;
        let leads: Vec<Option<usize>> = (0..actuation.coordinates.len()).map(|i| lead(hand, i)).collect();
        let roles: Vec<Role> = (0..hand.tree.joints.len()).map(|j| role(hand, &leads, j)).collect();
        let servos =
            hand.tree.joints.iter().enumerate().map(|(j, joint)| servo(hand, settings, j, joint)).collect();
        let (open, closed) = (actuation.joints(&actuation.open()), actuation.joints(&actuation.closed()));
        let closing =
            open.iter().zip(&closed).map(|(open, closed)| if closed < open { -1.0 } else { 1.0 }).collect();
        Self { roles, servos, leads, closing }
    }
}

/// The joint of a coordinate that depends on it alone, with the largest coefficient; the first of equals.
fn lead(hand: &Hand, coordinate: usize) -> Option<usize> {
    let mut best: Option<(usize, f64)> = None;
    for (j, row) in hand.actuation.rows.iter().enumerate() {
        if let [(i, c)] = row.terms[..]
            && i == coordinate
            && c.abs() > best.map_or(1e-9, |(_, b)| b.abs() + 1e-9)
        {
            best = Some((j, c));
        }
    }
    best.map(|(j, _)| j)
}

fn role(hand: &Hand, leads: &[Option<usize>], joint: usize) -> Role {
    let actuation = &hand.actuation;
    let row = &actuation.rows[joint];
    let [(coordinate, c)] = row.terms[..] else { return Role::Servo };
    let Some(lead) = leads[coordinate] else { return Role::Servo };
    if lead != joint {
        let lead_row = &actuation.rows[lead];
        let ratio = c / lead_row.terms[0].1;
        // A motor with fingers in parallel presses with its whole force at each: so datasheets state grip force.
        let first = first_of_chain(hand, coordinate, joint) == joint
            && first_of_chain(hand, coordinate, lead) != joint;
        return Role::Follower {
            lead,
            ratio,
            offset: row.offset - ratio * lead_row.offset,
            pulled_by: (first && actuation.coordinates[coordinate].kind == CoordinateKind::Actuator)
                .then_some(coordinate),
        };
    }
    match actuation.coordinates[coordinate].kind {
        CoordinateKind::Actuator => Role::Lead { coordinate },
        CoordinateKind::Adaptive => Role::Adaptive(adaptive(hand, leads, joint, coordinate)),
    }
}

/// The body that a joint moves.
fn body_of(hand: &Hand, joint: usize) -> usize {
    hand.tree.bodies.iter().position(|b| b.joint == Some(joint)).unwrap_or(0)
}

/// The joints that carry a joint, nearest first.
fn carriers(hand: &Hand, joint: usize) -> Vec<usize> {
    let mut out = Vec::new();
    let mut at = hand.tree.bodies[body_of(hand, joint)].parent;
    while let Some(body) = at {
        out.extend(hand.tree.bodies[body].joint);
        at = hand.tree.bodies[body].parent;
    }
    out
}

/// Of the joints of a coordinate in this joint's chain, the one nearest to the palm.
fn first_of_chain(hand: &Hand, coordinate: usize, joint: usize) -> usize {
    let depends = |j: &usize| hand.actuation.rows[*j].terms.iter().any(|&(i, _)| i == coordinate);
    carriers(hand, joint).into_iter().rfind(depends).unwrap_or(joint)
}

fn adaptive(hand: &Hand, leads: &[Option<usize>], joint: usize, coordinate: usize) -> Adaptive {
    let actuation = &hand.actuation;
    // What the mechanism prefers: a soft coupling that names the joint, else its open posture.
    let mut rest = Vec::new();
    let mut constant = actuation.coordinates[coordinate].open * actuation.rows[joint].terms[0].1
        + actuation.rows[joint].offset;
    // A coupling of several joints belongs to the last of them: the one farthest from the palm.
    let soft = actuation.couplings.iter().find(|s| {
        s.terms.iter().any(|t| t.0 == joint && t.1 != 0.0)
            && s.terms.iter().all(|t| carriers(hand, t.0).len() <= carriers(hand, joint).len())
    });
    if let Some(soft) = soft {
        let own: f64 = soft.terms.iter().filter(|t| t.0 == joint).map(|t| t.1).sum();
        if own != 0.0 {
            constant = soft.target / own;
            rest = soft.terms.iter().filter(|t| t.0 != joint).map(|&(j, c)| (j, -c / own)).collect();
        }
    }
    // The nearest motor towards the palm that flexes about a like axis drives the finger.
    let poses = hand.tree.body_poses(&actuation.joints(&actuation.open()));
    let axis = |j: usize| poses[body_of(hand, j)].rotation * hand.tree.joints[j].axis.into_inner();
    let driver = carriers(hand, joint).into_iter().find(|&j| {
        leads.contains(&Some(j))
            && actuation.rows[j].terms.len() == 1
            && actuation.coordinates[actuation.rows[j].terms[0].0].kind == CoordinateKind::Actuator
            && axis(j).dot(&axis(joint)).abs() > 0.7
    });
    let share = driver
        .map_or(0.0, |d| axis(d).dot(&axis(joint)).signum() * lever(hand, joint) / lever(hand, d).max(1e-3));
    Adaptive { coordinate, driver, share, rest, constant }
}

/// Distance from a joint's origin to the farthest pad centre that it moves, metres, at least 2 cm.
fn lever(hand: &Hand, joint: usize) -> f64 {
    let tree = &hand.tree;
    let poses = tree.body_poses(&hand.actuation.joints(&hand.actuation.open()));
    let links = tree.link_poses(&poses);
    let body = body_of(hand, joint);
    let origin = poses[body].translation.vector;
    hand.pads
        .iter()
        .filter(|p| tree.carries(body, tree.links[p.link].body))
        .map(|p| ((links[p.link] * p.center).coords - origin).norm())
        .fold(0.02, f64::max)
}

fn servo(hand: &Hand, settings: &HandSettings, j: usize, joint: &Joint) -> Servo {
    let row = &hand.actuation.rows[j];
    let coordinates = &hand.actuation.coordinates;
    let known = |c: &Coordinate| if c.effort > 0.0 { Some(c.effort) } else { None };
    // The coordinate's effort where it is known, in terms of the joint.
    let stated = row
        .terms
        .iter()
        .filter_map(|&(i, c)| Some(known(&coordinates[i])? / c.abs().max(0.1)))
        .reduce(f64::max);
    let own = (joint.effort > 0.0).then_some(joint.effort);
    let lever = lever(hand, j);
    let (guess, most) = match joint.kind {
        JointKind::Revolute => (settings.fingertip_force_n * lever, settings.most_fingertip_force_n * lever),
        JointKind::Prismatic => (settings.fingertip_force_n, f64::INFINITY),
    };
    let effort = stated.or(own).unwrap_or(guess).min(most);
    let (most, error) = match joint.kind {
        JointKind::Revolute => (settings.turn_rad_s, settings.full_effort_rad),
        JointKind::Prismatic => (settings.slide_m_s, settings.full_effort_m),
    };
    let speed = if joint.velocity > 0.0 { joint.velocity.min(most) } else { most };
    let stiffness = effort / error.max(1e-6);
    Servo { effort, stiffness, damping: stiffness * settings.servo_time_s, speed }
}
