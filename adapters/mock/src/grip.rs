//! What a hand of a shared world is doing with its fingers. Lives on the world's thread.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use graspd_adapters_core::{DeviceError, FaultKind, GripCommand, HandState};
use graspd_sim::world::{Command, HandId, World};

use crate::fault_handle::FaultHandle;
use crate::link::Call;
use crate::shared::Reply;
use crate::stage::{Process, Stage};

/// A grip that does not end in time is stopped this long before, seconds, so that the answer comes in time.
const STOP_AHEAD_S: f64 = 0.01;

/// State of one hand's controller.
pub(crate) struct HandCore {
    device: String,
    hand: HandId,
    faults: FaultHandle,
    /// How far each actuator must be from its target to count as held, radians or metres.
    tolerances: Vec<f64>,
    feels_contact: bool,
    /// Target and share of force of the last command; `None` before the first.
    target: Option<(Vec<f64>, f64)>,
    overloaded: bool,
    grip: Option<(Call, Reply<HandState>, f64)>,
    driven: bool,
}

/// A hand controller's state, shared by its calls and its process; only ever locked on the world's thread.
#[derive(Clone)]
pub(crate) struct Shared(Arc<Mutex<HandCore>>);

impl std::fmt::Debug for Shared {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("hand state")
    }
}

impl Shared {
    pub(crate) fn new(
        device: String,
        hand: HandId,
        faults: FaultHandle,
        tolerances: Vec<f64>,
        feels_contact: bool,
    ) -> Self {
        Self(Arc::new(Mutex::new(HandCore {
            device,
            hand,
            faults,
            tolerances,
            feels_contact,
            target: None,
            overloaded: false,
            grip: None,
            driven: false,
        })))
    }

    pub(crate) fn lock(&self) -> MutexGuard<'_, HandCore> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Begins a grip, or says why not.
    pub(crate) fn begin(
        &self,
        stage: &mut Stage,
        call: Call,
        reply: Reply<HandState>,
        command: &GripCommand,
    ) {
        let mut core = self.lock();
        if let Err(error) = core.begin(&mut stage.world, command) {
            let _unheard = reply.send(Err(error));
            return;
        }
        core.grip = Some((call, reply, stage.world.time_s()));
        if !core.driven {
            core.driven = true;
            stage.start(Fingers(self.clone()));
        }
    }
}

impl HandCore {
    /// What the hand reports.
    pub(crate) fn state(&self, world: &World) -> Result<HandState, DeviceError> {
        let state = world.hand_state(self.hand).ok_or_else(|| self.gone())?;
        let held = match &self.target {
            Some((target, _)) if self.feels_contact => {
                let away = state.actuators.iter().zip(target).zip(&self.tolerances);
                away.map(|((at, target), tolerance)| {
                    state.settled && !self.overloaded && (at - target).abs() > *tolerance
                })
                .collect()
            }
            _ if self.feels_contact => vec![false; self.tolerances.len()],
            _ => Vec::new(),
        };
        Ok(HandState { actuators: state.actuators, held, settled: state.settled })
    }

    /// Makes an overloaded hand ready.
    pub(crate) fn clear(&mut self) {
        self.overloaded = false;
    }

    fn begin(&mut self, world: &mut World, command: &GripCommand) -> Result<(), DeviceError> {
        if self.overloaded {
            return Err(self.overload());
        }
        if self.grip.as_ref().is_some_and(|(_, reply, _)| !reply.is_closed()) {
            return Err(DeviceError::Busy { device: self.device.clone(), with: "grip".into() });
        }
        let close = Command::Close {
            actuators: command.actuators.clone(),
            force: command.force,
            speed: command.speed,
        };
        if !world.command(self.hand, close) {
            return Err(self.gone());
        }
        self.target = Some((command.actuators.clone(), command.force));
        Ok(())
    }

    /// Looks at the hand after a step; true when no grip runs any more.
    fn after_step(&mut self, world: &mut World) -> bool {
        let Some((call, reply, began_s)) = &self.grip else { return true };
        let now_s = world.time_s();
        let answer = if reply.is_closed() {
            self.stop(world);
            self.grip = None;
            return true;
        } else if self.faults.overloads(now_s - began_s) {
            self.overloaded = true;
            // Motors that protect themselves give no torque.
            self.relax(world);
            Err(self.overload())
        } else {
            match self.state(world) {
                Ok(state) if !state.settled && now_s < call.until_s - STOP_AHEAD_S => return false,
                Ok(state) if !state.settled => {
                    let error = call.timed_out();
                    self.stop(world);
                    Err(error)
                }
                answer => answer,
            }
        };
        if let Some((_, reply, _)) = self.grip.take() {
            let _unheard = reply.send(answer);
        }
        true
    }

    /// Holds the fingers where they are, with the force that was asked for.
    fn stop(&mut self, world: &mut World) {
        let force = self.target.as_ref().map_or(1.0, |(_, force)| *force);
        self.hold(world, force);
    }

    fn relax(&mut self, world: &mut World) {
        self.hold(world, 0.0);
    }

    fn hold(&mut self, world: &mut World, force: f64) {
        if let Some(state) = world.hand_state(self.hand) {
            self.target = Some((state.actuators.clone(), force));
            let command = Command::Close { actuators: state.actuators, force, speed: 1.0 };
            // The hand was in the world a line ago.
            let _sent = world.command(self.hand, command);
        }
    }

    fn overload(&self) -> DeviceError {
        let detail = "a motor reports overload; its fingers have no force".into();
        DeviceError::Fault { device: self.device.clone(), kind: FaultKind::Overload, detail }
    }

    fn gone(&self) -> DeviceError {
        let detail = "the hand is no longer in the world".into();
        DeviceError::Disconnected { device: self.device.clone(), detail }
    }
}

/// Looks after a hand while its fingers move.
struct Fingers(Shared);

impl Process for Fingers {
    fn after_step(&mut self, world: &mut World) -> bool {
        let mut core = self.0.lock();
        let done = core.after_step(world);
        if done {
            core.driven = false;
        }
        done
    }
}
