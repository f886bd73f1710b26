//! What a gripper does with what is written to it.

use std::time::{Duration, Instant};

use super::device::{GripperConfig, Model};
use super::encode;
use super::plant::{AxisCommand, AxisState, Plant};

/// Silence after which a gripper reports that nobody talks to it.
const SILENCE: Duration = Duration::from_secs(1);
/// Scissor position of each mode of a 3-Finger, counts: basic, pinch, wide, scissor.
const MODES: [f64; 4] = [137.0, 220.0, 15.0, 137.0];

/// Fault codes.
pub(super) mod fault {
    /// A go-to before the activation was done.
    pub(crate) const ACTIVATE_FIRST: u8 = 0x05;
    /// A go-to during a change of mode.
    pub(crate) const MODE_FIRST: u8 = 0x06;
    /// A go-to without the activation bit.
    pub(crate) const ACTIVATION_BIT: u8 = 0x07;
    /// Nobody has talked to it for a second.
    pub(crate) const SILENT: u8 = 0x09;
    /// An automatic release runs.
    pub(crate) const RELEASING: u8 = 0x0B;
    /// An automatic release is done.
    pub(crate) const RELEASED: u8 = 0x0F;
}

/// Where a gripper is on its way to being ready.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Phase {
    Reset,
    /// Opens, closes, opens: so many ends are still to be reached.
    Activating(u8),
    ChangingMode(Instant),
    Ready,
    Releasing,
    /// Stopped by a fault or after a release, until it is activated again.
    Stopped,
}

/// The gripper's mind.
pub(super) struct Machine {
    pub(super) config: GripperConfig,
    plant: Box<dyn Plant>,
    /// As written, and as taken.
    written: [u8; 16],
    taken: [u8; 16],
    takes_at: Option<Instant>,
    pub(super) phase: Phase,
    pub(super) fault: u8,
    pub(super) away: bool,
    pub(super) axes: Vec<AxisState>,
    advanced: Instant,
    heard: Instant,
}

impl std::fmt::Debug for Machine {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Machine")
            .field("phase", &self.phase)
            .field("axes", &self.axes)
            .finish_non_exhaustive()
    }
}

impl Machine {
    pub(super) fn new(config: GripperConfig, plant: Box<dyn Plant>, now: Instant) -> Self {
        let count = if config.model == Model::TwoFinger { 1 } else { 4 };
        let axes = vec![AxisState { position: 60.0, ..AxisState::default() }; count];
        Self {
            config,
            plant,
            written: [0; 16],
            taken: [0; 16],
            takes_at: None,
            phase: Phase::Reset,
            fault: 0,
            away: false,
            axes,
            advanced: now,
            heard: now,
        }
    }

    pub(super) fn set_fault(&mut self, code: u8) {
        self.fault = code;
        // To a 3-Finger 0x0A and 0x0B pass.
        let major = if self.config.model == Model::ThreeFinger { 0x0D } else { 0x0A };
        if code >= major {
            self.phase = Phase::Stopped;
        } else if code == 0 && self.phase == Phase::Stopped {
            self.phase = Phase::Reset;
        }
    }

    pub(super) fn power_cycle(&mut self) {
        (self.written, self.taken, self.takes_at) = ([0; 16], [0; 16], None);
        (self.phase, self.fault) = (Phase::Reset, 0);
    }

    pub(super) fn outputs(&self) -> [u8; 16] {
        self.written
    }

    /// Request bytes from `at` on are written; any part of them is fine.
    pub(super) fn write(&mut self, at: usize, bytes: &[u8], now: Instant) {
        self.advance(now);
        for (slot, byte) in self.written.iter_mut().skip(at).zip(bytes) {
            *slot = *byte;
        }
        self.takes_at.get_or_insert(now + self.config.takes);
        self.heard = now;
    }

    /// Status bytes now.
    pub(super) fn inputs(&mut self, now: Instant) -> [u8; 16] {
        self.advance(now);
        let status = encode::status(self);
        self.heard = now;
        if self.config.model == Model::TwoFinger && self.fault == fault::SILENT {
            // Somebody talks again.
            self.fault = 0;
        }
        status
    }

    pub(super) fn taken(&self) -> &[u8; 16] {
        &self.taken
    }

    pub(super) fn activation_bit(&self) -> bool {
        self.taken[0] & 1 != 0
    }

    pub(super) fn goes(&self) -> bool {
        self.taken[0] & 1 << 3 != 0
    }

    /// Mode of a 3-Finger, 0 to 3.
    pub(super) fn mode(&self) -> usize {
        usize::from(self.taken[0] >> 1 & 3)
    }

    fn individual_fingers(&self) -> bool {
        self.taken[1] & 1 << 2 != 0
    }

    fn individual_scissor(&self) -> bool {
        self.taken[1] & 1 << 3 != 0
    }

    fn advance(&mut self, now: Instant) {
        // What was taken in between moves the plant from then on.
        if let Some(at) = self.takes_at.filter(|at| now >= *at) {
            self.pass(at);
            self.takes_at = None;
            self.take(at);
            // What is told now shows in the status at once.
            let commands = self.commands();
            self.plant.advance(Duration::ZERO, &commands, &mut self.axes);
        }
        self.pass(now);
        // To a 3-Finger this code means something else.
        let tells = self.config.model == Model::TwoFinger;
        if tells && self.fault == 0 && now.saturating_duration_since(self.heard) > SILENCE {
            self.fault = fault::SILENT;
        }
    }

    fn pass(&mut self, now: Instant) {
        // In steps, so that phases end when they end, not when somebody looks.
        while now > self.advanced {
            let step = (now - self.advanced).min(Duration::from_millis(20));
            let commands = self.commands();
            self.plant.advance(step, &commands, &mut self.axes);
            self.advanced += step;
            self.turn();
        }
    }

    /// Ends phases.
    fn turn(&mut self) {
        let rest = self.axes.iter().all(|a| !a.moving);
        match self.phase {
            Phase::Activating(0) => self.phase = Phase::Ready,
            Phase::Activating(ends) if rest => self.phase = Phase::Activating(ends - 1),
            Phase::ChangingMode(until) if self.advanced >= until => self.phase = Phase::Ready,
            Phase::Releasing if rest => {
                self.phase = Phase::Stopped;
                self.fault = fault::RELEASED;
            }
            _ => {}
        }
        if self.phase == Phase::Ready && matches!(self.fault, fault::ACTIVATE_FIRST | fault::MODE_FIRST) {
            self.fault = 0;
        }
    }

    /// Takes what was written.
    fn take(&mut self, now: Instant) {
        let (was_active, old_mode) = (self.activation_bit(), self.mode());
        self.taken = self.written;
        if !self.activation_bit() {
            self.phase = Phase::Reset;
            self.fault = if self.goes() { fault::ACTIVATION_BIT } else { 0 };
            return;
        }
        if self.taken[0] & 1 << 4 != 0 {
            if !matches!(self.phase, Phase::Releasing | Phase::Stopped) {
                self.phase = Phase::Releasing;
                self.fault = fault::RELEASING;
            }
            return;
        }
        if !was_active {
            // A major fault ends with the next activation, and so does one that needs the activation bit.
            self.fault = 0;
            self.phase = Phase::Activating(3);
        } else if self.config.model == Model::ThreeFinger
            && self.phase == Phase::Ready
            && self.mode() != old_mode
        {
            self.phase = Phase::ChangingMode(now + self.config.mode_change);
        }
        match self.phase {
            Phase::Activating(_) if self.goes() => self.fault = fault::ACTIVATE_FIRST,
            Phase::ChangingMode(_) if self.goes() => self.fault = fault::MODE_FIRST,
            _ => {}
        }
    }

    /// What each motor is told.
    fn commands(&self) -> Vec<AxisCommand> {
        let all = |target| vec![AxisCommand { target, speed: 1.0, force: 0.2 }; self.axes.len()];
        match self.phase {
            Phase::Activating(ends) => all(Some(if ends == 2 { 255.0 } else { 0.0 })),
            Phase::Releasing => {
                let closes = self.config.model == Model::TwoFinger && self.taken[0] & 1 << 5 == 0;
                let slow =
                    AxisCommand { target: Some(if closes { 255.0 } else { 0.0 }), speed: 0.0, force: 0.2 };
                vec![slow; self.axes.len()]
            }
            Phase::ChangingMode(_) => {
                let mut commands = all(None);
                if let Some(scissor) = commands.last_mut() {
                    scissor.target = Some(MODES[self.mode()]);
                }
                commands
            }
            Phase::Ready if self.goes() => self.requested(),
            _ => all(None),
        }
    }

    fn requested(&self) -> Vec<AxisCommand> {
        let from = |at: usize| AxisCommand {
            target: Some(f64::from(self.taken[at])),
            speed: f64::from(self.taken[at + 1]) / 255.0,
            force: f64::from(self.taken[at + 2]) / 255.0,
        };
        if self.config.model == Model::TwoFinger {
            return vec![from(3)];
        }
        let still = AxisCommand { target: None, speed: 0.0, force: 0.0 };
        let scissor_mode = self.mode() == 3 && !self.individual_scissor() && !self.individual_fingers();
        let fingers = if scissor_mode {
            [still; 3]
        } else if self.individual_fingers() {
            [from(3), from(6), from(9)]
        } else {
            [from(3); 3]
        };
        let scissor = if self.individual_scissor() {
            from(12)
        } else if scissor_mode {
            from(3)
        } else {
            AxisCommand { target: Some(MODES[self.mode()]), speed: 1.0, force: 1.0 }
        };
        let [a, b, c] = fingers;
        vec![a, b, c, scissor]
    }
}
