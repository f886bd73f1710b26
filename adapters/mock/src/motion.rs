//! What an arm of a shared world is doing: moving, braking, halted. Lives on the world's thread.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use graspd_adapters_core::{ArmMode, DeviceError, FaultKind, Reached};
use graspd_sim::world::{Command, HandId, HandState, World, WristForce};

use crate::arm::ArmSettings;
use crate::course::{Motion, Order};
use crate::fault_handle::FaultHandle;
use crate::faults::StopKind;
use crate::link::Call;
use crate::shared::Reply;
use crate::stage::{Process, Stage};

/// An arm that does not come to rest for this long while it brakes is taken to stand, seconds.
const BRAKE_LIMIT_S: f64 = 0.5;
/// A blocked arm that is this close to where it was sent, metres and radians, is there: it presses, and holds.
const IN_POSITION: (f64, f64) = (2e-3, 2e-2);
/// A motion that does not end in time is braked this long before, seconds, so that the answer comes in time.
const BRAKE_AHEAD_S: f64 = 0.05;

enum Phase {
    Standing,
    Moving(Motion),
    /// Braking after a motion that ended early; its caller hears of it when the arm stands.
    Braking {
        since_s: f64,
        then: Option<(Call, Reply<Reached>, Result<Reached, DeviceError>)>,
    },
}

/// State of one arm.
pub(crate) struct ArmCore {
    device: String,
    hand: HandId,
    settings: ArmSettings,
    faults: FaultHandle,
    phase: Phase,
    halt: Option<(FaultKind, String)>,
    /// Callers that wait for the arm to stand.
    stops: Vec<(Call, Reply<()>)>,
    /// True while a [`Drive`] looks at this arm after each step.
    driven: bool,
    felt: WristForce,
}

/// An arm's state, shared by its calls and its process; only ever locked on the world's thread.
#[derive(Clone)]
pub(crate) struct Shared(Arc<Mutex<ArmCore>>);

impl std::fmt::Debug for Shared {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("arm state")
    }
}

impl Shared {
    pub(crate) fn new(device: String, hand: HandId, settings: ArmSettings, faults: FaultHandle) -> Self {
        let felt = WristForce::new(settings.force_filter_s);
        Self(Arc::new(Mutex::new(ArmCore {
            device,
            hand,
            settings,
            faults,
            phase: Phase::Standing,
            halt: None,
            stops: Vec::new(),
            driven: false,
            felt,
        })))
    }

    pub(crate) fn lock(&self) -> MutexGuard<'_, ArmCore> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Begins a motion, or says why not.
    pub(crate) fn begin(&self, stage: &mut Stage, order: Order) {
        if order.reply.is_closed() {
            // Given up before the arm heard of it.
            return;
        }
        let mut core = self.lock();
        core.look_at_button(&mut stage.world);
        if let Err(error) = core.admit() {
            let _unheard = order.reply.send(Err(error));
            return;
        }
        core.begin(&mut stage.world, order);
        self.drive(core, stage);
    }

    /// Brakes whatever runs; the reply comes when the arm stands.
    pub(crate) fn stop(&self, stage: &mut Stage, call: Call, reply: Reply<()>) {
        let mut core = self.lock();
        core.brake(&mut stage.world, |call| Err(stopped(call)));
        if matches!(core.phase, Phase::Standing) {
            let _unheard = reply.send(Ok(()));
            return;
        }
        core.stops.push((call, reply));
        self.drive(core, stage);
    }

    fn drive(&self, mut core: MutexGuard<'_, ArmCore>, stage: &mut Stage) {
        if !core.driven {
            core.driven = true;
            stage.start(Drive(self.clone()));
        }
    }
}

impl ArmCore {
    /// What the arm says of itself.
    pub(crate) fn mode(&mut self, world: &mut World) -> ArmMode {
        self.look_at_button(world);
        match (&self.halt, &self.phase) {
            (Some((kind, _)), _) => ArmMode::Stopped(*kind),
            (None, Phase::Standing) => ArmMode::Ready,
            (None, _) => ArmMode::Moving,
        }
    }

    /// Releases what may be released.
    pub(crate) fn clear(&mut self, world: &mut World) -> Result<(), DeviceError> {
        self.look_at_button(world);
        if self.faults.emergency_stop() {
            return Err(self.halted(FaultKind::EmergencyStop, "the emergency stop is pressed"));
        }
        self.halt = None;
        Ok(())
    }

    /// `Ok` when a new motion may begin.
    fn admit(&mut self) -> Result<(), DeviceError> {
        if let Some((kind, detail)) = &self.halt {
            return Err(self.halted(*kind, detail));
        }
        match &self.phase {
            // A motion whose caller has gone stands in nobody's way.
            Phase::Moving(motion) if !self.settings.replaces_motion && !motion.reply.is_closed() => {
                Err(DeviceError::Busy { device: self.device.clone(), with: motion.call.operation.into() })
            }
            _ => Ok(()),
        }
    }

    fn begin(&mut self, world: &mut World, order: Order) {
        let goes_on = order.led && matches!(&self.phase, Phase::Moving(motion) if motion.led);
        if !goes_on {
            self.felt = WristForce::new(self.settings.force_filter_s);
        }
        let last = world.hand_state(self.hand).map(|s| s.world_from_hand.translation.vector);
        let sent = world.command(
            self.hand,
            Command::Move {
                world_from_hand: order.world_from_hand,
                speed_m_s: order.speed_m_s,
                turn_rad_s: self.settings.turn_rad_s,
            },
        );
        let (Some(last), true) = (last, sent) else {
            let _unheard = order.reply.send(Err(self.gone()));
            return;
        };
        let mut motion = Motion::new(order, last, world.time_s(), self.settings.turn_rad_s);
        if let Phase::Moving(before) = &self.phase
            && goes_on
        {
            motion.go_on_from(before);
        }
        match std::mem::replace(&mut self.phase, Phase::Moving(motion)) {
            Phase::Moving(old) => {
                let error = stopped(&old.call);
                let _unheard = old.reply.send(Err(error));
            }
            Phase::Braking { then: Some((_, reply, answer)), .. } => {
                let _unheard = reply.send(answer);
            }
            Phase::Braking { then: None, .. } | Phase::Standing => {}
        }
    }

    /// Looks at the arm after a step; true when it stands and nobody waits.
    fn after_step(&mut self, world: &mut World) -> bool {
        let Some(state) = world.hand_state(self.hand) else {
            let error = self.gone();
            self.answer_all(&error);
            return true;
        };
        self.look_at_button(world);
        let now_s = world.time_s();
        match &mut self.phase {
            Phase::Moving(motion) => {
                motion.go_on(&state.world_from_hand);
                self.watch_motion(world, &state);
            }
            Phase::Braking { since_s, then } => {
                let late = then.as_ref().is_some_and(|(call, ..)| now_s >= call.until_s);
                if state.arrived || late || now_s - *since_s > BRAKE_LIMIT_S {
                    if let Some((_, reply, answer)) = then.take() {
                        let _unheard = reply.send(answer);
                    }
                    self.phase = Phase::Standing;
                }
            }
            Phase::Standing => {}
        }
        self.answer_stops(now_s);
        matches!(self.phase, Phase::Standing) && self.stops.is_empty()
    }

    /// Ends the motion that runs where something ends it. Real arms stop themselves, too, when they cannot follow
    /// their path: otherwise a hand that is wedged by friction or held by its fingertips would press for ever.
    fn watch_motion(&mut self, world: &mut World, state: &HandState) {
        let now_s = world.time_s();
        let Phase::Moving(motion) = &mut self.phase else { return };
        let blocked = motion.blocked(&state.world_from_hand, now_s);
        let (way, angle) = motion.left(&state.world_from_hand);
        let timed_out = (now_s >= motion.call.until_s - BRAKE_AHEAD_S).then(|| motion.call.timed_out());
        let call = motion.call.clone();
        if motion.reply.is_closed() {
            self.brake(world, |call| Err(stopped(call)));
            return;
        }
        if let Some(kind) = self.faults.motion_stop(motion.path_m, now_s - motion.began_s) {
            let detail = format!("injected {:.3} m into {}", motion.path_m, motion.call.operation);
            let kind = match kind {
                StopKind::Protective => FaultKind::ProtectiveStop,
                StopKind::Emergency => FaultKind::EmergencyStop,
            };
            self.halt(world, kind, detail);
            return;
        }
        let contact_n = motion.contact_n.unwrap_or(f64::INFINITY);
        let force_n = self.felt.feel(world, self.hand);
        if let Some(limit) = self.settings.stop_force_n.filter(|limit| force_n > *limit) {
            let detail = format!("{force_n:.0} N at the hand during {}, limit {limit:.0} N", call.operation);
            self.halt(world, FaultKind::ProtectiveStop, detail);
        } else if force_n > contact_n {
            self.brake(world, |_| Ok(Reached::Contact));
        } else if state.arrived || (blocked && way < IN_POSITION.0 && angle < IN_POSITION.1) {
            if let Phase::Moving(motion) = std::mem::replace(&mut self.phase, Phase::Standing) {
                let _unheard = motion.reply.send(Ok(Reached::Goal));
            }
        } else if blocked {
            let (way, angle) = (1000.0 * way, angle.to_degrees());
            let detail =
                format!("blocked {way:.1} mm and {angle:.1} degrees before the end of {}", call.operation);
            self.halt(world, FaultKind::ProtectiveStop, detail);
        } else if let Some(error) = timed_out {
            self.brake(world, |_| Err(error.clone()));
        }
    }

    /// Notices a pressed emergency stop.
    fn look_at_button(&mut self, world: &mut World) {
        let known = matches!(self.halt, Some((FaultKind::EmergencyStop, _)));
        if self.faults.emergency_stop() && !known {
            self.halt(world, FaultKind::EmergencyStop, "the emergency stop is pressed".into());
        }
    }

    /// The arm stops itself.
    fn halt(&mut self, world: &mut World, kind: FaultKind, detail: String) {
        let error = self.halted(kind, &detail);
        self.halt = Some((kind, detail));
        self.brake(world, |_| Err(error.clone()));
    }

    /// Holds the wrist where it is; the caller of a motion that runs hears how it ended, when the arm stands.
    fn brake(&mut self, world: &mut World, how: impl Fn(&Call) -> Result<Reached, DeviceError>) {
        if !matches!(self.phase, Phase::Moving(_)) {
            return;
        }
        if let Some(state) = world.hand_state(self.hand) {
            let hold = Command::Move {
                world_from_hand: state.world_from_hand,
                speed_m_s: self.settings.max_speed_m_s,
                turn_rad_s: self.settings.turn_rad_s,
            };
            // The hand was in the world a line ago.
            let _sent = world.command(self.hand, hold);
        }
        let braking = Phase::Braking { since_s: world.time_s(), then: None };
        if let Phase::Moving(motion) = std::mem::replace(&mut self.phase, braking) {
            let answer = how(&motion.call);
            if let Phase::Braking { then, .. } = &mut self.phase {
                *then = Some((motion.call, motion.reply, answer));
            }
        }
    }

    /// Answers everybody, for the hand is gone.
    fn answer_all(&mut self, error: &DeviceError) {
        match std::mem::replace(&mut self.phase, Phase::Standing) {
            Phase::Moving(Motion { reply, .. }) | Phase::Braking { then: Some((_, reply, _)), .. } => {
                let _unheard = reply.send(Err(error.clone()));
            }
            Phase::Braking { then: None, .. } | Phase::Standing => {}
        }
        for (_, reply) in self.stops.drain(..) {
            let _unheard = reply.send(Err(error.clone()));
        }
    }

    fn answer_stops(&mut self, now_s: f64) {
        let standing = matches!(self.phase, Phase::Standing);
        for (call, reply) in std::mem::take(&mut self.stops) {
            if standing {
                let _unheard = reply.send(Ok(()));
            } else if now_s >= call.until_s {
                let _unheard = reply.send(Err(call.timed_out()));
            } else if !reply.is_closed() {
                self.stops.push((call, reply));
            }
        }
    }

    fn halted(&self, kind: FaultKind, detail: &str) -> DeviceError {
        DeviceError::Fault { device: self.device.clone(), kind, detail: detail.into() }
    }

    fn gone(&self) -> DeviceError {
        let detail = "the hand that the arm carries is no longer in the world".into();
        DeviceError::Disconnected { device: self.device.clone(), detail }
    }
}

fn stopped(call: &Call) -> DeviceError {
    DeviceError::Stopped { device: call.device.clone(), operation: call.operation }
}

/// Looks after an arm while it moves or brakes.
struct Drive(Shared);

impl Process for Drive {
    fn after_step(&mut self, world: &mut World) -> bool {
        let mut core = self.0.lock();
        let done = core.after_step(world);
        if done {
            core.driven = false;
        }
        done
    }

    fn takes_time(&self) -> bool {
        // One that is led along goes on while others look; one that nobody leads any more has to brake.
        !matches!(&self.0.lock().phase, Phase::Moving(motion) if motion.led && !motion.reply.is_closed())
    }
}
