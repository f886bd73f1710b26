//! The devices of a cell, in one simulated world: mock ones, and emulated ones whose wires lead into it.

use std::sync::Arc;

use anyhow::Context as _;
use graspd_adapters_core::{Arm, DepthCamera, Hand};
use graspd_adapters_emulators::requests::{
    FaultRequest, FaultyDevice, befall_bus, befall_gripper, befall_ur, carry_out,
};
use graspd_adapters_mock::plants::{GripperPlant, MotorPlant, WristMount, WristPlant};
use graspd_adapters_mock::{
    ArmSettings, Bin, CameraSettings, HandSettings, MockArm, MockCamera, MockHand, Mount, SharedWorld,
    SharedWorldSettings,
};
use graspd_cell::config::CellConfig;
use graspd_cell::pose::{PoseRecord, pointing_down};
use graspd_cell::witness::Witness;
use graspd_hands::library;
use graspd_sim::camera::look_at;
use graspd_sim::sensor::Sensor;
use graspd_sim::world::HandId;
use graspd_training::evaluate::servo::hand_from_camera;
use nalgebra::{Isometry3, Point3, Vector3};
use serde::de::DeserializeOwned;
use tokio::task::JoinSet;

use super::pictures::Viewpoint;
use super::simulation::{SensorName, Simulation, WireFaults, fill, tray};
use super::truth::SimulatedTruth;
use crate::devices::hand::{Body, HandEmulator};
use crate::devices::{self, EMULATOR, Section, sections};
use crate::hand_source;

/// The devices of a cell, and who knows what became of the objects.
pub(in crate::commands) struct Devices {
    pub(in crate::commands) camera: Arc<dyn DepthCamera>,
    pub(in crate::commands) arm: Arc<dyn Arm>,
    pub(in crate::commands) hand: Arc<dyn Hand>,
    /// Who knows what became of the objects; nobody in the real world.
    pub(in crate::commands) witness: Option<Arc<dyn Witness>>,
    /// The simulated world, where there is one.
    pub(in crate::commands) shared: Option<SharedWorld>,
    /// What befalls emulated devices; ends with this.
    pub(in crate::commands) trouble: JoinSet<()>,
}

/// Where pictures of a cell with one arm are taken from.
pub(super) const VIEWPOINT: Viewpoint =
    Viewpoint { eye: Point3::new(0.42, -0.62, 0.42), target: Point3::new(0.02, 0.0, 0.10), focal_px: 620.0 };

/// Says where the camera of a servo sits, where the file does not: a simulated one looks out of the palm.
///
/// # Errors
/// For a real camera, whose place nobody can guess.
pub(super) fn place_palm_camera(config: &mut CellConfig) -> anyhow::Result<()> {
    let is_mock = sections(config)[0].is_mock();
    let Some(servo) = config.servo.as_mut().filter(|servo| servo.hand_from_camera.is_none()) else {
        return Ok(());
    };
    anyhow::ensure!(
        is_mock,
        "servo.hand_from_camera: missing, expected the pose of the camera's optical frame in the hand's root link"
    );
    // An unknown hand is told of elsewhere.
    if let Some(hand) = library::hand(&config.hand.id) {
        servo.hand_from_camera = Some(PoseRecord::from(&hand_from_camera(hand)));
    }
    Ok(())
}

/// Makes the devices that the configuration names.
///
/// # Errors
/// For an adapter that is not there, settings that are not in order, an unknown hand.
pub(in crate::commands) async fn devices(config: &CellConfig) -> anyhow::Result<Devices> {
    let sections = sections(config);
    sections.iter().try_for_each(Section::check)?;
    devices::refuse_unarmed(config)?;
    if sections.iter().all(|s| !s.is_mock()) {
        return wired(config).await;
    }
    for section in &sections {
        // The mock device is in a simulated world: what is not in it neither moves nor sees anything there.
        anyhow::ensure!(
            section.is_mock() || section.is_emulated(),
            "{}.address: found {:?}, expected {EMULATOR:?}: {} is a mock device, of a simulated world in which nothing \
             real moves",
            section.name,
            section.address,
            sections.iter().find(|s| s.is_mock()).map_or("camera", |s| s.name)
        );
    }
    let emulated = sections.iter().any(Section::is_emulated);
    let mut simulation: Simulation = table("simulation", config.simulation.clone().unwrap_or_default())?;
    if emulated && simulation.speed == 0.0 {
        simulation.speed = 1.0;
    }
    let faults = Trouble::read(&simulation.wire_faults, config)?;
    let hand = library::hand(&config.hand.id).with_context(|| {
        format!("hand.id: {:?}: {}", config.hand.id, hand_source::unknown(&config.hand.id, library::ids()))
    })?;
    let settings = tray(config)?;
    let world = tokio::task::spawn_blocking({
        let simulation = simulation.clone();
        let sizes = simulation.sizes(hand)?;
        move || fill(&simulation, sizes, &settings)
    })
    .await??;
    let [x, y, _] = config.drop.position_m;
    let bin = Bin { center_m: [x, y], ..Bin::default() };
    let shared = SharedWorldSettings { speed: simulation.speed, bins: vec![bin] };
    let shared = SharedWorld::new(world, shared).with_context(|| {
        format!("simulation: the bin stands around drop.position_m = {:?}", config.drop.position_m)
    })?;
    let drop = Vector3::from(config.drop.position_m);
    let home = pointing_down(&hand.approach, &Vector3::x(), &hand.tool_point.coords, &drop, 0.0);
    let mounted = shared.add_hand(Arc::new(hand.clone()), home, None).await?;
    let camera = camera(config, &sections[0], &simulation, &shared, Some(mounted))?;
    let mut trouble = JoinSet::new();
    let (mock_arm, mock_hand) = (simulation.faults.arm.clone(), simulation.faults.hand.clone());
    let arm: Arc<dyn Arm> = if sections[1].is_mock() {
        let settings: ArmSettings = sections[1].settings(&[])?;
        Arc::new(MockArm::new(&shared, mounted, settings, mock_arm).context("arm.settings.mock")?)
    } else {
        emulated_arm(config, &shared, mounted, &home, faults.arm, &mut trouble).await?
    };
    let hand: Arc<dyn Hand> = if sections[2].is_mock() {
        let settings: HandSettings = sections[2].settings(&[])?;
        Arc::new(MockHand::new(&shared, mounted, settings, mock_hand).await.context("hand.settings.mock")?)
    } else {
        emulated_hand(config, &shared, mounted, faults.hand, &mut trouble).await?
    };
    let witness: Arc<dyn Witness> = Arc::new(SimulatedTruth::new(&shared).await?);
    Ok(Devices { camera, arm, hand, witness: Some(witness), shared: Some(shared), trouble })
}

/// Devices none of which is in a simulated world. One that is emulated all the same has the small plant that comes with
/// its emulator: it moves, and touches nothing.
async fn wired(config: &CellConfig) -> anyhow::Result<Devices> {
    let camera = devices::camera::connect(config).await?.camera();
    let arm = devices::arm::connect(config, None).await?;
    let hand = devices::hand::connect(config, None)?;
    let mut trouble = JoinSet::new();
    // The emulators live as long as this task.
    let emulators = (arm.emulator, hand.emulator);
    trouble.spawn(async move {
        let _emulators = emulators;
        std::future::pending::<()>().await;
    });
    Ok(Devices { camera, arm: arm.arm, hand: hand.hand.hand(), witness: None, shared: None, trouble })
}

/// A camera of the simulated world.
pub(super) fn camera(
    config: &CellConfig,
    section: &Section<'_>,
    simulation: &Simulation,
    shared: &SharedWorld,
    carried_by: Option<HandId>,
) -> anyhow::Result<Arc<dyn DepthCamera>> {
    let mut sensor = match simulation.sensor {
        SensorName::PicoFlexx => Sensor::pico_flexx(),
        SensorName::AzureKinect | SensorName::Ideal => Sensor::azure_kinect(),
    };
    if simulation.sensor == SensorName::Ideal {
        sensor = Sensor::ideal(sensor.lens);
    }
    let (eye, target) = (Point3::from(config.camera.position_m), Point3::from(config.camera.looks_at_m));
    let mount = match (&config.servo, carried_by) {
        (Some(servo), Some(hand)) => Mount::OnHand { hand, hand_from_camera: servo.hand_from_camera() },
        _ => Mount::Fixed { world_from_camera: look_at(&eye, &target, &Vector3::z()) },
    };
    let settings: CameraSettings = section.settings(&[])?;
    let camera = MockCamera::new(shared, settings, sensor, mount, simulation.faults.camera.clone());
    Ok(Arc::new(camera.context("camera.settings.mock")?))
}

/// Faults of emulated devices to come.
pub(super) struct Trouble {
    pub(super) arm: Vec<FaultRequest>,
    pub(super) hand: Vec<FaultRequest>,
}

impl Trouble {
    /// Of one of several arms.
    pub(super) fn read_for(simulation: &Simulation, config: &CellConfig, arm: &str) -> anyhow::Result<Self> {
        let faults = simulation.arms.get(arm).map(|t| t.wire_faults.clone()).unwrap_or_default();
        Self::read(&faults, config).with_context(|| format!("simulation.arms.{arm}"))
    }

    fn read(faults: &WireFaults, config: &CellConfig) -> anyhow::Result<Self> {
        let hand = if config.hand.kind == "leap" { FaultyDevice::Dynamixel } else { FaultyDevice::Robotiq };
        let [_, arm_section, hand_section] = sections(config);
        for (section, faults) in [(arm_section, &faults.arm), (hand_section, &faults.hand)] {
            anyhow::ensure!(
                faults.is_empty() || section.is_emulated(),
                "simulation.wire_faults.{0}: found {faults:?}, expected none: the {0} is not emulated",
                section.name
            );
        }
        let read = |name: &str, device, faults: &[String]| {
            let parsed = faults.iter().map(|fault| FaultRequest::parse(device, fault));
            parsed.collect::<Result<Vec<_>, _>>().with_context(|| format!("simulation.wire_faults.{name}"))
        };
        Ok(Self { arm: read("arm", FaultyDevice::Ur, &faults.arm)?, hand: read("hand", hand, &faults.hand)? })
    }
}

/// An arm behind its emulated wire, whose body is the wrist of the world's hand.
pub(super) async fn emulated_arm(
    config: &CellConfig,
    shared: &SharedWorld,
    mounted: HandId,
    home: &Isometry3<f64>,
    faults: Vec<FaultRequest>,
    trouble: &mut JoinSet<()>,
) -> anyhow::Result<Arc<dyn Arm>> {
    let settings = devices::arm::settings(config)?;
    let joints = devices::arm::joints_at(&settings, home)?;
    let mount = WristMount {
        model: devices::arm::model(&settings)?,
        world_from_base: settings.world_from_base(),
        flange_from_hand: settings.flange_from_hand(),
        joints,
    };
    let plant = WristPlant::new(shared, mounted, mount).await.context("the emulated arm's body")?;
    let wired = devices::arm::connect(config, Some((Box::new(plant), joints))).await?;
    let emulator = wired.emulator;
    // The emulator lives as long as this task.
    trouble.spawn(async move {
        let Some(emulator) = emulator else { return };
        carry_out(faults, |request, begins| befall_ur(&emulator, request, begins)).await;
        std::future::pending::<()>().await;
    });
    Ok(wired.arm)
}

/// A hand behind its emulated wire, whose body is the fingers of the world's hand.
pub(super) async fn emulated_hand(
    config: &CellConfig,
    shared: &SharedWorld,
    mounted: HandId,
    faults: Vec<FaultRequest>,
    trouble: &mut JoinSet<()>,
) -> anyhow::Result<Arc<dyn Hand>> {
    use devices::hand::HandSettings as Wire;
    let context = "the emulated hand's body";
    let body = match devices::hand::settings(config)? {
        Wire::Leap(settings) => {
            let ids = settings.joints.iter().map(|joint| joint.id).collect();
            // Full effort of the description is what the adapter calls full force.
            let plant =
                MotorPlant::new(shared, mounted, ids, settings.current_ma()).await.context(context)?;
            Body::Motors(Box::new(plant))
        }
        Wire::Robotiq(_) if config.hand.kind == "robotiq-3f" => {
            let plant = GripperPlant::three_finger(shared, mounted).await.context(context)?;
            Body::Gripper(Box::new(plant))
        }
        Wire::Robotiq(_) => {
            Body::Gripper(Box::new(GripperPlant::two_finger(shared, mounted).await.context(context)?))
        }
    };
    let wired = devices::hand::connect(config, Some(body))?;
    let emulator = wired.emulator;
    // The emulator lives as long as this task.
    trouble.spawn(async move {
        let Some(emulator) = emulator else { return };
        let befall = |request: &FaultRequest, begins: bool| match &*emulator {
            HandEmulator::Gripper { gripper, line } => {
                befall_gripper(gripper, std::slice::from_ref(line.faults()), request, begins);
            }
            HandEmulator::Bus(bus) => befall_bus(bus, request, begins),
        };
        carry_out(faults, befall).await;
        std::future::pending::<()>().await;
    });
    Ok(wired.hand.hand())
}

/// A free table as the settings that it stands for; what is wrong names the table.
pub(super) fn table<T: DeserializeOwned>(name: &str, table: toml::Table) -> anyhow::Result<T> {
    toml::Value::Table(table).try_into().map_err(|e: toml::de::Error| anyhow::anyhow!("{name}: {e}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use graspd_cell::observer::Silent;
    use graspd_cell::{Cell, clear_tray};

    async fn refused(text: &str) -> String {
        let config = CellConfig::parse(text).unwrap();
        match devices(&config).await {
            Ok(_) => panic!("{text} is accepted"),
            Err(error) => format!("{error:#}"),
        }
    }

    #[tokio::test]
    async fn what_is_wrong_is_named() {
        for (text, expected) in [
            ("[arm]\nkind = \"urr\"", "arm.kind: found \"urr\", expected one of mock, ur"),
            ("[arm]\nkind = \"ur\"\naddress = \"emulator\"", "motion is not armed for: arm"),
            (
                "[arm]\nkind = \"ur\"\naddress = \"10.0.0.1\"\narmed = true",
                "arm.address: found \"10.0.0.1\", expected \"emulator\": camera is a mock device",
            ),
            (
                "[simulation.wire_faults]\narm = [\"cut@3\"]",
                "simulation.wire_faults.arm: found [\"cut@3\"], expected none: the arm is not emulated",
            ),
            ("[hand]\nid = \"laep\"", "leap"),
            ("[simulation]\nobject = 3", "simulation: unknown field `object`"),
            ("[simulation]\nobjects = 300", "simulation.objects: found 300, expected at most 100"),
            ("[simulation]\nspeed = -1.0", "speed: found -1"),
            ("[simulation.faults.camera]\ndrop = 1.0", "unknown field `drop`"),
            ("[arm.settings.mock]\nreach = 1.0", "arm.settings.mock: unknown field `reach`"),
            ("[tray]\nyaw_rad = 0.5", "tray.yaw_rad"),
            (
                "[drop]\nposition_m = [0.22, 0, 0.25]",
                "the bin stands around drop.position_m = [0.22, 0.0, 0.25]: bins.bin.center_m: found",
            ),
            ("[tray]\nwall_height_m = 0.0", "tray.wall_height_m: found 0"),
            ("[simulation]\nscene = \"none.json\"", "none.json: cannot be read"),
        ] {
            let text = format!("{text}\n[simulation]\nobjects = 0\n");
            let text = if text.matches("[simulation]").count() > 1 {
                text.replacen("\n[simulation]\nobjects = 0\n", "", 1)
            } else {
                text
            };
            let message = refused(&text).await;
            assert!(message.contains(expected), "{message}\nshould contain\n{expected}");
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_run_counts_every_object_that_the_witness_sees() {
        let text = "[hand]\nid = \"robotiq-2f85\"\n[run]\ntrials = 3\n[simulation]\nobjects = 2\n";
        let config = CellConfig::parse(text).unwrap();
        let Devices { camera, arm, hand, witness, trouble: _trouble, .. } = devices(&config).await.unwrap();
        let report = super::super::with_planner(&config, async |planner| {
            let cell = Cell { camera, arm, hand, planner: Arc::new(planner), witness };
            Ok(clear_tray(&cell, &config, &mut Silent).await?)
        });
        let t = report.await.unwrap().tally;
        let sum = t.delivered.unwrap() + t.lost.unwrap() + t.in_tray.unwrap() + t.in_hand.unwrap();
        assert_eq!(sum, 2, "{t:?}");
        assert_eq!(t.remaining.len() as u32, t.in_tray.unwrap());
        // This gripper takes at least one of them, and each success is an object that arrived.
        assert!(t.successes >= 1 && t.successes <= t.delivered.unwrap(), "{t:?}");
    }
}
