//! Settings of a Robotiq gripper, as a table that a configuration file can hold. In `cell.toml`, address and arming stand in the
//! hand's section, the rest in its table for the kind.
//!
//! ```toml
//! [hand]
//! id = "robotiq-2f85"
//! kind = "robotiq-2f"
//! address = "/dev/ttyUSB0"  # or socket://, modbus://, rtu:// with host and port
//! armed = true              # without this nothing moves
//!
//! [hand.settings.robotiq-2f]
//! model = "2f-85"           # or "2f-140"
//! max_speed_mm_s = 100.0
//! max_force_n = 60.0
//! ```

use graspd_adapters_core::check::{SettingsError, require, require_within as number};
use serde::{Deserialize, Serialize};

use crate::calibration::Calibration;

/// Which gripper.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Model {
    /// Two fingers, 85 mm.
    #[serde(rename = "2f-85")]
    TwoFinger85,
    /// Two fingers, 140 mm.
    #[serde(rename = "2f-140")]
    TwoFinger140,
    /// Three fingers.
    #[serde(rename = "3f")]
    ThreeFinger,
}

impl Model {
    /// Slowest and fastest, millimetres per second.
    pub fn speeds_mm_s(self) -> (f64, f64) {
        match self {
            Self::TwoFinger85 => (20.0, 150.0),
            Self::TwoFinger140 => (30.0, 250.0),
            Self::ThreeFinger => (22.0, 110.0),
        }
    }

    /// Weakest and strongest, newtons.
    pub fn forces_n(self) -> (f64, f64) {
        match self {
            Self::TwoFinger85 => (20.0, 235.0),
            Self::TwoFinger140 => (10.0, 125.0),
            Self::ThreeFinger => (15.0, 60.0),
        }
    }
}

/// How the gripper is reached.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum LinkSettings {
    /// Modbus RTU on a serial port.
    Rtu {
        /// Serial port.
        port: String,
        /// Baud rate.
        #[serde(default = "baud")]
        baud: u32,
    },
    /// Modbus TCP.
    ModbusTcp {
        /// Host and port.
        address: String,
    },
    /// RTU frames over TCP, as an arm's tool port passes them on.
    RtuOverTcp {
        /// Host and port.
        address: String,
    },
    /// The text protocol of the wrist socket; 2F only.
    Socket {
        /// Host and port.
        address: String,
    },
}

fn baud() -> u32 {
    115_200
}

/// Settings of the adapter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RobotiqSettings {
    /// Name for logs and errors.
    pub name: String,
    /// Id of its description; left out: `robotiq-2f85`, `robotiq-2f140` or `robotiq-3f`.
    pub hand_id: Option<String>,
    /// Which gripper.
    pub model: Model,
    /// How it is reached.
    pub link: LinkSettings,
    /// Modbus address.
    pub slave: u8,
    /// First register that is read, and first that is written; left out: 2000 and 1000, or 0 and 0 on Modbus TCP.
    pub registers: Option<[u16; 2]>,
    /// Read with function code 4 instead of 3; left out: on Modbus TCP.
    pub input_registers: Option<bool>,
    /// Nothing moves, and the gripper is not activated, unless this is true or [`crate::RobotiqHand::arm`] was called.
    pub armed: bool,
    /// Looks at the status while fingers move, times a second.
    pub poll_hz: f64,
    /// Longest time without an answer, milliseconds.
    pub reply_timeout_ms: u64,
    /// Tries of an exchange before it counts as failed.
    pub attempts: u32,
    /// Silence between exchanges, milliseconds.
    pub gap_ms: u64,
    /// Longest time of an activation, seconds.
    pub activation_s: f64,
    /// Fastest, at a share of speed of 1, millimetres per second; left out: as fast as it can.
    pub max_speed_mm_s: Option<f64>,
    /// Strongest, at a share of force of 1, newtons; left out: as strong as it can.
    pub max_force_n: Option<f64>,
    /// Least and largest opening that a 2F is told to go to, millimetres; left out: all of its stroke.
    pub openings_mm: Option<[f64; 2]>,
    /// Counts of a 2F that is open and closed, and its stroke; left out: those of the model.
    pub calibration: Option<Calibration>,
}

impl Default for RobotiqSettings {
    fn default() -> Self {
        Self {
            name: "robotiq".into(),
            hand_id: None,
            model: Model::TwoFinger85,
            link: LinkSettings::Rtu { port: "/dev/ttyUSB0".into(), baud: baud() },
            slave: 9,
            registers: None,
            input_registers: None,
            armed: false,
            poll_hz: 50.0,
            reply_timeout_ms: 100,
            attempts: 3,
            gap_ms: 5,
            activation_s: 25.0,
            max_speed_mm_s: None,
            max_force_n: None,
            openings_mm: None,
            calibration: None,
        }
    }
}

impl RobotiqSettings {
    /// Id of the gripper's description.
    pub fn hand_id(&self) -> String {
        let known = match self.model {
            Model::TwoFinger85 => "robotiq-2f85",
            Model::TwoFinger140 => "robotiq-2f140",
            Model::ThreeFinger => "robotiq-3f",
        };
        self.hand_id.clone().unwrap_or_else(|| known.to_owned())
    }

    /// Counts, stroke and range.
    pub fn calibration(&self) -> Calibration {
        self.calibration.unwrap_or_else(|| Calibration::of(self.model))
    }

    pub(crate) fn max_speed(&self) -> f64 {
        self.max_speed_mm_s.unwrap_or(self.model.speeds_mm_s().1)
    }

    pub(crate) fn max_force(&self) -> f64 {
        self.max_force_n.unwrap_or(self.model.forces_n().1)
    }

    pub(crate) fn openings(&self) -> [f64; 2] {
        self.openings_mm.unwrap_or([0.0, self.calibration().open_mm])
    }

    /// First register that is read, and first that is written.
    pub(crate) fn first_registers(&self) -> [u16; 2] {
        let tcp = matches!(self.link, LinkSettings::ModbusTcp { .. });
        self.registers.unwrap_or(if tcp { [0, 0] } else { [2000, 1000] })
    }

    pub(crate) fn reads_input_registers(&self) -> bool {
        self.input_registers.unwrap_or(matches!(self.link, LinkSettings::ModbusTcp { .. }))
    }

    /// Checks every value.
    ///
    /// # Errors
    /// [`SettingsError`] with the first field that is wrong.
    pub fn check(&self) -> Result<(), SettingsError> {
        match &self.link {
            LinkSettings::Rtu { port, baud } => {
                require("link.port", format!("{port:?}"), !port.is_empty(), "a path, such as /dev/ttyUSB0")?;
                require("link.baud", baud, (1200..=1_000_000).contains(baud), "1200 to 1000000")?;
            }
            LinkSettings::ModbusTcp { address }
            | LinkSettings::RtuOverTcp { address }
            | LinkSettings::Socket { address } => {
                let ok = address
                    .rsplit_once(':')
                    .is_some_and(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok_and(|p| p > 0));
                require("link.address", format!("{address:?}"), ok, "host:port, such as 192.168.1.10:63352")?;
            }
        }
        let three = self.model == Model::ThreeFinger;
        let socket = matches!(self.link, LinkSettings::Socket { .. });
        require("link.kind", "socket", !(three && socket), "any other: the wrist socket knows no 3-Finger")?;
        require("slave", self.slave, (1..=247).contains(&self.slave), "1 to 247")?;
        number("poll_hz", self.poll_hz, 2.0, 200.0)?;
        number("reply_timeout_ms", self.reply_timeout_ms as f64, 5.0, 5000.0)?;
        number("attempts", f64::from(self.attempts), 1.0, 10.0)?;
        number("gap_ms", self.gap_ms as f64, 0.0, 100.0)?;
        number("activation_s", self.activation_s, 1.0, 120.0)?;
        let (slowest, fastest) = self.model.speeds_mm_s();
        number("max_speed_mm_s", self.max_speed(), slowest, fastest)?;
        let (weakest, strongest) = self.model.forces_n();
        number("max_force_n", self.max_force(), weakest, strongest)?;
        self.calibration().check()?;
        let [least, most] = self.openings();
        let ok = least >= 0.0 && least < most && most <= self.calibration().open_mm;
        let expected = format!("least and most within 0 to {}", self.calibration().open_mm);
        require("openings_mm", format!("{least} to {most}"), ok, expected)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_valid_and_nothing_is_armed() {
        let settings = RobotiqSettings::default();
        settings.check().unwrap();
        assert!(!settings.armed);
        let text = toml::to_string(&settings).unwrap();
        assert_eq!(toml::from_str::<RobotiqSettings>(&text).unwrap(), settings);
    }

    #[test]
    fn the_worked_example_is_read() {
        let text = "model = \"3f\"\narmed = true\nmax_force_n = 40.0\n[link]\nkind = \"modbus_tcp\"\naddress = \"192.168.1.11:502\"";
        let settings: RobotiqSettings = toml::from_str(text).unwrap();
        settings.check().unwrap();
        assert_eq!((settings.hand_id().as_str(), settings.first_registers()), ("robotiq-3f", [0, 0]));
        assert!(settings.reads_input_registers());
        let text = "[link]\nkind = \"rtu\"\nport = \"/dev/ttyUSB1\"";
        let settings: RobotiqSettings = toml::from_str(text).unwrap();
        assert_eq!(settings.first_registers(), [2000, 1000]);
    }

    #[test]
    fn what_is_wrong_is_named() {
        let wrong = |change: fn(&mut RobotiqSettings)| {
            let mut settings = RobotiqSettings::default();
            change(&mut settings);
            settings.check().unwrap_err().to_string()
        };
        assert_eq!(wrong(|s| s.max_force_n = Some(500.0)), "max_force_n: found 500, expected 20 to 235");
        assert_eq!(wrong(|s| s.max_speed_mm_s = Some(5.0)), "max_speed_mm_s: found 5, expected 20 to 150");
        assert_eq!(wrong(|s| s.slave = 0), "slave: found 0, expected 1 to 247");
        assert!(wrong(|s| s.openings_mm = Some([50.0, 90.0])).starts_with("openings_mm: found 50 to 90"));
        let socket = || LinkSettings::Socket { address: "10.0.0.1:63352".into() };
        assert!(
            wrong(|s| s.link = LinkSettings::Socket { address: "10.0.0.1".into() })
                .starts_with("link.address")
        );
        let three =
            RobotiqSettings { model: Model::ThreeFinger, link: socket(), ..RobotiqSettings::default() };
        assert!(three.check().unwrap_err().to_string().contains("knows no 3-Finger"));
        assert!(toml::from_str::<RobotiqSettings>("[link]\nkind = \"usb\"").is_err());
    }
}
