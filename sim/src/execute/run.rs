//! The phases of an execution, and what is noted in each for the verdict.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use graspd_hands::{CoordinateKind, Hand};
use nalgebra::{Isometry3, Point3, Vector3};

use super::closing::Closing;
use super::{ExecuteSettings, Failure, GraspCommand, Moment, Trial};
use crate::world::{Command, HandContact, HandId, ObjectId, Touched, World};

/// Speed of turning on the way, radians per second.
const TURN_RAD_S: f64 = 1.0;
/// Speed of the way to the pre-grasp, metres per second.
const REACH_M_S: f64 = 0.25;
/// Share of the lift that an object must have gone up.
const LIFTED: f64 = 0.7;
/// Objects that move faster than this relative to the hand are not held, metres per second.
const LOOSE_M_S: f64 = 0.1;
/// An object that has gone this far while the fingers closed on it, and is not held, has slipped away, metres.
const SLIPPED_M: f64 = 0.01;
/// Contact forces are averaged over this time before the arm judges them, seconds.
const FORCE_S: f64 = 0.01;
/// By this time fingers have reached their commanded squeeze, or are held, seconds.
const REACHED_S: f64 = 0.8;
/// Stillness after the shake, seconds.
const CALM_S: f64 = 0.3;
/// Interval of the commands that take the fingers to contact, seconds.
const MEET_COMMAND_S: f64 = 0.02;
/// Time between looks at which fingers touch, seconds.
const LOOK_S: f64 = 0.02;

/// Executes a grasp with a hand that is in the world; `watch` is called at each [`Moment`].
///
/// The hand goes to the pre-grasp if it is not there (up, across and down at 0.25 m/s; best put it there with the
/// coordinates of `open`), approaches until it arrives or something resists, closes all fingers at once until each is held, lifts, holds,
/// and shakes. Nothing but the objects' poses decides whether that succeeded. The hand stays at the end of its
/// motion, with whatever it holds. A hand that is not in the world holds nothing: [`Failure::UnstableContact`].
pub fn execute(
    world: &mut World,
    hand: HandId,
    grasp: &GraspCommand,
    settings: &ExecuteSettings,
    watch: &mut dyn FnMut(Moment, &World),
) -> Trial {
    let began = world.time_s();
    let Some(model) = world.hand(hand).cloned() else {
        return Trial {
            failure: Some(Failure::UnstableContact),
            held: Vec::new(),
            meant: None,
            joints_closed: Vec::new(),
            slip_m: 0.0,
            duration_s: 0.0,
        };
    };
    let meant = meant(world, &model, grasp);
    let mut run = Run { world, hand, model, settings, meant };
    run.reach(grasp);
    watch(Moment::Before, run.world);
    let approach = run.approach(grasp);
    let gap_before = run.pose_of(meant);
    run.close(grasp);
    watch(Moment::Contact, run.world);
    let joints_closed = run.world.hand_state(hand).map(|s| s.joints).unwrap_or_default();
    let in_hand = run.in_hand();
    let stable = run.stable();
    let moved = distance(&gap_before, &run.pose_of(meant));
    let start = run.heights();
    run.lift();
    let lifted = run.held(&start);
    if !lifted.is_empty() && settings.shake_m > 0.0 {
        run.shake();
    }
    let mut held = run.held(&start);
    held.sort_by_key(|&id| (Some(id) != meant, id));
    watch(Moment::After, run.world);
    let failure = if !held.is_empty() {
        None
    } else if approach.table {
        Some(Failure::CollisionTable)
    } else if approach.pushed {
        Some(Failure::CollisionObject)
    } else if !lifted.is_empty() {
        Some(Failure::LostShaking)
    } else if stable {
        Some(Failure::LostLifting)
    } else if moved > SLIPPED_M {
        Some(Failure::LostClosing)
    } else {
        Some(Failure::UnstableContact)
    };
    let slip_m = distance(&in_hand, &run.in_hand());
    Trial { failure, held, meant, joints_closed, slip_m, duration_s: run.world.time_s() - began }
}

/// What happened on the approach.
#[derive(Debug, Clone, Copy, Default)]
struct Approach {
    table: bool,
    pushed: bool,
}

struct Run<'a> {
    world: &'a mut World,
    hand: HandId,
    model: Arc<Hand>,
    settings: &'a ExecuteSettings,
    meant: Option<ObjectId>,
}

impl Run<'_> {
    fn steps(&self, time_s: f64) -> usize {
        (time_s.clamp(0.0, 60.0) / self.world.settings().dt_s).round() as usize
    }

    fn wrist(&self) -> Isometry3<f64> {
        self.world.hand_state(self.hand).map_or_else(Isometry3::identity, |s| s.world_from_hand)
    }

    fn go(&mut self, to: &Isometry3<f64>, speed_m_s: f64) {
        let command = Command::Move { world_from_hand: *to, speed_m_s, turn_rad_s: TURN_RAD_S };
        self.world.command(self.hand, command);
    }

    /// To the pre-grasp, fingers as they approach.
    fn reach(&mut self, grasp: &GraspCommand) {
        let open = Command::Close { actuators: grasp.open.clone(), force: 1.0, speed: 1.0 };
        self.world.command(self.hand, open);
        let (from, to) = (self.wrist(), grasp.world_from_pregrasp);
        // Up, across, down: over whatever stands between.
        let top = from.translation.z.max(to.translation.z);
        let (mut up, mut across) = (from, to);
        up.translation.z = top;
        across.translation.z = top;
        for via in [up, across, to] {
            self.go(&via, REACH_M_S);
            self.step_until(10.0, |arrived, settled| arrived && settled);
        }
    }

    /// Steps until the wrist has arrived and the fingers have settled as asked, or time is up.
    fn step_until(&mut self, limit_s: f64, done: fn(bool, bool) -> bool) {
        for _ in 0..self.steps(limit_s) {
            if self.world.hand_state(self.hand).is_none_or(|s| done(s.arrived, s.settled)) {
                return;
            }
            self.world.step();
        }
    }

    /// Straight to the grasp, stopping where something resists.
    fn approach(&mut self, grasp: &GraspCommand) -> Approach {
        let before = self.pose_of(self.meant);
        self.go(&grasp.world_from_hand, self.settings.approach_m_s);
        let mut out = Approach::default();
        let (mut fixed, mut object) = (0.0, 0.0);
        let blend = (self.world.settings().dt_s / FORCE_S).min(1.0);
        for _ in 0..self.steps(20.0) {
            self.world.step();
            let contacts = self.world.hand_contacts(self.hand);
            let force = |wanted: fn(&Touched) -> bool| -> f64 {
                contacts.iter().filter(|c| wanted(&c.touched)).map(|c| c.force_n).sum()
            };
            fixed += (force(|t| matches!(t, Touched::Table | Touched::Tray)) - fixed) * blend;
            object += (force(|t| matches!(t, Touched::Object(_))) - object) * blend;
            let hit = (fixed > self.settings.stop_force_n, object > self.settings.stop_force_n);
            if hit.0 || hit.1 {
                out = Approach { table: hit.0, pushed: hit.1 };
                let here = self.wrist();
                self.go(&here, self.settings.approach_m_s);
                break;
            }
            if self.world.hand_state(self.hand).is_none_or(|s| s.arrived) {
                break;
            }
        }
        out.pushed |= distance(&before, &self.pose_of(self.meant)) > self.settings.push_m;
        out
    }

    /// Takes all fingers from open to where contact is expected so that they arrive together: a finger that came first
    /// would push the object before the others hold against it.
    fn meet(&mut self, grasp: &GraspCommand) {
        let force = self.settings.grip_force;
        let steps = self.steps(self.settings.meet_s);
        let every = self.steps(MEET_COMMAND_S).max(1);
        for step in 0..steps {
            if step % every == 0 {
                let share = (step + every).min(steps) as f64 / steps as f64;
                let between = |(open, contact): (&f64, &f64)| open + share * (contact - open);
                let actuators = grasp.open.iter().zip(&grasp.contact).map(between).collect();
                self.world.command(self.hand, Command::Close { actuators, force, speed: 1.0 });
            }
            self.world.step();
        }
    }

    /// All fingers at once, until nothing moves any more.
    fn close(&mut self, grasp: &GraspCommand) {
        self.meet(grasp);
        let mut closing = Closing::new(&self.model, grasp);
        let force = self.settings.grip_force;
        let full = self.world.full_efforts(self.hand).unwrap_or_default();
        let look = self.steps(LOOK_S).max(1);
        let reached = self.steps(REACHED_S);
        let mut told = false;
        for step in 0..self.steps(self.settings.close_s) {
            if !told {
                let actuators = closing.targets().to_vec();
                self.world.command(self.hand, Command::Close { actuators, force, speed: 1.0 });
                told = true;
            }
            self.world.step();
            if step % look != 0 {
                continue;
            }
            let Some(state) = self.world.hand_state(self.hand) else { return };
            if !state.settled && step < reached {
                continue;
            }
            let touching: Vec<usize> = self.object_contacts().iter().map(|c| c.link).collect();
            let loads: Vec<f64> =
                state.efforts.iter().zip(&full).map(|(e, full)| e / (force * full).max(1e-9)).collect();
            if closing.go_on(&touching, &loads) {
                told = false;
            } else if state.settled {
                return;
            }
        }
    }

    fn lift(&mut self) {
        let mut to = self.wrist();
        to.translation.vector.z += self.settings.lift_m;
        self.go(&to, self.settings.lift_m_s);
        let limit_s = 3.0 * self.settings.lift_m / self.settings.lift_m_s.max(1e-3) + 1.0;
        self.step_until(limit_s, |arrived, _| arrived);
        for _ in 0..self.steps(self.settings.hold_s) {
            self.world.step();
        }
    }

    /// A few cycles along x, y and z.
    fn shake(&mut self) {
        let center = self.wrist();
        let hz = self.settings.shake_hz.clamp(0.1, 20.0);
        let time = self.settings.shake_cycles.clamp(0.0, 100.0) / hz;
        let dt = self.world.settings().dt_s;
        for axis in 0..3 {
            for step in 0..self.steps(time) {
                let t = (step + 1) as f64 * dt;
                // Half a cycle to swing up, half a cycle to come to rest.
                let ramp = (2.0 * hz * t.min(time - t)).clamp(0.0, 1.0);
                let envelope = (1.0 - (PI * ramp).cos()) / 2.0;
                let mut at = center;
                at.translation.vector[axis] += self.settings.shake_m * envelope * (TAU * hz * t).sin();
                self.world.guide(self.hand, &at);
                self.world.step();
            }
        }
        self.world.guide(self.hand, &center);
        for _ in 0..self.steps(CALM_S) {
            self.world.step();
        }
    }

    fn pose_of(&self, id: Option<ObjectId>) -> Option<Isometry3<f64>> {
        self.world.pose(id?)
    }

    /// The meant object in the hand's frame.
    fn in_hand(&self) -> Option<Isometry3<f64>> {
        Some(self.wrist().inverse() * self.pose_of(self.meant)?)
    }

    fn object_contacts(&self) -> Vec<HandContact> {
        let contacts = self.world.hand_contacts(self.hand).into_iter();
        contacts.filter(|c| matches!(c.touched, Touched::Object(_))).collect()
    }

    /// Whether at least two links press an object from opposing sides.
    fn stable(&self) -> bool {
        let contacts = self.object_contacts();
        contacts.iter().any(|a| {
            contacts
                .iter()
                .any(|b| a.link != b.link && a.touched == b.touched && a.normal.dot(&b.normal) < 0.0)
        })
    }

    /// Height of every object.
    fn heights(&self) -> Vec<(ObjectId, f64)> {
        let ids = self.world.ids().into_iter();
        ids.filter_map(|id| Some((id, self.world.pose(id)?.translation.z))).collect()
    }

    /// The objects that have gone up with the hand and move with it.
    fn held(&self, start: &[(ObjectId, f64)]) -> Vec<ObjectId> {
        let up = |&(id, z): &(ObjectId, f64)| {
            let gain = self.world.pose(id)?.translation.z - z;
            let speed = self.world.velocity(id)?.0.norm();
            (gain >= LIFTED * self.settings.lift_m && speed < LOOSE_M_S).then_some(id)
        };
        start.iter().filter_map(up).collect()
    }
}

fn distance(a: &Option<Isometry3<f64>>, b: &Option<Isometry3<f64>>) -> f64 {
    match (a, b) {
        (Some(a), Some(b)) => (a.translation.vector - b.translation.vector).norm(),
        _ => 0.0,
    }
}

/// The object nearest to the middle of the pads at the grasp; of those that contain it, the one whose origin is
/// nearest.
fn meant(world: &World, hand: &Hand, grasp: &GraspCommand) -> Option<ObjectId> {
    let mut u = hand.actuation.open();
    let driven =
        u.iter_mut().zip(&hand.actuation.coordinates).filter(|(_, c)| c.kind == CoordinateKind::Actuator);
    for ((value, _), contact) in driven.zip(&grasp.contact) {
        *value = *contact;
    }
    let bodies = hand.tree.body_poses(&hand.actuation.joints(&u));
    let links = hand.tree.link_poses(&bodies);
    let sum = hand.pads.iter().fold(Vector3::zeros(), |sum, p| sum + (links[p.link] * p.center).coords);
    let middle = grasp.world_from_hand * Point3::from(sum / hand.pads.len().max(1) as f64);
    let nearness = |id: &ObjectId| {
        let outside = world.distance(*id, &middle).unwrap_or(f64::INFINITY).max(0.0);
        let origin = world.pose(*id).map_or(f64::INFINITY, |p| (p.translation.vector - middle.coords).norm());
        (outside, origin)
    };
    world.ids().into_iter().min_by(|a, b| {
        let ((a, at), (b, bt)) = (nearness(a), nearness(b));
        a.total_cmp(&b).then(at.total_cmp(&bt))
    })
}
