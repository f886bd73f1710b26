//! Hands: gripping, feeling, faults.

use std::f64::consts::PI;
use std::sync::Arc;
use std::time::Duration;

use graspd_adapters_core::{Arm, DeviceError, FaultKind, GripCommand, Hand};
use graspd_adapters_mock::{
    ArmSettings, Faults, HandSettings, MockArm, MockHand, Overload, SharedWorld, SharedWorldSettings, Spell,
};
use graspd_hands::CoordinateKind;
use graspd_sim::object::Object;
use graspd_sim::world::{Tray, World, WorldSettings};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use crate::fixtures::{LIMITS, SECOND, TEN, arm, close, down, fingers, gripper, shared};

async fn hand_in_the_air(faults: Faults) -> (SharedWorld, MockHand) {
    let shared = shared(0.0);
    let hand = gripper(&shared).await;
    let fingers = fingers(&shared, hand, faults).await;
    (shared, fingers)
}

#[tokio::test]
async fn fingers_that_close_on_nothing_reach_their_target_and_feel_nothing() {
    let (_shared, hand) = hand_in_the_air(Faults::default()).await;
    let info = hand.info();
    assert_eq!((info.hand_id.as_str(), info.actuators.as_slice()), ("antipodal", &["grip".to_owned()][..]));
    let state = hand.grip(&close(0.04), TEN).await.unwrap();
    assert!(state.settled && !state.feels_object(), "{state:?}");
    assert!((state.actuators[0] - 0.04).abs() < 1e-3, "{state:?}");
    assert_eq!(hand.state(SECOND).await.unwrap(), state);
}

#[tokio::test]
async fn fingers_that_close_on_a_box_are_held_and_carry_it() {
    let shared = shared(0.0);
    let arm = arm(&shared, Faults::default()).await;
    let hand = fingers(&shared, arm.hand(), Faults::default()).await;
    arm.move_linear(&down(0.0, 0.0, 0.08), LIMITS, TEN).await.unwrap();
    let state = hand.grip(&close(0.06), TEN).await.unwrap();
    assert_eq!(state.held, [true]);
    // 12 cm open, the box is 5 cm wide: each finger has gone 3.5 cm.
    assert!((state.actuators[0] - 0.035).abs() < 2e-3, "{state:?}");
    arm.move_linear(&down(0.0, 0.0, 0.25), LIMITS, TEN).await.unwrap();
    let held = shared.held().await.unwrap();
    assert_eq!(held.len(), 1);
    assert_eq!(held[0].0, arm.hand());
    assert!(hand.state(SECOND).await.unwrap().feels_object());
}

#[tokio::test]
async fn a_hand_that_does_not_feel_says_nothing_about_contact() {
    let shared = shared(0.0);
    let id = gripper(&shared).await;
    let settings = HandSettings { feels_contact: false, ..HandSettings::default() };
    let hand = MockHand::new(&shared, id, settings, Faults::default()).await.unwrap();
    assert!(hand.grip(&close(0.03), TEN).await.unwrap().held.is_empty());
    assert!(shared.with(move |world| world.remove_hand(id)).await.unwrap());
    let error = hand.state(SECOND).await.unwrap_err();
    assert!(matches!(error, DeviceError::Disconnected { .. }), "{error}");
    assert!(MockHand::new(&shared, id, HandSettings::default(), Faults::default()).await.is_err());
}

#[tokio::test]
async fn what_cannot_be_is_refused_before_anything_moves() {
    let (shared, hand) = hand_in_the_air(Faults::default()).await;
    let cases = [
        (GripCommand { actuators: vec![0.0, 0.0], ..close(0.0) }, "actuators"),
        (close(0.07), "actuators.grip"),
        (close(f64::NAN), "actuators.grip"),
        (GripCommand { force: 1.5, ..close(0.0) }, "force"),
        (GripCommand { speed: -0.1, ..close(0.0) }, "speed"),
    ];
    for (command, expected) in cases {
        let error = hand.grip(&command, TEN).await.unwrap_err();
        assert!(matches!(&error, DeviceError::OutOfRange { field, .. } if field == expected), "{error}");
    }
    assert_eq!(shared.time_s(), 0.0);
}

#[tokio::test]
async fn a_hand_that_does_not_answer_times_out_and_does_nothing() {
    let (shared, hand) = hand_in_the_air(Faults { silent: Some(Spell::Calls(2)), ..Faults::default() }).await;
    let error = hand.grip(&close(0.06), SECOND).await.unwrap_err();
    assert!(matches!(error, DeviceError::Timeout { operation: "grip", .. }), "{error}");
    assert!((shared.time_s() - 1.0).abs() < 0.005);
    let error = hand.state(SECOND).await.unwrap_err();
    assert!(matches!(error, DeviceError::Timeout { operation: "state", .. }), "{error}");
    assert!(hand.state(SECOND).await.unwrap().actuators[0] < 1e-3);
    hand.faults().update(|f| f.refused = Some(Spell::Calls(1))).unwrap();
    let error = hand.grip(&close(0.06), SECOND).await.unwrap_err();
    assert!(matches!(error, DeviceError::Disconnected { .. }), "{error}");
}

#[tokio::test]
async fn an_overloaded_hand_lets_go_and_works_again_when_cleared() {
    let shared = shared(0.0);
    let arm = arm(&shared, Faults::default()).await;
    let hand = fingers(&shared, arm.hand(), Faults::default()).await;
    arm.move_linear(&down(0.0, 0.0, 0.08), LIMITS, TEN).await.unwrap();
    hand.grip(&close(0.06), TEN).await.unwrap();
    arm.move_linear(&down(0.0, 0.0, 0.15), LIMITS, TEN).await.unwrap();
    hand.faults().update(|f| f.overload = Some(Overload { after_s: 0.02 })).unwrap();
    let error = hand.grip(&close(0.06), TEN).await.unwrap_err();
    assert!(matches!(error, DeviceError::Fault { kind: FaultKind::Overload, .. }), "{error}");
    assert!(error.is_clearable());
    shared.wait(1.0).await.unwrap();
    assert!(shared.held().await.unwrap().is_empty(), "fingers without force hold nothing");
    assert!(!hand.state(SECOND).await.unwrap().feels_object());
    let refused = hand.grip(&close(0.0), TEN).await.unwrap_err();
    assert!(matches!(refused, DeviceError::Fault { kind: FaultKind::Overload, .. }), "{refused}");
    hand.clear_fault(SECOND).await.unwrap();
    hand.grip(&close(0.0), TEN).await.unwrap();
}

#[tokio::test]
async fn a_second_grip_is_refused_while_one_runs() {
    let (shared, hand) = hand_in_the_air(Faults::default()).await;
    let slow = GripCommand { speed: 0.1, ..close(0.05) };
    let held = shared.hold_after(0.0).await.unwrap();
    let (first, second) = tokio::join!(hand.grip(&slow, TEN), async {
        let held = held.go_on(0.1).await.unwrap();
        let command = close(0.0);
        tokio::join!(hand.grip(&command, TEN), async { drop(held) }).0
    });
    assert!((first.unwrap().actuators[0] - 0.05).abs() < 1e-3);
    assert!(matches!(second, Err(DeviceError::Busy { .. })), "{second:?}");
}

#[tokio::test]
async fn a_grip_that_takes_too_long_is_stopped_and_times_out_in_time() {
    let (shared, hand) = hand_in_the_air(Faults::default()).await;
    let slow = GripCommand { speed: 0.05, ..close(0.06) };
    let error = hand.grip(&slow, SECOND).await.unwrap_err();
    assert!(matches!(error, DeviceError::Timeout { operation: "grip", .. }), "{error}");
    assert!(shared.time_s() <= 1.003);
    let at = hand.state(SECOND).await.unwrap().actuators[0];
    shared.wait(1.0).await.unwrap();
    let later = hand.state(SECOND).await.unwrap().actuators[0];
    assert!((later - at).abs() < 1e-3 && later < 0.03, "{at}, then {later}");
}

#[tokio::test]
async fn dropping_a_grip_stops_the_fingers() {
    let (shared, hand) = hand_in_the_air(Faults::default()).await;
    shared.pause();
    let slow = GripCommand { speed: 0.05, ..close(0.06) };
    let dropped = tokio::time::timeout(Duration::from_millis(20), hand.grip(&slow, 1000 * SECOND)).await;
    assert!(dropped.is_err());
    shared.resume();
    shared.wait(1.0).await.unwrap();
    assert!(hand.state(SECOND).await.unwrap().actuators[0] < 0.005);
    assert!((hand.grip(&close(0.02), TEN).await.unwrap().actuators[0] - 0.02).abs() < 1e-3);
}

#[tokio::test]
async fn an_answer_that_is_lost_does_not_undo_what_was_done() {
    let (shared, hand) = hand_in_the_air(Faults::default()).await;
    let command = close(0.04);
    let held = shared.hold_after(0.0).await.unwrap();
    let (lost, ()) = tokio::join!(hand.grip(&command, TEN), async {
        let _held = held.go_on(0.1).await.unwrap();
        hand.faults().update(|f| f.silent = Some(Spell::Seconds(9.0))).unwrap();
    });
    let DeviceError::Timeout { after, .. } = lost.unwrap_err() else { panic!("an answer came") };
    assert_eq!(after, TEN);
    assert!((hand.state(SECOND).await.unwrap().actuators[0] - 0.04).abs() < 1e-3);
}

#[tokio::test]
async fn fingers_that_are_pressed_against_something_still_come_to_an_end() {
    let shared = shared(0.0);
    let described = Arc::new(graspd_hands::library::hand("finray-2f").unwrap().clone());
    let turn = UnitQuaternion::rotation_between(&described.approach, &-Vector3::z_axis());
    let turn = turn.unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI));
    // The middle of the first finger's pad above the box, then two centimetres into it.
    let links = described
        .tree
        .link_poses(&described.tree.body_poses(&described.actuation.joints(&described.actuation.open())));
    let pad = turn * (links[described.pads[0].link] * described.pads[0].center).coords;
    let at = |z: f64| Isometry3::from_parts((Vector3::new(0.0, 0.0, z) - pad).into(), turn);
    let id = shared.add_hand(described.clone(), at(0.2), None).await.unwrap();
    let arm = MockArm::new(&shared, id, ArmSettings::default(), Faults::default()).unwrap();
    let hand = fingers(&shared, id, Faults::default()).await;
    let pressed = arm.move_linear(&at(0.03), LIMITS, TEN).await;
    assert!(
        matches!(pressed, Err(DeviceError::Fault { kind: FaultKind::ProtectiveStop, .. })),
        "{pressed:?}"
    );
    let began_s = shared.time_s();
    let state = hand.grip(&close(described.actuation.closed()[0]), TEN).await.unwrap();
    assert!(state.settled && shared.time_s() - began_s < 3.0);
}

/// A hand of the library, reaching down, its tool point at a height above the tray's middle.
fn reaching(hand: &graspd_hands::Hand, tool_z: f64) -> Isometry3<f64> {
    let turn = UnitQuaternion::rotation_between(&hand.approach, &-Vector3::z_axis());
    let turn = turn.unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI));
    let at = Vector3::new(0.0, 0.0, tool_z) - turn * hand.tool_point.coords;
    Isometry3::from_parts(at.into(), turn)
}

/// Closes a hand around a box (or nothing), lifts; what it felt when closed and when lifted, and what it holds by
/// physics. `None` when fingers and box go round and round: the hand says so with a time-out.
async fn close_and_lift(id: &str, object: Option<[f64; 3]>) -> Option<(bool, bool, usize)> {
    let described = Arc::new(graspd_hands::library::hand(id).unwrap().clone());
    let mut world = World::new(WorldSettings { tray: Some(Tray::default()), ..WorldSettings::default() });
    if let Some(half) = object {
        let cuboid = Object::cuboid("box", Vector3::from(half)).unwrap();
        world.add(Arc::new(Object { mass_kg: 0.1, ..cuboid }), &Isometry3::translation(0.0, 0.0, half[2]));
    }
    let shared = SharedWorld::new(world, SharedWorldSettings::default()).unwrap();
    let placed = shared.add_hand(described.clone(), reaching(&described, 0.06), None).await.unwrap();
    // Fingers that squeeze a box askew press it on the table: what a hand feels is asked here, not what an arm bears.
    let patient = ArmSettings { stop_force_n: None, ..ArmSettings::default() };
    let arm = MockArm::new(&shared, placed, patient, Faults::default()).unwrap();
    let hand = fingers(&shared, placed, Faults::default()).await;
    let driven = described.actuation.coordinates.iter().filter(|c| c.kind == CoordinateKind::Actuator);
    let actuators = driven.map(|c| c.closed).collect();
    let closed = hand.grip(&GripCommand { actuators, speed: 1.0, force: 0.7 }, TEN).await;
    let closed = match closed {
        Err(DeviceError::Timeout { .. }) => return None,
        closed => closed.unwrap(),
    };
    let up = arm.move_linear(&reaching(&described, 0.2), LIMITS, TEN).await;
    up.unwrap_or_else(|e| panic!("{id} closed on {object:?}: {e}"));
    let lifted = hand.state(SECOND).await.unwrap();
    Some((closed.feels_object(), lifted.feels_object(), shared.held().await.unwrap().len()))
}

#[tokio::test]
async fn every_hand_feels_what_it_holds_and_nothing_when_it_holds_nothing() {
    let (mut held, mut caged): (Vec<&str>, usize) = (Vec::new(), 0);
    for id in graspd_hands::library::ids() {
        assert_eq!(close_and_lift(id, None).await, Some((false, false, 0)), "{id} closed on nothing");
        let Some((closed, lifted, holds)) = close_and_lift(id, Some([0.07, 0.02, 0.045])).await else {
            continue;
        };
        assert!(!lifted || holds > 0, "{id} feels what it does not hold");
        // A box that lies on curled fingers presses on no motor.
        caged += usize::from(!lifted && holds > 0);
        assert!(closed || holds == 0, "{id}");
        held.extend((holds > 0).then_some(id));
    }
    assert!(held.len() >= 7, "only {held:?} hold the box");
    assert!(caged <= 1, "{caged} of {held:?} do not feel it");
}

#[tokio::test]
async fn a_gripper_feels_what_is_thinner_than_its_tolerance() {
    // Two per cent of this gripper's way are 1.2 mm; the sheet keeps each finger from 0.5 mm of it.
    let shared = shared(0.0);
    let arm = arm(&shared, Faults::default()).await;
    let hand = fingers(&shared, arm.hand(), Faults::default()).await;
    let sheet = Object::cuboid("sheet", Vector3::new(0.03, 0.0005, 0.03)).unwrap();
    let sheet = Arc::new(Object { mass_kg: 0.02, ..sheet });
    shared
        .with(move |world| {
            for id in world.ids() {
                world.remove(id);
            }
            world.add(sheet, &Isometry3::translation(0.0, 0.0, 0.03));
        })
        .await
        .unwrap();
    arm.move_linear(&down(0.0, 0.0, 0.08), LIMITS, TEN).await.unwrap();
    assert!(hand.grip(&close(0.06), TEN).await.unwrap().feels_object());
    arm.move_linear(&down(0.0, 0.0, 0.25), LIMITS, TEN).await.unwrap();
    assert!(hand.state(SECOND).await.unwrap().feels_object());
    assert_eq!(shared.held().await.unwrap().len(), 1);
}
