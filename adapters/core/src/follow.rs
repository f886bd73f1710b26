//! Poses that an arm follows while they change: from whoever leads to the arm, the newest only, and the way from one to
//! the next with bounded speed and acceleration.

use std::time::Duration;

use nalgebra::{Isometry3, Vector3};
use tokio::sync::watch;

use crate::Limits;

/// The end of whoever leads: dropped, the arm stops and its call ends well.
#[derive(Debug)]
pub struct Lead(watch::Sender<Option<Isometry3<f64>>>);

/// The arm's end.
#[derive(Debug)]
pub struct Goals(watch::Receiver<Option<Isometry3<f64>>>);

/// What comes to an arm that follows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Goal {
    /// Go there now.
    Pose(Isometry3<f64>),
    /// Nothing came for as long as was allowed.
    Silence,
    /// Nobody leads any more.
    End,
}

/// Both ends.
pub fn lead() -> (Lead, Goals) {
    let (sender, receiver) = watch::channel(None);
    (Lead(sender), Goals(receiver))
}

impl Lead {
    /// Sends the arm to a pose, whatever it was sent to before. The same pose again says that somebody still leads. False
    /// when no arm follows any more.
    pub fn to(&self, world_from_flange: &Isometry3<f64>) -> bool {
        self.0.send(Some(*world_from_flange)).is_ok()
    }
}

impl Goals {
    /// The newest pose, if one has come since the last look; at once.
    pub fn newest(&mut self) -> Option<Goal> {
        match self.0.has_changed() {
            Ok(true) => self.0.borrow_and_update().map(Goal::Pose),
            Ok(false) => None,
            // What was sent last before the end counts no more: the arm is to stand.
            Err(_) => Some(Goal::End),
        }
    }

    /// The next pose, waiting no longer than this for it. Loses nothing when it is dropped.
    pub async fn next(&mut self, silence: Duration) -> Goal {
        let next = async {
            loop {
                if let Some(goal) = self.newest() {
                    return goal;
                }
                if self.0.changed().await.is_err() {
                    return Goal::End;
                }
                // Looked at again: it is marked as seen now.
                if let Some(pose) = *self.0.borrow_and_update() {
                    return Goal::Pose(pose);
                }
            }
        };
        tokio::time::timeout(silence, next).await.unwrap_or(Goal::Silence)
    }
}

/// A pose on its way to another that may change at any time. Its speed and acceleration are bounded; it brakes in time to
/// stand where it is sent, and turns at a bounded rate.
#[derive(Debug, Clone)]
pub struct Pursuit {
    at: Isometry3<f64>,
    velocity: Vector3<f64>,
    turn_rad_s: f64,
    limits: Limits,
    most_turn_rad_s: f64,
}

/// Angular acceleration, as a multiple of the largest angular speed a second.
const TURN_RISE: f64 = 4.0;

impl Pursuit {
    /// One that stands.
    pub fn new(at: Isometry3<f64>, limits: Limits, most_turn_rad_s: f64) -> Self {
        Self { at, velocity: Vector3::zeros(), turn_rad_s: 0.0, limits, most_turn_rad_s }
    }

    /// Its bounds.
    pub fn limits(&self) -> Limits {
        self.limits
    }

    /// The largest angular speed, radians per second.
    pub fn most_turn_rad_s(&self) -> f64 {
        self.most_turn_rad_s
    }

    /// Where it is.
    pub fn at(&self) -> &Isometry3<f64> {
        &self.at
    }

    /// Goes on towards a pose for so many seconds.
    pub fn step(&mut self, to: &Isometry3<f64>, seconds: f64) -> &Isometry3<f64> {
        if seconds.is_nan() || seconds <= 0.0 {
            return &self.at;
        }
        let Limits { speed_m_s: most, acceleration_m_s2: rise } = self.limits;
        let way = to.translation.vector - self.at.translation.vector;
        let left = way.norm();
        // The fastest from which it can still stand there, one step ahead.
        let wanted = most.min(slowing(left, rise, seconds));
        let wanted = way.try_normalize(1e-12).map_or_else(Vector3::zeros, |along| along * wanted);
        let change = wanted - self.velocity;
        self.velocity += change * (rise * seconds / change.norm().max(1e-12)).min(1.0);
        self.at.translation.vector += self.velocity * seconds;

        let angle = self.at.rotation.angle_to(&to.rotation);
        let rise = TURN_RISE * self.most_turn_rad_s;
        let wanted = self.most_turn_rad_s.min(slowing(angle, rise, seconds));
        self.turn_rad_s = wanted.min(self.turn_rad_s + rise * seconds);
        let turned = self.turn_rad_s * seconds;
        let share = if turned >= angle { 1.0 } else { turned / angle };
        // Opposite rotations have no shortest way; it stays until they are not.
        if let Some(rotation) = self.at.rotation.try_slerp(&to.rotation, share, 1e-9) {
            self.at.rotation = rotation;
        }
        &self.at
    }
}

/// The largest speed from which something that slows down by `rise` stands after `left`, in steps of so many seconds.
fn slowing(left: f64, rise: f64, seconds: f64) -> f64 {
    let half = 0.5 * rise * seconds;
    ((half * half + 2.0 * rise * left).sqrt() - half).min(left / seconds)
}

#[cfg(test)]
mod tests {
    use nalgebra::{Translation3, UnitQuaternion};
    use proptest::prelude::*;

    use super::*;

    const LIMITS: Limits = Limits { speed_m_s: 0.25, acceleration_m_s2: 1.0 };

    fn pose(at: [f64; 3], turn: [f64; 3]) -> Isometry3<f64> {
        Isometry3::from_parts(
            Translation3::from(Vector3::from(at)),
            UnitQuaternion::from_scaled_axis(Vector3::from(turn)),
        )
    }

    proptest! {
        #[test]
        fn whatever_comes_speed_and_acceleration_are_bounded_and_it_arrives(
            goals in prop::collection::vec((prop::array::uniform3(-0.3..0.3f64), prop::array::uniform3(-1.0..1.0f64)), 1..6),
            steps in 1usize..200,
        ) {
            let dt = 0.008;
            let mut pursuit = Pursuit::new(Isometry3::identity(), LIMITS, 1.0);
            let (mut before, mut velocity) = (*pursuit.at(), Vector3::zeros());
            let mut check = |pursuit: &Pursuit| {
                let now = (pursuit.at().translation.vector - before.translation.vector) / dt;
                assert!(now.norm() <= LIMITS.speed_m_s + 1e-9, "{}", now.norm());
                assert!((now - velocity).norm() <= LIMITS.acceleration_m_s2 * dt + 1e-9);
                assert!(pursuit.at().rotation.angle_to(&before.rotation) <= 1.0 * dt + 1e-9);
                (before, velocity) = (*pursuit.at(), now);
            };
            let mut last = Isometry3::identity();
            for (at, turn) in goals {
                last = pose(at, turn);
                for _ in 0..steps {
                    pursuit.step(&last, dt);
                    check(&pursuit);
                }
            }
            for _ in 0..2000 {
                pursuit.step(&last, dt);
                check(&pursuit);
            }
            prop_assert!((pursuit.at().translation.vector - last.translation.vector).norm() < 1e-4);
            prop_assert!(pursuit.at().rotation.angle_to(&last.rotation) < 1e-4);
        }
    }

    #[tokio::test(start_paused = true)]
    async fn the_newest_pose_counts_and_silence_and_the_end_are_told() {
        let (lead, mut goals) = lead();
        assert_eq!(goals.newest(), None);
        assert_eq!(goals.next(Duration::from_millis(50)).await, Goal::Silence);
        let (a, b) = (Isometry3::translation(0.1, 0.0, 0.0), Isometry3::translation(0.2, 0.0, 0.0));
        assert!(lead.to(&a) && lead.to(&b));
        assert_eq!(goals.next(Duration::from_millis(50)).await, Goal::Pose(b));
        assert_eq!(goals.next(Duration::from_millis(50)).await, Goal::Silence);
        // The same again is a sign of life.
        lead.to(&b);
        assert_eq!(goals.newest(), Some(Goal::Pose(b)));
        drop(lead);
        assert_eq!(goals.next(Duration::from_millis(50)).await, Goal::End);
    }
}
