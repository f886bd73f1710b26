//! From an unknown line to motors that hold: who is there, what they are set to, torque.

use graspd_adapters_core::{DeviceError, FaultKind};
use graspd_adapters_dynamixel::table::{self, Register};
use tokio::time::Instant;

use super::Driver;
use crate::bus::{Answer, Bus, BusError};

impl Driver {
    /// Opens the line and sees that every motor is there and of the right model. Nothing is written.
    pub(super) async fn connect(&mut self) -> Result<(), DeviceError> {
        let s = &self.settings;
        let opened = Bus::open(&s.port, s.baud, s.reply_timeout(), s.attempts).await;
        let mut bus = match opened {
            Ok(bus) => bus,
            Err(error) => return Err(self.disconnected(error.to_string())),
        };
        let model = s.model();
        let (mut silent, mut others, mut last) = (Vec::new(), Vec::new(), None);
        for id in self.ids.clone() {
            // The first time around a motor that is silent is asked once: a whole silent bus must not take long.
            let attempts = self.settings.attempts;
            let tried =
                if bus.answers(id).await.is_ok_and(|there| there) || (silent.is_empty() && attempts > 1) {
                    bus.ping(id).await
                } else {
                    Err(BusError::NoReply {
                        ids: vec![id],
                        after: self.settings.reply_timeout(),
                        broken: crate::bus::Broken::default(),
                    })
                };
            match tried {
                Ok((found, _)) if found == model => {}
                Ok((found, _)) => others.push(format!("{}: model {found}", self.motor(id))),
                Err(BusError::NoReply { broken, .. }) => {
                    silent.push(self.motor(id));
                    last = Some(broken);
                }
                Err(error) => return Err(self.disconnected(error.to_string())),
            }
        }
        if !silent.is_empty() {
            return Err(self.disconnected(self.silence(&silent, &last.unwrap_or_default())));
        }
        if !others.is_empty() {
            let variant = self.settings.variant;
            let detail = format!("{}; expected model {model} (variant {variant:?})", others.join(", "));
            return Err(DeviceError::Protocol { device: self.device(), detail });
        }
        self.bus = Some(bus);
        self.fed = Instant::now();
        Ok(())
    }

    /// Reads a register of all motors.
    pub(super) async fn read_all(&mut self, register: Register) -> Result<Vec<Answer>, DeviceError> {
        let ids = self.ids.clone();
        let asked = Instant::now();
        let read = self.bus().await?.sync_read(register, &ids, false).await;
        match read {
            Ok(answers) => {
                self.heard(asked);
                Ok(answers)
            }
            Err(error) => Err(self.lose(error).await),
        }
    }

    /// Writes a register of one motor, which confirms it.
    pub(super) async fn write(&mut self, id: u8, register: Register, value: i32) -> Result<(), DeviceError> {
        let asked = Instant::now();
        let written = self.bus().await?.write(id, register, value).await;
        match written {
            Ok(()) => {
                self.heard(asked);
                Ok(())
            }
            Err(error) => Err(self.lose(error).await),
        }
    }

    /// Brings motors from whatever they were left in to holding where they are, in current-based position control. The
    /// order matters: a mode is locked while torque is on, and a goal from earlier must not make a finger jump.
    pub(super) async fn energize(&mut self) -> Result<(), DeviceError> {
        self.look().await?;
        let reversed = self.read_all(table::DRIVE_MODE).await?;
        if let Some(answer) = reversed.iter().find(|a| a.data.first().is_some_and(|mode| mode & 1 != 0)) {
            let detail = format!(
                "{}: Drive Mode: found {}, expected an even one; say `reversed` of its joint instead",
                self.motor(answer.id),
                answer.data[0]
            );
            return Err(DeviceError::Protocol { device: self.device(), detail });
        }
        let modes = self.read_all(table::OPERATING_MODE).await?;
        let delays = self.read_all(table::RETURN_DELAY).await?;
        let torques = self.read_all(table::TORQUE_ENABLE).await?;
        let watchdogs = self.read_all(table::BUS_WATCHDOG).await?;
        let current_limits = self.read_all(table::CURRENT_LIMIT).await?;
        for (i, id) in self.ids.clone().into_iter().enumerate() {
            let is = |answers: &[Answer], value: u8| answers.get(i).is_some_and(|a| a.data == [value]);
            if !is(&watchdogs, 0) {
                self.write(id, table::BUS_WATCHDOG, 0).await?;
            }
            let mode_right = is(&modes, table::MODE_CURRENT_POSITION);
            // A motor that holds something already, in the right mode, goes on holding it.
            if is(&torques, 1) && !(mode_right && is(&delays, 0)) {
                self.write(id, table::TORQUE_ENABLE, 0).await?;
            }
            if !mode_right {
                self.write(id, table::OPERATING_MODE, i32::from(table::MODE_CURRENT_POSITION)).await?;
            }
            if !is(&delays, 0) {
                self.write(id, table::RETURN_DELAY, 0).await?;
            }
            let allowed = current_limits.get(i).map_or(0, |a| word(&a.data));
            if f64::from(allowed) < self.settings.current_ma() {
                let (found, expected) = (self.settings.current_ma(), allowed);
                let detail = format!(
                    "{}: Current Limit: {expected} mA is less than max_current_ma {found}",
                    self.motor(id)
                );
                return Err(DeviceError::Protocol { device: self.device(), detail });
            }
        }
        self.limit_current(self.settings.current_ma()).await?;
        self.limit_speed().await?;
        self.hold().await?;
        for (i, id) in self.ids.clone().into_iter().enumerate() {
            let holds = torques.get(i).is_some_and(|a| a.data == [1])
                && modes.get(i).is_some_and(|a| a.data == [table::MODE_CURRENT_POSITION])
                && delays.get(i).is_some_and(|a| a.data == [0]);
            if !holds {
                self.write(id, table::TORQUE_ENABLE, 1).await?;
            }
        }
        self.set_gains().await?;
        self.hold().await?;
        let torques = self.read_all(table::TORQUE_ENABLE).await?;
        if let Some(answer) = torques.iter().find(|a| a.data != [1]) {
            let detail =
                format!("{}: Torque Enable: found {:?}, expected [1]", self.motor(answer.id), answer.data);
            return Err(self.stopped(FaultKind::NotActivated, detail));
        }
        self.feed_watchdog().await?;
        self.energized = true;
        Ok(())
    }

    /// Starts the motors' watchdog, which stops them when we are silent.
    pub(super) async fn feed_watchdog(&mut self) -> Result<(), DeviceError> {
        let counts = i32::from(self.settings.watchdog_counts());
        for id in self.ids.clone() {
            self.write(id, table::BUS_WATCHDOG, 0).await?;
        }
        self.hold().await?;
        for id in self.ids.clone() {
            self.write(id, table::BUS_WATCHDOG, counts).await?;
        }
        Ok(())
    }

    /// Sets the current that each motor may use, and sees that it did.
    pub(super) async fn limit_current(&mut self, current_ma: f64) -> Result<(), DeviceError> {
        // At most 1750, as settings are checked.
        let value = current_ma.round() as i32;
        let targets: Vec<(u8, i32)> = self.ids.iter().map(|id| (*id, value)).collect();
        self.write_all(table::GOAL_CURRENT, targets).await?;
        let answers = self.read_all(table::GOAL_CURRENT).await?;
        match answers.iter().find(|a| i32::from(word(&a.data)) != value) {
            None => Ok(()),
            Some(answer) => {
                let detail = format!(
                    "{}: Goal Current: found {}, expected {value}",
                    self.motor(answer.id),
                    word(&answer.data)
                );
                Err(DeviceError::Protocol { device: self.device(), detail })
            }
        }
    }

    /// The motors' own bound on speed, a little above ours: it holds even when goals come late and far.
    async fn limit_speed(&mut self) -> Result<(), DeviceError> {
        let counts = (1.2 * self.settings.max_speed_rad_s / table::RAD_S_PER_COUNT).ceil() as i32;
        let targets = self.ids.iter().map(|id| (*id, counts)).collect();
        self.write_all(table::PROFILE_VELOCITY, targets).await
    }

    async fn set_gains(&mut self) -> Result<(), DeviceError> {
        let [p, i, d] = self.settings.gains;
        for (register, gain, shared) in
            [(table::POSITION_P, p, true), (table::POSITION_I, i, false), (table::POSITION_D, d, true)]
        {
            let value = |share: f64| {
                let share = if shared { share } else { 1.0 };
                (f64::from(gain) * share).round().clamp(0.0, 16_383.0) as i32
            };
            let targets = self.settings.joints.iter().map(|j| (j.id, value(j.gain))).collect();
            self.write_all(register, targets).await?;
        }
        Ok(())
    }

    async fn write_all(&mut self, register: Register, targets: Vec<(u8, i32)>) -> Result<(), DeviceError> {
        let written = self.bus().await?.sync_write(register, targets.into_iter()).await;
        match written {
            Ok(()) => Ok(()),
            Err(error) => Err(self.lose(error).await),
        }
    }

    /// Takes all torque away.
    pub(super) async fn relax(&mut self) -> Result<(), DeviceError> {
        if self.bus.is_none() {
            return Ok(());
        }
        self.energized = false;
        self.goals = None;
        for id in self.ids.clone() {
            self.write(id, table::BUS_WATCHDOG, 0).await?;
            self.write(id, table::TORQUE_ENABLE, 0).await?;
        }
        Ok(())
    }
}

/// The first two bytes as a number.
fn word(data: &[u8]) -> u16 {
    match data {
        [low, high, ..] => u16::from_le_bytes([*low, *high]),
        _ => 0,
    }
}
