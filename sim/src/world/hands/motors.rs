//! The motors of a hand in the world: what they were told, what they do in each step, what they report.
//!
//! A motor is a servo: its reference goes to the commanded target at the motor's speed, a spring of limited force
//! pulls the joint to the reference, and damping, which the engine integrates implicitly, keeps it calm. Held by an
//! object, the reference waits just far enough ahead for the force limit, so the motor stays pressed with exactly it.

use graspd_hands::{CoordinateKind, Hand};
use rapier3d_f64::prelude::PhysicsWorld;

use super::body::{HandBody, axis};
use super::drive::{Adaptive, Drives, Role, Servo};
use crate::world::HandSettings;

/// Stiffness that stands for a constant force: over a step it does not change noticeably.
const CONSTANT: f64 = 1e-6;
/// An actuator rests when it moves by less than this share of its largest speed ...
const REST: f64 = 0.01;
/// ... for this long, seconds.
const REST_S: f64 = 0.05;
/// Time over which torque handed on to adaptive joints is smoothed, seconds.
const HANDED_S: f64 = 0.02;

/// State of a hand's motors.
#[derive(Debug, Clone)]
pub(super) struct Motors {
    /// Commanded, per coordinate; adaptive coordinates keep their first value, which nothing uses.
    targets: Vec<f64>,
    /// Where each coordinate should be now.
    references: Vec<f64>,
    /// Share of effort and speed.
    force: f64,
    speed: f64,
    /// Share of that force which each joint's motor may use.
    shares: Vec<f64>,
    /// What each joint's motor exerts, in the joint's own terms.
    exerted: Vec<f64>,
    /// Torque handed on to each adaptive joint, smoothed.
    handed: Vec<f64>,
    /// Where each joint has been driven to, and in which direction: gears do not let it be pushed back from there.
    latched: Vec<Option<(f64, f64)>>,
    /// Joint positions before the last step: the engine's velocities still carry what pushes overlaps apart.
    before: Vec<f64>,
    /// How long every actuator has been at rest, seconds.
    rest_s: f64,
}

impl Motors {
    /// Motors that hold coordinates `u`.
    pub(super) fn new(hand: &Hand, u: &[f64]) -> Self {
        let joints = hand.tree.joints.len();
        Self {
            targets: u.to_vec(),
            references: u.to_vec(),
            force: 1.0,
            speed: 1.0,
            shares: vec![1.0; joints],
            exerted: vec![0.0; joints],
            handed: vec![0.0; joints],
            latched: vec![None; joints],
            before: hand.actuation.joints(u),
            rest_s: 0.0,
        }
    }

    /// Takes a command; `false` when it does not fit the hand.
    pub(super) fn command(&mut self, hand: &Hand, actuators: &[f64], force: f64, speed: f64) -> bool {
        let good = actuators.len() == hand.actuation.actuator_count()
            && actuators.iter().chain([&force, &speed]).all(|v| v.is_finite());
        if !good {
            return false;
        }
        let coordinates = hand.actuation.coordinates.iter().enumerate();
        let driven = coordinates.filter(|(_, c)| c.kind == CoordinateKind::Actuator);
        for ((i, c), target) in driven.zip(actuators) {
            self.targets[i] = target.clamp(c.lower, c.upper);
        }
        (self.force, self.speed) = (force.clamp(0.0, 1.0), speed.clamp(0.01, 1.0));
        self.rest_s = 0.0;
        true
    }

    /// Bounds the force of each actuator alone; `false` when that does not fit the hand.
    pub(super) fn share_forces(&mut self, hand: &Hand, shares: &[f64]) -> bool {
        let good = shares.len() == hand.actuation.actuator_count() && shares.iter().all(|v| v.is_finite());
        if !good {
            return false;
        }
        let coordinates = hand.actuation.coordinates.iter();
        let mut given = shares.iter();
        // What no actuator moves has no bound of its own.
        let of_coordinate: Vec<f64> = coordinates
            .map(|c| if c.kind == CoordinateKind::Actuator { given.next().copied() } else { None })
            .map(|share| share.map_or(1.0, |share| share.clamp(0.0, 1.0)))
            .collect();
        for (share, row) in self.shares.iter_mut().zip(&hand.actuation.rows) {
            let of_terms = row.terms.iter().map(|&(i, _)| of_coordinate[i]);
            *share = of_terms.reduce(f64::max).unwrap_or(1.0);
        }
        true
    }

    /// Force of a joint's motor as a share of its effort.
    fn allowed(&self, j: usize) -> f64 {
        self.force * self.shares[j]
    }

    /// Actuator positions from joint positions.
    pub(super) fn actuators(&self, hand: &Hand, drives: &Drives, q: &[f64]) -> Vec<f64> {
        let now = self.coordinates(hand, drives, q);
        let coordinates = hand.actuation.coordinates.iter().zip(now);
        coordinates.filter(|(c, _)| c.kind == CoordinateKind::Actuator).map(|(_, u)| u).collect()
    }

    /// What each actuator exerts, positive towards closed (or upwards where it does not close).
    pub(super) fn efforts(&self, hand: &Hand) -> Vec<f64> {
        let mut sum = vec![0.0; hand.actuation.coordinates.len()];
        let mut chains = vec![0.0_f64; sum.len()];
        for (row, exerted) in hand.actuation.rows.iter().zip(&self.exerted) {
            for &(i, c) in &row.terms {
                if *exerted != 0.0 {
                    sum[i] += c * exerted;
                    chains[i] += 1.0;
                }
            }
        }
        let coordinates = hand.actuation.coordinates.iter().enumerate();
        coordinates
            .filter(|(_, c)| c.kind == CoordinateKind::Actuator)
            .map(|(i, c)| sum[i] / chains[i].max(1.0) * if c.closed < c.open { -1.0 } else { 1.0 })
            .collect()
    }

    /// True when nothing moves any more.
    pub(super) fn settled(&self) -> bool {
        self.rest_s >= REST_S
    }

    fn coordinates(&self, hand: &Hand, drives: &Drives, q: &[f64]) -> Vec<f64> {
        let of = |(i, lead): (usize, &Option<usize>)| {
            let Some(j) = *lead else { return self.references[i] };
            let row = &hand.actuation.rows[j];
            (q[j] - row.offset) / row.terms[0].1
        };
        drives.leads.iter().enumerate().map(of).collect()
    }

    /// What every motor does in the next step.
    pub(super) fn step(
        &mut self,
        physics: &mut PhysicsWorld,
        hand: &Hand,
        drives: &Drives,
        body: &HandBody,
        settings: &HandSettings,
        dt: f64,
    ) {
        let q = body.positions(physics, &hand.tree);
        let speeds: Vec<f64> = q.iter().zip(&self.before).map(|(now, before)| (now - before) / dt).collect();
        self.before.clone_from(&q);
        let u = self.coordinates(hand, drives, &q);
        for (j, role) in drives.roles.iter().enumerate() {
            if matches!(role, Role::Lead { .. } | Role::Follower { pulled_by: Some(_), .. }) {
                body.damp(physics, j, self.damping(j, &drives.servos[j]));
            }
        }
        self.lead(hand, drives, &u, &speeds, settings, dt);
        for (j, role) in drives.roles.iter().enumerate() {
            let (servo, row) = (&drives.servos[j], &hand.actuation.rows[j]);
            let (stiffness, rest) = match role {
                Role::Lead { .. } | Role::Follower { pulled_by: Some(_), .. } => {
                    let goal = row.terms.iter().fold(row.offset, |s, &(i, c)| s + c * self.references[i]);
                    self.pull(j, servo, settings, goal, q[j], speeds[j])
                }
                Role::Follower { .. } => continue,
                Role::Servo => {
                    let goal = row.terms.iter().fold(row.offset, |s, &(i, c)| s + c * u[i]);
                    self.pull(j, servo, settings, goal, q[j], speeds[j])
                }
                Role::Adaptive(adaptive) => self.follow(j, adaptive, drives, settings, &q, dt),
            };
            body.spring(physics, j, axis(&hand.tree.joints[j]), stiffness, rest);
        }
    }

    /// Moves the references on, and counts how long everything has been at rest.
    fn lead(
        &mut self,
        hand: &Hand,
        drives: &Drives,
        u: &[f64],
        speeds: &[f64],
        settings: &HandSettings,
        dt: f64,
    ) {
        let mut rests = true;
        for (i, lead) in drives.leads.iter().enumerate() {
            if hand.actuation.coordinates[i].kind == CoordinateKind::Adaptive {
                continue;
            }
            // A coordinate without a leading joint moves its servos at the speed of a finger.
            let (servo, scale, moves) = match lead {
                Some(j) => {
                    (Some((*j, &drives.servos[*j])), hand.actuation.rows[*j].terms[0].1.abs(), speeds[*j])
                }
                None => (None, 1.0, 0.0),
            };
            let fastest = servo.map_or(settings.turn_rad_s, |(_, s)| s.speed);
            let most = self.speed * fastest / scale;
            let way = self.targets[i] - self.references[i];
            let mut next = self.references[i] + way.clamp(-most * dt, most * dt);
            if let Some((j, servo)) = servo {
                let ahead = self.allowed(j) * servo.effort / servo.stiffness / scale;
                let ahead = 1.2 * ahead + most * settings.servo_time_s + 1e-4;
                next = next.clamp(u[i] - ahead, u[i] + ahead);
            }
            let still = moves.abs() < REST * fastest;
            rests &= still && (next - self.references[i]).abs() <= REST * most * dt;
            self.references[i] = next;
        }
        self.rest_s = if rests { self.rest_s + dt } else { 0.0 };
    }

    /// Damping of a motor: less where a small force has to move it at its speed.
    fn damping(&self, j: usize, servo: &Servo) -> f64 {
        servo.damping.min(self.allowed(j) * servo.effort / (2.0 * self.speed * servo.speed))
    }

    /// A servo's spring for this step.
    fn pull(
        &mut self,
        j: usize,
        servo: &Servo,
        settings: &HandSettings,
        goal: f64,
        q: f64,
        speed: f64,
    ) -> (f64, f64) {
        let most = self.allowed(j) * servo.effort;
        let wanted = servo.stiffness * (goal - q);
        self.exerted[j] = wanted.clamp(-most, most) - self.damping(j, servo) * speed;
        if wanted.abs() <= most {
            self.latched[j] = None;
            return (servo.stiffness, goal);
        }
        // At the limit: a constant force, until something stronger pushes back against the gears.
        let sign = wanted.signum();
        let farthest = match self.latched[j] {
            Some((at, direction)) if direction == sign && (at - q) * sign > 0.0 => at,
            _ => q,
        };
        self.latched[j] = Some((farthest, sign));
        let held = most + servo.stiffness * (farthest - q).abs();
        let holds = (settings.back_drive * servo.effort).max(most);
        if held > most && held < holds {
            (servo.stiffness, farthest + sign * most / servo.stiffness)
        } else {
            (CONSTANT, q + sign * held.min(holds) / CONSTANT)
        }
    }

    /// An adaptive joint's spring for this step: weak towards the object, stiff against being bent back, and pulled
    /// by its share of what the finger's motor exerts.
    fn follow(
        &mut self,
        j: usize,
        adaptive: &Adaptive,
        drives: &Drives,
        settings: &HandSettings,
        q: &[f64],
        dt: f64,
    ) -> (f64, f64) {
        let rest = adaptive.rest.iter().fold(adaptive.constant, |s, &(i, c)| s + c * q[i]);
        let driving = &drives.servos[adaptive.driver.unwrap_or(j)];
        let closes = adaptive.driver.map_or(1.0, |d| drives.closing[d]);
        let closing = if adaptive.share < 0.0 { -closes } else { closes };
        let bent_back = (q[j] - rest) * closing < 0.0 && adaptive.driver.is_some();
        let stiffness =
            if bent_back { driving.stiffness } else { settings.adaptive_stiffness * driving.effort };
        let pull = adaptive.driver.map_or(0.0, |d| {
            // A motor that opens hands nothing on.
            settings.adaptive_share * adaptive.share * (self.exerted[d] * closes).max(0.0) * closes
        });
        self.handed[j] += (pull - self.handed[j]) * (dt / HANDED_S).min(1.0);
        (stiffness, rest + self.handed[j] / stiffness.max(1e-9))
    }
}
