//! What happens some hundred times a second while motors hold: read all, look, tell all.

use graspd_adapters_core::{DeviceError, FaultKind};
use graspd_adapters_dynamixel::table;
use tokio::time::Instant;

use super::Driver;
use crate::bus::{Answer, BusError, FEEDBACK};
use crate::motion::Reading;

/// Temperatures are read every so many exchanges.
const SUPPLY_EVERY: u32 = 50;

impl Driver {
    pub(super) async fn tick(&mut self) {
        let seen = match self.look().await {
            Ok(()) => self.watch().await,
            Err(error) => Err(error),
        };
        if let Err(error) = seen {
            for reply in self.waiting.drain(..) {
                let _unheard = reply.send(Err(error.clone()));
            }
            return self.finish(Err(error));
        }
        if let Err(error) = self.move_on().await {
            self.finish(Err(error));
        }
        let report = self.report();
        for reply in self.waiting.drain(..) {
            let _unheard = reply.send(Ok(report.clone()));
        }
    }

    /// Reads all motors. A hardware error stops the fingers, and is remembered.
    pub(super) async fn look(&mut self) -> Result<(), DeviceError> {
        let (ids, fast) = (self.ids.clone(), self.settings.fast_sync_read);
        let asked = Instant::now();
        let read = self.bus().await?.sync_read(FEEDBACK, &ids, fast).await;
        let answers = match read {
            Ok(answers) => answers,
            Err(error) => return Err(self.lose(error).await),
        };
        self.heard(asked);
        let readings: Result<Vec<Reading>, BusError> =
            self.settings.joints.iter().zip(&answers).map(|(joint, answer)| reading(joint, answer)).collect();
        match readings {
            Ok(readings) => self.readings = readings,
            Err(error) => return Err(self.lose(error).await),
        }
        let now = self.now();
        self.resting = self.rest.look(&self.readings, now);
        let alerting: Vec<u8> = answers.iter().filter(|a| a.alert).map(|a| a.id).collect();
        if alerting.is_empty() {
            return Ok(());
        }
        self.remember(&alerting).await?;
        Ok(())
    }

    /// Notes that the motors have heard what was sent at `asked`. When exactly they did is not known: between this time and
    /// the last one they may have heard nothing from the one request's sending to this one's answer, though nobody here
    /// was silent so long.
    pub(super) fn heard(&mut self, asked: Instant) {
        let longest = self.fed.elapsed();
        self.suspect |= longest.as_millis() >= u128::from(self.settings.watchdog_ms) * 3 / 4;
        self.fed = asked;
    }

    /// A motor whose watchdog has fired takes no goal any more, and nobody says so: it would stand and lack its goal as if
    /// it held something. Where one may have, all are asked. A motion ends there; fingers that were told to press press on.
    async fn watch(&mut self) -> Result<(), DeviceError> {
        let goals = self.goals.clone();
        let Some(detail) = self.revive().await? else { return Ok(()) };
        if self.running.is_some() {
            return Err(self.stopped(FaultKind::NotActivated, detail));
        }
        match goals {
            Some(goals) => self.tell(&goals).await,
            None => Ok(()),
        }
    }

    /// Starts motors again, where they are, that their watchdog has stopped; what to say of it, `None` when there were
    /// none.
    pub(super) async fn revive(&mut self) -> Result<Option<String>, DeviceError> {
        if !self.suspect {
            return Ok(None);
        }
        let answers = self.read_all(table::BUS_WATCHDOG).await?;
        self.suspect = false;
        let fired: Vec<String> =
            answers.iter().filter(|a| a.data == [255]).map(|a| self.motor(a.id)).collect();
        if fired.is_empty() {
            return Ok(None);
        }
        self.look().await?;
        self.feed_watchdog().await?;
        let (count, all, limit) = (fired.len(), self.ids.len(), self.settings.watchdog_ms);
        let detail = format!(
            "the motors' watchdog stopped them: {count} of {all} heard nothing for watchdog_ms = {limit}"
        );
        tracing::warn!(device = self.settings.name, motors = fired.join(", "), "{detail}");
        Ok(Some(detail))
    }

    /// Brings a motion one step further.
    async fn move_on(&mut self) -> Result<(), DeviceError> {
        if self.until_supply == 0 {
            self.until_supply = SUPPLY_EVERY;
            self.feel_temperature().await?;
            // Whatever the clocks say: a motor that stands unnoticed must not stand for long.
            self.suspect = true;
        }
        self.until_supply -= 1;
        if let Some((kind, detail)) = &self.fault {
            let error = self.stopped(*kind, detail.clone());
            if self.running.is_some() {
                self.hold().await?;
            }
            return Err(error);
        }
        let now = self.now();
        let Some(running) = &mut self.running else { return Ok(()) };
        if running.reply.is_closed() {
            self.running = None;
            return self.hold().await;
        }
        if Instant::now() >= running.patience.until {
            let (operation, after) = (running.operation, running.patience.timeout);
            self.hold().await?;
            return Err(DeviceError::Timeout { device: self.device(), operation, after });
        }
        let done = running.motion.step(&self.readings, now);
        let goals = running.motion.goals().to_vec();
        self.tell(&goals).await?;
        if done {
            let running = self.running.take();
            self.resting = true;
            let report = self.report();
            if let Some(running) = running {
                let _unheard = running.reply.send(Ok(report));
            }
        }
        Ok(())
    }

    /// Tells all motors where to go.
    pub(super) async fn tell(&mut self, goals: &[f64]) -> Result<(), DeviceError> {
        let targets: Vec<(u8, i32)> = self
            .settings
            .joints
            .iter()
            .zip(goals)
            .map(|(j, goal)| (j.id, j.pulses(goal.clamp(j.lower_rad, j.upper_rad))))
            .collect();
        let told = self.bus().await?.sync_write(table::GOAL_POSITION, targets.into_iter()).await;
        if let Err(error) = told {
            let error = self.disconnected(error.to_string());
            self.abandon(&error);
            return Err(error);
        }
        self.goals = Some(goals.to_vec());
        Ok(())
    }

    /// Holds the fingers where they were last seen.
    pub(super) async fn hold(&mut self) -> Result<(), DeviceError> {
        let here: Vec<f64> = self.readings.iter().map(|r| r.position_rad).collect();
        if self.bus.is_none() || here.is_empty() {
            return Ok(());
        }
        self.tell(&here).await
    }
}

/// A motor's ten bytes as numbers of its joint.
fn reading(joint: &crate::joints::Joint, answer: &Answer) -> Result<Reading, BusError> {
    let [c0, c1, v0, v1, v2, v3, p0, p1, p2, p3] = answer.data[..] else {
        let (id, register) = (answer.id, FEEDBACK.name);
        return Err(BusError::Length { id, register, found: answer.data.len(), expected: 10 });
    };
    let velocity = f64::from(i32::from_le_bytes([v0, v1, v2, v3])) * table::RAD_S_PER_COUNT;
    Ok(Reading {
        position_rad: joint.angle_rad(f64::from(i32::from_le_bytes([p0, p1, p2, p3]))),
        velocity_rad_s: joint.sign() * velocity,
        current_ma: joint.sign() * f64::from(i16::from_le_bytes([c0, c1])),
    })
}
