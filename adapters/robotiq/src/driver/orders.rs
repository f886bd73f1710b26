//! What callers ask of the task, and how it obeys.

use graspd_adapters_core::check::Finding;
use graspd_adapters_core::task::{HandOrder, Patience, Reply, tell};
use graspd_adapters_core::{CloseCommand, DeviceError, FaultKind, HandState};

use super::Driver;
use super::steps::{Running, Step, Waits};
use crate::calibration::share_count;
use crate::report::{AxisReport, GripperReport};
use crate::settings::Model;
use crate::wire::{AxisRequest, Mode, Phase, Status};

/// Millimetres of a 3-Finger's fingertip for one count, roughly: 155 mm over its range.
const THREE_MM_PER_COUNT: f64 = 155.0 / 255.0;

/// What callers ask.
pub(crate) type Order = HandOrder<Own>;

/// What only these grippers are asked.
#[derive(Debug)]
pub(crate) enum Own {
    Together(Together, Patience, Reply<HandState>),
    /// To a count, all motors.
    Count(u8, Patience, Reply<HandState>),
    Release(bool, Patience, Reply<()>),
    Report(Reply<GripperReport>),
}

/// What a 3-Finger is asked in one of its modes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Together {
    pub(crate) mode: Mode,
    /// Share of the way from open to closed.
    pub(crate) closed: f64,
    pub(crate) speed: f64,
    pub(crate) force: f64,
}

impl Driver {
    pub(super) async fn obey(&mut self, order: Order) {
        match order {
            Order::State(reply) => {
                let answer = self.look().await.map(|status| self.state_of(&status));
                tell(reply, answer);
            }
            Order::Grip(command, patience, reply) => match self.ready_to_move(&reply).await {
                Ok(_) => {
                    let speed = self.speed(command.speed);
                    let counts = self.actuators.counts(&command.actuators, false);
                    let axes = self.requests(&counts, &vec![speed; counts.len()], command.force);
                    self.start("grip", vec![Step::go(axes)], patience, Waits::State(reply)).await;
                }
                Err(error) => tell(reply, Err(error)),
            },
            Order::Close(command, patience, reply) => match self.ready_to_move(&reply).await {
                Ok(status) => {
                    let steps = self.closing(&command, &status);
                    self.start("close", steps, patience, Waits::State(reply)).await;
                }
                Err(error) => tell(reply, Err(error)),
            },
            Order::Own(Own::Together(Together { mode, closed, speed, force }, patience, reply)) => {
                match self.ready_to_move(&reply).await {
                    Ok(status) => {
                        let count = share_count(closed, (0.0, 1.0));
                        let axes = self.requests(&[count], &[self.speed(speed)], force);
                        let change = (status.mode != mode).then(|| Step::change(mode));
                        let steps = change.into_iter().chain(axes.into_iter().map(Step::together)).collect();
                        self.start("grip_in_mode", steps, patience, Waits::State(reply)).await;
                    }
                    Err(error) => tell(reply, Err(error)),
                }
            }
            Order::Own(Own::Count(count, patience, reply)) => match self.ready_to_move(&reply).await {
                Ok(status) => {
                    let counts = vec![count; status.axes.len()];
                    let axes = self.requests(&counts, &vec![self.speed(0.5); counts.len()], 0.0);
                    self.start("calibrate", vec![Step::go(axes)], patience, Waits::State(reply)).await;
                }
                Err(error) => tell(reply, Err(error)),
            },
            Order::Own(Own::Release(opens, patience, reply)) => {
                let allowed = self.refuse_unarmed().and_then(|()| self.refuse_busy());
                match allowed {
                    Ok(()) => {
                        let steps = vec![Step::release(opens)];
                        self.start("release", steps, patience, Waits::Done(reply)).await;
                    }
                    Err(error) => tell(reply, Err(error)),
                }
            }
            Order::Stop(reply) => {
                let answer = self.stop().await;
                tell(reply, answer);
            }
            Order::Clear(patience, reply) => self.clear(patience, reply).await,
            Order::Arm(armed, reply) => {
                let disarms = self.armed && !armed;
                // Whatever fails below, nothing begins to move any more.
                self.armed = armed;
                let stopped = if disarms { self.stop().await } else { Ok(()) };
                tell(reply, stopped);
            }
            Order::Own(Own::Report(reply)) => {
                let answer = self.look().await.map(|status| self.report(&status));
                tell(reply, answer);
            }
            Order::Check(reply) => {
                let findings = self.check().await;
                tell(reply, findings);
            }
        }
    }

    fn refuse_unarmed(&self) -> Result<(), DeviceError> {
        if self.armed {
            return Ok(());
        }
        let detail = "motion is not armed: set `armed = true` in its settings, or call `arm`";
        Err(self.stopped(FaultKind::Other, detail))
    }

    fn refuse_busy(&self) -> Result<(), DeviceError> {
        match &self.running {
            Some(running) if !running.is_given_up() => {
                Err(DeviceError::Busy { device: self.device(), with: running.operation.into() })
            }
            _ => Ok(()),
        }
    }

    /// Everything that must be so before fingers move.
    async fn ready_to_move(&mut self, reply: &Reply<HandState>) -> Result<Status, DeviceError> {
        self.refuse_unarmed()?;
        self.refuse_busy()?;
        let status = self.look().await?;
        if let Some(fault) = status.fault.filter(|f| f.stops()) {
            return Err(self.stopped(fault.kind(), fault.to_string()));
        }
        if !status.activated || status.phase != Phase::Ready {
            let phase = status.phase;
            let detail = format!("it is not activated ({phase:?}): its fingers must open and close once");
            return Err(self.stopped(FaultKind::NotActivated, detail));
        }
        if reply.is_closed() {
            return Err(DeviceError::Stopped { device: self.device(), operation: "grip" });
        }
        Ok(status)
    }

    /// A share of the speed that is allowed, millimetres per second.
    fn speed(&self, share: f64) -> f64 {
        share * self.settings.max_speed()
    }

    /// What is asked of each axis; no more than is allowed, whatever was asked.
    fn requests(&self, counts: &[u8], speeds_mm_s: &[f64], force: f64) -> Vec<AxisRequest> {
        let model = self.settings.model;
        let force_n = (force * self.settings.max_force()).max(model.forces_n().0);
        let bounded = |speed: f64| speed.clamp(model.speeds_mm_s().0, self.settings.max_speed());
        counts
            .iter()
            .zip(speeds_mm_s)
            .map(|(position, speed)| AxisRequest {
                position: *position,
                speed: share_count(bounded(*speed), model.speeds_mm_s()),
                force: share_count(force_n, model.forces_n()),
            })
            .collect()
    }

    /// To where contact is expected with such speeds that all arrive together, then on until something stops them.
    fn closing(&self, command: &CloseCommand, status: &Status) -> Vec<Step> {
        let model = self.settings.model;
        let mm_per_count = if model == Model::ThreeFinger {
            THREE_MM_PER_COUNT
        } else {
            let c = self.settings.calibration();
            c.open_mm / (c.closed_count - c.open_count)
        };
        // An actuator that is beyond contact already stays: opened again it might let go.
        let now = self.actuators.values(&status.axes);
        let meeting: Vec<f64> = now
            .iter()
            .zip(command.contact.iter().zip(&command.squeezed))
            .map(
                |(now, (contact, squeezed))| {
                    if (now - contact) * (squeezed - contact) > 0.0 { *now } else { *contact }
                },
            )
            .collect();
        let contact = self.actuators.counts(&meeting, false);
        let meet_s = command.meet.as_secs_f64().max(0.02);
        let speeds: Vec<f64> = contact
            .iter()
            .zip(&status.axes)
            .map(|(to, axis)| f64::from(to.abs_diff(axis.position)) * mm_per_count / meet_s)
            .collect();
        let farthest = self.actuators.counts(&command.farthest, true);
        let on = vec![self.speed(command.speed); farthest.len()];
        vec![
            Step::go(self.requests(&contact, &speeds, command.force)),
            Step::go(self.requests(&farthest, &on, command.force)),
        ]
    }

    async fn clear(&mut self, patience: Patience, reply: Reply<()>) {
        let status = match self.refuse_busy() {
            Ok(()) => self.look().await,
            Err(error) => Err(error),
        };
        let status = match status {
            Ok(status) => status,
            Err(error) => return tell(reply, Err(error)),
        };
        let faulty = status.fault.is_some_and(super::super::wire::Fault::stops);
        if status.activated && status.phase == Phase::Ready && !faulty {
            return tell(reply, Ok(()));
        }
        // An activation moves the fingers through their whole range.
        if let Err(error) = self.refuse_unarmed() {
            return tell(reply, Err(error));
        }
        self.start("clear_fault", vec![Step::reset(), Step::activate()], patience, Waits::Done(reply)).await;
    }

    async fn start(&mut self, operation: &'static str, steps: Vec<Step>, patience: Patience, waits: Waits) {
        self.running = Some(Running::new(operation, steps, patience, waits));
        self.tick().await;
    }

    /// Stops the fingers where they are.
    async fn stop(&mut self) -> Result<(), DeviceError> {
        let halted = self.halt().await;
        if let Some(running) = self.running.take() {
            let error = DeviceError::Stopped { device: self.device(), operation: running.operation };
            running.fail(error);
        }
        halted
    }

    fn report(&self, status: &Status) -> GripperReport {
        let model = self.settings.model;
        // A count of a 3-Finger is 0.1 A, of a 2F 10 mA.
        let ma = if model == Model::ThreeFinger { 100.0 } else { 10.0 };
        let axes = self.actuators.in_order(&status.axes);
        let values = self.actuators.values(&status.axes);
        let named = self.actuators.list.iter().zip(axes).zip(values);
        let opening = status.axes.first().map(|a| self.settings.calibration().opening_mm(a.position));
        GripperReport {
            phase: status.phase,
            fault: status.fault,
            mode: status.mode,
            opening_mm: opening.filter(|_| model != Model::ThreeFinger),
            axes: named
                .map(|(((name, ..), axis), position)| AxisReport {
                    actuator: (*name).to_owned(),
                    position,
                    count: axis.position,
                    current_ma: f64::from(axis.current) * ma,
                    motion: axis.motion,
                })
                .collect(),
        }
    }

    /// Looks at everything that commonly goes wrong. Nothing moves, nothing is written.
    async fn check(&mut self) -> Vec<Finding> {
        let mut findings = Vec::new();
        let status = match self.look().await {
            Ok(status) => status,
            Err(error) => {
                let advice = "see that the gripper has power, that cables and address are right, and that only one \
                              of the arm's gripper programs is installed";
                return vec![Finding::bad("link", error.to_string(), advice)];
            }
        };
        findings.push(Finding::good("link", "the gripper answers"));
        findings.push(match status.fault.filter(|f| f.stops()) {
            None => Finding::good("fault", "none"),
            Some(fault) => {
                Finding::bad("fault", fault.to_string(), "take away the cause, then clear the fault")
            }
        });
        if status.controller_fault != 0 {
            let found = format!("fault {:#x} (high half of the fault byte)", status.controller_fault);
            let advice = "look it up in the manual of the controller that the gripper hangs on";
            findings.push(Finding::bad("controller", found, advice));
        }
        let phase = format!("{:?}", status.phase);
        findings.push(if status.activated && status.phase == Phase::Ready {
            Finding::good("activation", phase)
        } else {
            Finding::bad(
                "activation",
                phase,
                "clear the fault to activate it: its fingers open and close once",
            )
        });
        findings.push(Finding::of_arming(self.armed));
        findings
    }
}
