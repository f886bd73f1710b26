//! What callers ask of the task, and how it obeys.

use std::time::Duration;

use graspd_adapters_core::task::{HandOrder, Patience, Reply, tell};
use graspd_adapters_core::{DeviceError, FaultKind, GripCommand, HandState};

use super::{Driver, Running};
use crate::motion::{Bounds, Motion};
use crate::report::JointReport;

/// Slowest share of speed: a motion never takes forever.
const SLOWEST: f64 = 0.02;

/// What only this hand is asked: its joints.
#[derive(Debug)]
pub(crate) struct Joints(pub(crate) Reply<Vec<JointReport>>);

/// What callers ask.
pub(crate) type Order = HandOrder<Joints>;

impl Driver {
    pub(super) async fn obey(&mut self, order: Order) {
        match order {
            Order::State(reply) if self.energized => self.waiting.push(reply),
            Order::State(reply) => {
                let answer = self.look().await.map(|()| self.report());
                tell(reply, answer);
            }
            Order::Grip(command, patience, reply) => {
                let GripCommand { actuators, speed, force } = command;
                let begun = self.begin(speed, force, &reply).await;
                self.start("grip", patience, reply, begun, |fingers, from, bounds, now| {
                    Motion::grip(fingers, from, actuators, bounds, now)
                });
            }
            Order::Close(command, patience, reply) => {
                let begun = self.begin(command.speed, command.force, &reply).await;
                let meet = (command.meet, self.settings.max_speed_rad_s);
                self.start("close", patience, reply, begun, |fingers, from, bounds, now| {
                    let way: [&[f64]; 3] = [&command.contact, &command.squeezed, &command.farthest];
                    Motion::close(fingers, from, way, meet, bounds, now)
                });
            }
            Order::Stop(reply) => {
                let answer = self.stop("stop").await;
                tell(reply, answer);
            }
            Order::Clear(_, reply) => {
                let answer = self.clear().await;
                tell(reply, answer);
            }
            Order::Arm(armed, reply) => {
                let answer = self.arm(armed).await;
                tell(reply, answer);
            }
            Order::Own(Joints(reply)) => {
                let answer = self.joints().await;
                tell(reply, answer);
            }
            Order::Check(reply) => {
                let findings = self.check().await;
                tell(reply, findings);
            }
        }
    }

    /// Everything that must be so before fingers move; `None` for a caller that gave up already.
    async fn begin(
        &mut self,
        speed: f64,
        force: f64,
        reply: &Reply<HandState>,
    ) -> Result<Option<Bounds>, DeviceError> {
        if !self.armed {
            let detail = "motion is not armed: set `armed = true` in its settings, or call `arm`";
            return Err(self.stopped(FaultKind::Other, detail));
        }
        if let Some(running) = &self.running
            && !running.reply.is_closed()
        {
            return Err(DeviceError::Busy { device: self.device(), with: running.operation.into() });
        }
        if let Some((kind, detail)) = &self.fault {
            return Err(self.stopped(*kind, detail.clone()));
        }
        self.bus().await?;
        self.refuse_unhealthy().await?;
        if !self.energized {
            self.energize().await?;
        }
        self.look().await?;
        // Nothing moves yet, so it does not matter that motors stood.
        self.revive().await?;
        let current_ma = force * self.settings.current_ma();
        self.limit_current(current_ma).await?;
        if reply.is_closed() {
            return Ok(None);
        }
        let speed_rad_s = speed.max(SLOWEST) * self.settings.max_speed_rad_s;
        Ok(Some(Bounds { speed_rad_s, current_ma, ..self.bounds }))
    }

    fn start(
        &mut self,
        operation: &'static str,
        patience: Patience,
        reply: Reply<HandState>,
        begun: Result<Option<Bounds>, DeviceError>,
        motion: impl FnOnce(Vec<u8>, Vec<f64>, Bounds, Duration) -> Motion,
    ) {
        let bounds = match begun {
            Ok(Some(bounds)) => bounds,
            Ok(None) => return,
            Err(error) => return tell(reply, Err(error)),
        };
        self.bounds = bounds;
        let fingers = self.settings.joints.iter().map(|j| j.finger).collect();
        // From where the motors were told to be, where they hold: a finger that presses is not let go first.
        let from = match &self.goals {
            Some(goals) => goals.clone(),
            None => self.readings.iter().map(|r| r.position_rad).collect(),
        };
        let motion = motion(fingers, from, bounds, self.now());
        self.resting = false;
        self.running = Some(Running { motion, operation, patience, reply });
    }

    /// Ends a motion and holds the fingers where they are.
    pub(super) async fn stop(&mut self, by: &'static str) -> Result<(), DeviceError> {
        if let Some(running) = self.running.take() {
            tracing::debug!(device = self.settings.name, by, "stopped");
            let error = DeviceError::Stopped { device: self.device(), operation: running.operation };
            tell(running.reply, Err(error));
        }
        if !self.energized {
            return Ok(());
        }
        self.hold().await
    }

    async fn arm(&mut self, armed: bool) -> Result<(), DeviceError> {
        let disarms = self.armed && !armed;
        // Whatever fails below, nothing begins to move any more.
        self.armed = armed;
        if !disarms {
            return Ok(());
        }
        self.stop("disarming").await?;
        self.relax().await
    }

    /// Ends a motion with its answer.
    pub(super) fn finish(&mut self, answer: Result<HandState, DeviceError>) {
        if let Some(running) = self.running.take() {
            tell(running.reply, answer);
        }
    }
}
