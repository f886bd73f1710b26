//! Hardware errors and temperatures: seen, remembered, cleared, reported.

use std::time::Duration;

use graspd_adapters_core::check::Finding;
use graspd_adapters_core::{DeviceError, FaultKind};
use graspd_adapters_dynamixel::table::{self, hardware_errors};
use tokio::time::{Instant, sleep};

use super::Driver;
use crate::bus::SUPPLY;
use crate::report::JointReport;

/// Longest time that a motor boots.
const BOOT: Duration = Duration::from_secs(2);
/// Bits of the errors that a rest and a reboot may heal: overheating, electrical shock, overload.
const HEALABLE: u8 = 0b11_0100;
/// A latency timer of more than this, milliseconds, makes the bus slow.
const LATENCY_MS: u32 = 1;

impl Driver {
    /// Remembers the hardware errors of motors that raise an alert.
    pub(super) async fn remember(&mut self, alerting: &[u8]) -> Result<(), DeviceError> {
        let (mut texts, mut bits) = (Vec::new(), 0);
        for id in alerting {
            let read = self.bus().await?.read(*id, table::HARDWARE_ERROR).await;
            match read {
                Ok(answer) => {
                    let byte = answer.data.first().copied().unwrap_or(0);
                    bits |= byte;
                    texts.push(format!("{}: {}", self.motor(*id), hardware_errors(byte).join(", ")));
                }
                Err(error) => return Err(self.lose(error).await),
            }
        }
        // Cleared between the alert and the look at it.
        if bits == 0 {
            return Ok(());
        }
        let kind = if bits & HEALABLE != 0 { FaultKind::Overload } else { FaultKind::Other };
        let detail = format!("hardware error of {}", texts.join("; "));
        if self.fault.is_none() {
            tracing::warn!(device = self.settings.name, "{detail}");
        }
        self.fault = Some((kind, detail));
        Ok(())
    }

    /// Motors that report errors, or are too hot, do not begin a motion.
    pub(super) async fn refuse_unhealthy(&mut self) -> Result<(), DeviceError> {
        self.look().await?;
        self.feel_temperature().await?;
        match &self.fault {
            Some((kind, detail)) => Err(self.stopped(*kind, detail.clone())),
            None => Ok(()),
        }
    }

    /// Reads temperatures, and torque where motors hold; what is wrong is remembered as what stopped the hand.
    pub(super) async fn feel_temperature(&mut self) -> Result<(), DeviceError> {
        let limit = self.settings.max_temperature_c;
        let answers = self.read_all(SUPPLY).await?;
        let temperature = |data: &[u8]| data.get(2).map_or(0.0, |c| f64::from(*c));
        let hot: Vec<String> = answers
            .iter()
            .filter(|a| temperature(&a.data) > limit)
            .map(|a| format!("{}: {} C", self.motor(a.id), temperature(&a.data)))
            .collect();
        if !hot.is_empty() && self.fault.is_none() {
            let detail = format!("over-temperature of {}, limit {limit} C", hot.join("; "));
            tracing::warn!(device = self.settings.name, "{detail}");
            self.fault = Some((FaultKind::Overload, detail));
        }
        if self.energized { self.miss_torque().await } else { Ok(()) }
    }

    /// A motor that lost its power for a moment is back without torque, and says nothing of it.
    async fn miss_torque(&mut self) -> Result<(), DeviceError> {
        let answers = self.read_all(table::TORQUE_ENABLE).await?;
        let ids: Vec<u8> = answers.iter().filter(|a| a.data != [1]).map(|a| a.id).collect();
        // One that has switched itself off because of an error says so, if it is asked.
        self.remember(&ids).await?;
        let limp: Vec<String> = ids.iter().map(|id| self.motor(*id)).collect();
        if !limp.is_empty() && self.fault.is_none() {
            let detail = format!(
                "no torque at {}: it lost power, or somebody else has switched it off",
                limp.join(", ")
            );
            tracing::warn!(device = self.settings.name, "{detail}");
            self.fault = Some((FaultKind::NotActivated, detail));
        }
        Ok(())
    }

    /// Makes the hand ready: motors with hardware errors boot, then all hold again where motion is armed.
    pub(super) async fn clear(&mut self) -> Result<(), DeviceError> {
        let (ids, fast) = (self.ids.clone(), false);
        let read = self.bus().await?.sync_read(table::HARDWARE_ERROR, &ids, fast).await;
        let answers = match read {
            Ok(answers) => answers,
            Err(error) => return Err(self.lose(error).await),
        };
        let faulty: Vec<u8> = answers.iter().filter(|a| a.data != [0]).map(|a| a.id).collect();
        if faulty.is_empty() && self.fault.is_none() && (self.energized || !self.armed) {
            return Ok(());
        }
        let limp = matches!(self.fault, Some((FaultKind::NotActivated, _)));
        self.fault = None;
        if limp || !faulty.is_empty() {
            self.energized = false;
        }
        for id in &faulty {
            let booted = self.bus().await?.reboot(*id).await;
            if let Err(error) = booted
                && error.is_lost()
            {
                return Err(self.lose(error).await);
            }
        }
        for id in &faulty {
            self.wait_for(*id).await?;
        }
        self.refuse_unhealthy().await.inspect_err(|_| self.energized = false)?;
        if self.armed && !self.energized {
            self.energize().await?;
        }
        Ok(())
    }

    async fn wait_for(&mut self, id: u8) -> Result<(), DeviceError> {
        let until = Instant::now() + BOOT;
        loop {
            match self.bus().await?.answers(id).await {
                Ok(true) => return Ok(()),
                Ok(false) if Instant::now() < until => sleep(Duration::from_millis(20)).await,
                Ok(false) => {
                    let detail = format!("{} did not come back from its reboot", self.motor(id));
                    return Err(self.stopped(FaultKind::Other, detail));
                }
                Err(error) => return Err(self.lose(error).await),
            }
        }
    }

    /// Every joint with its motor's numbers.
    pub(super) async fn joints(&mut self) -> Result<Vec<JointReport>, DeviceError> {
        self.look().await?;
        let supplies = self.read_all(SUPPLY).await?;
        let errors = self.read_all(table::HARDWARE_ERROR).await?;
        let joints = self.settings.joints.iter().zip(&self.readings).zip(supplies.iter().zip(&errors));
        Ok(joints
            .map(|((joint, reading), (supply, errors))| {
                let (voltage, temperature) = match supply.data[..] {
                    [low, high, temperature] => (u16::from_le_bytes([low, high]), temperature),
                    _ => (0, 0),
                };
                JointReport {
                    actuator: joint.actuator.clone(),
                    id: joint.id,
                    position_rad: reading.position_rad,
                    velocity_rad_s: reading.velocity_rad_s,
                    current_ma: reading.current_ma,
                    temperature_c: f64::from(temperature),
                    voltage_v: f64::from(voltage) / 10.0,
                    errors: hardware_errors(errors.data.first().copied().unwrap_or(0)),
                }
            })
            .collect())
    }

    /// Looks at everything that commonly goes wrong. Nothing moves, nothing is written.
    pub(super) async fn check(&mut self) -> Vec<Finding> {
        let port = self.settings.port.clone();
        let mut findings = Vec::new();
        if let Some(latency) = latency_ms(&port).await {
            let subject = "USB latency timer";
            let found = format!("{latency} ms");
            findings.push(if latency <= LATENCY_MS {
                Finding::good(subject, found)
            } else {
                Finding::bad(subject, found, "set it to 1 ms: each exchange waits for it")
            });
        }
        if let Err(error) = self.look().await {
            let advice =
                "see that the hand has power, that its cables hold, and that port and baud are right";
            findings.push(Finding::bad(format!("bus on {port}"), error.to_string(), advice));
            return findings;
        }
        findings.push(Finding::good(format!("bus on {port}"), format!("{} motors answer", self.ids.len())));
        match self.joints().await {
            Ok(joints) => findings.extend(joints.into_iter().map(|j| self.judge(&j))),
            Err(error) => {
                findings.push(Finding::bad("motors", error.to_string(), "ask again: the line is disturbed"));
            }
        }
        findings.push(Finding::of_arming(self.armed));
        findings
    }

    fn judge(&self, joint: &JointReport) -> Finding {
        let subject = self.motor(joint.id);
        let limit = self.settings.max_temperature_c;
        if !joint.errors.is_empty() {
            let advice = "take away what overloads it, then clear the fault: the motor is rebooted";
            return Finding::bad(subject, joint.errors.join(", "), advice);
        }
        if joint.temperature_c > limit {
            return Finding::bad(
                subject,
                format!("{} C", joint.temperature_c),
                format!("let it cool below {limit} C"),
            );
        }
        let described = self.joint(joint.id);
        let inside = described.is_none_or(|j| {
            // Backlash and calibration of a joint that leans on its end stop.
            joint.position_rad > j.lower_rad - 0.1 && joint.position_rad < j.upper_rad + 0.1
        });
        let found =
            format!("{:.3} rad, {:.0} C, {:.1} V", joint.position_rad, joint.temperature_c, joint.voltage_v);
        if inside {
            return Finding::good(subject, found);
        }
        Finding::bad(
            subject,
            found,
            "outside its limits: is the horn mounted at its mark, `zero_pulse` right?",
        )
    }
}

/// What the system says of a USB converter's latency timer, milliseconds; `None` for other ports.
async fn latency_ms(port: &str) -> Option<u32> {
    let real = tokio::task::spawn_blocking({
        let port = port.to_owned();
        move || {
            let real = std::fs::canonicalize(port).ok()?;
            let name = real.file_name()?.to_str()?.to_owned();
            std::fs::read_to_string(format!("/sys/bus/usb-serial/devices/{name}/latency_timer")).ok()
        }
    });
    real.await.ok()??.trim().parse().ok()
}
