//! The wrist of a hand of the world as the body of an emulated arm.

use graspd_adapters_core::check::SettingsError;
use graspd_adapters_emulators::ur::{Plant, PlantState, PlantTarget, Six, UrModel};
use graspd_sim::world::{HandId, World, WristForce};
use nalgebra::{Isometry3, Vector3};

use super::{FarEnd, Line, require_hand, require_speed};
use crate::shared::SharedWorld;
use crate::stage::Process;

/// Time in which the world's wrist makes up for what it is off the controller's path, seconds.
const FOLLOW_S: f64 = 0.02;
/// It never accelerates more than this, metres and radians per second squared, though the machine that emulates the
/// controller may pause and its targets jump then: no real arm jerks because a computer is busy.
const ACCELERATION: (f64, f64) = (6.0, 30.0);
/// How stiff the tool of an arm of this size is, newtons per metre, and with what force it follows where nothing is in
/// its way, newtons.
const STIFFNESS_N_M: f64 = 20_000.0;
const FREE_N: f64 = 40.0;
/// Time over which the force sensor of an arm smooths, seconds.
const FORCE_S: f64 = 0.01;
/// Joint speeds are smoothed over this time, seconds, and are none below this, radians per second.
const SPEED_S: f64 = 0.02;
const STANDS_RAD_S: f64 = 1e-3;
/// A wrist that is so far from where the controller wants it has been held for long, metres: real ones stop then.
const TOO_FAR_M: f64 = 0.05;

/// How an emulated arm stands in the world and carries its hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WristMount {
    /// Which arm.
    pub model: UrModel,
    /// Where its base stands.
    pub world_from_base: Isometry3<f64>,
    /// How the hand's root link is mounted on its flange.
    pub flange_from_hand: Isometry3<f64>,
    /// Its joints where the hand is now, radians: what the emulated controller starts with.
    pub joints: Six,
}

/// Linear and angular velocity, world frame.
type Twist = (Vector3<f64>, Vector3<f64>);

/// The way from one pose to another, metres and radians.
fn way(from: &Isometry3<f64>, to: &Isometry3<f64>) -> Twist {
    let turn = (to.rotation * from.rotation.inverse()).scaled_axis();
    (to.translation.vector - from.translation.vector, turn)
}

/// What the controller's thread and the world's thread tell each other.
#[derive(Debug)]
struct Said {
    /// Where the hand should be, and how fast that moves: metres and radians per second.
    target: Option<(Isometry3<f64>, Twist)>,
    /// Where it is, and what presses on it, world frame.
    at: Isometry3<f64>,
    force: Vector3<f64>,
    /// False once the hand or the world is gone.
    alive: bool,
}

/// A body for an emulated arm: the wrist of a hand of the world.
#[derive(Debug)]
pub struct WristPlant {
    line: Line<Said>,
    mount: WristMount,
    q: Six,
    qd: Six,
}

impl WristPlant {
    /// For a hand of the world, whose wrist nobody else may move.
    ///
    /// # Errors
    /// [`SettingsError`] for a world that runs on demand, a hand that is not there, joints that do not take the hand to
    /// where it is.
    pub async fn new(shared: &SharedWorld, hand: HandId, mount: WristMount) -> Result<Self, SettingsError> {
        require_speed(shared)?;
        let flange = mount.model.flange(&mount.joints);
        let expected = mount.world_from_base * flange * mount.flange_from_hand;
        let begun = shared.on_stage(move |stage| {
            let at = stage.world.hand_state(hand)?.world_from_hand;
            let line = Line::new(Said { target: None, at, force: Vector3::zeros(), alive: true });
            stage.start(Follow {
                line: line.far_end(),
                hand,
                reference: at,
                velocity: (Vector3::zeros(), Vector3::zeros()),
                felt: WristForce::new(FORCE_S),
            });
            Some((line, at))
        });
        let (line, at) = require_hand(begun.await.ok().flatten())?;
        let off = (at.translation.vector - expected.translation.vector).norm();
        if !(off < 5e-3 && at.rotation.angle_to(&expected.rotation) < 5e-2) {
            return Err(SettingsError {
                field: "joints".into(),
                found: format!(
                    "{:?}, which takes the hand {:.1} mm beside where it is",
                    mount.joints,
                    1e3 * off
                ),
                expected: "the posture in which the arm holds the hand".into(),
            });
        }
        Ok(Self { line, mount, q: mount.joints, qd: [0.0; 6] })
    }
}

impl Plant for WristPlant {
    fn step(&mut self, target: &PlantTarget) -> PlantState {
        let mount = &self.mount;
        let wanted = mount.world_from_base * target.base_from_flange * mount.flange_from_hand;
        let (at, force, alive) = {
            let mut line = self.line.lock();
            // In the controller's time, which does not pause.
            let before = line.target.map_or(wanted, |(before, _)| before);
            let (linear, angular) = way(&before, &wanted);
            line.target = Some((wanted, (linear / target.dt_s.max(1e-6), angular / target.dt_s.max(1e-6))));
            (line.at, line.force, line.alive)
        };
        let base_from_flange = mount.world_from_base.inverse() * at * mount.flange_from_hand.inverse();
        // The hand is near where the controller wants it. Where no posture is found, next to a singularity, what is wanted
        // stands for what is.
        let near = |seed: &Six| mount.model.joints(&base_from_flange, seed);
        let q = near(&target.q).or_else(|| near(&self.q)).unwrap_or(target.q);
        let blend = (target.dt_s / SPEED_S).min(1.0);
        for ((now, before), qd) in q.iter().zip(&self.q).zip(&mut self.qd) {
            let speed = (now - before) / target.dt_s.max(1e-6);
            *qd += (speed - *qd) * blend;
        }
        self.q = q;
        let base = mount.world_from_base.rotation.inverse() * force;
        let far = (at.translation.vector - wanted.translation.vector).norm();
        let protective_stop = if !alive {
            Some("the simulated world has ended".to_owned())
        } else if far > TOO_FAR_M {
            Some(format!("the arm is held {:.0} mm from where it should be", 1e3 * far))
        } else {
            None
        };
        let qd = self.qd.map(|v| if v.abs() < STANDS_RAD_S { 0.0 } else { v });
        PlantState { q, qd, wrench: [base.x, base.y, base.z, 0.0, 0.0, 0.0], protective_stop }
    }
}

/// Leads the wrist after each step of the world; ends with the plant.
struct Follow {
    line: FarEnd<Said>,
    hand: HandId,
    reference: Isometry3<f64>,
    velocity: Twist,
    felt: WristForce,
}

/// A velocity that leads what is off by `error` and should move at `wanted` there, with bounded acceleration.
fn lead(
    velocity: &Vector3<f64>,
    error: &Vector3<f64>,
    wanted: &Vector3<f64>,
    most: f64,
    dt: f64,
) -> Vector3<f64> {
    let far = error.norm();
    // No faster than it can brake from, with half of its acceleration.
    let speed = (far / FOLLOW_S).min((most * far).sqrt());
    let change = wanted + error * (speed / far.max(1e-12)) - velocity;
    velocity + change * (most * dt / change.norm().max(1e-12)).min(1.0)
}

impl Process for Follow {
    fn after_step(&mut self, world: &mut World) -> bool {
        let Some(line) = self.line.line() else { return true };
        let Some(state) = world.hand_state(self.hand) else { return true };
        let at = state.world_from_hand;
        let force = self.felt.feel_vector(world, self.hand);
        let target = {
            let mut line = line.lock();
            (line.at, line.force) = (at, force);
            line.target
        };
        let Some(target) = target else { return false };
        let dt = world.settings().dt_s;
        let (target, (linear, angular)) = target;
        let (off, turned) = way(&self.reference, &target);
        self.velocity.0 = lead(&self.velocity.0, &off, &linear, ACCELERATION.0, dt);
        self.velocity.1 = lead(&self.velocity.1, &turned, &angular, ACCELERATION.1, dt);
        self.reference.translation.vector += self.velocity.0 * dt;
        let turn = nalgebra::UnitQuaternion::from_scaled_axis(self.velocity.1 * dt);
        self.reference.rotation = turn * self.reference.rotation;
        let held_back = way(&at, &self.reference).0.norm();
        !world.guide(self.hand, &self.reference, FREE_N + STIFFNESS_N_M * held_back)
    }
}

impl Drop for Follow {
    fn drop(&mut self) {
        // The world has ended, or the hand has gone; a plant that is gone itself hears nothing.
        if let Some(line) = self.line.line() {
            line.lock().alive = false;
        }
    }
}
