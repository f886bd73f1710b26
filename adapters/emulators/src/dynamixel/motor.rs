//! One motor: its control table and what it obeys.

use std::f64::consts::TAU;
use std::time::{Duration, Instant};

use graspd_adapters_dynamixel::table::{self, PULSES_PER_TURN, RAD_S_PER_COUNT, Register, TABLE_LEN};
use graspd_adapters_dynamixel::{Refusal, StatusError};

use super::plant::{MotorCommand, MotorState};
use super::registers;

/// Register value of a bus watchdog that has fired.
const FIRED: u8 = 255;
/// One count of the bus watchdog.
const WATCHDOG_COUNT: Duration = Duration::from_millis(20);

/// A motor on the bus.
#[derive(Debug)]
pub(super) struct Motor {
    pub(super) id: u8,
    model: u16,
    return_delay: u8,
    table: [u8; TABLE_LEN],
    staged: Option<(u16, Vec<u8>)>,
    pub(super) state: MotorState,
    pub(super) unplugged: bool,
    /// Until then it boots and hears nothing.
    away_until: Option<Instant>,
}

impl Motor {
    pub(super) fn new(id: u8, model: u16, return_delay: u8) -> Self {
        let mut motor = Self {
            id,
            model,
            return_delay,
            table: [0; TABLE_LEN],
            staged: None,
            state: MotorState::default(),
            unplugged: false,
            away_until: None,
        };
        motor.initialize(0);
        motor
    }

    /// Sets initial values from an address on.
    fn initialize(&mut self, from: u16) {
        self.table[usize::from(from)..].fill(0);
        for (register, value) in registers::initial(self.id, self.model, self.return_delay) {
            if register.addr >= from {
                self.set(register, value);
            }
        }
        for i in 0..20u16 {
            let shown = (table::INDIRECT_DATA + i).to_le_bytes();
            let at = usize::from(table::INDIRECT_ADDRESS + 2 * i);
            self.table[at..at + 2].copy_from_slice(&shown);
        }
    }

    fn set(&mut self, register: Register, value: i64) {
        let at = usize::from(register.addr);
        let len = usize::from(register.len);
        self.table[at..at + len].copy_from_slice(&value.to_le_bytes()[..len]);
    }

    /// Value of a register, signed where it is as long as its sign needs.
    pub(super) fn get(&self, register: Register) -> i64 {
        let at = usize::from(register.addr);
        match (register.len, &self.table[at..]) {
            (1, [a, ..]) => i64::from(*a),
            (2, [a, b, ..]) => i64::from(i16::from_le_bytes([*a, *b])),
            (_, [a, b, c, d, ..]) => i64::from(i32::from_le_bytes([*a, *b, *c, *d])),
            _ => 0,
        }
    }

    pub(super) fn hears(&mut self, now: Instant) -> bool {
        if self.away_until.is_some_and(|until| now >= until) {
            self.away_until = None;
        }
        !self.unplugged && self.away_until.is_none()
    }

    pub(super) fn torque(&self) -> bool {
        self.get(table::TORQUE_ENABLE) == 1
    }

    pub(super) fn delay(&self) -> Duration {
        Duration::from_micros(2 * u64::from(self.table[usize::from(table::RETURN_DELAY.addr)]))
    }

    pub(super) fn error(&self, refusal: Option<Refusal>) -> StatusError {
        StatusError { alert: self.get(table::HARDWARE_ERROR) != 0, refusal }
    }

    pub(super) fn command(&self) -> MotorCommand {
        let profile = self.get(table::PROFILE_VELOCITY);
        let profile_rad_s = if profile == 0 { f64::INFINITY } else { profile as f64 * RAD_S_PER_COUNT };
        let current_based = self.get(table::OPERATING_MODE) == i64::from(table::MODE_CURRENT_POSITION);
        let current = if current_based { table::GOAL_CURRENT } else { table::CURRENT_LIMIT };
        MotorCommand {
            id: self.id,
            torque: self.torque() && !self.unplugged && self.away_until.is_none(),
            goal_rad: self.get(table::GOAL_POSITION) as f64 * TAU / PULSES_PER_TURN,
            current_limit_ma: self.get(current) as f64,
            speed_limit_rad_s: profile_rad_s,
        }
    }

    /// Brings the plant's numbers into the registers.
    pub(super) fn measure(&mut self) {
        let state = self.state;
        self.set(table::PRESENT_POSITION, (state.position_rad * PULSES_PER_TURN / TAU).round() as i64);
        self.set(table::PRESENT_VELOCITY, (state.velocity_rad_s / RAD_S_PER_COUNT).round() as i64);
        self.set(table::PRESENT_CURRENT, state.current_ma.round() as i64);
        self.set(table::MOVING, i64::from(state.velocity_rad_s.abs() > RAD_S_PER_COUNT));
        self.set(table::PRESENT_VOLTAGE, (state.voltage_v * 10.0).round() as i64);
        self.set(table::PRESENT_TEMPERATURE, state.temperature_c.round().clamp(0.0, 255.0) as i64);
        if state.overloaded {
            self.raise(1 << 5);
        }
        if state.temperature_c > self.get(table::TEMPERATURE_LIMIT) as f64 {
            self.raise(1 << 2);
        }
    }

    pub(super) fn raise(&mut self, errors: u8) {
        let raised = self.get(table::HARDWARE_ERROR) | i64::from(errors);
        self.set(table::HARDWARE_ERROR, raised);
        if raised & self.get(table::SHUTDOWN) != 0 {
            self.set(table::TORQUE_ENABLE, 0);
        }
    }

    /// Silence after which its bus watchdog stops it; `None` while that is off, or has fired.
    pub(super) fn watchdog(&self) -> Option<Duration> {
        let count = self.table[usize::from(table::BUS_WATCHDOG.addr)];
        let waits = count != 0 && count != FIRED && self.torque();
        waits.then(|| WATCHDOG_COUNT * u32::from(count))
    }

    /// Its bus watchdog fires.
    pub(super) fn stop_alone(&mut self) {
        self.table[usize::from(table::BUS_WATCHDOG.addr)] = FIRED;
        self.hold();
    }

    fn hold(&mut self) {
        let here = (self.state.position_rad * PULSES_PER_TURN / TAU).round() as i64;
        self.set(table::GOAL_POSITION, here);
    }

    pub(super) fn reboot(&mut self, now: Instant, away: Duration) {
        self.initialize(table::RAM_START);
        self.staged = None;
        self.state.overloaded = false;
        self.away_until = Some(now + away);
    }

    /// All but address and baud rate.
    pub(super) fn reset(&mut self) {
        self.initialize(0);
    }

    /// Where byte `addr` really is: indirect data shows other registers.
    fn shown(&self, addr: u16) -> usize {
        let i = addr.wrapping_sub(table::INDIRECT_DATA);
        if i >= 20 {
            return usize::from(addr);
        }
        let at = usize::from(table::INDIRECT_ADDRESS + 2 * i);
        let shown = usize::from(u16::from_le_bytes([self.table[at], self.table[at + 1]]));
        if shown < TABLE_LEN { shown } else { usize::from(addr) }
    }

    pub(super) fn read(&self, addr: u16, len: u16) -> Result<Vec<u8>, Refusal> {
        let end = usize::from(addr) + usize::from(len);
        if len == 0 || end > TABLE_LEN {
            return Err(Refusal::DataRange);
        }
        Ok((addr..addr + len).map(|a| self.table[self.shown(a)]).collect())
    }

    pub(super) fn stage(&mut self, addr: u16, data: Vec<u8>) -> Result<(), Refusal> {
        self.allows(addr, &data)?;
        self.staged = Some((addr, data));
        self.set(table::REGISTERED, 1);
        Ok(())
    }

    pub(super) fn act(&mut self) -> Result<(), Refusal> {
        self.set(table::REGISTERED, 0);
        self.staged.take().map_or(Ok(()), |(addr, data)| self.write(addr, &data))
    }

    pub(super) fn write(&mut self, addr: u16, data: &[u8]) -> Result<(), Refusal> {
        self.allows(addr, data)?;
        let had_torque = self.torque();
        for (a, byte) in (addr..).zip(data) {
            let at = self.shown(a);
            self.table[at] = *byte;
        }
        if self.torque() && !had_torque {
            self.hold();
        }
        Ok(())
    }

    /// Whether a write may be done.
    fn allows(&self, addr: u16, data: &[u8]) -> Result<(), Refusal> {
        let end = usize::from(addr) + data.len();
        if data.is_empty() || end > TABLE_LEN {
            return Err(Refusal::DataRange);
        }
        if registers::read_only(addr, data.len()) || (addr < table::RAM_START && self.torque()) {
            return Err(Refusal::Access);
        }
        let fired = self.table[usize::from(table::BUS_WATCHDOG.addr)] == FIRED;
        if fired && registers::goal(addr, data.len()) {
            return Err(Refusal::DataRange);
        }
        let mut then = self.table;
        then[usize::from(addr)..end].copy_from_slice(data);
        let then = Self { table: then, staged: None, ..*self };
        for register in table::ALL {
            let (first, after) = (usize::from(register.addr), usize::from(register.addr + register.len));
            if first >= end || after <= usize::from(addr) {
                continue;
            }
            if first < usize::from(addr) || after > end {
                return Err(Refusal::DataLength);
            }
            let value = then.get(*register);
            if registers::range(*register).is_some_and(|(low, high)| value < low || value > high) {
                return Err(Refusal::DataRange);
            }
            let current_limit = self.get(table::CURRENT_LIMIT);
            if *register == table::GOAL_CURRENT && value.abs() > current_limit {
                return Err(Refusal::DataLimit);
            }
            let mode = self.get(table::OPERATING_MODE);
            let outside = value < self.get(table::MIN_POSITION) || value > self.get(table::MAX_POSITION);
            if *register == table::GOAL_POSITION && mode == 3 && outside {
                return Err(Refusal::DataLimit);
            }
        }
        // Torque stays off until a reboot.
        let shut = self.get(table::HARDWARE_ERROR) & self.get(table::SHUTDOWN) != 0;
        if shut && then.torque() { Err(Refusal::Result) } else { Ok(()) }
    }
}
