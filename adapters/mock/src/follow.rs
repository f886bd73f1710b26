//! A mock arm that follows poses: each is a motion that takes the place of the one before.
//!
//! In a world on demand following lets no time go by: whoever looks, or waits, moves the clock, and the arm moves
//! meanwhile. So a leader that takes its time to think is never too slow there, and the same frames lead to the same way.

use std::time::Duration;

use graspd_adapters_core::follow::{Goal, Goals};
use graspd_adapters_core::{Arm as _, DeviceError, Limits, Reached};
use nalgebra::Isometry3;
use tokio::sync::oneshot;

use crate::arm::MockArm;
use crate::course::Order;
use crate::link::Call;

/// The world's clock is looked at so often while nobody leads, wall clock.
const LOOK: Duration = Duration::from_millis(20);
/// What an arm says that it waited for in vain.
const NEXT_POSE: &str = "the next pose to follow";

/// The motion that runs, as far as its end is not known.
type Running = Option<oneshot::Receiver<Result<Reached, DeviceError>>>;

impl MockArm {
    /// See [`graspd_adapters_core::Arm::follow`].
    pub(crate) async fn follow_goals(
        &self,
        mut goals: Goals,
        limits: Limits,
        silence: Duration,
        timeout: Duration,
    ) -> Result<(), DeviceError> {
        let call = self.link.call("follow", timeout);
        let reached = self.link.reach(&call, true);
        self.link.shared.bounded(&call.device, call.operation, timeout, reached).await?;
        let mut heard_s = self.link.shared.time_s();
        let mut running: Running = None;
        loop {
            tokio::select! {
                biased;
                goal = goals.next(LOOK) => match goal {
                    Goal::Pose(to) => {
                        self.check(&to, limits)?;
                        running = Some(self.lead_to(&to, limits, silence).await?);
                        heard_s = self.link.shared.time_s();
                    }
                    Goal::End => break,
                    Goal::Silence => {
                        let silent_s = self.link.shared.time_s() - heard_s;
                        if silent_s > silence.as_secs_f64() {
                            self.stop(timeout).await?;
                            return Err(self.link.call(NEXT_POSE, silence).timed_out());
                        }
                    }
                },
                ended = end_of(&mut running) => {
                    running = None;
                    // A pose that is reached is held until the next one comes.
                    ended.map_err(|_| self.link.ended())??;
                }
            }
        }
        // The motion's caller has gone when this is dropped; until then it would be stopped by another.
        drop(running);
        self.stop(timeout).await
    }

    /// Sends the arm to a pose; the answer comes at its end.
    async fn lead_to(
        &self,
        to: &Isometry3<f64>,
        limits: Limits,
        silence: Duration,
    ) -> Result<oneshot::Receiver<Result<Reached, DeviceError>>, DeviceError> {
        let (reply, answer) = oneshot::channel();
        let call: Call = self.link.call(NEXT_POSE, silence);
        let (state, world_from_hand, speed_m_s) = (self.state.clone(), *to, limits.speed_m_s);
        let begun = self.link.shared.on_stage(move |stage| {
            state.begin(stage, Order { call, reply, world_from_hand, speed_m_s, contact_n: None, led: true });
        });
        begun.await.map_err(|_| self.link.ended())?;
        Ok(answer)
    }
}

/// Ready when a motion that runs has ended.
async fn end_of(running: &mut Running) -> Result<Result<Reached, DeviceError>, oneshot::error::RecvError> {
    match running {
        Some(answer) => answer.await,
        None => std::future::pending().await,
    }
}
