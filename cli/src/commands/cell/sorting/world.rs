//! The devices of a sorting cell: several arms with their hands in one simulated world, mock ones and emulated ones.

use std::any::Any;
use std::sync::Arc;

use anyhow::Context as _;
use graspd_adapters_core::{Arm, Hand};
use graspd_adapters_mock::{
    ArmSettings, Bin, FaultHandle, HandSettings, MockArm, MockHand, SharedWorld, SharedWorldSettings,
};
use graspd_cell::config::CellConfig;
use graspd_cell::pose::pointing_down;
use graspd_cell::sort::ArmCell;
use graspd_cell::sort::clock::Clock;
use graspd_cell::sort::config::{ArmStation, SortConfig};
use graspd_hands::library;
use nalgebra::Vector3;
use tokio::task::JoinSet;

use super::super::simulation::{Simulation, fill, tray};
use super::super::world::{Trouble, camera, emulated_arm, emulated_hand, table};
use super::envelope::envelope;
use super::shape::UrShape;
use super::truth::{NameRecognizer, SortingTruth, Watched};
use crate::devices::{self, Section, sections};
use crate::hand_source;

/// The clock of the simulated world. On demand it stands still while the cell thinks: figures in simulated time do not depend on
/// how fast the machine plans.
#[derive(Debug)]
pub(super) struct WorldClock(pub(super) SharedWorld);

impl Clock for WorldClock {
    fn now_s(&self) -> f64 {
        self.0.time_s()
    }

    fn still(&self) -> Option<Box<dyn Any + Send>> {
        (!self.0.is_paced()).then(|| Box::new(self.0.hold()) as Box<dyn Any + Send>)
    }
}

/// Half of the opening of a simulated bin, metres.
const BIN_HALF_M: f64 = 0.075;

/// The devices, and who knows the truth.
pub(super) struct SortingDevices {
    pub(super) camera: Arc<dyn graspd_adapters_core::DepthCamera>,
    pub(super) arms: Vec<ArmCell>,
    pub(super) recognizer: Arc<NameRecognizer>,
    pub(super) witness: Arc<SortingTruth>,
    pub(super) shared: SharedWorld,
    /// Faults of mock arms, to be changed at run time.
    #[cfg_attr(not(test), allow(dead_code, reason = "tests press the buttons"))]
    pub(super) faults: Vec<Option<FaultHandle>>,
    /// Emulators live as long as this.
    pub(super) trouble: JoinSet<()>,
}

/// An arm's part of the file as that of a cell with one arm, with where its base stands told once.
fn cell_of(config: &SortConfig, station: &ArmStation, shape: &UrShape) -> anyhow::Result<CellConfig> {
    let mut cell = config.cell(station);
    let table = cell.arm.settings.entry("ur").or_insert_with(|| toml::Table::new().into());
    let table = table.as_table_mut().context("arm.settings.ur: expected a table")?;
    for key in ["world_from_base", "model"] {
        anyhow::ensure!(
            !table.contains_key(key),
            "arms ({}): arm.settings.ur.{key}: found a value, expected none: base_m, base_yaw_rad and kinematics say it",
            station.name
        );
    }
    let base = shape.world_from_base();
    let (t, q) = (base.translation.vector, base.rotation.coords);
    let mut pose = toml::Table::new();
    pose.insert("position_m".to_owned(), vec![t.x, t.y, t.z].into());
    pose.insert("orientation".to_owned(), vec![q.x, q.y, q.z, q.w].into());
    table.insert("world_from_base".to_owned(), pose.into());
    table.insert("model".to_owned(), shape.model().name().to_lowercase().into());
    Ok(cell)
}

/// A mock arm at its station; what the file says stands above what follows from its kinematics.
fn mock_settings(
    section: &Section<'_>,
    station: &ArmStation,
    shape: &UrShape,
) -> anyhow::Result<ArmSettings> {
    let mut settings: ArmSettings = section.settings(&[])?;
    settings.name.clone_from(&station.name);
    settings.model = shape.model().name().to_owned();
    settings.base_m = shape.world_from_base().translation.vector.into();
    // Its kinematics are asked before: the sphere only holds it.
    settings.reach_m = shape.model().reach_m() + 0.3;
    Ok(settings)
}

/// Makes the devices that the configuration names.
///
/// # Errors
/// For an adapter that is not there, settings that are not in order, an unknown hand.
pub(super) async fn devices(config: &SortConfig) -> anyhow::Result<SortingDevices> {
    let shapes = config.arms.iter().map(UrShape::new).collect::<anyhow::Result<Vec<_>>>()?;
    let cells = config.arms.iter().zip(&shapes).map(|(station, shape)| cell_of(config, station, shape));
    let cells = cells.collect::<anyhow::Result<Vec<_>>>()?;
    let mut emulated = false;
    for (station, cell) in config.arms.iter().zip(&cells) {
        let of = || format!("arms ({})", station.name);
        let sections = sections(cell);
        sections.iter().try_for_each(Section::check).with_context(of)?;
        devices::refuse_unarmed(cell).with_context(of)?;
        for section in &sections {
            anyhow::ensure!(
                section.is_mock() || section.is_emulated(),
                "arms ({}): {}.address: found {:?}, expected \"emulator\" or kind = \"mock\": a sorting cell with real \
                 devices needs a program of its own around graspd_cell::sort",
                station.name,
                section.name,
                section.address
            );
            emulated |= section.is_emulated();
        }
    }
    let mut simulation: Simulation = table("simulation", config.simulation.clone().unwrap_or_default())?;
    if emulated && simulation.speed == 0.0 {
        simulation.speed = 1.0;
    }
    let hands = config.arms.iter().map(|a| {
        let id = &a.hand.id;
        library::hand(id)
            .with_context(|| format!("hand.id: {id:?}: {}", hand_source::unknown(id, library::ids())))
    });
    let hands = hands.collect::<anyhow::Result<Vec<_>>>()?;
    let wide = |h: &&&graspd_hands::Hand| h.opening.map_or(0, |o| (o.max_m * 1e6) as u64);
    let widest = hands.iter().max_by_key(wide).context("arms: found none, expected at least one")?;
    let world = tokio::task::spawn_blocking({
        let (simulation, sizes) = (simulation.clone(), simulation.sizes(widest)?);
        let settings = tray(&cells[0])?;
        move || fill(&simulation, sizes, &settings)
    })
    .await??;
    let bins = config.bins.iter().map(|bin| Bin {
        name: bin.name.clone(),
        center_m: [bin.position_m[0], bin.position_m[1]],
        half_extents_m: [BIN_HALF_M, BIN_HALF_M],
        ..Bin::default()
    });
    let shared = SharedWorldSettings { speed: simulation.speed, bins: bins.collect() };
    let shared = SharedWorld::new(world, shared).context("simulation: bins stand under bins.position_m")?;
    let camera = camera(&cells[0], &sections(&cells[0])[0], &simulation, &shared, None)?;
    let mut trouble = JoinSet::new();
    let (mut arms, mut watched, mut handles) = (Vec::new(), Vec::new(), Vec::new());
    for (i, ((station, cell), shape)) in config.arms.iter().zip(&cells).zip(&shapes).enumerate() {
        let of = || format!("arms ({})", station.name);
        let hand = hands[i];
        let position = Vector3::from(station.home_m);
        let lateral = hand_lateral(hand);
        let home =
            pointing_down(&hand.approach, &lateral, &hand.tool_point.coords, &position, station.yaw_rad);
        let mounted = shared.add_hand(Arc::new(hand.clone()), home, None).await?;
        let [_, arm_section, hand_section] = sections(cell);
        let faults = Trouble::read_for(&simulation, cell, &station.name)?;
        let own = simulation.arm_faults(&station.name);
        let arm: Arc<dyn Arm> = if arm_section.is_mock() {
            let settings = mock_settings(&arm_section, station, shape).with_context(of)?;
            let arm = MockArm::new(&shared, mounted, settings, own.arm).context("arm.settings.mock")?;
            handles.push(Some(arm.faults()));
            Arc::new(arm)
        } else {
            handles.push(None);
            emulated_arm(cell, &shared, mounted, &home, faults.arm, &mut trouble).await.with_context(of)?
        };
        let fingers: Arc<dyn Hand> = if hand_section.is_mock() {
            let mut settings: HandSettings = hand_section.settings(&[])?;
            settings.name = format!("{} hand", station.name);
            Arc::new(MockHand::new(&shared, mounted, settings, own.hand).await.context("hand.settings.mock")?)
        } else {
            emulated_hand(cell, &shared, mounted, faults.hand, &mut trouble).await.with_context(of)?
        };
        let hand_bodies = envelope(hand);
        arms.push(ArmCell { arm, hand: fingers, shape: Arc::new(shape.clone()), hand_bodies });
        watched.push(Watched { name: station.name.clone(), hand: mounted, shape: shape.clone() });
    }
    let witness = Arc::new(SortingTruth::new(&shared, config, watched).await?);
    let recognizer = Arc::new(NameRecognizer(shared.clone()));
    Ok(SortingDevices { camera, arms, recognizer, witness, shared, faults: handles, trouble })
}

/// The axis from which a hand's rotation is measured: as the server tells it.
fn hand_lateral(hand: &graspd_hands::Hand) -> Vector3<f64> {
    // Across the approach: the hand's x axis, or y where it reaches along x.
    if hand.approach.x.abs() > 0.9 { Vector3::y() } else { Vector3::x() }
}
