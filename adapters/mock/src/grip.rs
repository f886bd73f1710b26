//! What a hand of a shared world is doing with its fingers. Lives on the world's thread.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use graspd_adapters_core::{CloseCommand, DeviceError, FaultKind, GripCommand, HandState};
use graspd_sim::execute::{CloseOrder, Closing};
use graspd_sim::world::{Command, HandId, World};

use crate::fault_handle::FaultHandle;
use crate::link::Call;
use crate::shared::Reply;
use crate::stage::{Process, Stage};

/// A hand is also at rest when, for this long, seconds ...
const STALL_S: f64 = 0.2;
/// ... no actuator has gone farther than this share of its range: controllers end a grip that creeps.
const STALL_SHARE: f64 = 1e-3;
/// An actuator at rest is also held when it gives this share of the effort that it was allowed: so a hand feels what is
/// so thin that its fingers all but reach their targets.
const HELD_LOAD: f64 = 0.2;
/// A grip that does not end in time is stopped this long before, seconds, so that the answer comes in time.
const STOP_AHEAD_S: f64 = 0.01;

/// Longest time from contact until all fingers are held, seconds, as in trials of the simulation.
const CLOSE_S: f64 = 3.0;

/// What the fingers are told.
pub(crate) enum Order {
    /// To positions.
    Grip(GripCommand),
    /// To contact together, and on until they are held.
    Close(CloseCommand),
}

/// State of one hand's controller.
pub(crate) struct HandCore {
    device: String,
    hand: HandId,
    faults: FaultHandle,
    /// Range of each actuator, radians or metres.
    ranges: Vec<f64>,
    /// How far from its target an actuator at rest counts as held, share of its range; `None`: it feels nothing.
    held_share: Option<f64>,
    /// Target and share of force of the last command; `None` before the first.
    target: Option<(Vec<f64>, f64)>,
    overloaded: bool,
    grip: Option<(Call, Reply<HandState>, f64)>,
    /// While the fingers close on an object: what they are told from step to step.
    closing: Option<Closing>,
    /// True from a closing on: fingers that it has brought to an object are not stopped.
    presses_on: bool,
    driven: bool,
    /// Where the actuators were when they last moved, and when that was.
    still: Option<(Vec<f64>, f64)>,
    /// True when the last grip ended with the fingers at rest.
    rested: bool,
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
        ranges: Vec<f64>,
        held_share: Option<f64>,
    ) -> Self {
        Self(Arc::new(Mutex::new(HandCore {
            device,
            hand,
            faults,
            ranges,
            held_share,
            target: None,
            overloaded: false,
            grip: None,
            closing: None,
            presses_on: false,
            driven: false,
            still: None,
            rested: false,
        })))
    }

    pub(crate) fn lock(&self) -> MutexGuard<'_, HandCore> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Begins a grip, or says why not.
    pub(crate) fn begin(&self, stage: &mut Stage, call: Call, reply: Reply<HandState>, order: Order) {
        if reply.is_closed() {
            // Given up before the hand heard of it.
            return;
        }
        let mut core = self.lock();
        if let Err(error) = core.begin(&mut stage.world, order) {
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
        let settled = (state.settled || self.rested) && self.closing.is_none();
        let held = match (&self.target, self.held_share) {
            (_, None) => Vec::new(),
            (None, Some(_)) => vec![false; self.ranges.len()],
            (Some((target, force)), Some(share)) => {
                let full = world.full_efforts(self.hand).unwrap_or_default();
                let held = |i: usize| {
                    let short = (state.actuators[i] - target[i]).abs() > share * self.ranges[i];
                    let allowed = force * full.get(i).copied().unwrap_or(0.0);
                    short || (allowed > 0.0 && state.efforts[i].abs() >= HELD_LOAD * allowed)
                };
                let alive = settled && !self.overloaded;
                (0..target.len().min(state.efforts.len())).map(|i| alive && held(i)).collect()
            }
        };
        Ok(HandState { actuators: state.actuators, held, settled })
    }

    /// Makes an overloaded hand ready.
    pub(crate) fn clear(&mut self) {
        self.overloaded = false;
    }

    fn begin(&mut self, world: &mut World, order: Order) -> Result<(), DeviceError> {
        if self.overloaded {
            return Err(self.overload());
        }
        if let Some((call, reply, _)) = &self.grip
            && !reply.is_closed()
        {
            return Err(DeviceError::Busy { device: self.device.clone(), with: call.operation.into() });
        }
        self.closing = None;
        self.presses_on = matches!(order, Order::Close(_));
        match order {
            Order::Grip(GripCommand { actuators, speed, force }) => {
                let close = Command::Close { actuators: actuators.clone(), force, speed };
                if !world.command(self.hand, close) {
                    return Err(self.gone());
                }
                self.target = Some((actuators, force));
            }
            Order::Close(command) => {
                let from = world.hand_state(self.hand).ok_or_else(|| self.gone())?.actuators;
                let force = command.force;
                let order = CloseOrder {
                    from,
                    contact: command.contact,
                    squeezed: command.squeezed,
                    farthest: command.farthest,
                    force,
                    speed: command.speed,
                    meet_s: command.meet.as_secs_f64(),
                    close_s: CLOSE_S,
                };
                let mut closing = Closing::new(world, self.hand, order).ok_or_else(|| self.gone())?;
                closing.before_step(world, self.hand);
                self.target = Some((closing.targets().to_vec(), force));
                self.closing = Some(closing);
            }
        }
        (self.still, self.rested) = (None, false);
        Ok(())
    }

    /// Closes on; true while the fingers are not done.
    fn closes(&mut self, world: &mut World) -> bool {
        let Some(closing) = &mut self.closing else { return false };
        let done = closing.before_step(world, self.hand);
        if let Some((target, _)) = &mut self.target {
            target.clear();
            target.extend_from_slice(closing.targets());
        }
        if done {
            self.closing = None;
        }
        !done
    }

    /// Looks at the hand after a step; true when no grip runs any more.
    fn after_step(&mut self, world: &mut World) -> bool {
        let now_s = world.time_s();
        self.rested = self.rests(world, now_s);
        let closes = self.closes(world);
        let Some((call, reply, began_s)) = &self.grip else { return true };
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
                Ok(state) if (closes || !state.settled) && now_s < call.until_s - STOP_AHEAD_S => {
                    return false;
                }
                // Fingers that creep on an object when their time is up press on.
                Ok(state) if closes || !(state.settled || self.presses_on) => {
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

    /// True when the fingers have stalled.
    fn rests(&mut self, world: &World, now_s: f64) -> bool {
        let Some(state) = world.hand_state(self.hand) else { return false };
        let (then, since_s) = self.still.get_or_insert_with(|| (state.actuators.clone(), now_s));
        let moved = state.actuators.iter().zip(&*then).zip(&self.ranges);
        if moved.into_iter().any(|((now, then), range)| (now - then).abs() > STALL_SHARE * range) {
            (*then, *since_s) = (state.actuators, now_s);
        }
        now_s - *since_s >= STALL_S
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
        self.closing = None;
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
