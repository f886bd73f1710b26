//! Settings of a LEAP Hand, as a table that a configuration file can hold. In `cell.toml`, address and arming stand in the
//! hand's section, the rest in its table for the kind.
//!
//! ```toml
//! [hand]
//! id = "leap"
//! kind = "leap"
//! address = "/dev/ttyUSB0"
//! armed = true              # without this nothing moves
//!
//! [hand.settings.leap]
//! variant = "lite"          # XL330 motors; "full" for XC330
//! max_current_ma = 300.0
//! max_speed_rad_s = 2.0
//! ```

use std::collections::BTreeSet;
use std::time::Duration;

use graspd_adapters_core::check::{SettingsError, require, require_within as number};
use serde::{Deserialize, Serialize};

use crate::joints::{Joint, leap};

/// Which motors the hand has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Variant {
    /// XL330-M288.
    Lite,
    /// XC330-M288.
    Full,
}

/// Settings of the adapter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LeapSettings {
    /// Name for logs and errors.
    pub name: String,
    /// Id of its description.
    pub hand_id: String,
    /// Serial port, for example `/dev/ttyUSB0`.
    pub port: String,
    /// Baud rate of the bus.
    pub baud: u32,
    /// Which motors it has: their model number is checked, and it sets the current that is used at most.
    pub variant: Variant,
    /// Nothing moves, and no motor holds, unless this is true or [`crate::LeapHand::arm`] was called.
    pub armed: bool,
    /// Exchanges with all motors, times a second.
    pub rate_hz: f64,
    /// Read all motors in one answer; false for firmware without fast sync read.
    pub fast_sync_read: bool,
    /// Longest time without an answer, milliseconds: the USB converter's latency timer is most of it.
    pub reply_timeout_ms: u64,
    /// Tries of an exchange before it counts as failed.
    pub attempts: u32,
    /// Motors stop by themselves after this silence, milliseconds, 20 to 2540.
    pub watchdog_ms: u64,
    /// Fastest speed of a joint, at a share of speed of 1.
    pub max_speed_rad_s: f64,
    /// Largest acceleration of a joint.
    pub max_acceleration_rad_s2: f64,
    /// Largest current of a motor, at a share of force of 1; left out: 350 for lite, 550 for full.
    pub max_current_ma: Option<f64>,
    /// Motion is refused, and stopped, above this temperature of a motor.
    pub max_temperature_c: f64,
    /// A joint at rest that lacks more than this of its goal is held by something.
    pub held_rad: f64,
    /// Proportional, integral and derivative gain of the motors, in their counts.
    pub gains: [u16; 3],
    /// Joints in the order of the actuators of the hand's description; left out: those of the LEAP Hand.
    pub joints: Vec<Joint>,
}

impl Default for LeapSettings {
    fn default() -> Self {
        Self {
            name: "leap".into(),
            hand_id: "leap".into(),
            port: "/dev/ttyUSB0".into(),
            baud: 4_000_000,
            variant: Variant::Lite,
            armed: false,
            rate_hz: 100.0,
            fast_sync_read: true,
            reply_timeout_ms: 20,
            attempts: 3,
            watchdog_ms: 300,
            max_speed_rad_s: 2.5,
            max_acceleration_rad_s2: 20.0,
            max_current_ma: None,
            max_temperature_c: 65.0,
            held_rad: 0.08,
            gains: [600, 0, 200],
            joints: leap(),
        }
    }
}

impl LeapSettings {
    /// Current that a motor uses at most, milliamperes.
    pub fn current_ma(&self) -> f64 {
        self.max_current_ma.unwrap_or(match self.variant {
            Variant::Lite => 350.0,
            Variant::Full => 550.0,
        })
    }

    /// Model number that every motor must have.
    pub fn model(&self) -> u16 {
        use graspd_adapters_dynamixel::table::{XC330_M288, XL330_M288};
        match self.variant {
            Variant::Lite => XL330_M288,
            Variant::Full => XC330_M288,
        }
    }

    pub(crate) fn reply_timeout(&self) -> Duration {
        Duration::from_millis(self.reply_timeout_ms)
    }

    /// Register value of the motors' watchdog.
    pub(crate) fn watchdog_counts(&self) -> u8 {
        u8::try_from(self.watchdog_ms / 20).unwrap_or(127)
    }

    /// Checks every value.
    ///
    /// # Errors
    /// [`SettingsError`] with the first field that is wrong.
    pub fn check(&self) -> Result<(), SettingsError> {
        require("port", format!("{:?}", self.port), !self.port.is_empty(), "a path, such as /dev/ttyUSB0")?;
        require("baud", self.baud, (9600..=4_500_000).contains(&self.baud), "9600 to 4500000")?;
        number("rate_hz", self.rate_hz, 10.0, 500.0)?;
        number("reply_timeout_ms", self.reply_timeout_ms as f64, 1.0, 1000.0)?;
        number("attempts", f64::from(self.attempts), 1.0, 10.0)?;
        number("watchdog_ms", self.watchdog_ms as f64, 20.0, 2540.0)?;
        let slowest = 3000.0 / self.rate_hz;
        let fed = self.watchdog_ms as f64 >= slowest;
        require(
            "watchdog_ms",
            self.watchdog_ms,
            fed,
            format!("three periods of rate_hz, {slowest} or more"),
        )?;
        number("max_speed_rad_s", self.max_speed_rad_s, 0.01, 8.5)?;
        number("max_acceleration_rad_s2", self.max_acceleration_rad_s2, 0.1, 1000.0)?;
        number("max_current_ma", self.current_ma(), 1.0, 1750.0)?;
        number("max_temperature_c", self.max_temperature_c, 30.0, 70.0)?;
        number("held_rad", self.held_rad, 0.005, 0.5)?;
        for gain in self.gains {
            number("gains", f64::from(gain), 0.0, 16_383.0)?;
        }
        let count = self.joints.len();
        require("joints", format!("{count} joints"), (1..=100).contains(&count), "1 to 100")?;
        let mut ids = BTreeSet::new();
        let mut names = BTreeSet::new();
        for joint in &self.joints {
            let field = |name: &str| format!("joints.{}.{name}", joint.actuator);
            require(&field("id"), joint.id, joint.id <= 252 && ids.insert(joint.id), "0 to 252, each once")?;
            let named = names.insert(&joint.actuator);
            require("joints.actuator", format!("{:?}", joint.actuator), named, "each name once")?;
            let (lower, upper) = (joint.lower_rad, joint.upper_rad);
            let range = format!("{lower} to {upper}");
            let ok = lower < upper && lower.abs() <= 7.0 && upper.abs() <= 7.0;
            require(&field("lower_rad"), range, ok, "a range within -7 to 7")?;
            number(&field("zero_pulse"), joint.zero_pulse, 0.0, 4095.0)?;
            number(&field("gain"), joint.gain, 0.0, 4.0)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_valid_and_nothing_is_armed() {
        let settings = LeapSettings::default();
        settings.check().unwrap();
        assert!(!settings.armed);
        assert_eq!((settings.current_ma(), settings.model()), (350.0, 1200));
        let text = toml::to_string(&settings).unwrap();
        assert_eq!(toml::from_str::<LeapSettings>(&text).unwrap(), settings);
    }

    #[test]
    fn the_worked_example_is_read() {
        let text = "port = \"/dev/ttyUSB0\"\narmed = true\nvariant = \"full\"\nmax_current_ma = 300.0";
        let settings: LeapSettings = toml::from_str(text).unwrap();
        settings.check().unwrap();
        assert_eq!((settings.armed, settings.current_ma(), settings.model()), (true, 300.0, 1240));
    }

    #[test]
    fn what_is_wrong_is_named() {
        let wrong = |change: fn(&mut LeapSettings)| {
            let mut settings = LeapSettings::default();
            change(&mut settings);
            settings.check().unwrap_err().to_string()
        };
        assert_eq!(wrong(|s| s.max_speed_rad_s = 99.0), "max_speed_rad_s: found 99, expected 0.01 to 8.5");
        assert_eq!(wrong(|s| s.rate_hz = f64::NAN), "rate_hz: found NaN, expected 10 to 500");
        assert_eq!(
            wrong(|s| s.joints[1].id = 1),
            "joints.index_abduction.id: found 1, expected 0 to 252, each once"
        );
        assert!(wrong(|s| s.watchdog_ms = 20).starts_with("watchdog_ms: found 20, expected three periods"));
        assert!(
            toml::from_str::<LeapSettings>("prot = 1").unwrap_err().to_string().contains("unknown field")
        );
    }
}
