//! The devices of a cell, in one simulated world: mock ones, and emulated ones whose wires lead into it.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::Context as _;
use graspd_adapters_core::{Arm, DepthCamera, Hand};
use graspd_adapters_emulators::requests::{
    FaultRequest, FaultyDevice, befall_bus, befall_gripper, befall_ur, carry_out,
};
use graspd_adapters_mock::plants::{GripperPlant, MotorPlant, WristMount, WristPlant};
use graspd_adapters_mock::{
    ArmSettings, Bin, CameraSettings, Census, Faults, HandSettings, MockArm, MockCamera, MockHand, Mount,
    SharedWorld, SharedWorldSettings, WorldEnded,
};
use graspd_cell::config::CellConfig;
use graspd_cell::pose::pointing_down;
use graspd_cell::witness::{Witness, Witnessed};
use graspd_hands::{Opening, library};
use graspd_sim::camera::look_at;
use graspd_sim::clutter::{Arrangement, Sizes, arrange};
use graspd_sim::scene;
use graspd_sim::sensor::Sensor;
use graspd_sim::world::{HandId, ObjectId, Tray, World, WorldSettings};
use nalgebra::{Isometry3, Point3, Vector3};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use tokio::task::JoinSet;

use crate::devices::hand::{Body, HandEmulator};
use crate::devices::{self, EMULATOR, Section, sections};
use crate::hand_source;

/// Simulated seconds for dropped things to fall and roll before they are counted.
const REST_S: f64 = 0.8;
/// However wide a hand opens, the drawn objects are household objects that lie five in a tray, metres.
const WIDEST_OPENING_M: f64 = 0.12;
/// Most objects that a tray is filled with.
const MOST_OBJECTS: usize = 100;

/// `[simulation]`
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Simulation {
    /// Number of objects.
    objects: usize,
    /// Shortest edge that an object has at least, metres; the hand's if left out.
    thinnest_m: Option<f64>,
    /// Middle edge that an object has at most, metres; the hand's if left out.
    widest_m: Option<f64>,
    /// How they are put into the tray.
    arrangement: ArrangementName,
    /// Seed of objects and arrangement.
    seed: u64,
    /// A scene file instead of drawn objects; it brings its own tray.
    scene: Option<PathBuf>,
    /// Noise of the depth camera.
    sensor: SensorName,
    /// How many times as fast as the wall clock the world runs; 0: as fast as it can, on demand. Emulated devices live on
    /// the wall clock: with them 0 means 1.
    speed: f64,
    /// What goes wrong with mock devices.
    faults: DeviceFaults,
    /// What goes wrong with emulated devices.
    wire_faults: WireFaults,
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
        }
    }
}

impl Simulation {
    /// Sizes of the objects that are drawn: what the hand can take, unless it is said.
    fn sizes(&self, hand: &graspd_hands::Hand) -> anyhow::Result<Sizes> {
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
enum ArrangementName {
    Pile,
    Packed,
}

#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum SensorName {
    AzureKinect,
    PicoFlexx,
    Ideal,
}

/// `[simulation.faults]`
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct DeviceFaults {
    camera: Faults,
    arm: Faults,
    hand: Faults,
}

/// `[simulation.wire_faults]`: as `graspd emulate --fault` takes them, counted from the beginning of the run.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct WireFaults {
    arm: Vec<String>,
    hand: Vec<String>,
}

/// The devices of a cell, and who knows what became of the objects.
pub(in crate::commands) struct Devices {
    pub(in crate::commands) camera: Arc<dyn DepthCamera>,
    pub(in crate::commands) arm: Arc<dyn Arm>,
    pub(in crate::commands) hand: Arc<dyn Hand>,
    /// Who knows what became of the objects; nobody in the real world.
    pub(in crate::commands) witness: Option<Arc<dyn Witness>>,
    /// What befalls emulated devices; ends with this.
    pub(in crate::commands) trouble: JoinSet<()>,
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
    let camera = camera(config, &sections[0], &simulation, &shared)?;
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
    Ok(Devices { camera, arm, hand, witness: Some(witness), trouble })
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
    Ok(Devices { camera, arm: arm.arm, hand: hand.hand.hand(), witness: None, trouble })
}

/// A camera of the simulated world.
fn camera(
    config: &CellConfig,
    section: &Section<'_>,
    simulation: &Simulation,
    shared: &SharedWorld,
) -> anyhow::Result<Arc<dyn DepthCamera>> {
    let mut sensor = match simulation.sensor {
        SensorName::PicoFlexx => Sensor::pico_flexx(),
        SensorName::AzureKinect | SensorName::Ideal => Sensor::azure_kinect(),
    };
    if simulation.sensor == SensorName::Ideal {
        sensor = Sensor::ideal(sensor.lens);
    }
    let (eye, target) = (Point3::from(config.camera.position_m), Point3::from(config.camera.looks_at_m));
    let mount = Mount::Fixed { world_from_camera: look_at(&eye, &target, &Vector3::z()) };
    let settings: CameraSettings = section.settings(&[])?;
    let camera = MockCamera::new(shared, settings, sensor, mount, simulation.faults.camera.clone());
    Ok(Arc::new(camera.context("camera.settings.mock")?))
}

/// Faults of emulated devices to come.
struct Trouble {
    arm: Vec<FaultRequest>,
    hand: Vec<FaultRequest>,
}

impl Trouble {
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
async fn emulated_arm(
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
async fn emulated_hand(
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
fn table<T: DeserializeOwned>(name: &str, table: toml::Table) -> anyhow::Result<T> {
    toml::Value::Table(table).try_into().map_err(|e: toml::de::Error| anyhow::anyhow!("{name}: {e}"))
}

/// The world with the configured tray.
fn tray(config: &CellConfig) -> anyhow::Result<WorldSettings> {
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

fn fill(simulation: &Simulation, sizes: Sizes, settings: &WorldSettings) -> anyhow::Result<World> {
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

/// Tells by physics what became of the objects.
#[derive(Debug)]
struct SimulatedTruth {
    shared: SharedWorld,
    known: Mutex<Known>,
}

/// What a witness remembers.
#[derive(Debug)]
struct Known {
    /// Delivered when asked last.
    delivered: BTreeSet<ObjectId>,
    /// Beside the tray since before the run: not lost by it.
    beside: BTreeSet<ObjectId>,
}

impl SimulatedTruth {
    /// A witness of what becomes of the objects from now on.
    async fn new(shared: &SharedWorld) -> Result<Self, WorldEnded> {
        let census = shared.census().await?;
        let beside = census.elsewhere.iter().map(|object| object.id).collect();
        let known = Known { delivered: delivered(&census), beside };
        Ok(Self { shared: shared.clone(), known: Mutex::new(known) })
    }
}

fn delivered(census: &Census) -> BTreeSet<ObjectId> {
    census.delivered.iter().map(|object| object.id).collect()
}

#[graspd_adapters_core::async_trait]
impl Witness for SimulatedTruth {
    async fn outcome(&self, _attempt: u32) -> Option<Witnessed> {
        // A world that has ended has nothing to tell; the devices report it.
        self.shared.wait(REST_S).await.ok()?;
        let census = self.shared.census().await.ok()?;
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let elsewhere: BTreeSet<ObjectId> = census.elsewhere.iter().map(|object| object.id).collect();
        // What the run has moved is its own from then on.
        known.beside.retain(|id| elsewhere.contains(id));
        let arrived = delivered(&census);
        let witnessed = Witnessed {
            delivered: arrived.difference(&known.delivered).count() as u32,
            lost: elsewhere.difference(&known.beside).count() as u32,
            in_tray: census.tray.len() as u32,
            in_hand: census.held.len() as u32,
            remaining: census.tray.iter().map(|object| object.name.clone()).collect(),
        };
        known.delivered = arrived;
        Some(witnessed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use graspd_cell::observer::Silent;
    use graspd_cell::{Cell, clear_tray};
    use graspd_sim::object::Object;
    use nalgebra::Isometry3;

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

    /// What the witness says, and that it adds up to `objects`.
    async fn says(truth: &SimulatedTruth, before: &mut u32, objects: u32) -> Witnessed {
        let seen = truth.outcome(1).await.unwrap();
        *before += seen.delivered;
        assert_eq!(*before + seen.lost + seen.in_tray + seen.in_hand, objects, "{seen:?}");
        seen
    }

    #[tokio::test]
    async fn what_the_witness_counts_adds_up() {
        let mut world = World::new(WorldSettings { tray: Some(Tray::default()), ..WorldSettings::default() });
        let cuboid = |name: &str| Arc::new(Object::cuboid(name, Vector3::new(0.02, 0.02, 0.02)).unwrap());
        let at = |x: f64, y: f64| Isometry3::translation(x, y, 0.02);
        let first = world.add(cuboid("first"), &at(0.0, 0.0));
        let second = world.add(cuboid("second"), &at(0.1, 0.0));
        let beside = world.add(cuboid("beside"), &at(0.0, 0.35));
        let (beyond, bin) = (at(-0.3, 0.0), at(0.40, 0.0));
        let shared = SharedWorld::new(world, SharedWorldSettings::default()).unwrap();
        let truth = SimulatedTruth::new(&shared).await.unwrap();
        let place = |id, to: Isometry3<f64>| shared.with(move |world| assert!(world.place(id, &to)));
        let mut all = 0;
        let seen = says(&truth, &mut all, 2).await;
        assert_eq!(
            (seen.delivered, seen.lost, seen.in_tray),
            (0, 0, 2),
            "the third lay beside the tray before"
        );
        assert_eq!(seen.remaining, ["first", "second"]);
        // One leaves the tray, and stays where it is.
        place(first, beyond).await.unwrap();
        assert_eq!(says(&truth, &mut all, 2).await.lost, 1);
        assert_eq!(says(&truth, &mut all, 2).await.lost, 1, "still lost");
        // It comes back while the other one leaves: one is lost, as before, and it is another one.
        place(first, at(0.0, 0.0)).await.unwrap();
        place(second, beyond).await.unwrap();
        let seen = says(&truth, &mut all, 2).await;
        assert_eq!((seen.lost, &seen.remaining[..]), (1, &["first".to_owned()][..]));
        // What was lost is delivered after all.
        place(second, bin).await.unwrap();
        let seen = says(&truth, &mut all, 2).await;
        assert_eq!((seen.delivered, seen.lost, seen.in_tray), (1, 0, 1));
        assert_eq!(says(&truth, &mut all, 2).await.delivered, 0, "an object arrives once");
        // What lay beside the tray is the run's from when it picks it up.
        place(beside, at(0.1, 0.0)).await.unwrap();
        assert_eq!(says(&truth, &mut all, 3).await.in_tray, 2);
        place(beside, beyond).await.unwrap();
        assert_eq!(says(&truth, &mut all, 3).await.lost, 1);
        // A world that has ended has nothing to tell.
        let broken = shared.with::<()>(|_| std::panic::resume_unwind(Box::new("a step that fails"))).await;
        assert_eq!((broken, truth.outcome(1).await), (Err(WorldEnded), None));
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_run_counts_every_object_that_the_witness_sees() {
        let text = "[hand]\nid = \"robotiq-2f85\"\n[run]\ntrials = 3\n[simulation]\nobjects = 2\n";
        let config = CellConfig::parse(text).unwrap();
        let Devices { camera, arm, hand, witness, trouble: _trouble } = devices(&config).await.unwrap();
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
