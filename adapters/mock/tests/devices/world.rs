//! The shared world itself: where things are, what time does, whether it all repeats.

use graspd_adapters_core::{Arm, Hand};
use graspd_adapters_mock::{Bin, Census, Faults, SharedWorld, SharedWorldSettings};
use graspd_sim::scene;
use nalgebra::Isometry3;

use crate::fixtures::{LIMITS, TEN, arm, box_in_tray, close, cuboid, down, fingers, lens, shared};

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
    let view = shared.view(lens(), Isometry3::new([0.0, 0.0, 0.5].into(), [3.1415927, 0.0, 0.0].into()));
    let view = view.await.unwrap();
    assert!((view.depth_m[24 * 64 + 32] - 0.45).abs() < 1e-3);
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
}
