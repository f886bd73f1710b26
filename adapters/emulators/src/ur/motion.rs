//! The emulated controller's motion: from commands to targets of joints, step by step.

use nalgebra::{Isometry3, Vector3};

use super::geometry::{Six, UrModel};

/// Deceleration of a stop that nobody chose, radians per second squared.
const DEFAULT_STOP: f64 = 15.0;
/// Joint acceleration of `servoj`, radians per second squared.
const SERVO_ACCELERATION: f64 = 40.0;

/// A way from 0 to 1 with constant acceleration, speed, deceleration.
#[derive(Debug, Clone, Copy)]
struct Ramp {
    ramp_s: f64,
    total_s: f64,
}

impl Ramp {
    /// For a distance, with largest speed and acceleration.
    fn new(distance: f64, speed: f64, acceleration: f64) -> Self {
        let ramp_s = (speed / acceleration).min((distance / acceleration).sqrt());
        let peak = acceleration * ramp_s;
        let total_s = if peak > 0.0 { distance / peak + ramp_s } else { 0.0 };
        Self { ramp_s, total_s }
    }

    /// In a given time.
    fn lasting(total_s: f64) -> Self {
        Self { ramp_s: total_s / 4.0, total_s }
    }

    fn at(&self, t: f64) -> f64 {
        if t >= self.total_s || self.total_s <= 0.0 {
            return 1.0;
        }
        let peak = 1.0 / (self.total_s - self.ramp_s);
        if t < self.ramp_s {
            0.5 * peak * t * t / self.ramp_s
        } else if t < self.total_s - self.ramp_s {
            peak * (t - 0.5 * self.ramp_s)
        } else {
            let left = self.total_s - t;
            1.0 - 0.5 * peak * left * left / self.ramp_s
        }
    }
}

/// What is asked of the arm.
#[derive(Debug, Clone)]
pub(crate) enum Order {
    Joint { to: Six, speed: f64, acceleration: f64, time_s: f64 },
    Linear { to: Isometry3<f64>, speed: f64, acceleration: f64, time_s: f64 },
    Servo { to: Six, time_s: f64, lookahead_s: f64, gain: f64 },
    SpeedJoint { qd: Six, acceleration: f64, time_s: f64 },
    SpeedLinear { xd: Six, acceleration: f64, time_s: f64 },
    StopJoint { deceleration: f64 },
    StopLinear { deceleration: f64 },
}

#[derive(Debug, Clone)]
enum Phase {
    Standing,
    Joint { from: Six, to: Six, ramp: Ramp, t: f64 },
    Linear { from: Isometry3<f64>, to: Isometry3<f64>, ramp: Ramp, t: f64 },
    Servo { to: Six, left_s: f64, lookahead_s: f64, gain: f64 },
    SpeedJoint { qd: Six, acceleration: f64, left_s: f64 },
    SpeedLinear { xd: Six, acceleration: f64, left_s: f64 },
    StopJoint { deceleration: f64, then: Option<Box<Order>> },
    StopLinear { deceleration: f64 },
}

/// What a step did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Stepped {
    Fine,
    /// The path cannot be followed; why.
    Lost(&'static str),
}

/// Generates targets. Counts its orders, so that who gave one knows whether it is done.
#[derive(Debug)]
pub(crate) struct Mover {
    model: UrModel,
    pub(crate) q: Six,
    pub(crate) qd: Six,
    tcp: Isometry3<f64>,
    phase: Phase,
    /// Number of the last order, and of the last that is done or was replaced.
    given: u64,
    done: u64,
}

impl Mover {
    pub(crate) fn new(model: UrModel, q: Six) -> Self {
        Self { model, q, qd: [0.0; 6], tcp: Isometry3::identity(), phase: Phase::Standing, given: 0, done: 0 }
    }

    pub(crate) fn set_tcp(&mut self, tcp: Isometry3<f64>) {
        self.tcp = tcp;
    }

    pub(crate) fn tcp(&self) -> Isometry3<f64> {
        self.tcp
    }

    pub(crate) fn base_from_tcp(&self) -> Isometry3<f64> {
        self.model.flange(&self.q) * self.tcp
    }

    pub(crate) fn is_done(&self, order: u64) -> bool {
        self.done >= order
    }

    pub(crate) fn is_standing(&self) -> bool {
        matches!(self.phase, Phase::Standing)
    }

    /// Takes an order; what runs is replaced. A planned motion begins at rest: a moving arm brakes before.
    pub(crate) fn order(&mut self, order: Order) -> u64 {
        self.given += 1;
        self.done = self.given - 1;
        let planned = matches!(order, Order::Joint { .. } | Order::Linear { .. });
        let moving = self.qd.iter().any(|v| v.abs() > 1e-9);
        self.phase = if planned && moving {
            Phase::StopJoint { deceleration: DEFAULT_STOP, then: Some(Box::new(order)) }
        } else {
            self.begin(order)
        };
        self.given
    }

    /// Once it stands, it means to be where it is.
    pub(crate) fn settle(&mut self, q: Six) {
        if self.is_standing() {
            self.q = q;
        }
    }

    /// Brakes as a program does that ends or is replaced.
    pub(crate) fn brake(&mut self) {
        self.order(Order::StopJoint { deceleration: DEFAULT_STOP });
    }

    fn begin(&self, order: Order) -> Phase {
        match order {
            Order::Joint { to, speed, acceleration, time_s } => {
                let far = self.q.iter().zip(&to).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                let ramp =
                    if time_s > 0.0 { Ramp::lasting(time_s) } else { Ramp::new(far, speed, acceleration) };
                Phase::Joint { from: self.q, to, ramp, t: 0.0 }
            }
            Order::Linear { to, speed, acceleration, time_s } => {
                let from = self.base_from_tcp();
                let way = (to.translation.vector - from.translation.vector).norm();
                // A turn on the spot is paced as if its radians were metres.
                let far = way.max(from.rotation.angle_to(&to.rotation) * 0.25);
                let ramp =
                    if time_s > 0.0 { Ramp::lasting(time_s) } else { Ramp::new(far, speed, acceleration) };
                Phase::Linear { from, to, ramp, t: 0.0 }
            }
            Order::Servo { to, time_s, lookahead_s, gain } => {
                Phase::Servo { to, left_s: time_s, lookahead_s, gain }
            }
            Order::SpeedJoint { qd, acceleration, time_s } => {
                Phase::SpeedJoint { qd, acceleration, left_s: time_s }
            }
            Order::SpeedLinear { xd, acceleration, time_s } => {
                Phase::SpeedLinear { xd, acceleration, left_s: time_s }
            }
            Order::StopJoint { deceleration } => Phase::StopJoint { deceleration, then: None },
            Order::StopLinear { deceleration } => Phase::StopLinear { deceleration },
        }
    }

    /// One control step; `scaling` is the speed slider.
    pub(crate) fn step(&mut self, dt: f64, scaling: f64) -> Stepped {
        let before = self.q;
        let mut phase = std::mem::replace(&mut self.phase, Phase::Standing);
        let finished;
        let mut hold = false;
        match &mut phase {
            Phase::Standing => {
                self.qd = [0.0; 6];
                finished = true;
            }
            Phase::Joint { from, to, ramp, t } => {
                *t += dt * scaling;
                let s = ramp.at(*t);
                self.q = std::array::from_fn(|i| from[i] + s * (to[i] - from[i]));
                finished = *t >= ramp.total_s;
            }
            Phase::Linear { from, to, ramp, t } => {
                *t += dt * scaling;
                let s = ramp.at(*t);
                let turn = (to.rotation * from.rotation.inverse()).scaled_axis() * s;
                let rotation = nalgebra::UnitQuaternion::from_scaled_axis(turn) * from.rotation;
                let way = from.translation.vector.lerp(&to.translation.vector, s);
                let flange = Isometry3::from_parts(way.into(), rotation) * self.tcp.inverse();
                match self.model.joints(&flange, &self.q) {
                    Some(q) => self.q = q,
                    None => return Stepped::Lost("no inverse kinematics on the line"),
                }
                finished = *t >= ramp.total_s;
            }
            Phase::Servo { to, left_s, lookahead_s, gain } => {
                *left_s -= dt;
                let rate = (1.0 / *lookahead_s).min(*gain / 20.0);
                let wanted: Six = std::array::from_fn(|i| (to[i] - self.q[i]) * rate);
                self.accelerate(&wanted, SERVO_ACCELERATION, dt);
                hold = true;
                finished = *left_s <= 1e-9;
                if *left_s < -1.5 * dt {
                    // Nobody came with another target.
                    phase = Phase::StopJoint { deceleration: DEFAULT_STOP, then: None };
                }
            }
            Phase::SpeedJoint { qd, acceleration, left_s } => {
                *left_s -= dt;
                let (wanted, acceleration) = (*qd, *acceleration);
                self.accelerate(&wanted, acceleration, dt);
                let reached = self.qd.iter().zip(&wanted).all(|(a, b)| (a - b).abs() < 1e-6);
                finished = *left_s <= 1e-9 && (*left_s > -1e3 || reached);
                hold = true;
            }
            Phase::SpeedLinear { xd, acceleration, left_s } => {
                *left_s -= dt;
                let point = self.base_from_tcp().translation.vector;
                let jacobian = self.model.jacobian(&self.q, &point);
                let wanted = jacobian.try_inverse().map(|inverse| inverse * nalgebra::Vector6::from(*xd));
                let Some(wanted) = wanted.filter(|w| w.amax() < 20.0) else {
                    return Stepped::Lost("speedl next to a singularity");
                };
                // The acceleration of the tool as one of joints, at the arm's length.
                let acceleration = *acceleration * 4.0;
                self.accelerate(&wanted.into(), acceleration, dt);
                let reached = self.qd.iter().zip(wanted.iter()).all(|(a, b)| (a - b).abs() < 1e-3);
                finished = *left_s <= 1e-9 && (*left_s > -1e3 || reached);
                hold = true;
            }
            Phase::StopJoint { deceleration, .. } => {
                let fastest = self.qd.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
                let left = (fastest - *deceleration * dt).max(0.0);
                self.scale_speed(fastest, left, dt);
                finished = left == 0.0;
            }
            Phase::StopLinear { deceleration } => {
                let speed = self.tcp_speed().norm();
                let left = (speed - *deceleration * dt).max(0.0);
                let left = if speed < 1e-6 { 0.0 } else { left };
                self.scale_speed(speed.max(1e-6), left, dt);
                finished = left == 0.0;
            }
        }
        if !matches!(phase, Phase::Standing) {
            self.qd = std::array::from_fn(|i| (self.q[i] - before[i]) / dt);
        }
        let fastest = self.model.fastest();
        if let Some(_joint) = (0..6).find(|&i| self.qd[i].abs() > 1.02 * fastest[i]) {
            return Stepped::Lost("a joint faster than it may be");
        }
        if finished {
            self.done = self.given;
        }
        self.phase = match phase {
            Phase::StopJoint { then: Some(order), .. } if finished => {
                self.done = self.given - 1;
                self.begin(*order)
            }
            phase if finished && !hold => {
                drop(phase);
                self.qd = [0.0; 6];
                Phase::Standing
            }
            phase => phase,
        };
        Stepped::Fine
    }

    /// Speed of the tool centre point, metres per second.
    pub(crate) fn tcp_speed(&self) -> Vector3<f64> {
        let point = self.base_from_tcp().translation.vector;
        let speeds = self.model.jacobian(&self.q, &point) * nalgebra::Vector6::from(self.qd);
        speeds.fixed_rows::<3>(0).into_owned()
    }

    /// Linear and angular speed of the tool centre point.
    pub(crate) fn tcp_twist(&self, qd: &Six) -> Six {
        let point = self.base_from_tcp().translation.vector;
        (self.model.jacobian(&self.q, &point) * nalgebra::Vector6::from(*qd)).into()
    }

    fn accelerate(&mut self, wanted: &Six, acceleration: f64, dt: f64) {
        let fastest = self.model.fastest();
        for i in 0..6 {
            let wanted = wanted[i].clamp(-fastest[i], fastest[i]);
            let change = (wanted - self.qd[i]).clamp(-acceleration * dt, acceleration * dt);
            self.qd[i] += change;
            self.q[i] += self.qd[i] * dt;
        }
    }

    fn scale_speed(&mut self, from: f64, to: f64, dt: f64) {
        let share = if from > 0.0 { to / from } else { 0.0 };
        for i in 0..6 {
            self.qd[i] *= share;
            self.q[i] += self.qd[i] * dt;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::plant::home;
    use super::*;

    fn run(mover: &mut Mover, order: Order, most: usize) -> (usize, f64) {
        let number = mover.order(order);
        let mut fastest: f64 = 0.0;
        for step in 0..most {
            assert_eq!(mover.step(0.002, 1.0), Stepped::Fine);
            fastest = fastest.max(mover.tcp_speed().norm());
            if mover.is_done(number) {
                return (step, fastest);
            }
        }
        panic!("not done: {mover:?}");
    }

    #[test]
    fn motions_arrive_and_keep_their_limits() {
        let mut mover = Mover::new(UrModel::Ur5e, home(UrModel::Ur5e));
        let mut to = mover.q;
        to[0] += 0.5;
        let (steps, _) =
            run(&mut mover, Order::Joint { to, speed: 1.0, acceleration: 2.0, time_s: 0.0 }, 2000);
        assert_eq!(mover.q, to);
        // 0.5 s up and down at 2 rad/s² make 0.5 rad.
        assert!((steps as f64 * 0.002 - 1.0).abs() < 0.01, "{steps}");
        let goal = mover.base_from_tcp() * nalgebra::Translation3::new(0.0, 0.0, 0.1);
        let (_, fastest) =
            run(&mut mover, Order::Linear { to: goal, speed: 0.1, acceleration: 1.0, time_s: 0.0 }, 2000);
        assert!((mover.base_from_tcp().translation.vector - goal.translation.vector).norm() < 1e-9);
        assert!((fastest - 0.1).abs() < 1e-3, "{fastest}");
    }

    #[test]
    fn a_stop_in_the_middle_stands_soon_and_a_servo_without_targets_stands_too() {
        let mut mover = Mover::new(UrModel::Ur5e, home(UrModel::Ur5e));
        let mut to = mover.q;
        to[1] -= 0.5;
        mover.order(Order::Joint { to, speed: 1.0, acceleration: 2.0, time_s: 0.0 });
        for _ in 0..200 {
            mover.step(0.002, 1.0);
        }
        let (steps, _) = run(&mut mover, Order::StopJoint { deceleration: 4.0 }, 1000);
        assert!((steps as f64 * 0.002 - 0.2).abs() < 0.02, "{steps}");
        assert!(mover.is_standing());
        let to = mover.q.map(|q| q + 0.3);
        mover.order(Order::Servo { to, time_s: 0.002, lookahead_s: 0.1, gain: 300.0 });
        for _ in 0..500 {
            mover.step(0.002, 1.0);
        }
        assert!(mover.is_standing() && mover.q != to);
    }
}
