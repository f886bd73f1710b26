//! Motions as steps that never block: written once, then looked at until they are done.

use std::collections::VecDeque;
use std::time::Duration;

use graspd_adapters_core::task::{Patience, Reply, tell};
use graspd_adapters_core::{DeviceError, FaultKind, HandState};
use tokio::time::Instant;

use super::Driver;
use crate::settings::Model;
use crate::wire::{AxisRequest, AxisStatus, Fault, Mode, Motion, Phase, Request, Status};

/// A gripper that is reset rests this long before it is activated.
const RESET: Duration = Duration::from_millis(500);
/// Status of a request is believed when the gripper has echoed it, and this long after it was written at the earliest:
/// a request for the position of the one before has the same echo.
const TAKES: Duration = Duration::from_millis(40);
/// A fault that outlives the beginning of an activation is one of it.
const OLD_FAULT: Duration = Duration::from_millis(500);

/// What is done next.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Act {
    /// Not activated, so that it can be activated anew.
    Reset,
    /// Open and close once.
    Activate,
    /// To these positions, each motor alone.
    Go(Vec<AxisRequest>),
    /// A 3-Finger to a mode.
    Change(Mode),
    /// All fingers of a 3-Finger as one, as its mode says.
    Together(AxisRequest),
    /// Automatic release: slowly open (true) or closed, whatever else was asked.
    Release(bool),
}

/// A step, and since when.
#[derive(Debug, Clone)]
pub(super) struct Step {
    act: Act,
    since: Option<Instant>,
}

impl Step {
    pub(super) fn reset() -> Self {
        Self { act: Act::Reset, since: None }
    }

    pub(super) fn activate() -> Self {
        Self { act: Act::Activate, since: None }
    }

    pub(super) fn change(mode: Mode) -> Self {
        Self { act: Act::Change(mode), since: None }
    }

    pub(super) fn together(axis: AxisRequest) -> Self {
        Self { act: Act::Together(axis), since: None }
    }

    pub(super) fn release(opens: bool) -> Self {
        Self { act: Act::Release(opens), since: None }
    }

    pub(super) fn go(axes: Vec<AxisRequest>) -> Self {
        Self { act: Act::Go(axes), since: None }
    }
}

/// Who waits for a motion.
pub(super) enum Waits {
    State(Reply<HandState>),
    Done(Reply<()>),
}

/// A motion that runs.
pub(super) struct Running {
    pub(super) operation: &'static str,
    steps: VecDeque<Step>,
    patience: Patience,
    waits: Waits,
}

impl Running {
    pub(super) fn new(operation: &'static str, steps: Vec<Step>, patience: Patience, waits: Waits) -> Self {
        Self { operation, steps: steps.into(), patience, waits }
    }

    /// True when its caller does not wait any more.
    pub(super) fn is_given_up(&self) -> bool {
        match &self.waits {
            Waits::State(reply) => reply.is_closed(),
            Waits::Done(reply) => reply.is_closed(),
        }
    }

    pub(super) fn fail(self, error: DeviceError) {
        match self.waits {
            Waits::State(reply) => tell(reply, Err(error)),
            Waits::Done(reply) => tell(reply, Err(error)),
        }
    }
}

impl Driver {
    /// Brings the running motion on.
    pub(super) async fn tick(&mut self) {
        let Some(mut running) = self.running.take() else { return };
        if running.is_given_up() {
            if let Err(error) = self.halt().await {
                tracing::warn!(device = self.settings.name, %error, "a motion that was given up could not be stopped");
            }
            return;
        }
        if Instant::now() >= running.patience.until {
            let (operation, after) = (running.operation, running.patience.timeout);
            if let Err(error) = self.halt().await {
                tracing::warn!(device = self.settings.name, %error, "a late motion could not be stopped");
            }
            return running.fail(DeviceError::Timeout { device: self.device(), operation, after });
        }
        match self.step(&mut running).await {
            Ok(false) => self.running = Some(running),
            Ok(true) => {
                let state = self.status.as_ref().map(|status| self.state_of(status));
                match (running.waits, state) {
                    (Waits::State(reply), Some(state)) => tell(reply, Ok(state)),
                    (Waits::State(reply), None) => {
                        let detail = "no status was read".to_owned();
                        tell(reply, Err(DeviceError::Protocol { device: self.device(), detail }));
                    }
                    (Waits::Done(reply), _) => tell(reply, Ok(())),
                }
            }
            Err(error) => {
                // A gripper that faults or is lost goes on with what it was told, unless it hears this.
                if !matches!(error, DeviceError::Disconnected { .. }) {
                    let _stopped = self.halt().await;
                }
                running.fail(error);
            }
        }
    }

    /// One look, and what follows from it; true when all is done.
    async fn step(&mut self, running: &mut Running) -> Result<bool, DeviceError> {
        let Some(step) = running.steps.front_mut() else { return Ok(true) };
        let Some(since) = step.since else {
            step.since = Some(Instant::now());
            let request = match step.act.clone() {
                Act::Reset => Request::default(),
                Act::Activate => Request { activate: true, ..self.rest() },
                Act::Go(axes) => Request { activate: true, go: true, axes, ..self.rest() },
                Act::Change(mode) => Request { activate: true, mode, individual: false, ..self.rest() },
                Act::Release(opens) => Request { activate: true, release: Some(opens), ..self.rest() },
                Act::Together(axis) => {
                    let axes =
                        vec![axis, AxisRequest::default(), AxisRequest::default(), AxisRequest::default()];
                    Request { activate: true, go: true, individual: false, axes, ..self.rest() }
                }
            };
            self.write(request).await?;
            return Ok(false);
        };
        let status = self.look().await?;
        let waited = since.elapsed();
        let done = match &step.act {
            Act::Reset => !status.activated && status.phase == Phase::Reset && waited >= RESET,
            Act::Activate => self.is_activated(&status, waited)?,
            Act::Go(_) | Act::Together(_) => self.is_there(&status, waited)?,
            Act::Release(_) => status.fault.is_some_and(Fault::is_released),
            Act::Change(mode) => waited >= TAKES && status.phase == Phase::Ready && status.mode == *mode,
        };
        if done {
            running.steps.pop_front();
        }
        Ok(running.steps.is_empty())
    }

    fn is_activated(&self, status: &Status, waited: Duration) -> Result<bool, DeviceError> {
        let fault =
            status.fault.filter(|f| f.stops() && (waited >= OLD_FAULT || status.phase == Phase::Ready));
        if let Some(fault) = fault {
            return Err(self.stopped(fault.kind(), fault.to_string()));
        }
        let limit = self.settings.activation_s;
        if waited.as_secs_f64() > limit {
            let detail = format!(
                "its activation did not end within {limit} s: something in the way, or another master?"
            );
            return Err(self.stopped(FaultKind::NotActivated, detail));
        }
        Ok(status.activated && status.phase == Phase::Ready)
    }

    fn is_there(&self, status: &Status, waited: Duration) -> Result<bool, DeviceError> {
        if let Some(fault) = status.fault.filter(|f| f.stops()) {
            return Err(self.stopped(fault.kind(), fault.to_string()));
        }
        if !status.activated || status.phase == Phase::Reset {
            let detail = "it is not activated any more: it lost power, or another master has reset it";
            return Err(self.stopped(FaultKind::NotActivated, detail));
        }
        // Before it is taken, the motion is about the request before.
        let taken = waited >= TAKES && status.goes && self.taken(status);
        Ok(taken && status.axes.iter().all(|a| a.motion != Motion::Moving))
    }

    /// Stops the fingers where they are: they keep their grip. Looks first: a gripper that is not activated any more
    /// would take the activation bit of a stop for an activation, and move.
    pub(super) async fn halt(&mut self) -> Result<(), DeviceError> {
        let status = self.look().await?;
        if !status.activated {
            self.request = Request::default();
            return Ok(());
        }
        if !status.goes && !self.request.go {
            return Ok(());
        }
        // What somebody else has asked stays what it was.
        let asked = |a: &AxisStatus| AxisRequest { position: a.requested, ..AxisRequest::default() };
        let axes = if self.request.axes.len() == status.axes.len() {
            self.request.axes.clone()
        } else {
            status.axes.iter().map(asked).collect()
        };
        let individual = self.request.individual;
        self.write(Request { activate: true, go: false, release: None, mode: status.mode, individual, axes })
            .await
    }

    /// A request's constant part.
    fn rest(&self) -> Request {
        let individual = self.settings.model == Model::ThreeFinger;
        // Individual control does not look at the mode; another one would make the fingers turn first.
        Request { individual, mode: self.request.mode, axes: self.request.axes.clone(), ..Request::default() }
    }
}
