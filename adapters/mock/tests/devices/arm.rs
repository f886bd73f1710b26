//! Arms: motions, stops, faults.

use std::time::Duration;

use graspd_adapters_core::{Arm, ArmMode, DeviceError, FaultKind, Leg, Limits, Reach, Reached};
use graspd_adapters_mock::{After, ArmSettings, Faults, MockArm, MotionFault, Spell, StopKind};

use crate::fixtures::{LIMITS, SECOND, TEN, apart, arm, down, gripper, shared};

fn kind(error: &DeviceError) -> Option<FaultKind> {
    match error {
        DeviceError::Fault { kind, .. } => Some(*kind),
        _ => None,
    }
}

#[tokio::test]
async fn a_motion_ends_where_it_was_sent_after_the_time_it_takes() {
    let shared = shared(0.0);
    let arm = arm(&shared, Faults::default()).await;
    let goal = down(0.10, 0.05, 0.30);
    let way = apart(&goal, &arm.state(SECOND).await.unwrap().world_from_flange);
    let began_s = shared.time_s();
    arm.move_linear(&goal, LIMITS, TEN).await.unwrap();
    let took_s = shared.time_s() - began_s;
    let state = arm.state(SECOND).await.unwrap();
    assert!(apart(&state.world_from_flange, &goal) < 1e-3);
    assert!(state.world_from_flange.rotation.angle_to(&goal.rotation) < 5e-3);
    assert_eq!((state.mode, state.joints.len()), (ArmMode::Ready, 0));
    assert!(took_s > way / LIMITS.speed_m_s && took_s < way / LIMITS.speed_m_s + 0.6, "{took_s}");
}

#[tokio::test]
async fn what_cannot_be_is_refused_before_anything_moves() {
    let shared = shared(0.0);
    let arm = arm(&shared, Faults::default()).await;
    let near = down(0.0, 0.0, 0.3);
    let cases = [
        (down(0.9, 0.0, 0.3), LIMITS, "world_from_flange"),
        (down(f64::NAN, 0.0, 0.3), LIMITS, "world_from_flange"),
        (near, Limits { speed_m_s: 0.0, ..LIMITS }, "speed_m_s"),
        (near, Limits { speed_m_s: 5.0, ..LIMITS }, "speed_m_s"),
        (near, Limits { acceleration_m_s2: f64::NAN, ..LIMITS }, "acceleration_m_s2"),
        (near, Limits { acceleration_m_s2: 1.9, ..LIMITS }, "acceleration_m_s2"),
    ];
    for (pose, limits, expected) in cases {
        let error = arm.move_to(&pose, limits, TEN).await.unwrap_err();
        assert!(matches!(&error, DeviceError::OutOfRange { field, .. } if field == expected), "{error}");
    }
    assert_eq!(shared.time_s(), 0.0);
}

#[tokio::test]
async fn no_motion_accelerates_more_than_it_may() {
    let shared = shared(0.0);
    let arm = arm(&shared, Faults::default()).await;
    let goal = down(0.3, 0.0, 0.25);
    let mut held = shared.hold_after(0.0).await.unwrap();
    let (moved, speeds) = tokio::join!(arm.move_linear(&goal, LIMITS, TEN), async {
        let mut speeds = Vec::new();
        let mut before: Option<(f64, f64)> = None;
        // While it accelerates, and a little longer.
        while shared.time_s() < 0.15 {
            held = held.go_on(0.025).await.unwrap();
            let x = arm.state(SECOND).await.unwrap().world_from_flange.translation.x;
            let now = (shared.time_s(), x);
            if let Some((time_s, at)) = before.replace(now) {
                speeds.push((x - at) / (now.0 - time_s));
            }
        }
        drop(held);
        speeds
    });
    moved.unwrap();
    let most = speeds.windows(2).map(|w| (w[1] - w[0]) / 0.025).fold(0.0, f64::max);
    // It lags a little behind its path, which evens out.
    assert!(most > 1.0 && most <= 1.2 * LIMITS.acceleration_m_s2, "{most}: {speeds:?}");
}

#[tokio::test]
async fn dropping_a_motion_stops_it_and_leaves_the_arm_usable() {
    let shared = shared(2.0);
    let arm = arm(&shared, Faults::default()).await;
    let slow = Limits { speed_m_s: 0.1, ..LIMITS };
    let far = down(0.30, 0.0, 0.25);
    let dropped = tokio::time::timeout(Duration::from_millis(300), arm.move_linear(&far, slow, TEN)).await;
    assert!(dropped.is_err());
    arm.stop(SECOND).await.unwrap();
    let stopped = arm.state(SECOND).await.unwrap();
    assert_eq!(stopped.mode, ArmMode::Ready);
    shared.wait(0.5).await.unwrap();
    let later = arm.state(SECOND).await.unwrap();
    assert!(apart(&stopped.world_from_flange, &later.world_from_flange) < 1e-3, "it goes on moving");
    let gone = later.world_from_flange.translation.x;
    assert!(gone > 0.005 && gone < 0.25, "stopped at {gone}");
    arm.move_linear(&down(0.0, 0.0, 0.25), LIMITS, TEN).await.unwrap();
}

#[tokio::test]
async fn dropping_a_motion_on_demand_brakes_it_with_nobody_waiting() {
    let shared = shared(0.0);
    let arm = arm(&shared, Faults::default()).await;
    let slow = Limits { speed_m_s: 0.001, ..LIMITS };
    let far = down(0.3, 0.0, 0.25);
    let motion = arm.move_linear(&far, slow, 1000 * SECOND);
    assert!(tokio::time::timeout(Duration::from_millis(100), motion).await.is_err());
    let mut mode = ArmMode::Moving;
    for _ in 0..100 {
        mode = arm.state(SECOND).await.unwrap().mode;
        if mode == ArmMode::Ready {
            break;
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    assert_eq!(mode, ArmMode::Ready);
    let still_s = shared.time_s();
    tokio::time::sleep(Duration::from_millis(50)).await;
    assert_eq!(shared.time_s(), still_s);
}

#[tokio::test]
async fn a_stop_ends_the_motion_as_stopped() {
    let shared = shared(0.0);
    let arm = arm(&shared, Faults::default()).await;
    let goal = down(0.25, 0.0, 0.25);
    let held = shared.hold_after(0.0).await.unwrap();
    let (motion, stop) = tokio::join!(arm.move_linear(&goal, LIMITS, TEN), async {
        let held = held.go_on(0.5).await.unwrap();
        assert_eq!(arm.state(SECOND).await.unwrap().mode, ArmMode::Moving);
        tokio::join!(arm.stop(SECOND), async { drop(held) }).0
    });
    assert!(matches!(motion, Err(DeviceError::Stopped { operation: "move_linear", .. })), "{motion:?}");
    stop.unwrap();
    assert_eq!(arm.state(SECOND).await.unwrap().mode, ArmMode::Ready);
    arm.stop(SECOND).await.unwrap();
}

#[tokio::test]
async fn a_newer_motion_replaces_or_is_refused_as_the_capability_says() {
    for replaces_motion in [true, false] {
        let shared = shared(0.0);
        let settings = ArmSettings { replaces_motion, ..ArmSettings::default() };
        let arm = MockArm::new(&shared, gripper(&shared).await, settings, Faults::default()).unwrap();
        assert_eq!(arm.info().replaces_motion, replaces_motion);
        let (first, second) = (down(0.2, 0.0, 0.25), down(-0.1, 0.0, 0.25));
        let held = shared.hold_after(0.0).await.unwrap();
        let (one, two) = tokio::join!(arm.move_linear(&first, LIMITS, TEN), async {
            let held = held.go_on(0.3).await.unwrap();
            tokio::join!(arm.move_linear(&second, LIMITS, TEN), async { drop(held) }).0
        });
        let at = arm.state(SECOND).await.unwrap().world_from_flange;
        if replaces_motion {
            assert!(matches!(one, Err(DeviceError::Stopped { .. })), "{one:?}");
            assert!(two.is_ok() && apart(&at, &second) < 1e-3);
        } else {
            assert!(matches!(two, Err(DeviceError::Busy { .. })), "{two:?}");
            assert!(one.is_ok() && apart(&at, &first) < 1e-3);
        }
    }
}

#[tokio::test]
async fn pressing_on_the_table_is_a_protective_stop() {
    let shared = shared(0.0);
    let arm = arm(&shared, Faults::default()).await;
    arm.move_linear(&down(0.0, 0.12, 0.15), LIMITS, TEN).await.unwrap();
    // The fingers reach 60 mm past the hand's frame: 3 cm into the table.
    let error = arm.move_linear(&down(0.0, 0.12, 0.03), LIMITS, TEN).await.unwrap_err();
    assert_eq!(kind(&error), Some(FaultKind::ProtectiveStop), "{error}");
    assert!(error.is_clearable() && error.to_string().contains("limit 150 N"), "{error}");
    assert_eq!(arm.state(SECOND).await.unwrap().mode, ArmMode::Stopped(FaultKind::ProtectiveStop));
    let up = down(0.0, 0.12, 0.2);
    let refused = arm.move_linear(&up, LIMITS, TEN).await.unwrap_err();
    assert_eq!(kind(&refused), Some(FaultKind::ProtectiveStop), "until it is released");
    arm.clear_fault(SECOND).await.unwrap();
    arm.move_linear(&up, LIMITS, TEN).await.unwrap();
}

#[tokio::test]
async fn a_fault_in_the_middle_of_a_motion_stops_it_there() {
    for (after, low, high) in [(After::Metres(0.05), 0.05, 0.07), (After::Seconds(0.5), 0.08, 0.14)] {
        let shared = shared(0.0);
        let motion = Some(MotionFault { after, kind: StopKind::Protective });
        let arm = arm(&shared, Faults { motion, ..Faults::default() }).await;
        let goal = down(0.2, 0.0, 0.25);
        let error = arm.move_linear(&goal, LIMITS, TEN).await.unwrap_err();
        assert_eq!(kind(&error), Some(FaultKind::ProtectiveStop), "{error}");
        let x = arm.state(SECOND).await.unwrap().world_from_flange.translation.x;
        assert!((low..high).contains(&x), "stopped at {x} for {after:?}");
        arm.clear_fault(SECOND).await.unwrap();
        arm.move_linear(&goal, LIMITS, TEN).await.unwrap();
    }
}

#[tokio::test]
async fn an_emergency_stop_needs_a_person() {
    let shared = shared(0.0);
    let motion = Some(MotionFault { after: After::Metres(0.05), kind: StopKind::Emergency });
    let arm = arm(&shared, Faults { motion, ..Faults::default() }).await;
    let goal = down(0.2, 0.0, 0.25);
    let error = arm.move_linear(&goal, LIMITS, TEN).await.unwrap_err();
    assert_eq!(kind(&error), Some(FaultKind::EmergencyStop), "{error}");
    assert!(!error.is_clearable());
    for error in
        [arm.clear_fault(SECOND).await.unwrap_err(), arm.move_to(&goal, LIMITS, TEN).await.unwrap_err()]
    {
        assert_eq!(kind(&error), Some(FaultKind::EmergencyStop), "{error}");
    }
    arm.faults().update(|f| f.emergency_stop = false).unwrap();
    assert_eq!(arm.state(SECOND).await.unwrap().mode, ArmMode::Stopped(FaultKind::EmergencyStop));
    arm.clear_fault(SECOND).await.unwrap();
    arm.move_to(&goal, LIMITS, TEN).await.unwrap();
    // Pressed by hand in the middle of a motion.
    let back = down(0.0, 0.0, 0.25);
    let held = shared.hold_after(0.0).await.unwrap();
    let (motion, ()) = tokio::join!(arm.move_to(&back, LIMITS, TEN), async {
        let _held = held.go_on(0.2).await.unwrap();
        arm.faults().update(|f| f.emergency_stop = true).unwrap();
    });
    assert_eq!(kind(&motion.unwrap_err()), Some(FaultKind::EmergencyStop));
}

#[tokio::test]
async fn a_motion_that_takes_too_long_is_stopped_and_times_out_in_time() {
    let shared = shared(0.0);
    let arm = arm(&shared, Faults::default()).await;
    let slow = Limits { speed_m_s: 0.05, ..LIMITS };
    let error = arm.move_linear(&down(0.3, 0.0, 0.25), slow, SECOND).await.unwrap_err();
    assert!(matches!(error, DeviceError::Timeout { operation: "move_linear", .. }), "{error}");
    assert!(shared.time_s() <= 1.003, "{}", shared.time_s());
    let state = arm.state(SECOND).await.unwrap();
    assert_eq!(state.mode, ArmMode::Ready);
    shared.wait(0.5).await.unwrap();
    assert!(apart(&arm.state(SECOND).await.unwrap().world_from_flange, &state.world_from_flange) < 2e-3);
}

#[tokio::test]
async fn a_paused_world_ends_motions_and_answers_questions() {
    let shared = shared(0.0);
    let arm = arm(&shared, Faults::default()).await;
    shared.pause();
    let error = arm.move_to(&down(0.1, 0.0, 0.25), LIMITS, SECOND / 10).await.unwrap_err();
    assert!(matches!(error, DeviceError::Timeout { .. }), "{error}");
    arm.state(SECOND).await.unwrap();
    shared.resume();
    // The motion that was given up does not come back.
    shared.wait(0.5).await.unwrap();
    assert!(arm.state(SECOND).await.unwrap().world_from_flange.translation.x < 1e-3);
}

#[tokio::test]
async fn refusals_silence_and_latency_reach_every_call() {
    let shared = shared(0.0);
    let arm = arm(&shared, Faults::default()).await;
    let goal = down(0.01, 0.0, 0.25);
    arm.faults().update(|f| f.refused = Some(Spell::Calls(4))).unwrap();
    for error in [
        arm.state(SECOND).await.unwrap_err(),
        arm.move_to(&goal, LIMITS, SECOND).await.unwrap_err(),
        arm.stop(SECOND).await.unwrap_err(),
        arm.clear_fault(SECOND).await.unwrap_err(),
    ] {
        assert!(matches!(error, DeviceError::Disconnected { .. }) && error.is_transient(), "{error}");
    }
    arm.faults().update(|f| f.silent = Some(Spell::Calls(4))).unwrap();
    for error in [
        arm.state(SECOND).await.unwrap_err(),
        arm.move_linear(&goal, LIMITS, SECOND).await.unwrap_err(),
        arm.stop(SECOND).await.unwrap_err(),
        arm.clear_fault(SECOND).await.unwrap_err(),
    ] {
        assert!(matches!(error, DeviceError::Timeout { .. }), "{error}");
    }
    arm.faults().update(|f| f.latency_s = 0.2).unwrap();
    let before_s = shared.time_s();
    arm.state(SECOND).await.unwrap();
    assert!((shared.time_s() - before_s - 0.2).abs() < 0.004);
    let error = arm.state(SECOND / 10).await.unwrap_err();
    assert!(matches!(error, DeviceError::Timeout { .. }), "an answer that comes too late: {error}");
}

#[tokio::test]
async fn a_guarded_motion_ends_where_it_meets_something() {
    let shared = shared(0.0);
    let arm = arm(&shared, Faults::default()).await;
    let (above, inside) = (down(0.0, 0.12, 0.15), down(0.0, 0.12, 0.03));
    arm.move_linear(&above, LIMITS, TEN).await.unwrap();
    let slow = Limits { speed_m_s: 0.1, ..LIMITS };
    assert_eq!(arm.move_until_contact(&inside, slow, 40.0, TEN).await.unwrap(), Reached::Contact);
    let state = arm.state(SECOND).await.unwrap();
    assert_eq!(state.mode, ArmMode::Ready, "that is no stop");
    let z = state.world_from_flange.translation.z;
    // The fingers reach 60 mm past the hand's frame, and one of them meets the wall of the tray, 30 mm high.
    assert!((0.085..0.092).contains(&z), "{z}");
    assert_eq!(arm.move_until_contact(&above, slow, 40.0, TEN).await.unwrap(), Reached::Goal);
    let error = arm.move_until_contact(&inside, slow, 0.0, TEN).await.unwrap_err();
    assert!(matches!(error, DeviceError::OutOfRange { .. }), "{error}");
}

#[tokio::test]
async fn a_blocked_motion_is_a_protective_stop_within_a_second_and_the_way_back_is_free() {
    let shared = shared(0.0);
    // An arm that feels no force: it only notices that it cannot follow its path.
    let numb = ArmSettings { stop_force_n: None, ..ArmSettings::default() };
    let arm = MockArm::new(&shared, gripper(&shared).await, numb, Faults::default()).unwrap();
    let above = down(0.0, 0.12, 0.15);
    arm.move_linear(&above, LIMITS, TEN).await.unwrap();
    let began_s = shared.time_s();
    let error = arm.move_linear(&down(0.0, 0.12, 0.0), LIMITS, 6 * TEN).await.unwrap_err();
    assert_eq!(kind(&error), Some(FaultKind::ProtectiveStop), "{error}");
    assert!(error.to_string().contains("blocked"), "{error}");
    // Less than half a second to get there.
    assert!(shared.time_s() - began_s < 1.5, "{}", shared.time_s() - began_s);
    arm.clear_fault(SECOND).await.unwrap();
    let began_s = shared.time_s();
    arm.move_linear(&above, LIMITS, TEN).await.unwrap();
    assert!(apart(&arm.state(SECOND).await.unwrap().world_from_flange, &above) < 1e-3);
    assert!(shared.time_s() - began_s < 1.5);
}

#[tokio::test]
async fn an_arm_whose_base_is_nowhere_is_refused() {
    let shared = shared(0.0);
    let hand = gripper(&shared).await;
    for base_m in [[f64::NAN, 0.4, 0.15], [0.0, f64::INFINITY, 0.15]] {
        let settings = ArmSettings { base_m, ..ArmSettings::default() };
        let error = MockArm::new(&shared, hand, settings, Faults::default()).unwrap_err();
        assert_eq!((error.field.as_str(), error.expected.as_str()), ("base_m", "a finite number"));
    }
}

#[tokio::test]
async fn what_is_out_of_reach_is_known_before_anything_moves() {
    let shared = shared(0.0);
    let arm = arm(&shared, Faults::default()).await;
    let leg = |straight, z| Leg { world_from_flange: down(0.0, 0.0, z), straight, limits: LIMITS };
    assert_eq!(arm.reaches(&[leg(false, 0.5), leg(true, 0.2)]), Reach::Reaches);
    let way = [leg(false, 0.5), leg(true, 2.0)];
    let Reach::Beyond { leg: 1, why } = arm.reaches(&way) else { panic!("{:?}", arm.reaches(&way)) };
    // The word is kept: in the same words.
    arm.move_to(&way[0].world_from_flange, LIMITS, TEN).await.unwrap();
    let error = arm.move_linear(&way[1].world_from_flange, LIMITS, TEN).await.unwrap_err();
    assert_eq!(error.to_string(), why);
    let fast = Leg { limits: Limits { speed_m_s: 9.0, ..LIMITS }, ..leg(false, 0.5) };
    assert!(matches!(arm.reaches(&[fast]), Reach::Beyond { leg: 0, .. }));
}
