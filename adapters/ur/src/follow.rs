//! An arm that follows poses as they come: a stream of targets on a way with bounded speed and acceleration to the newest.

use std::time::Duration;

use graspd_adapters_core::follow::{Goal, Goals, Pursuit};
use graspd_adapters_core::{DeviceError, Limits};
use tokio::time::{Instant, MissedTickBehavior, interval};

use crate::arm::UrArm;
use crate::servo::{ServoSettings, ServoStream};

/// Targets are sent so often.
const BEAT: Duration = Duration::from_millis(8);
/// A stream accepts what is this share of its bounds: ticks come unevenly.
const SHARE: f64 = 0.9;
/// However late a tick comes, the way goes on for no longer than this.
const LONGEST_STEP_S: f64 = 0.04;
/// The next target is asked for in ever shorter steps where joints would have to be too fast.
const SHORTER: f64 = 0.5;
/// An arm that cannot follow for so long says so.
const STUCK: Duration = Duration::from_millis(500);

impl UrArm {
    /// See [`graspd_adapters_core::Arm::follow`].
    pub(crate) async fn follow_goals(
        &self,
        mut goals: Goals,
        limits: Limits,
        silence: Duration,
        timeout: Duration,
    ) -> Result<(), DeviceError> {
        let device = || self.name();
        let silent = || DeviceError::Timeout {
            device: device(),
            operation: "the next pose to follow",
            after: silence,
        };
        // Nothing is begun before there is somewhere to go.
        let mut to = match goals.next(silence).await {
            Goal::Pose(to) => to,
            Goal::Silence => return Err(silent()),
            Goal::End => return Ok(()),
        };
        let mut stream = self.servo_pose(ServoSettings::default(), limits, timeout).await?;
        let bounds = Limits { speed_m_s: SHARE * limits.speed_m_s, ..limits };
        let turn_rad_s = SHARE * self.config().limits.turn_rad_s;
        let mut way = Pursuit::new(stream.at(), bounds, turn_rad_s);
        let mut clock = interval(BEAT);
        clock.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let (mut heard, mut before, mut went) = (Instant::now(), Instant::now(), Instant::now());
        loop {
            clock.tick().await;
            let now = Instant::now();
            match goals.newest() {
                Some(Goal::Pose(pose)) => (to, heard) = (pose, now),
                Some(Goal::End) => return stream.finish(timeout).await,
                Some(Goal::Silence) | None if now - heard > silence => {
                    stream.finish(timeout).await?;
                    return Err(silent());
                }
                Some(Goal::Silence) | None => {}
            }
            let seconds = (now - before).as_secs_f64().min(LONGEST_STEP_S);
            before = now;
            match advance(&mut stream, &mut way, &to, seconds) {
                Ok(()) => went = now,
                // Refused and nothing else: the stream stands where it is.
                Err(DeviceError::OutOfRange { .. }) if now - went < STUCK => {}
                Err(error) => return Err(error),
            }
        }
    }
}

/// The next target on the way; a shorter step where the stream does not take a long one.
fn advance(
    stream: &mut ServoStream<'_>,
    way: &mut Pursuit,
    to: &nalgebra::Isometry3<f64>,
    seconds: f64,
) -> Result<(), DeviceError> {
    let mut refused = None;
    for share in [1.0, SHORTER, SHORTER * SHORTER] {
        let mut next = way.clone();
        match stream.send_pose(next.step(to, share * seconds)) {
            Ok(()) => {
                *way = next;
                return Ok(());
            }
            Err(error @ DeviceError::OutOfRange { .. }) => refused = Some(error),
            Err(error) => return Err(error),
        }
    }
    // The target of before says that somebody is still there.
    *way = Pursuit::new(*way.at(), way.limits(), way.most_turn_rad_s());
    stream.send_pose(way.at())?;
    refused.map_or(Ok(()), Err)
}
