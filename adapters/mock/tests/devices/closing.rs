//! Hands that close on objects: all fingers together, and on until they hold.

use std::sync::Arc;
use std::time::Duration;

use graspd_adapters_core::{Arm, CloseCommand, DeviceError, Hand};
use graspd_adapters_mock::{Faults, MockHand, Overload, SharedWorld, Spell};
use graspd_hands::{Coordinate, CoordinateKind};
use graspd_sim::world::HandId;
use nalgebra::Isometry3;

use crate::fixtures::{LIMITS, SECOND, TEN, arm, close, down, fingers, shared};

/// LEAP Hand, open, far above the tray.
async fn leap() -> (SharedWorld, MockHand, HandId, Vec<Coordinate>) {
    let shared = shared(0.0);
    let described = Arc::new(graspd_hands::library::hand("leap").unwrap().clone());
    let coordinates = described.actuation.coordinates.iter();
    let actuators = coordinates.filter(|c| c.kind == CoordinateKind::Actuator).cloned().collect();
    let id = shared.add_hand(described, Isometry3::translation(0.0, 0.0, 0.6), None).await.unwrap();
    let hand = fingers(&shared, id, Faults::default()).await;
    (shared, hand, id, actuators)
}

/// Contact after different shares of the way of every actuator, a squeeze of a twentieth of it.
fn uneven(actuators: &[Coordinate]) -> CloseCommand {
    let at = |extra: f64| {
        let of =
            |(i, c): (usize, &Coordinate)| c.open + ([0.2, 0.6, 0.4][i % 3] + extra) * (c.closed - c.open);
        actuators.iter().enumerate().map(of).collect()
    };
    CloseCommand {
        contact: at(0.0),
        squeezed: at(0.05),
        farthest: actuators.iter().map(|c| c.closed).collect(),
        meet: Duration::from_millis(500),
        speed: 1.0,
        force: 0.7,
    }
}

/// The parallel gripper around the box.
fn around_the_box() -> CloseCommand {
    CloseCommand {
        contact: vec![0.03],
        squeezed: vec![0.034],
        farthest: vec![0.06],
        meet: Duration::from_millis(500),
        speed: 1.0,
        force: 0.5,
    }
}

#[tokio::test]
async fn all_fingers_are_on_their_way_to_contact_by_the_same_share() {
    let (shared, hand, _, actuators) = leap().await;
    let command = uneven(&actuators);
    let held = shared.hold_after(0.0).await.unwrap();
    let (closed, halfway) = tokio::join!(hand.close(&command, TEN), async {
        let _held = held.go_on(0.3).await.unwrap();
        hand.state(SECOND).await.unwrap()
    });
    let shares: Vec<f64> = actuators
        .iter()
        .zip(&halfway.actuators)
        .zip(&command.contact)
        .filter(|((c, _), contact)| (*contact - c.open).abs() > 0.05)
        .map(|((c, at), contact)| (at - c.open) / (contact - c.open))
        .collect();
    let (least, most) = shares.iter().fold((1.0_f64, 0.0_f64), |(a, b), s| (a.min(*s), b.max(*s)));
    assert!(shares.len() >= 8 && least > 0.4 && most < 0.7, "{shares:?}");
    assert!(most - least < 0.1, "{shares:?}");
    assert!(!halfway.settled && !halfway.feels_object(), "{halfway:?}");
    // Nothing was between the fingers: they have gone on to their ends, and feel nothing.
    let closed = closed.unwrap();
    for ((at, c), squeezed) in closed.actuators.iter().zip(&actuators).zip(&command.squeezed) {
        let (gone, asked) = ((at - c.open) * (c.closed - c.open), (squeezed - c.open) * (c.closed - c.open));
        assert!(gone >= asked - 1e-2, "{}: {at}, told {squeezed}", c.name);
    }
    assert!(closed.settled && !closed.feels_object(), "{closed:?}");
}

#[tokio::test]
async fn fingers_that_expect_the_box_elsewhere_close_until_they_hold_it() {
    for contact in [0.01, 0.03, 0.045] {
        let shared = shared(0.0);
        let arm = arm(&shared, Faults::default()).await;
        let hand = fingers(&shared, arm.hand(), Faults::default()).await;
        arm.move_linear(&down(0.0, 0.0, 0.08), LIMITS, TEN).await.unwrap();
        let command =
            CloseCommand { contact: vec![contact], squeezed: vec![contact + 4e-3], ..around_the_box() };
        let state = hand.close(&command, TEN).await.unwrap();
        assert_eq!(state.held, [true], "contact expected at {contact}");
        // 12 cm open, the box is 5 cm wide: each finger has gone 3.5 cm.
        assert!((state.actuators[0] - 0.035).abs() < 2e-3, "{state:?}");
        // Closed once more, as after a lost answer, it does not open on the way.
        assert_eq!(hand.close(&command, TEN).await.unwrap().held, [true]);
        arm.move_linear(&down(0.0, 0.0, 0.25), LIMITS, TEN).await.unwrap();
        assert_eq!(shared.held().await.unwrap().len(), 1, "contact expected at {contact}");
    }
}

#[tokio::test]
async fn what_cannot_be_is_refused_before_anything_moves() {
    let (shared, hand, _, actuators) = leap().await;
    let good = uneven(&actuators);
    let name = &hand.info().actuators[1];
    let beyond = |list: &[f64]| {
        let mut list = list.to_vec();
        list[1] = 9.0;
        list
    };
    let cases = [
        (CloseCommand { contact: vec![0.1], ..good.clone() }, "contact".to_owned()),
        (CloseCommand { contact: beyond(&good.contact), ..good.clone() }, format!("contact.{name}")),
        (CloseCommand { squeezed: beyond(&good.squeezed), ..good.clone() }, format!("squeezed.{name}")),
        (CloseCommand { farthest: beyond(&good.farthest), ..good.clone() }, format!("farthest.{name}")),
        (CloseCommand { force: f64::NAN, ..good.clone() }, "force".to_owned()),
    ];
    for (command, expected) in cases {
        let error = hand.close(&command, TEN).await.unwrap_err();
        assert!(matches!(&error, DeviceError::OutOfRange { field, .. } if *field == expected), "{error}");
    }
    assert_eq!(shared.time_s(), 0.0);
}

#[tokio::test]
async fn faults_reach_who_closes() {
    let (shared, hand, id, actuators) = leap().await;
    let command = uneven(&actuators);
    hand.faults().update(|f| f.silent = Some(Spell::Calls(1))).unwrap();
    let error = hand.close(&command, SECOND).await.unwrap_err();
    assert!(matches!(error, DeviceError::Timeout { operation: "close", .. }), "{error}");
    let error = hand.close(&command, Duration::from_millis(300)).await.unwrap_err();
    assert!(matches!(error, DeviceError::Timeout { operation: "close", .. }), "{error}");
    let held = shared.hold_after(0.0).await.unwrap();
    let (first, second) = tokio::join!(hand.close(&command, TEN), async {
        let held = held.go_on(0.1).await.unwrap();
        let other = command.clone();
        tokio::join!(hand.close(&other, TEN), async { drop(held) }).0
    });
    assert!(first.is_ok() && matches!(second, Err(DeviceError::Busy { .. })), "{second:?}");
    hand.faults().update(|f| f.overload = Some(Overload { after_s: 0.02 })).unwrap();
    let error = hand.close(&command, TEN).await.unwrap_err();
    assert!(matches!(error, DeviceError::Fault { .. }) && error.is_clearable(), "{error}");
    assert!(shared.with(move |world| world.remove_hand(id)).await.unwrap());
    hand.clear_fault(SECOND).await.unwrap();
    let error = hand.close(&command, TEN).await.unwrap_err();
    assert!(matches!(error, DeviceError::Disconnected { .. }), "{error}");
}

#[tokio::test]
async fn dropping_a_closing_stops_the_fingers() {
    let shared = shared(0.0);
    let arm = arm(&shared, Faults::default()).await;
    let hand = fingers(&shared, arm.hand(), Faults::default()).await;
    shared.pause();
    let slow = CloseCommand { meet: 20 * SECOND, ..around_the_box() };
    let dropped = tokio::time::timeout(Duration::from_millis(20), hand.close(&slow, 1000 * SECOND)).await;
    assert!(dropped.is_err());
    shared.resume();
    shared.wait(1.0).await.unwrap();
    assert!(hand.state(SECOND).await.unwrap().actuators[0] < 0.005);
    assert!((hand.grip(&close(0.02), TEN).await.unwrap().actuators[0] - 0.02).abs() < 1e-3);
}
