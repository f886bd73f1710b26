//! The phases of an execution, and what is noted in each for the verdict.

use std::f64::consts::{PI, TAU};

use nalgebra::Isometry3;

use super::closing::{CloseOrder, Closing};
use super::place::meant;
use super::{ExecuteSettings, Failure, GraspCommand, Moment, Trial};
use crate::world::{Command, HandContact, HandId, ObjectId, Touched, World, WristForce};

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
/// What the hand overlaps by more than this where it was set down, it would have hit on the way there, metres.
const OVERLAP_M: f64 = 0.002;
/// Stillness after the shake, seconds.
const CALM_S: f64 = 0.3;

/// Executes a grasp with a hand that is in the world; `watch` is called at each [`Moment`].
///
/// The hand goes to the pre-grasp if it is not there (up, across and down at 0.25 m/s; best [`set_down`] there),
/// approaches until it arrives or something resists, closes all fingers at once until each is held, lifts, holds, and
/// shakes. Nothing but the objects' poses decides whether that succeeded; what a hand overlaps where it was set down
/// counts as hit on the way. The hand stays at the end of its motion, with whatever it holds. A hand that is not in
/// the world holds nothing: [`Failure::UnstableContact`].
///
/// [`set_down`]: super::set_down
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
    let mut run = Run { world, hand, settings, meant };
    // The first step pushes apart what overlaps: it is to be seen before.
    let begin = run.overlap();
    run.reach(grasp);
    watch(Moment::Before, run.world);
    let way = run.approach(grasp);
    let approach = Approach { table: begin.table || way.table, pushed: begin.pushed || way.pushed };
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

/// What the hand met on its way.
#[derive(Debug, Clone, Copy, Default)]
struct Approach {
    table: bool,
    pushed: bool,
}

struct Run<'a> {
    world: &'a mut World,
    hand: HandId,
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

    /// What the hand stands in.
    fn overlap(&self) -> Approach {
        let mut out = Approach::default();
        for touched in self.world.hand_overlaps(self.hand, OVERLAP_M) {
            match touched {
                Touched::Table | Touched::Tray => out.table = true,
                Touched::Object(_) => out.pushed = true,
                Touched::Hand(_) => {}
            }
        }
        out
    }

    /// Straight to the grasp, stopping where something resists.
    fn approach(&mut self, grasp: &GraspCommand) -> Approach {
        let before = self.pose_of(self.meant);
        self.go(&grasp.world_from_hand, self.settings.approach_m_s);
        let mut out = Approach::default();
        let mut felt = WristForce::new(WristForce::FILTER_S);
        for _ in 0..self.steps(20.0) {
            self.world.step();
            if felt.feel(self.world, self.hand) > self.settings.stop_force_n {
                let table = felt.is_mostly_fixed();
                out = Approach { table, pushed: !table };
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

    /// All fingers at once, until nothing moves any more.
    fn close(&mut self, grasp: &GraspCommand) {
        let order = CloseOrder {
            from: grasp.open.clone(),
            contact: grasp.contact.clone(),
            squeezed: grasp.squeezed.clone(),
            farthest: Vec::new(),
            force: self.settings.grip_force,
            speed: 1.0,
            meet_s: self.settings.meet_s,
            close_s: self.settings.close_s,
        };
        let Some(mut closing) = Closing::new(self.world, self.hand, order) else { return };
        while !closing.before_step(self.world, self.hand) {
            self.world.step();
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
                self.world.guide(self.hand, &at, f64::INFINITY);
                self.world.step();
            }
        }
        self.world.guide(self.hand, &center, f64::INFINITY);
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
            let at = self.world.pose(id)?.translation.vector;
            let carried = self.world.hand_velocity_at(self.hand, &at.into())?;
            let loose = (self.world.velocity(id)?.0 - carried).norm();
            (gain >= LIFTED * self.settings.lift_m && loose < LOOSE_M_S).then_some(id)
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
