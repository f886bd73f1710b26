//! Devices by name: which kinds there are, where they are, whether they are emulated in this process.
//!
//! A cell's file names a kind and an address. Changing one of the two lines swaps a mock device, an emulated one and a real
//! one; everything else stays, because each kind reads settings of its own.

#![cfg_attr(not(feature = "sim"), allow(dead_code, reason = "bodies of a simulated world"))]

pub(crate) mod arm;
pub(crate) mod camera;
pub(crate) mod hand;

use anyhow::Context as _;
use graspd_cell::config::CellConfig;
use serde::de::DeserializeOwned;

/// Address of a device that is emulated in this process.
pub(crate) const EMULATOR: &str = "emulator";

/// A kind of device: its name, what it is.
pub(crate) type Kind = (&'static str, &'static str);

/// Kinds of cameras.
pub(crate) const CAMERAS: &[Kind] = &[
    ("mock", "depth camera of the simulated world"),
    (
        "azure-kinect",
        "Azure Kinect; address: its serial number, a recording (.mkv), or none for the first device",
    ),
    (
        "pico-flexx",
        "CamBoard pico flexx; address: camera id, ws://host:port of rosbridge, or none for the first device",
    ),
];
/// Kinds of arms.
pub(crate) const ARMS: &[Kind] = &[
    ("mock", "arm of the simulated world"),
    ("ur", "Universal Robots UR3 to UR16e; address: its controller"),
];
/// Kinds of hands.
pub(crate) const HANDS: &[Kind] = &[
    ("mock", "hand of the simulated world"),
    ("robotiq-2f", "Robotiq 2F-85, 2F-140; address: serial port, socket://, modbus:// or rtu:// host:port"),
    ("robotiq-3f", "Robotiq 3-Finger; address: serial port, modbus:// or rtu:// host:port"),
    ("leap", "LEAP Hand, other hands of Dynamixel X330 motors; address: serial port"),
];

/// One device of a cell's file.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Section<'c> {
    /// `camera`, `arm` or `hand`.
    pub(crate) name: &'static str,
    pub(crate) kind: &'c str,
    pub(crate) address: &'c str,
    /// `None` for what does not move.
    pub(crate) armed: Option<bool>,
    settings: &'c toml::Table,
    kinds: &'static [Kind],
}

/// The devices of a cell's file.
pub(crate) fn sections(config: &CellConfig) -> [Section<'_>; 3] {
    let (camera, arm, hand) = (&config.camera, &config.arm, &config.hand);
    [
        Section {
            name: "camera",
            kind: &camera.kind,
            address: &camera.address,
            armed: None,
            settings: &camera.settings,
            kinds: CAMERAS,
        },
        Section {
            name: "arm",
            kind: &arm.kind,
            address: &arm.address,
            armed: Some(arm.armed),
            settings: &arm.settings,
            kinds: ARMS,
        },
        Section {
            name: "hand",
            kind: &hand.kind,
            address: &hand.address,
            armed: Some(hand.armed),
            settings: &hand.settings,
            kinds: HANDS,
        },
    ]
}

impl Section<'_> {
    /// True for one of the simulated world that nothing but memory leads to.
    pub(crate) fn is_mock(&self) -> bool {
        self.kind == "mock"
    }

    /// True for one that is emulated in this process.
    pub(crate) fn is_emulated(&self) -> bool {
        !self.is_mock() && self.address == EMULATOR
    }

    /// Refuses kinds, addresses and tables that are none.
    pub(crate) fn check(&self) -> anyhow::Result<()> {
        let names: Vec<&str> = self.kinds.iter().map(|(name, _)| *name).collect();
        let of = |key: &str| names.contains(&key);
        let expected = names.join(", ");
        anyhow::ensure!(
            of(self.kind),
            "{}.kind: found {:?}, expected one of {expected}",
            self.name,
            self.kind
        );
        if let Some(key) = self.settings.keys().find(|key| !of(key)) {
            anyhow::bail!(
                "{}.settings.{key}: found a kind that there is not, expected one of {expected}",
                self.name
            );
        }
        // Cameras are found on their bus without an address; there are no emulated ones.
        let is_camera = self.armed.is_none();
        anyhow::ensure!(
            !(is_camera && self.is_emulated()),
            "{}.address: found {EMULATOR:?}, expected a device or a recording: cameras are not emulated, kind = \"mock\" \
             sees the simulated world",
            self.name
        );
        if !is_camera && !self.is_mock() && self.address.trim().is_empty() {
            anyhow::bail!(
                "{}.address: found nothing, expected where the {} is, or {EMULATOR:?} for one that is emulated here",
                self.name,
                self.name
            );
        }
        Ok(())
    }

    /// Settings of its kind, read as `T`; `elsewhere` names keys that other fields of the file stand for.
    pub(crate) fn settings<T: DeserializeOwned>(&self, elsewhere: &[(&str, &str)]) -> anyhow::Result<T> {
        let field = format!("{}.settings.{}", self.name, self.kind);
        let table = match self.settings.get(self.kind) {
            Some(toml::Value::Table(table)) => table.clone(),
            _ => toml::Table::new(),
        };
        if let Some((key, there)) = elsewhere.iter().find(|(key, _)| table.contains_key(*key)) {
            anyhow::bail!(
                "{field}.{key}: found a value, expected none: it is {}.{there} in this file",
                self.name
            );
        }
        let read = toml::Value::Table(table).try_into();
        read.map_err(|e: toml::de::Error| anyhow::anyhow!("{field}: {e}"))
    }
}

/// Refuses a file whose devices may not move.
///
/// # Errors
/// With what to do about it.
pub(crate) fn refuse_unarmed(config: &CellConfig) -> anyhow::Result<()> {
    let sections = sections(config);
    let still: Vec<&str> =
        sections.iter().filter(|s| !s.is_mock() && s.armed == Some(false)).map(|s| s.name).collect();
    anyhow::ensure!(
        still.is_empty(),
        "motion is not armed for: {}. Nothing has moved. When nobody is in reach, set {} in the file or give --arm-motion",
        still.join(", "),
        still.iter().map(|name| format!("{name}.armed = true")).collect::<Vec<_>>().join(" and ")
    );
    Ok(())
}

/// Reads the tables of every device that is no mock one, without touching any.
///
/// # Errors
/// With the field, what was found and what was expected.
pub(crate) fn check_settings(config: &CellConfig) -> anyhow::Result<()> {
    let [camera, arm, hand] = sections(config);
    [&camera, &arm, &hand].into_iter().try_for_each(Section::check)?;
    if !camera.is_mock() {
        camera::settings(config)?;
    }
    if !arm.is_mock() {
        arm::settings(config)?;
    }
    if !hand.is_mock() {
        hand::settings(config)?;
    }
    Ok(())
}

/// Reads a cell's file; the defaults where there is none. Checked, but no device is touched.
///
/// # Errors
/// With the file, the field, what was found and what was expected.
pub(crate) fn read(path: Option<&std::path::Path>) -> anyhow::Result<CellConfig> {
    let mut config = match path {
        Some(path) => {
            let name = path.display();
            let text = std::fs::read_to_string(path).with_context(|| format!("{name}: cannot be read"))?;
            CellConfig::parse(&text).with_context(|| format!("{name}"))?
        }
        None => CellConfig::default(),
    };
    config.apply_environment(|name| std::env::var(name).ok())?;
    Ok(config)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wrong(text: &str) -> String {
        let config = CellConfig::parse(text).unwrap();
        let checked = sections(&config).iter().try_for_each(Section::check);
        format!("{:#}", checked.and_then(|()| refuse_unarmed(&config)).unwrap_err())
    }

    #[test]
    fn what_is_wrong_is_named_with_what_to_do() {
        for (text, expected) in [
            ("[arm]\nkind = \"urr\"", "arm.kind: found \"urr\", expected one of mock, ur"),
            (
                "[hand]\nkind = \"leap\"",
                "hand.address: found nothing, expected where the hand is, or \"emulator\"",
            ),
            ("[arm.settings.abb]\n", "arm.settings.abb: found a kind that there is not"),
            (
                "[arm]\nkind = \"ur\"\naddress = \"emulator\"\n[hand]\nkind = \"leap\"\naddress = \"/dev/ttyUSB0\"",
                "motion is not armed for: arm, hand. Nothing has moved. When nobody is in reach, set arm.armed = true and \
                 hand.armed = true in the file or give --arm-motion",
            ),
        ] {
            let message = wrong(text);
            assert!(message.contains(expected), "{message}\nshould contain\n{expected}");
        }
        let armed = "[arm]\nkind = \"ur\"\naddress = \"10.0.0.1\"\narmed = true";
        let config = CellConfig::parse(armed).unwrap();
        refuse_unarmed(&config).unwrap();
        refuse_unarmed(&CellConfig::default()).unwrap();
    }
}
