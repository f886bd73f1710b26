//! A whole cell: mock devices in a simulated world, a real server that goes away in the middle of a run.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use graspd_adapters_mock::{
    After, ArmSettings, CameraSettings, FaultHandle, Faults, HandSettings, MockArm, MockCamera, MockHand,
    MotionFault, Mount, SharedWorld, SharedWorldSettings, Spell, StopKind,
};
use graspd_cell::config::CellConfig;
use graspd_cell::observer::{Event, Observer};
use graspd_cell::outcome::{End, Holding};
use graspd_cell::plan::PlannerClient;
use graspd_cell::record::{read_attempts, replay};
use graspd_cell::steps::{Step, Trouble};
use graspd_cell::{Cell, clear_tray};
use graspd_hands::library;
use graspd_sim::camera::look_at;
use graspd_sim::clutter::{Arrangement, arrange, assortment};
use graspd_sim::sensor::Sensor;
use graspd_sim::world::{Tray, WorldSettings};
use graspd_tests::TestServer;
use nalgebra::{Isometry3, Point3, Vector3};
use tokio::sync::Notify;

const OBJECTS: usize = 3;

/// Tells when the first attempt has ended, and keeps the troubles.
struct Watcher {
    first: Arc<Notify>,
    troubles: Vec<Trouble>,
}

impl Observer for Watcher {
    fn on(&mut self, event: &Event<'_>) {
        match event {
            Event::AttemptEnded { .. } => self.first.notify_one(),
            Event::Trouble { trouble, .. } => self.troubles.push(*trouble),
            _ => {}
        }
    }
}

/// A folder that goes with the test.
struct Folder(PathBuf);

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// What can go wrong with the devices of a cell, while it runs.
struct Buttons {
    arm: FaultHandle,
    hand: FaultHandle,
}

/// A camera that loses frames.
fn camera_faults() -> Faults {
    Faults { drop_share: 0.3, refused: Some(Spell::Calls(2)), ..Faults::default() }
}

/// A protective stop on the way.
fn stop_after(metres: f64) -> Option<MotionFault> {
    Some(MotionFault { after: After::Metres(metres), kind: StopKind::Protective })
}

async fn cell(endpoint: &str, arm_faults: Faults, hand_faults: Faults) -> (Cell, SharedWorld, Buttons) {
    let settings = WorldSettings { tray: Some(Tray::default()), ..WorldSettings::default() };
    let world = arrange(&settings, &assortment(OBJECTS, 1), Arrangement::Pile, 1).unwrap();
    let shared = SharedWorld::new(world, SharedWorldSettings::default()).unwrap();
    let hand = library::hand("robotiq-2f85").unwrap();
    let home = Isometry3::translation(0.40, 0.0, 0.6);
    let mounted = shared.add_hand(Arc::new(hand.clone()), home, None).await.unwrap();
    let eye = look_at(&Point3::new(0.0, -0.25, 0.75), &Point3::new(0.0, 0.0, 0.02), &Vector3::z());
    let mount = Mount::Fixed { world_from_camera: eye };
    let (lens, camera) = (Sensor::azure_kinect(), CameraSettings::default());
    let arm = MockArm::new(&shared, mounted, ArmSettings::default(), arm_faults).unwrap();
    let hand = MockHand::new(&shared, mounted, HandSettings::default(), hand_faults).await.unwrap();
    let buttons = Buttons { arm: arm.faults(), hand: hand.faults() };
    let cell = Cell {
        camera: Arc::new(MockCamera::new(&shared, camera, lens, mount, camera_faults()).unwrap()),
        arm: Arc::new(arm),
        hand: Arc::new(hand),
        planner: Arc::new(PlannerClient::new(endpoint)),
        witness: None,
    };
    (cell, shared, buttons)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_survives_faults_and_a_planner_that_is_restarted() {
    let server = TestServer::start().await;
    let arm_faults = Faults { motion: stop_after(0.15), ..Faults::default() };
    let hand_faults = Faults { silent: Some(Spell::Calls(2)), ..Faults::default() };
    let (cell, shared, _) = cell(&server.endpoint(), arm_faults, hand_faults).await;
    let folder = Folder(std::env::temp_dir().join(format!("graspd-e2e-cell-{}", std::process::id())));
    let mut config = CellConfig::default();
    config.hand.id = "robotiq-2f85".to_owned();
    config.run.time_limit_s = 240.0;
    config.recording.folder = Some(folder.0.clone());
    let first = Arc::new(Notify::new());
    let mut watcher = Watcher { first: Arc::clone(&first), troubles: Vec::new() };
    let restart = async {
        first.notified().await;
        let addr = server.addr;
        server.stop().await.unwrap().unwrap();
        tokio::time::sleep(Duration::from_secs(2)).await;
        let again = graspd_server::ServerConfig { listen: addr, ..TestServer::config() };
        TestServer::start_with(again).await
    };
    let (report, server) = tokio::join!(clear_tray(&cell, &config, &mut watcher), restart);
    let report = report.unwrap();
    let census = shared.census().await.unwrap();
    assert_eq!(census.total(), OBJECTS, "an object is lost from the count: {census:?}");
    // Which grasps hold is physics; that no device is given up, that the run ends in order, and that it counts what
    // arrived, is the cell's.
    match &report.end {
        End::Empty => assert!(census.tray.is_empty(), "{census:?}"),
        End::NoGrasp { .. } => assert!(!census.tray.is_empty(), "{census:?}"),
        end => panic!("ended by {end}: {report:?}"),
    }
    assert_eq!(report.holding, Holding::Nothing, "{report:?}");
    assert!(census.held.is_empty() && census.elsewhere.is_empty(), "{census:?}");
    assert!(census.delivered.len() >= 2, "{report:?}");
    let tally = &report.tally;
    assert_eq!(tally.successes as usize, census.delivered.len(), "{report:?}");
    let failures: u32 = tally.failures.values().sum();
    assert_eq!(tally.attempts, tally.successes + failures + tally.not_executed + tally.unknown, "{report:?}");
    assert_eq!((tally.trials, tally.unknown), (tally.successes + failures, 0), "{report:?}");
    for trouble in [Trouble::PlannerAway, Trouble::NoAnswer, Trouble::Stop] {
        assert!(watcher.troubles.contains(&trouble), "{trouble:?} was not met: {:?}", watcher.troubles);
    }
    // Every attempt can be planned again from its record, by a server that never saw the run.
    let planner = PlannerClient::new(&server.endpoint());
    let attempts = read_attempts(&folder.0).unwrap().records;
    assert_eq!(attempts.len() as u32, report.tally.attempts);
    for attempt in attempts.iter().filter(|a| a.answer.is_some()) {
        let again = replay(&planner, &folder.0, attempt.attempt, Duration::from_secs(60)).await.unwrap();
        assert!(again.same, "attempt {}: {:?}", attempt.attempt, again.apart);
    }
}

/// Presses a button at the first beginning of each step in which an object is in the hand, and keeps the troubles.
struct Saboteur {
    buttons: Buttons,
    pressed: Vec<Step>,
    troubles: Vec<(Step, Trouble)>,
}

impl Observer for Saboteur {
    fn on(&mut self, event: &Event<'_>) {
        match event {
            Event::Trouble { step, trouble, .. } => self.troubles.push((*step, *trouble)),
            Event::StepBegan { step, .. } if !self.pressed.contains(step) => {
                let Buttons { arm, hand } = &self.buttons;
                match step {
                    Step::Lift => arm.update(|f| f.motion = stop_after(0.05)).unwrap(),
                    Step::Carry => arm.update(|f| f.motion = stop_after(0.15)).unwrap(),
                    Step::CheckHeld | Step::CheckDelivered | Step::Release => {
                        hand.update(|f| f.silent = Some(Spell::Calls(1))).unwrap();
                    }
                    _ => return,
                }
                self.pressed.push(*step);
            }
            _ => {}
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_in_the_hand_survives_stops_and_silence() {
    let server = TestServer::start().await;
    let (cell, shared, buttons) = cell(&server.endpoint(), Faults::default(), Faults::default()).await;
    let mut config = CellConfig::default();
    config.hand.id = "robotiq-2f85".to_owned();
    config.run.time_limit_s = 240.0;
    let mut saboteur = Saboteur { buttons, pressed: Vec::new(), troubles: Vec::new() };
    let report = clear_tray(&cell, &config, &mut saboteur).await.unwrap();
    let census = shared.census().await.unwrap();
    let told = (&report, &census, &saboteur.troubles);
    assert_eq!(census.total(), OBJECTS, "{told:?}");
    assert!(census.held.is_empty() && census.elsewhere.is_empty(), "{told:?}");
    assert!(matches!(report.end, End::Empty | End::NoGrasp { .. }), "{told:?}");
    assert_eq!(report.holding, Holding::Nothing, "{told:?}");
    assert_eq!(report.tally.successes as usize, census.delivered.len(), "{told:?}");
    assert!(census.delivered.len() >= 2, "{told:?}");
    for met in [
        (Step::Lift, Trouble::Stop),
        (Step::CheckHeld, Trouble::NoAnswer),
        (Step::Carry, Trouble::Stop),
        (Step::CheckDelivered, Trouble::NoAnswer),
        (Step::Release, Trouble::NoAnswer),
    ] {
        assert!(saboteur.troubles.contains(&met), "{met:?} was not met: {told:?}");
    }
    server.stop().await.unwrap().unwrap();
}
