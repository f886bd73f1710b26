//! Hands that are reached over a wire.

use std::sync::Arc;
use std::time::Duration;

use anyhow::Context as _;
use graspd_adapters_core::check::Finding;
use graspd_adapters_core::{DeviceError, Hand};
use graspd_adapters_emulators::dynamixel::{self, BusConfig, BusEmulator, MotorConfig};
use graspd_adapters_emulators::line::SerialLine;
use graspd_adapters_emulators::robotiq::{self, Gripper, GripperConfig};
use graspd_adapters_leap::{LeapHand, LeapSettings};
use graspd_adapters_robotiq::settings::LinkSettings;
use graspd_adapters_robotiq::{Model, RobotiqHand, RobotiqSettings};
use graspd_cell::config::CellConfig;

use super::{EMULATOR, sections};

/// Either kind of hand.
#[derive(Debug, Clone)]
pub(crate) enum AnyHand {
    Robotiq(Arc<RobotiqHand>),
    Leap(Arc<LeapHand>),
}

impl AnyHand {
    /// As any hand.
    pub(crate) fn hand(&self) -> Arc<dyn Hand> {
        match self {
            Self::Robotiq(hand) => hand.clone(),
            Self::Leap(hand) => hand.clone(),
        }
    }

    /// What is wrong with it and what to do about it.
    pub(crate) async fn check(&self, timeout: Duration) -> Result<Vec<Finding>, DeviceError> {
        match self {
            Self::Robotiq(hand) => hand.check(timeout).await,
            Self::Leap(hand) => hand.check(timeout).await,
        }
    }
}

/// The emulator behind a hand's wire.
#[derive(Debug)]
pub(crate) enum HandEmulator {
    Gripper { gripper: Gripper, line: SerialLine },
    Bus(BusEmulator),
}

/// A hand, and the emulator behind its wire where it is emulated in this process.
#[derive(Debug)]
pub(crate) struct WiredHand {
    pub(crate) hand: AnyHand,
    pub(crate) emulator: Option<Arc<HandEmulator>>,
}

/// What moves behind an emulated hand's wire instead of the small plant that comes with the emulator.
pub(crate) enum Body {
    Gripper(Box<dyn robotiq::Plant>),
    Motors(Box<dyn dynamixel::Plant>),
}

/// Settings of a hand.
#[derive(Debug, Clone)]
pub(crate) enum HandSettings {
    Robotiq(RobotiqSettings),
    Leap(LeapSettings),
}

/// Reads an address: a serial port, or a protocol with host and port.
fn link(address: &str) -> anyhow::Result<LinkSettings> {
    let text = |address: &str| address.to_owned();
    Ok(match address.split_once("://") {
        Some(("socket", address)) => LinkSettings::Socket { address: text(address) },
        Some(("modbus", address)) => LinkSettings::ModbusTcp { address: text(address) },
        Some(("rtu", address)) => LinkSettings::RtuOverTcp { address: text(address) },
        None if address.starts_with('/') || address.starts_with("COM") => {
            LinkSettings::Rtu { port: text(address), baud: 115_200 }
        }
        _ => anyhow::bail!(
            "hand.address: found {address:?}, expected a serial port such as /dev/ttyUSB0, or socket://, modbus:// or \
             rtu:// with host and port, or {EMULATOR:?}"
        ),
    })
}

/// Settings of the hand, as the cell's file says.
///
/// # Errors
/// For a kind, an address or a table that is not in order.
pub(crate) fn settings(config: &CellConfig) -> anyhow::Result<HandSettings> {
    let [_, _, section] = sections(config);
    section.check()?;
    let (id, armed) = (config.hand.id.clone(), config.hand.armed);
    let elsewhere = [("armed", "armed"), ("hand_id", "id"), ("link", "address"), ("port", "address")];
    // The line of an emulated one is made later; its place is held by any path.
    let address = if section.is_emulated() { "/dev/null" } else { section.address };
    let settings = if section.kind == "leap" {
        let mut settings: LeapSettings = section.settings(&elsewhere)?;
        (settings.hand_id, settings.armed) = (id, armed);
        address.clone_into(&mut settings.port);
        settings.check().context("hand.settings.leap")?;
        HandSettings::Leap(settings)
    } else {
        let mut settings: RobotiqSettings = section.settings(&elsewhere)?;
        (settings.armed, settings.link) = (armed, link(address)?);
        settings.hand_id = Some(id);
        let three = settings.model == Model::ThreeFinger;
        if section.kind == "robotiq-3f" {
            settings.model = Model::ThreeFinger;
        } else {
            anyhow::ensure!(!three, "hand.settings.robotiq-2f.model: found 3f, expected 2f-85 or 2f-140");
        }
        settings.check().with_context(|| format!("hand.settings.{}", section.kind))?;
        HandSettings::Robotiq(settings)
    };
    Ok(settings)
}

/// Connects to the hand; one that is emulated is started first, with a body of one's own where one is given.
///
/// # Errors
/// As [`settings`]; an emulator whose line cannot be made. Whether anybody answers shows with the first call.
pub(crate) fn connect(config: &CellConfig, body: Option<Body>) -> anyhow::Result<WiredHand> {
    let emulated = config.hand.address == EMULATOR;
    let cannot = "the emulated hand's serial line cannot be made";
    Ok(match settings(config)? {
        HandSettings::Robotiq(mut settings) => {
            let mut emulator = None;
            if emulated {
                let three = settings.model == Model::ThreeFinger;
                let model = if three { robotiq::Model::ThreeFinger } else { robotiq::Model::TwoFinger };
                let plant: Box<dyn robotiq::Plant> = match body {
                    Some(Body::Gripper(plant)) => plant,
                    _ if three => Box::new(robotiq::KinematicPlant::three_finger()),
                    _ => Box::new(robotiq::KinematicPlant::two_finger()),
                };
                let config = GripperConfig { slave: settings.slave, ..GripperConfig::new(model) };
                let gripper = Gripper::new(config, plant);
                let line = gripper.serve_rtu(None).context(cannot)?;
                let port = line.path().display().to_string();
                settings.link = LinkSettings::Rtu { port, baud: 115_200 };
                emulator = Some(Arc::new(HandEmulator::Gripper { gripper, line }));
            }
            WiredHand { hand: AnyHand::Robotiq(Arc::new(RobotiqHand::new(settings)?)), emulator }
        }
        HandSettings::Leap(mut settings) => {
            let mut emulator = None;
            if emulated {
                let plant: Box<dyn dynamixel::Plant> = match body {
                    Some(Body::Motors(plant)) => plant,
                    _ => Box::new(dynamixel::KinematicPlant::new()),
                };
                let model = settings.model();
                let motors = settings.joints.iter().map(|j| MotorConfig { id: j.id, model }).collect();
                let bus = BusConfig { motors, baud: settings.baud, ..BusConfig::leap(false) };
                let bus = BusEmulator::start(bus, plant).context(cannot)?;
                settings.port = bus.path().display().to_string();
                emulator = Some(Arc::new(HandEmulator::Bus(bus)));
            }
            WiredHand { hand: AnyHand::Leap(Arc::new(LeapHand::new(settings)?)), emulator }
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<HandSettings, String> {
        let config = CellConfig::parse(text).unwrap();
        settings(&config).map_err(|e| format!("{e:#}"))
    }

    #[test]
    fn an_address_says_how_a_hand_is_reached() {
        for (address, expected) in [
            ("/dev/ttyUSB1", LinkSettings::Rtu { port: "/dev/ttyUSB1".into(), baud: 115_200 }),
            ("socket://10.0.0.1:63352", LinkSettings::Socket { address: "10.0.0.1:63352".into() }),
            ("modbus://10.0.0.2:502", LinkSettings::ModbusTcp { address: "10.0.0.2:502".into() }),
            ("rtu://10.0.0.1:54321", LinkSettings::RtuOverTcp { address: "10.0.0.1:54321".into() }),
        ] {
            let text = format!("[hand]\nkind = \"robotiq-2f\"\naddress = \"{address}\"");
            let HandSettings::Robotiq(settings) = read(&text).unwrap() else { panic!("{address}") };
            assert_eq!(settings.link, expected);
            assert!(!settings.armed && settings.hand_id.as_deref() == Some("robotiq-2f85"));
        }
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (text, expected) in [
            (
                "kind = \"robotiq-2f\"\naddress = \"10.0.0.1\"",
                "hand.address: found \"10.0.0.1\", expected a serial",
            ),
            ("kind = \"robotiq-3f\"\naddress = \"socket://10.0.0.1:63352\"", "knows no 3-Finger"),
            (
                "kind = \"robotiq-2f\"\naddress = \"emulator\"\n[hand.settings.robotiq-2f]\nmodel = \"3f\"",
                "expected 2f-85 or 2f-140",
            ),
            (
                "kind = \"leap\"\naddress = \"emulator\"\n[hand.settings.leap]\nport = \"/dev/ttyUSB0\"",
                "hand.settings.leap.port: found a value, expected none: it is hand.address in this file",
            ),
            (
                "kind = \"leap\"\naddress = \"emulator\"\n[hand.settings.leap]\nmax_current_ma = 5000",
                "hand.settings.leap: max_current_ma: found 5000",
            ),
        ] {
            let message = read(&format!("[hand]\n{text}")).unwrap_err();
            assert!(message.contains(expected), "{message}\nshould contain\n{expected}");
        }
        // Settings of kinds that are not chosen are not read.
        let text = "[hand]\nkind = \"leap\"\naddress = \"/dev/ttyUSB0\"\n[hand.settings.robotiq-3f]\nx = 1";
        assert!(matches!(read(text), Ok(HandSettings::Leap(_))));
    }
}
