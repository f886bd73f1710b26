//! The arm that carries a hand: a stiff position-controlled wrist of limited force.
//!
//! The wrist's reference moves on a straight line with bounded speed and acceleration. In every step the root
//! body's velocity is led to the reference's; how much it may change in one step is what the arm's force allows, so
//! that whatever stands in the way feels that force and no more. While the wrist is held back, the reference waits.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use crate::world::HandSettings;

/// Acceleration along the line, metres per second squared.
const ACCELERATION: f64 = 2.0;
/// Time in which the wrist makes up for a position error, seconds.
const CATCH_UP_S: f64 = 0.02;
/// The reference waits when the wrist lags behind by this much, metres and radians.
const LAG: (f64, f64) = (2e-3, 2e-2);
/// The wrist has arrived when it is this close, metres and radians.
const ARRIVED: (f64, f64) = (5e-4, 2e-3);

/// Linear and angular velocity, world frame.
pub(super) type Twist = (Vector3<f64>, Vector3<f64>);

/// The motion of one wrist.
#[derive(Debug, Clone)]
pub(super) struct Wrist {
    from: Isometry3<f64>,
    to: Isometry3<f64>,
    /// Length of the way, metres; turning counts as the way that takes as long.
    length: f64,
    /// Largest speed along it, metres per second.
    speed: f64,
    /// Way done and speed now.
    done: f64,
    rate: f64,
    /// Where the wrist should be now.
    reference: Isometry3<f64>,
    /// Set by [`Wrist::guide`]: the reference is given from outside for the next step.
    guided: Option<Isometry3<f64>>,
    /// Force that a guided wrist uses at most, newtons; infinite: the arm's.
    guided_force_n: f64,
}

impl Wrist {
    /// A wrist at rest.
    pub(super) fn new(at: &Isometry3<f64>) -> Self {
        Self {
            from: *at,
            to: *at,
            length: 0.0,
            speed: 0.0,
            done: 0.0,
            rate: 0.0,
            reference: *at,
            guided: None,
            guided_force_n: f64::INFINITY,
        }
    }

    /// Moves from where the reference is to a pose; from where the wrist is when something holds it back: a
    /// reference that waits for the wrist would otherwise press on, and no new motion would ever begin. What it has of
    /// speed in the new direction it keeps: poses that follow each other quickly make one motion.
    pub(super) fn go(&mut self, at: &Isometry3<f64>, to: &Isometry3<f64>, speed_m_s: f64, turn_rad_s: f64) {
        let mut velocity = self.velocity();
        if self.lags(at) {
            self.reference = *at;
            velocity = Vector3::zeros();
        }
        let (speed, turn) = (speed_m_s.clamp(1e-4, 5.0), turn_rad_s.clamp(1e-3, 20.0));
        let way = (to.translation.vector - self.reference.translation.vector).norm();
        let angle = self.reference.rotation.angle_to(&to.rotation);
        self.from = self.reference;
        self.to = *to;
        self.length = way.max(angle * speed / turn);
        self.speed = speed;
        self.done = 0.0;
        let along = (to.translation.vector - self.from.translation.vector).try_normalize(1e-6);
        let kept = along.map_or(0.0, |along| velocity.dot(&along).max(0.0));
        self.rate = if way > 0.0 { (kept * self.length / way).min(speed) } else { 0.0 };
        (self.guided, self.guided_force_n) = (None, f64::INFINITY);
    }

    /// Velocity of the reference's origin on its way.
    fn velocity(&self) -> Vector3<f64> {
        let way = self.to.translation.vector - self.from.translation.vector;
        if self.length > 0.0 && self.done < self.length {
            way * (self.rate / self.length)
        } else {
            Vector3::zeros()
        }
    }

    /// Gives the reference of the next step, and the force with which the wrist follows it at most from now on.
    pub(super) fn guide(&mut self, to: &Isometry3<f64>, force_n: f64) {
        (self.guided, self.guided_force_n) = (Some(*to), force_n.max(0.0));
    }

    /// Whether the way is done and the wrist is there.
    pub(super) fn arrived(&self, at: &Isometry3<f64>) -> bool {
        self.done >= self.length
            && (at.translation.vector - self.to.translation.vector).norm() < ARRIVED.0
            && at.rotation.angle_to(&self.to.rotation) < ARRIVED.1
    }

    /// The velocity to give to the root body for the next step, from its pose and velocity now.
    pub(super) fn step(
        &mut self,
        at: &Isometry3<f64>,
        now: &Twist,
        dt: f64,
        settings: &HandSettings,
    ) -> Twist {
        let before = self.reference;
        self.advance(at, dt);
        let (linear, angular) = twist(&before, &self.reference, dt);
        let (error_linear, error_angular) = twist(at, &self.reference, CATCH_UP_S);
        let most = settings.arm_force_n.min(self.guided_force_n) / settings.arm_mass_kg * dt;
        // The same force at a tenth of a metre turns the root, whose radius of gyration that is.
        let most_angular = most / 0.1;
        let lead = |now: &Vector3<f64>, wanted: Vector3<f64>, most: f64| {
            let change = wanted - now;
            now + change * (most / change.norm().max(1e-12)).min(1.0)
        };
        (lead(&now.0, linear + error_linear, most), lead(&now.1, angular + error_angular, most_angular))
    }

    /// True while something holds the wrist back, on its way or in its turn.
    fn lags(&self, at: &Isometry3<f64>) -> bool {
        (self.reference.translation.vector - at.translation.vector).norm() > LAG.0
            || self.reference.rotation.angle_to(&at.rotation) > LAG.1
    }

    fn advance(&mut self, at: &Isometry3<f64>, dt: f64) {
        if let Some(guided) = self.guided.take() {
            (self.reference, self.from, self.to) = (guided, guided, guided);
            (self.length, self.done, self.rate) = (0.0, 0.0, 0.0);
            return;
        }
        if self.lags(at) || self.done >= self.length {
            self.rate = 0.0;
            return;
        }
        let left = self.length - self.done;
        self.rate = (self.rate + ACCELERATION * dt).min(self.speed).min((2.0 * ACCELERATION * left).sqrt());
        // The last bit is not crept along for ever.
        self.done = (self.done + self.rate.max(1e-3) * dt).min(self.length);
        let share = self.done / self.length;
        let (from, to) = (self.from.translation.vector, self.to.translation.vector);
        let translation = Translation3::from(from.lerp(&to, share));
        let whole = (self.to.rotation * self.from.rotation.inverse()).scaled_axis();
        let rotation = UnitQuaternion::from_scaled_axis(whole * share) * self.from.rotation;
        self.reference = Isometry3::from_parts(translation, rotation);
    }
}

/// The velocity that takes one pose to another in a time.
fn twist(from: &Isometry3<f64>, to: &Isometry3<f64>, time_s: f64) -> Twist {
    (
        (to.translation.vector - from.translation.vector) / time_s,
        (to.rotation * from.rotation.inverse()).scaled_axis() / time_s,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Where the reference of a wrist that does not move is after two seconds on its way to `to`.
    fn held_back(to: &Isometry3<f64>) -> Isometry3<f64> {
        let (at, still) = (Isometry3::identity(), (Vector3::zeros(), Vector3::zeros()));
        let mut wrist = Wrist::new(&at);
        wrist.go(&at, to, 0.25, 1.0);
        for _ in 0..800 {
            wrist.step(&at, &still, 1.0 / 400.0, &HandSettings::default());
        }
        wrist.reference
    }

    #[test]
    fn the_reference_waits_for_a_wrist_that_cannot_move_or_cannot_turn() {
        let moved = held_back(&Isometry3::translation(0.3, 0.0, 0.0));
        assert!(moved.translation.vector.norm() < 0.01, "{moved}");
        let turned = held_back(&Isometry3::rotation(Vector3::z() * 1.5));
        assert!(turned.rotation.angle() < 0.05, "{turned}");
    }

    #[test]
    fn poses_that_follow_each_other_quickly_make_one_motion_and_another_direction_is_not_kept() {
        let (dt, still) = (1.0 / 400.0, (Vector3::zeros(), Vector3::zeros()));
        let mut wrist = Wrist::new(&Isometry3::identity());
        let mut walk = |to: Isometry3<f64>, steps: usize| {
            for k in 0..steps {
                let at = wrist.reference;
                if k % 27 == 0 {
                    wrist.go(&at, &to, 0.25, 1.0);
                }
                wrist.step(&at, &still, dt, &HandSettings::default());
            }
            (wrist.reference.translation.vector, wrist.rate)
        };
        let (at, rate) = walk(Isometry3::translation(2.0, 0.0, 0.0), 800);
        // Two seconds at full speed, but for an eighth of a second to get there.
        assert!((at.x - 0.484).abs() < 5e-3 && (rate - 0.25).abs() < 1e-9, "{at} {rate}");
        let (_, rate) = walk(Isometry3::translation(0.0, 0.0, 0.0), 2);
        assert!(rate < 0.02, "back it begins from rest: {rate}");
    }
}
