//! The shared world itself: where things are, what time does, whether it all repeats.

use std::sync::Arc;
use std::time::Duration;

use graspd_adapters_core::{Arm, DepthCamera, DeviceError, GripCommand, Hand};
use graspd_adapters_mock::{
    ArmSettings, Bin, Census, Faults, MockArm, SharedWorld, SharedWorldSettings, WorldEnded,
};
use graspd_sim::scene;
use graspd_sim::world::{World, WorldSettings};
use nalgebra::Isometry3;

use crate::fixtures::{
    HALF, LIMITS, TEN, arm, box_in_tray, camera, close, cuboid, down, fingers, lens, shared,
};

/// Grips the box, carries it to a place, lets go.
async fn carry(shared: &SharedWorld, x: f64, z: f64) -> Census {
    let arm = arm(shared, Faults::default()).await;
    let hand = fingers(shared, arm.hand(), Faults::default()).await;
    arm.move_linear(&down(0.0, 0.0, 0.08), LIMITS, TEN).await.unwrap();
    hand.grip(&close(0.06), TEN).await.unwrap();
    for place in [down(0.0, 0.0, 0.25), down(x, 0.0, 0.25), down(x, 0.0, z)] {
        arm.move_linear(&place, LIMITS, TEN).await.unwrap();
    }
    let census = shared.census().await.unwrap();
    assert_eq!((census.held.len(), census.total()), (1, 1), "{census:?}");
    hand.grip(&close(0.0), TEN).await.unwrap();
    shared.wait(1.0).await.unwrap();
    shared.census().await.unwrap()
}

#[tokio::test]
async fn what_is_let_go_above_a_bin_is_delivered() {
    let shared = shared(0.0);
    let before = shared.census().await.unwrap();
    assert_eq!((before.tray.len(), before.total()), (1, 1));
    let rim = Bin::default().opening();
    let census = carry(&shared, rim.x, rim.z + 0.13).await;
    assert_eq!((census.delivered.len(), census.total()), (1, 1), "{census:?}");
    assert_eq!(census.delivered[0].name, "box");
    assert_eq!(census.delivered, shared.delivered().await.unwrap());
    assert!(shared.objects().await.unwrap().is_empty());
}

#[tokio::test]
async fn what_is_let_go_beside_the_tray_is_elsewhere() {
    let settings = SharedWorldSettings { bins: Vec::new(), ..SharedWorldSettings::default() };
    let shared = SharedWorld::new(box_in_tray(), settings).unwrap();
    let census = carry(&shared, 0.35, 0.12).await;
    assert_eq!((census.elsewhere.len(), census.total()), (1, 1), "{census:?}");
}

#[tokio::test]
async fn what_lies_in_the_middle_of_a_bare_table_is_where_a_tray_would_be() {
    let mut world = World::new(WorldSettings::default());
    world.add(cuboid(), &Isometry3::translation(0.0, 0.0, HALF[2]));
    world.add(cuboid(), &Isometry3::translation(0.0, 0.4, HALF[2]));
    let shared = SharedWorld::new(world, SharedWorldSettings::default()).unwrap();
    let census = shared.census().await.unwrap();
    assert_eq!((census.tray.len(), census.elsewhere.len(), census.total()), (1, 1, 2), "{census:?}");
}

#[tokio::test]
async fn the_same_calls_give_the_same_world() {
    let run = || async {
        let shared = shared(0.0);
        shared.with(|world| world.add(cuboid(), &Isometry3::translation(0.1, 0.1, 0.1))).await.unwrap();
        let arm = arm(&shared, Faults { latency_s: 0.01, jitter_s: 0.02, ..Faults::default() }).await;
        let hand = fingers(&shared, arm.hand(), Faults::default()).await;
        arm.move_linear(&down(0.0, 0.0, 0.08), LIMITS, TEN).await.unwrap();
        hand.grip(&close(0.06), TEN).await.unwrap();
        arm.move_linear(&down(0.05, 0.05, 0.2), LIMITS, TEN).await.unwrap();
        (shared.time_s(), shared.objects().await.unwrap())
    };
    assert_eq!(run().await, run().await);
}

#[tokio::test]
async fn the_world_can_be_looked_at_and_saved() {
    let shared = shared(0.0);
    let json = shared.scene_json().await.unwrap();
    let again = scene::from_json(&json).unwrap();
    assert_eq!(again.ids().len(), 1);
    let view =
        shared.view(lens(), Isometry3::new([0.0, 0.0, 0.5].into(), [std::f64::consts::PI, 0.0, 0.0].into()));
    let view = view.await.unwrap();
    assert!((view.depth_m[24 * 64 + 32] - 0.45).abs() < 1e-3);
    let picture = shared.picture(lens(), view.world_from_camera).await.unwrap();
    assert_eq!((picture.width, picture.height, picture.pixels.len()), (64, 48, 64 * 48));
}

#[tokio::test]
async fn impossible_settings_are_named() {
    let make = |settings| SharedWorld::new(box_in_tray(), settings).map(|_| ()).map_err(|e| e.field);
    assert_eq!(make(SharedWorldSettings::default()), Ok(()));
    let speed = f64::NAN;
    assert_eq!(make(SharedWorldSettings { speed, ..SharedWorldSettings::default() }), Err("speed".into()));
    let bin = Bin { half_extents_m: [0.1, -0.1], ..Bin::default() };
    let bins = vec![bin];
    let field = make(SharedWorldSettings { bins, ..SharedWorldSettings::default() }).unwrap_err();
    assert_eq!(field, "bins.bin.half_extents_m");
    // The tray's outer edge is at 0.188 m.
    let at = |x: f64| SharedWorldSettings {
        bins: vec![Bin { center_m: [x, 0.0], ..Bin::default() }],
        ..SharedWorldSettings::default()
    };
    assert_eq!((make(at(0.34)), make(at(-0.34))), (Ok(()), Ok(())));
    for x in [0.33, 0.0, f64::NAN] {
        assert_eq!(make(at(x)), Err("bins.bin.center_m".into()), "{x}");
    }
}

#[tokio::test]
async fn a_hold_stops_the_clock_at_an_exact_moment_until_it_is_dropped() {
    let shared = shared(0.0);
    let held = shared.hold_after(0.0).await.unwrap();
    let began_s = shared.time_s();
    let (went_on, ()) = tokio::join!(shared.wait(2.0), async {
        let held = held.go_on(0.5).await.unwrap();
        tokio::time::sleep(Duration::from_millis(30)).await;
        assert!((shared.time_s() - began_s - 0.5).abs() < 1e-9, "{}", shared.time_s());
        drop(held);
    });
    went_on.unwrap();
    // One that is given up holds nothing.
    assert!(tokio::time::timeout(Duration::ZERO, shared.hold_after(1e9)).await.is_err());
    shared.wait(1.0).await.unwrap();
    let still_s = shared.time_s();
    tokio::time::sleep(Duration::from_millis(30)).await;
    assert_eq!(shared.time_s(), still_s);
}

#[tokio::test]
async fn two_arms_with_different_hands_work_in_one_world() {
    let shared = shared(0.0);
    let place = Isometry3::translation(0.1, 0.1, HALF[2]);
    shared.with(move |world| world.add(cuboid(), &place)).await.unwrap();
    let first = arm(&shared, Faults::default()).await;
    let leap = Arc::new(graspd_hands::library::hand("leap").unwrap().clone());
    let mounted = shared.add_hand(leap.clone(), down(-0.1, -0.1, 0.35), None).await.unwrap();
    let settings = ArmSettings { name: "second arm".into(), ..ArmSettings::default() };
    let second = MockArm::new(&shared, mounted, settings, Faults::default()).unwrap();
    let fingers_of_leap = fingers(&shared, mounted, Faults::default()).await;
    assert_eq!(fingers_of_leap.info().actuators.len(), 16);
    let fist = GripCommand { actuators: leap.actuation.closed(), speed: 1.0, force: 0.5 };
    let hand = fingers(&shared, first.hand(), Faults::default()).await;
    let pick = async {
        first.move_linear(&down(0.0, 0.0, 0.08), LIMITS, TEN).await.unwrap();
        hand.grip(&close(0.06), TEN).await.unwrap();
        first.move_linear(&down(0.0, 0.0, 0.2), LIMITS, TEN).await.unwrap();
    };
    let wave = async {
        second.move_to(&down(-0.1, -0.1, 0.45), LIMITS, TEN).await.unwrap();
        fingers_of_leap.grip(&fist, TEN).await.unwrap()
    };
    let ((), state) = tokio::join!(pick, wave);
    assert!(state.settled);
    let census = shared.census().await.unwrap();
    assert_eq!((census.held.len(), census.tray.len(), census.total()), (1, 1, 2), "{census:?}");
    assert_eq!(census.held[0].0, first.hand());
}

#[tokio::test]
async fn devices_of_a_world_that_has_ended_are_disconnected() {
    let shared = shared(0.0);
    let camera = camera(&shared, Faults { drop_share: 1.0, ..Faults::default() });
    let arm = arm(&shared, Faults::default()).await;
    let second = Duration::from_secs(1);
    let (capture, ended) = tokio::join!(camera.capture(second, 100_000 * second), async {
        shared.with::<()>(|_| std::panic::resume_unwind(Box::new("a step that fails"))).await
    });
    assert_eq!(ended, Err(WorldEnded));
    for error in [capture.unwrap_err(), arm.state(second).await.unwrap_err()] {
        assert!(matches!(error, DeviceError::Disconnected { .. }), "{error}");
    }
    assert_eq!(shared.objects().await, Err(WorldEnded));
}
