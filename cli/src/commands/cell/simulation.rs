//! `[simulation]`: the world of mock and emulated devices, as the cell's file says.

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::Context as _;
use graspd_adapters_mock::Faults;
use graspd_cell::config::CellConfig;
use graspd_hands::Opening;
use graspd_sim::clutter::{Arrangement, Sizes, arrange};
use graspd_sim::scene;
use graspd_sim::world::{Tray, World, WorldSettings};
use serde::Deserialize;

/// However wide a hand opens, the drawn objects are household objects that lie five in a tray, metres.
const WIDEST_OPENING_M: f64 = 0.12;
/// Most objects that a tray is filled with.
const MOST_OBJECTS: usize = 100;

/// `[simulation]`
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct Simulation {
    /// Number of objects.
    pub(super) objects: usize,
    /// Shortest edge that an object has at least, metres; the hand's if left out.
    pub(super) thinnest_m: Option<f64>,
    /// Middle edge that an object has at most, metres; the hand's if left out.
    pub(super) widest_m: Option<f64>,
    /// How they are put into the tray.
    pub(super) arrangement: ArrangementName,
    /// Seed of objects and arrangement.
    pub(super) seed: u64,
    /// A scene file instead of drawn objects; it brings its own tray.
    pub(super) scene: Option<PathBuf>,
    /// Noise of the depth camera.
    pub(super) sensor: SensorName,
    /// How many times as fast as the wall clock the world runs; 0: as fast as it can, on demand. Emulated devices live on
    /// the wall clock: with them 0 means 1.
    pub(super) speed: f64,
    /// What goes wrong with mock devices.
    pub(super) faults: DeviceFaults,
    /// What goes wrong with emulated devices.
    pub(super) wire_faults: WireFaults,
    /// What goes wrong with one of several arms, by its name.
    pub(super) arms: BTreeMap<String, ArmTrouble>,
}

impl Default for Simulation {
    fn default() -> Self {
        Self {
            objects: 5,
            thinnest_m: None,
            widest_m: None,
            arrangement: ArrangementName::Pile,
            seed: 1,
            scene: None,
            sensor: SensorName::AzureKinect,
            speed: 0.0,
            faults: DeviceFaults::default(),
            wire_faults: WireFaults::default(),
            arms: BTreeMap::new(),
        }
    }
}

impl Simulation {
    /// What goes wrong with the mock devices of one of several arms.
    pub(super) fn arm_faults(&self, name: &str) -> DeviceFaults {
        self.arms.get(name).map(|trouble| trouble.faults.clone()).unwrap_or_default()
    }

    /// Sizes of the objects that are drawn: what the hand can take, unless it is said.
    pub(super) fn sizes(&self, hand: &graspd_hands::Hand) -> anyhow::Result<Sizes> {
        let opening = hand.opening.unwrap_or(Opening { min_m: 0.0, max_m: WIDEST_OPENING_M });
        let of_hand = Sizes::between_pads(opening.min_m, opening.max_m.min(WIDEST_OPENING_M));
        for (field, value) in [("thinnest_m", self.thinnest_m), ("widest_m", self.widest_m)] {
            anyhow::ensure!(
                value.is_none_or(|v| (0.0..=1.0).contains(&v)),
                "simulation.{field}: found {}, expected 0 to 1 metres",
                value.unwrap_or_default()
            );
        }
        let or = |said: Option<f64>, own: f64| said.unwrap_or(own);
        Ok(Sizes {
            thinnest_m: or(self.thinnest_m, of_hand.thinnest_m),
            widest_m: or(self.widest_m, of_hand.widest_m),
        })
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum ArrangementName {
    Pile,
    Packed,
    Spread,
}

#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum SensorName {
    AzureKinect,
    PicoFlexx,
    Ideal,
}

/// `[simulation.faults]`
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct DeviceFaults {
    pub(super) camera: Faults,
    pub(super) arm: Faults,
    pub(super) hand: Faults,
}

/// `[simulation.arms.NAME]`
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct ArmTrouble {
    /// Of mock devices.
    pub(super) faults: DeviceFaults,
    /// Of emulated ones.
    pub(super) wire_faults: WireFaults,
}

/// `[simulation.wire_faults]`: as `graspd emulate --fault` takes them, counted from the beginning of the run.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct WireFaults {
    pub(super) arm: Vec<String>,
    pub(super) hand: Vec<String>,
}

/// The world with the configured tray.
pub(super) fn tray(config: &CellConfig) -> anyhow::Result<WorldSettings> {
    let t = &config.tray;
    anyhow::ensure!(
        t.position_m == [0.0; 3] && t.yaw_rad == 0.0,
        "tray.position_m, tray.yaw_rad: found {:?}, {}, expected zeros: the simulated tray is in the middle",
        t.position_m,
        t.yaw_rad
    );
    anyhow::ensure!(
        t.wall_height_m > 0.0,
        "tray.wall_height_m: found 0, expected more: the simulated tray has walls"
    );
    let tray = Tray { width_m: t.width_m, length_m: t.length_m, height_m: t.wall_height_m, wall_m: t.wall_m };
    Ok(WorldSettings { tray: Some(tray), ..WorldSettings::default() })
}

/// The world with its objects at rest in the tray.
pub(super) fn fill(simulation: &Simulation, sizes: Sizes, settings: &WorldSettings) -> anyhow::Result<World> {
    if let Some(path) = &simulation.scene {
        let name = path.display();
        let text = std::fs::read_to_string(path).with_context(|| format!("{name}: cannot be read"))?;
        return scene::from_json(&text).with_context(|| format!("{name}"));
    }
    let count = simulation.objects;
    anyhow::ensure!(
        count <= MOST_OBJECTS,
        "simulation.objects: found {count}, expected at most {MOST_OBJECTS}"
    );
    let how = match simulation.arrangement {
        ArrangementName::Pile => Arrangement::Pile,
        ArrangementName::Packed => Arrangement::Packed,
        ArrangementName::Spread => Arrangement::Spread,
    };
    let objects = sizes.draw(count, |round| simulation.seed.wrapping_add(round << 32));
    anyhow::ensure!(
        objects.len() == count,
        "simulation.thinnest_m, simulation.widest_m: found {} to {}, expected a wider range: only {} of {count} \
         objects fit",
        sizes.thinnest_m,
        sizes.widest_m,
        objects.len()
    );
    arrange(settings, &objects, how, simulation.seed).context("simulation")
}
