//! The emulated controller's state: modes, registers, safety, motion. Every port reads and writes it.

use std::collections::{HashSet, VecDeque};

use nalgebra::Isometry3;
use tokio::sync::broadcast;

use super::geometry::{Six, UrModel, from_six};
use super::motion::{Mover, Stepped};
use super::plant::{Plant, PlantState, PlantTarget};
use super::settings::UrSettings;

/// Modes of the robot as the controller numbers them.
pub(crate) mod mode {
    pub(crate) const POWER_OFF: i32 = 3;
    pub(crate) const POWER_ON: i32 = 4;
    pub(crate) const IDLE: i32 = 5;
    pub(crate) const RUNNING: i32 = 7;
}

/// States of the safety system.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Safety {
    /// Nothing is wrong.
    Normal,
    /// Stopped itself; can be unlocked a while later.
    ProtectiveStop,
    /// A safeguard input is open.
    SafeguardStop,
    /// The emergency button is pressed.
    EmergencyStop,
    /// A safety limit was violated; the safety system must be started again.
    Violation,
}

impl Safety {
    pub(crate) fn number(self) -> i32 {
        match self {
            Self::Normal => 1,
            Self::ProtectiveStop => 3,
            Self::SafeguardStop => 5,
            Self::EmergencyStop => 7,
            Self::Violation => 8,
        }
    }

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Normal => "NORMAL",
            Self::ProtectiveStop => "PROTECTIVE_STOP",
            Self::SafeguardStop => "SAFEGUARD_STOP",
            Self::EmergencyStop => "ROBOT_EMERGENCY_STOP",
            Self::Violation => "VIOLATION",
        }
    }

    pub(crate) fn bits(self) -> u32 {
        match self {
            Self::Normal => 1,
            Self::ProtectiveStop => (1 << 2) | (1 << 10),
            Self::SafeguardStop => (1 << 4) | (1 << 10),
            Self::EmergencyStop => (1 << 6) | (1 << 7) | (1 << 10),
            Self::Violation => (1 << 8) | (1 << 10),
        }
    }
}

/// What the primary interface tells.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Message {
    Text(String),
    Key { title: String, text: String },
    Error { code: i32, argument: i32, text: String },
    Exception { line: i32, text: String },
}

/// General purpose registers of one direction.
#[derive(Debug, Clone)]
pub(crate) struct Registers {
    pub(crate) bits: [bool; 128],
    pub(crate) ints: [i32; 48],
    pub(crate) doubles: [f64; 48],
}

impl Default for Registers {
    fn default() -> Self {
        Self { bits: [false; 128], ints: [0; 48], doubles: [0.0; 48] }
    }
}

/// A register that a script wants to see written often enough.
#[derive(Debug, Clone)]
pub(crate) struct Watchdog {
    pub(crate) field: String,
    pub(crate) period_s: f64,
    pub(crate) fed_s: f64,
}

pub(crate) struct Robot {
    pub(crate) model: UrModel,
    pub(crate) step_s: f64,
    pub(crate) time_s: f64,
    pub(crate) steps: u64,
    pub(crate) mode: i32,
    /// The next mode, and when.
    coming: VecDeque<(f64, i32)>,
    mode_change_s: f64,
    safety: Safety,
    safety_since_s: f64,
    unlock_wait_s: f64,
    pub(crate) remote: bool,
    /// 1 stopped, 2 playing, 4 paused.
    pub(crate) runtime: u32,
    pub(crate) loaded: Option<String>,
    pub(crate) inputs: Registers,
    pub(crate) outputs: Registers,
    pub(crate) slider: f64,
    /// Standard (0-7), configurable (8-15), tool (16-17).
    pub(crate) digital_out: u64,
    pub(crate) digital_in: u64,
    pub(crate) analog_out: [f64; 2],
    pub(crate) tool_voltage: i32,
    pub(crate) payload_kg: f64,
    pub(crate) payload_cog: [f64; 3],
    pub(crate) mover: Mover,
    pub(crate) plant: Box<dyn Plant>,
    pub(crate) state: PlantState,
    pub(crate) force_zero: Six,
    pub(crate) stop_force_n: f64,
    pub(crate) watchdog: Option<Watchdog>,
    pub(crate) history: VecDeque<Six>,
    /// Input fields that something else owns.
    pub(crate) occupied: HashSet<String>,
    pub(crate) messages: broadcast::Sender<Message>,
    /// True when the program that runs must end now.
    pub(crate) stop_program: bool,
}

impl Robot {
    pub(crate) fn new(settings: &UrSettings, q: Six, plant: Box<dyn Plant>) -> Self {
        let messages = broadcast::Sender::new(256);
        let state = PlantState { q, qd: [0.0; 6], wrench: [0.0; 6], protective_stop: None };
        Self {
            model: settings.model,
            step_s: settings.model.step_s(),
            time_s: 1.0,
            steps: 0,
            mode: if settings.powered { mode::RUNNING } else { mode::POWER_OFF },
            coming: VecDeque::new(),
            mode_change_s: settings.mode_change_s,
            safety: Safety::Normal,
            safety_since_s: 0.0,
            unlock_wait_s: settings.unlock_wait_s,
            remote: settings.remote_control,
            runtime: 1,
            loaded: None,
            inputs: Registers::default(),
            outputs: Registers::default(),
            slider: 1.0,
            digital_out: 0,
            digital_in: 0,
            analog_out: [0.0; 2],
            tool_voltage: 0,
            payload_kg: 0.0,
            payload_cog: [0.0; 3],
            mover: Mover::new(settings.model, q),
            plant,
            state,
            force_zero: [0.0; 6],
            stop_force_n: settings.stop_force_n,
            watchdog: None,
            history: VecDeque::new(),
            occupied: HashSet::new(),
            messages,
            stop_program: false,
        }
    }

    pub(crate) fn safety(&self) -> Safety {
        self.safety
    }

    pub(crate) fn tell(&self, message: Message) {
        // Nobody listens: nobody hears.
        let _unheard = self.messages.send(message);
    }

    pub(crate) fn set_safety(&mut self, safety: Safety, why: &str) {
        if self.safety == safety {
            return;
        }
        tracing::debug!(from = self.safety.name(), to = safety.name(), why, "emulated safety");
        self.safety = safety;
        self.safety_since_s = self.time_s;
        if safety != Safety::Normal {
            self.stop_program = true;
            self.mover.brake();
            self.tell(Message::Error { code: 153, argument: 0, text: why.to_owned() });
        }
        if matches!(safety, Safety::EmergencyStop | Safety::Violation) {
            self.mode = mode::POWER_OFF;
            self.coming.clear();
        }
    }

    pub(crate) fn power_on(&mut self) -> bool {
        if self.safety != Safety::Normal {
            return false;
        }
        if self.mode == mode::POWER_OFF {
            self.mode = mode::POWER_ON;
            self.coming.push_back((self.time_s + self.mode_change_s, mode::IDLE));
        }
        true
    }

    pub(crate) fn brake_release(&mut self) -> bool {
        if !self.power_on() {
            return false;
        }
        if self.mode != mode::RUNNING {
            let from = self.coming.back().map_or(self.time_s, |(at, _)| *at);
            self.coming.push_back((from + self.mode_change_s, mode::RUNNING));
        }
        true
    }

    pub(crate) fn power_off(&mut self) {
        self.mode = mode::POWER_OFF;
        self.coming.clear();
        self.stop_program = true;
    }

    /// True when the protective stop is released.
    pub(crate) fn unlock(&mut self) -> bool {
        let waited = self.time_s - self.safety_since_s >= self.unlock_wait_s;
        match self.safety {
            Safety::ProtectiveStop if !waited => false,
            Safety::ProtectiveStop => {
                self.set_safety(Safety::Normal, "unlocked");
                true
            }
            _ => true,
        }
    }

    pub(crate) fn can_move(&self) -> bool {
        self.mode == mode::RUNNING && self.safety == Safety::Normal
    }

    /// Compensated force at the tool.
    pub(crate) fn wrench(&self) -> Six {
        std::array::from_fn(|i| self.state.wrench[i] - self.force_zero[i])
    }

    pub(crate) fn actual_flange(&self) -> Isometry3<f64> {
        self.model.flange(&self.state.q)
    }

    pub(crate) fn actual_tcp(&self) -> Isometry3<f64> {
        self.actual_flange() * self.mover.tcp()
    }

    pub(crate) fn set_tcp(&mut self, tcp: &Six) {
        self.mover.set_tcp(from_six(tcp));
    }

    pub(crate) fn is_steady(&self) -> bool {
        self.mover.is_standing() && self.state.qd.iter().all(|v| v.abs() < 1e-4)
    }

    /// A register was written by a client.
    pub(crate) fn fed(&mut self, field: &str) {
        let now = self.time_s;
        if let Some(watchdog) = self.watchdog.as_mut().filter(|w| w.field == field) {
            watchdog.fed_s = now;
        }
    }

    /// Time goes on: modes change, watchdogs bite, joints move.
    pub(crate) fn step(&mut self) {
        let dt = self.step_s;
        self.time_s += dt;
        self.steps += 1;
        while let Some((at, next)) = self.coming.front().copied() {
            if at > self.time_s {
                break;
            }
            self.coming.pop_front();
            self.mode = next;
        }
        if let Some(watchdog) = &self.watchdog
            && self.time_s - watchdog.fed_s > watchdog.period_s
        {
            let text = format!("watchdog: {} was not written in time", watchdog.field);
            self.tell(Message::Text(text));
            self.watchdog = None;
            self.stop_program = true;
            self.mover.brake();
        }
        if let Stepped::Lost(why) = self.mover.step(dt, self.slider.clamp(0.0, 1.0)) {
            self.set_safety(Safety::ProtectiveStop, why);
        }
        let base_from_flange = self.model.flange(&self.mover.q);
        let target = PlantTarget {
            dt_s: dt,
            q: self.mover.q,
            qd: self.mover.qd,
            base_from_flange,
            base_from_tcp: base_from_flange * self.mover.tcp(),
        };
        self.state = self.plant.step(&target);
        self.history.push_front(self.state.q);
        self.history.truncate(500);
        if let Some(why) = self.state.protective_stop.take() {
            self.set_safety(Safety::ProtectiveStop, &why);
        }
        if self.safety != Safety::Normal {
            // What stopped itself does not go on pressing to where it was going: it holds where it is.
            self.mover.settle(self.state.q);
        }
        let wrench = self.wrench();
        let force = (wrench[0].powi(2) + wrench[1].powi(2) + wrench[2].powi(2)).sqrt();
        if self.safety == Safety::Normal && force > self.stop_force_n {
            let why = format!("{force:.0} N at the tool");
            self.set_safety(Safety::ProtectiveStop, &why);
        }
    }
}
