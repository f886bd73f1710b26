//! The hand over a real pseudo-terminal, against the emulated bus: what it does, and every fault.
#![allow(clippy::unwrap_used)]

use std::f64::consts::PI;
use std::time::{Duration, Instant};

use graspd_adapters_core::{CloseCommand, DeviceError, FaultKind, GripCommand, Hand, HandState};
use graspd_adapters_dynamixel::Packet;
use graspd_adapters_emulators::dynamixel::{BusConfig, BusEmulator, KinematicPlant, Obstacles};
use graspd_adapters_emulators::line::{LineDevice, Reply, SerialLine};
use graspd_adapters_leap::{LeapHand, LeapSettings};
use proptest::prelude::*;

const PATIENT: Duration = Duration::from_secs(20);

struct Bench {
    bus: BusEmulator,
    obstacles: Obstacles,
    hand: LeapHand,
}

fn bench_with(config: BusConfig, change: impl FnOnce(&mut LeapSettings)) -> Bench {
    let plant = KinematicPlant::new();
    let obstacles = plant.obstacles();
    let bus = BusEmulator::start(config, plant).unwrap();
    let mut settings = LeapSettings {
        port: bus.path().display().to_string(),
        armed: true,
        // The machine that tests may be busy.
        reply_timeout_ms: 300,
        watchdog_ms: 2000,
        ..LeapSettings::default()
    };
    change(&mut settings);
    Bench { bus, obstacles, hand: LeapHand::new(settings).unwrap() }
}

fn bench() -> Bench {
    bench_with(BusConfig::leap(false), |_| {})
}

fn grip(angle: f64) -> GripCommand {
    GripCommand { actuators: vec![angle; 16], speed: 1.0, force: 0.5 }
}

/// A motion of a hand whose watchdog is so short that a busy machine may let it fire: then it is asked again, as cells do.
async fn grip_in_spite_of_pauses(hand: &LeapHand, command: &GripCommand) -> HandState {
    let until = Instant::now() + PATIENT;
    loop {
        match hand.grip(command, PATIENT).await {
            Ok(state) => return state,
            Err(error) => {
                let paused = error.to_string().contains("the motors' watchdog stopped them");
                assert!(paused && Instant::now() < until, "{error}");
            }
        }
    }
}

fn index_of(name: &str) -> usize {
    graspd_adapters_leap::joints::leap().iter().position(|j| j.actuator == name).unwrap()
}

fn goal(bus: &BusEmulator, id: u8) -> i32 {
    i32::from_le_bytes(bus.register(id, 116, 4).unwrap().try_into().unwrap())
}

#[tokio::test(flavor = "multi_thread")]
async fn joints_go_where_their_names_say() {
    let b = bench();
    let start = b.hand.state(PATIENT).await.unwrap();
    assert!(start.actuators.iter().all(|a| a.abs() < 0.002), "{start:?}");
    assert_eq!(b.bus.register(0, 64, 1).unwrap(), [0], "looking does not make motors hold");
    let mut command = grip(0.0);
    command.actuators[index_of("index_flex")] = 0.6;
    command.actuators[index_of("index_abduction")] = -0.3;
    command.actuators[index_of("thumb_ip")] = 0.9;
    let state = b.hand.grip(&command, PATIENT).await.unwrap();
    assert!(state.settled && !state.feels_object(), "{state:?}");
    for (reached, asked) in state.actuators.iter().zip(&command.actuators) {
        assert!((reached - asked).abs() < 0.005, "{state:?}");
    }
    // The joint that bends the index finger is motor 1, the one that spreads it motor 0.
    assert_eq!((goal(&b.bus, 1), goal(&b.bus, 0), goal(&b.bus, 15)), (2439, 1852, 2635));
    // Current-based position control, half of 350 mA, no return delay, gains less for spreading joints, watchdog.
    assert_eq!(b.bus.register(1, 11, 1).unwrap(), [5]);
    assert_eq!(b.bus.register(1, 9, 1).unwrap(), [0]);
    assert_eq!(b.bus.register(1, 102, 2).unwrap(), 175i16.to_le_bytes());
    assert_eq!(b.bus.register(1, 84, 2).unwrap(), 600i16.to_le_bytes());
    assert_eq!(b.bus.register(0, 84, 2).unwrap(), 450i16.to_le_bytes());
    assert_eq!(b.bus.register(1, 98, 1).unwrap(), [100]);
}

#[tokio::test(flavor = "multi_thread")]
async fn closing_fingers_hold_what_they_meet() {
    let b = bench();
    b.obstacles.stop_above(1, Some(PI + 0.55));
    b.obstacles.stop_above(14, Some(PI + 0.25));
    let mut squeezed = vec![0.0; 16];
    let mut farthest = vec![0.0; 16];
    for (i, joint) in graspd_adapters_leap::joints::leap().iter().enumerate() {
        if joint.actuator.ends_with("flex") || joint.actuator == "thumb_mcp" {
            (squeezed[i], farthest[i]) = (0.6, 1.2);
        }
    }
    let contact = squeezed.iter().map(|s| s * 0.5).collect();
    let meet = Duration::from_millis(300);
    let command = CloseCommand { contact, squeezed, farthest, meet, speed: 1.0, force: 0.8 };
    let state = b.hand.close(&command, PATIENT).await.unwrap();
    let (flex, middle, thumb) = (index_of("index_flex"), index_of("middle_flex"), index_of("thumb_mcp"));
    assert!(state.held[flex] && state.held[thumb] && !state.held[middle], "{state:?}");
    assert!((state.actuators[flex] - 0.55).abs() < 0.01 && (state.actuators[thumb] - 0.25).abs() < 0.01);
    assert!((state.actuators[middle] - 1.2).abs() < 0.01, "{state:?}");
    // A held finger is not told to go on to the end.
    assert!(f64::from(goal(&b.bus, 1)) < 2048.0 + 0.8 * 652.0, "{}", goal(&b.bus, 1));
    // Asked again later, the hand still feels what it holds.
    assert!(b.hand.state(PATIENT).await.unwrap().held[flex]);
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_moves_before_it_is_armed_nor_beyond_limits() {
    let b = bench_with(BusConfig::leap(false), |s| s.armed = false);
    let refused = b.hand.grip(&grip(0.2), PATIENT).await.unwrap_err();
    assert!(refused.to_string().contains("motion is not armed"), "{refused}");
    b.hand.clear_fault(PATIENT).await.unwrap();
    assert_eq!(b.bus.register(3, 64, 1).unwrap(), [0]);
    b.hand.arm(true, PATIENT).await.unwrap();
    let mut command = grip(0.0);
    command.actuators[1] = 1.2;
    let error = b.hand.grip(&command, PATIENT).await.unwrap_err();
    assert_eq!(error.to_string(), "leap: actuators.index_abduction: found 1.2, expected -1.047 to 1.047");
    let error = b.hand.grip(&GripCommand { actuators: vec![0.0; 4], speed: 1.0, force: 1.0 }, PATIENT).await;
    assert!(matches!(error, Err(DeviceError::OutOfRange { field, .. }) if field == "actuators"));
    let error = b.hand.grip(&GripCommand { speed: 1.5, ..grip(0.0) }, PATIENT).await;
    assert!(matches!(error, Err(DeviceError::OutOfRange { field, .. }) if field == "speed"));
    b.hand.grip(&grip(0.2), PATIENT).await.unwrap();
    b.hand.arm(false, PATIENT).await.unwrap();
    assert_eq!(b.bus.register(3, 64, 1).unwrap(), [0], "disarmed motors give no torque");
}

#[tokio::test(flavor = "multi_thread")]
async fn motions_are_exclusive_stoppable_and_end_with_their_caller() {
    let b = bench_with(BusConfig::leap(false), |s| s.max_speed_rad_s = 0.2);
    b.hand.grip(&grip(0.0), PATIENT).await.unwrap();
    let slow = grip(0.8);
    let (first, (), stopped) = tokio::join!(
        b.hand.grip(&slow, PATIENT),
        async {
            tokio::time::sleep(Duration::from_millis(300)).await;
            let busy = b.hand.grip(&slow, PATIENT).await.unwrap_err();
            assert!(matches!(busy, DeviceError::Busy { .. }), "{busy}");
        },
        async {
            tokio::time::sleep(Duration::from_millis(600)).await;
            b.hand.stop(PATIENT).await
        },
    );
    assert!(matches!(first, Err(DeviceError::Stopped { operation: "grip", .. })), "{first:?}");
    stopped.unwrap();
    // A caller that gives up stops the fingers.
    let given_up = tokio::time::timeout(Duration::from_millis(400), b.hand.grip(&slow, PATIENT)).await;
    assert!(given_up.is_err());
    tokio::time::sleep(Duration::from_millis(300)).await;
    let there = b.hand.state(PATIENT).await.unwrap();
    tokio::time::sleep(Duration::from_millis(300)).await;
    let still = b.hand.state(PATIENT).await.unwrap();
    assert!((there.actuators[0] - still.actuators[0]).abs() < 0.01 && still.actuators[0] < 0.5, "{still:?}");
    // Too little time: the fingers are stopped, and the error comes in time.
    let began = Instant::now();
    let late = b.hand.grip(&slow, Duration::from_millis(400)).await.unwrap_err();
    assert!(matches!(late, DeviceError::Timeout { operation: "grip", .. }), "{late}");
    assert!(began.elapsed() < Duration::from_millis(450));
    b.hand.grip(&GripCommand { speed: 1.0, ..grip(0.0) }, PATIENT).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn disturbances_of_the_line_are_overcome() {
    for fast in [true, false] {
        let b = bench_with(BusConfig::leap(false), |s| s.fast_sync_read = fast);
        b.hand.state(PATIENT).await.unwrap();
        let faults = b.bus.faults();
        faults.garble(1);
        b.hand.state(PATIENT).await.unwrap();
        faults.change(|now| now.halve = 1);
        b.hand.state(PATIENT).await.unwrap();
        faults.change(|now| now.lose = 2);
        b.hand.state(PATIENT).await.unwrap();
        faults.change(|now| now.noise = 1);
        b.hand.state(PATIENT).await.unwrap();
        faults.change(|now| now.delay = Duration::from_millis(10));
        b.hand.state(PATIENT).await.unwrap();
        faults.clear();
        b.hand.grip(&grip(0.1), PATIENT).await.unwrap();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_line_that_stays_disturbed_is_an_error_that_says_so() {
    let b = bench();
    b.hand.state(PATIENT).await.unwrap();
    b.bus.faults().garble(3);
    let error = b.hand.state(PATIENT).await.unwrap_err();
    let text = error.to_string();
    assert!(matches!(error, DeviceError::Disconnected { .. }), "{text}");
    assert!(
        text.contains("a disturbed line, though every motor answers alone: 1 damaged packets, the last: CRC"),
        "{text}"
    );
    b.hand.state(PATIENT).await.unwrap();
    b.bus.faults().change(|now| now.delay = Duration::from_millis(600));
    let error = b.hand.state(PATIENT).await.unwrap_err();
    assert!(matches!(error, DeviceError::Disconnected { .. }), "{error}");
    b.bus.faults().clear();
    // What came late is not taken for an answer.
    let until = Instant::now() + PATIENT;
    while let Err(error) = b.hand.state(PATIENT).await {
        assert!(Instant::now() < until, "{error}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_missing_motor_is_named_and_hangs_nothing() {
    let b = bench();
    b.hand.grip(&grip(0.0), PATIENT).await.unwrap();
    b.bus.unplug(6, true);
    let error = b.hand.grip(&grip(0.3), PATIENT).await.unwrap_err();
    let text = error.to_string();
    assert!(
        error.is_transient() && text.contains("1 of 16 motors do not answer: motor 6 (middle_pip)"),
        "{text}"
    );
    let again = b.hand.state(PATIENT).await.unwrap_err().to_string();
    assert!(again.contains("motor 6 (middle_pip)"), "{again}");
    b.bus.unplug(6, false);
    let state = b.hand.grip(&grip(0.3), PATIENT).await.unwrap();
    assert!((state.actuators[0] - 0.3).abs() < 0.01);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_motor_that_lost_its_power_for_a_moment_is_noticed() {
    let b = bench();
    b.hand.grip(&grip(0.0), PATIENT).await.unwrap();
    b.bus.power_cycle(13);
    let error = b.hand.grip(&grip(0.3), PATIENT).await.unwrap_err();
    assert!(
        error.is_clearable() && error.to_string().contains("no torque at motor 13 (thumb_axl)"),
        "{error}"
    );
    b.hand.clear_fault(PATIENT).await.unwrap();
    let state = b.hand.grip(&grip(0.3), PATIENT).await.unwrap();
    assert!((state.actuators[index_of("thumb_axl")] - 0.3).abs() < 0.01);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_hand_that_is_dropped_frees_its_port() {
    let b = bench();
    b.hand.grip(&grip(0.1), PATIENT).await.unwrap();
    drop(b.hand);
    // Ports are opened for one user alone: this one waits until the port is free.
    let port = b.bus.path().display().to_string();
    let other =
        LeapHand::new(LeapSettings { port, reply_timeout_ms: 100, ..LeapSettings::default() }).unwrap();
    let until = Instant::now() + PATIENT;
    while other.state(PATIENT).await.is_err() {
        assert!(Instant::now() < until, "the port is still taken");
    }
    let path = b.bus.path().to_owned();
    drop(b.bus);
    assert!(!path.is_symlink());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_silent_bus_is_an_error_in_bounded_time() {
    let b = bench_with(BusConfig::leap(false), |s| s.reply_timeout_ms = 20);
    for id in 0..16 {
        b.bus.unplug(id, true);
    }
    let began = Instant::now();
    let text = b.hand.state(PATIENT).await.unwrap_err().to_string();
    assert!(
        text.contains("none of 16 motors answers on") && text.contains("power, cable, baud rate?"),
        "{text}"
    );
    assert!(began.elapsed() < PATIENT);
    let short = b.hand.state(Duration::from_millis(50)).await.unwrap_err();
    assert!(matches!(short, DeviceError::Timeout { operation: "state", .. }), "{short}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_hang_up_ends_a_motion_and_the_next_call_connects_again() {
    let b = bench_with(BusConfig::leap(false), |s| s.max_speed_rad_s = 0.3);
    b.hand.grip(&grip(0.0), PATIENT).await.unwrap();
    let command = grip(0.6);
    let began = Instant::now();
    let (ended, ()) = tokio::join!(b.hand.grip(&command, PATIENT), async {
        tokio::time::sleep(Duration::from_millis(300)).await;
        b.bus.faults().hang_up(Duration::from_millis(500));
        // Whoever meets the broken line first, all are told.
        while b.hand.joints(PATIENT).await.is_ok() && b.hand.state(PATIENT).await.is_ok() {}
    });
    assert!(began.elapsed() < Duration::from_secs(5));
    let error = ended.unwrap_err();
    assert!(matches!(error, DeviceError::Disconnected { .. }), "{error}");
    let away = b.hand.state(PATIENT).await.unwrap_err();
    assert!(away.is_transient(), "{away}");
    let until = Instant::now() + PATIENT;
    while b.hand.state(PATIENT).await.is_err() {
        assert!(Instant::now() < until, "the hand did not come back");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    b.hand.grip(&GripCommand { speed: 1.0, ..grip(0.1) }, PATIENT).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn an_overloaded_motor_stops_the_hand_until_it_is_cleared() {
    let b = bench_with(BusConfig::leap(false), |s| s.max_speed_rad_s = 0.5);
    b.hand.grip(&grip(0.0), PATIENT).await.unwrap();
    let command = grip(0.8);
    let (ended, ()) = tokio::join!(b.hand.grip(&command, PATIENT), async {
        tokio::time::sleep(Duration::from_millis(500)).await;
        b.bus.raise(10, 1 << 5);
    });
    let error = ended.unwrap_err();
    assert!(
        matches!(&error, DeviceError::Fault { kind: FaultKind::Overload, detail, .. }
        if detail == "hardware error of motor 10 (ring_pip): overload"),
        "{error}"
    );
    assert!(error.is_clearable());
    // It still says where it is, and refuses to move.
    b.hand.state(PATIENT).await.unwrap();
    assert!(matches!(b.hand.grip(&grip(0.1), PATIENT).await, Err(DeviceError::Fault { .. })));
    let joints = b.hand.joints(PATIENT).await.unwrap();
    let ring = joints.iter().find(|j| j.id == 10).unwrap();
    assert_eq!((ring.actuator.as_str(), &ring.errors[..]), ("ring_pip", &["overload".to_owned()][..]));
    b.hand.clear_fault(PATIENT).await.unwrap();
    let state = b.hand.grip(&grip(0.2), PATIENT).await.unwrap();
    assert!((state.actuators[index_of("ring_pip")] - 0.2).abs() < 0.01);
}

#[tokio::test(flavor = "multi_thread")]
async fn every_hardware_error_is_named_and_gone_after_a_reboot() {
    let b = bench();
    b.hand.grip(&grip(0.0), PATIENT).await.unwrap();
    for (bit, name, kind) in [
        (0, "input voltage", FaultKind::Other),
        (2, "overheating", FaultKind::Overload),
        (3, "encoder", FaultKind::Other),
        (4, "electrical shock", FaultKind::Overload),
        (5, "overload", FaultKind::Overload),
    ] {
        b.bus.raise(10, 1 << bit);
        let error = b.hand.grip(&grip(0.1), PATIENT).await.unwrap_err();
        let expected = format!("hardware error of motor 10 (ring_pip): {name}");
        assert!(
            matches!(&error, DeviceError::Fault { kind: found, detail, .. } if *found == kind && *detail == expected),
            "{error:?}, expected {expected}"
        );
        b.hand.clear_fault(PATIENT).await.unwrap();
        let state = b.hand.grip(&grip(0.05), PATIENT).await.unwrap();
        assert!((state.actuators[0] - 0.05).abs() < 0.01, "after {name}: {state:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn over_current_of_a_pressing_motor_is_an_overload() {
    let b = bench_with(BusConfig::leap(true), |s| {
        s.variant = graspd_adapters_leap::settings::Variant::Full;
        s.max_current_ma = Some(1400.0);
    });
    b.obstacles.tire_after(Some(0.3));
    b.obstacles.stop_above(5, Some(PI + 0.1));
    let mut command = GripCommand { force: 1.0, ..grip(0.0) };
    command.actuators[index_of("middle_flex")] = 1.5;
    // Held and resting ends a grip; the motor goes on pressing and tires.
    let grip = b.hand.grip(&command, PATIENT).await;
    tokio::time::sleep(Duration::from_millis(800)).await;
    let error = match grip {
        Err(error) => error,
        Ok(_) => b.hand.grip(&command, PATIENT).await.unwrap_err(),
    };
    assert!(error.to_string().contains("motor 5 (middle_flex): overload"), "{error}");
    b.obstacles.stop_above(5, None);
    b.hand.clear_fault(PATIENT).await.unwrap();
    b.hand.grip(&command, PATIENT).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_hot_motor_stops_the_hand_before_it_stops_itself() {
    let b = bench();
    b.hand.grip(&grip(0.0), PATIENT).await.unwrap();
    b.obstacles.heat(12, 68.0);
    let error = b.hand.grip(&grip(0.2), PATIENT).await.unwrap_err();
    assert!(
        error.to_string().contains("over-temperature of motor 12 (thumb_cmc): 68 C, limit 65 C"),
        "{error}"
    );
    let hot = b.hand.clear_fault(PATIENT).await.unwrap_err();
    assert!(hot.to_string().contains("over-temperature"), "{hot}");
    b.obstacles.heat(12, 40.0);
    b.hand.clear_fault(PATIENT).await.unwrap();
    b.hand.grip(&grip(0.2), PATIENT).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn motors_stop_by_themselves_when_the_host_is_gone() {
    let b = bench_with(BusConfig::leap(false), |s| {
        s.watchdog_ms = 200;
        s.max_speed_rad_s = 0.3;
    });
    grip_in_spite_of_pauses(&b.hand, &grip(0.0)).await;
    let Bench { hand, bus, .. } = b;
    // The line is cut in the middle of a motion: nobody says stop.
    let command = grip(0.6);
    let (error, ()) = tokio::join!(hand.grip(&command, PATIENT), async {
        tokio::time::sleep(Duration::from_millis(300)).await;
        bus.faults().hang_up(Duration::from_millis(600));
    });
    assert!(error.is_err());
    tokio::time::sleep(Duration::from_millis(800)).await;
    assert_eq!(bus.register(1, 98, 1).unwrap(), [255], "the watchdog fired");
    let until = Instant::now() + PATIENT;
    while hand.state(PATIENT).await.is_err() {
        assert!(Instant::now() < until, "the hand did not come back");
    }
    let state = grip_in_spite_of_pauses(&hand, &GripCommand { speed: 1.0, ..grip(0.3) }).await;
    assert!((state.actuators[0] - 0.3).abs() < 0.01, "{state:?}");
}

/// Motors count the time between what they hear, the host that between what it sends: an exchange that merely takes long
/// lets their watchdog fire while the host has never been silent. A motor whose watchdog has fired takes no goal, and
/// nobody says so: unseen, the fingers would stand, and lack their goals as if they held something.
#[tokio::test(flavor = "multi_thread")]
async fn a_watchdog_that_fires_during_a_slow_exchange_is_seen() {
    let b = bench_with(BusConfig::leap(false), |s| {
        s.reply_timeout_ms = 1000;
        s.watchdog_ms = 300;
        s.max_speed_rad_s = 0.3;
    });
    grip_in_spite_of_pauses(&b.hand, &grip(0.0)).await;
    let way = grip(0.9);
    let slow = async {
        tokio::time::sleep(Duration::from_millis(500)).await;
        b.bus.faults().change(|now| now.delay = Duration::from_millis(700));
        let until = Instant::now() + PATIENT;
        while b.bus.register(1, 98, 1).unwrap() != [255] {
            assert!(Instant::now() < until, "the watchdog does not fire");
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        b.bus.faults().clear();
    };
    let (error, ()) = tokio::join!(b.hand.grip(&way, PATIENT), slow);
    let error = error.unwrap_err();
    assert!(error.to_string().contains("the motors' watchdog stopped them"), "{error}");
    assert!(error.is_clearable(), "a cell tries again: {error:?}");
    // Nobody needs to clear anything: the fingers hold where they are, and go where they are told.
    let state = b.hand.state(PATIENT).await.unwrap();
    assert!(!state.feels_object() && state.actuators[0] < 0.85, "{state:?}");
    let state = grip_in_spite_of_pauses(&b.hand, &GripCommand { speed: 1.0, ..grip(0.3) }).await;
    assert!((state.actuators[0] - 0.3).abs() < 0.01, "{state:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_watchdog_that_fired_between_motions_lets_fingers_press_on_and_move() {
    let b = bench_with(BusConfig::leap(false), |s| {
        s.reply_timeout_ms = 1000;
        s.watchdog_ms = 300;
    });
    b.obstacles.stop_above(1, Some(PI + 0.1));
    let flex = index_of("index_flex");
    assert!(grip_in_spite_of_pauses(&b.hand, &grip(0.3)).await.held[flex]);
    b.bus.faults().change(|now| now.delay = Duration::from_millis(700));
    let until = Instant::now() + PATIENT;
    while b.bus.register(1, 98, 1).unwrap() != [255] {
        assert!(Instant::now() < until, "the watchdog does not fire");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    b.bus.faults().clear();
    while b.bus.register(1, 98, 1).unwrap() == [255] || goal(&b.bus, 1) < 2048 + 190 {
        assert!(Instant::now() < until, "the finger does not press on");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    assert!(b.hand.state(PATIENT).await.unwrap().held[flex]);
    b.obstacles.stop_above(1, None);
    let state = grip_in_spite_of_pauses(&b.hand, &grip(0.5)).await;
    assert!((state.actuators[flex] - 0.5).abs() < 0.01 && !state.feels_object(), "{state:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn motors_left_in_another_mode_with_torque_are_brought_up_in_order() {
    let b = bench();
    // Torque on in position mode: the mode is locked until torque is off.
    let mut other = LeapSettings { port: b.bus.path().display().to_string(), ..LeapSettings::default() };
    other.reply_timeout_ms = 100;
    {
        use graspd_adapters_dynamixel::table;
        let mut bus =
            graspd_adapters_leap::bus::Bus::open(&other.port, other.baud, Duration::from_millis(100), 3)
                .await
                .unwrap();
        bus.write(4, table::TORQUE_ENABLE, 1).await.unwrap();
        let locked = bus.write(4, table::OPERATING_MODE, 5).await.unwrap_err();
        assert_eq!(
            locked.to_string(),
            "motor 4: Operating Mode: register is read-only, or locked while torque is on"
        );
    }
    b.hand.grip(&grip(0.1), PATIENT).await.unwrap();
    assert_eq!(b.bus.register(4, 11, 1).unwrap(), [5]);
}

#[tokio::test(flavor = "multi_thread")]
async fn other_motors_than_expected_are_refused() {
    let b = bench_with(BusConfig::leap(true), |_| {});
    let error = b.hand.state(PATIENT).await.unwrap_err();
    assert!(matches!(error, DeviceError::Protocol { .. }));
    assert!(
        error.to_string().contains("model 1240") && error.to_string().contains("expected model 1200"),
        "{error}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_check_says_what_is_wrong_and_what_to_do() {
    let b = bench_with(BusConfig::leap(false), |s| s.armed = false);
    b.bus.raise(3, 1 << 5);
    let findings = b.hand.check(PATIENT).await.unwrap();
    let bad: Vec<_> = findings.iter().filter(|f| !f.ok).collect();
    assert_eq!(bad.len(), 2, "{bad:?}");
    assert!(bad[0].subject == "motor 3 (index_dip)" && bad[0].found == "overload");
    assert!(bad.iter().all(|f| !f.advice.is_empty()));
    let nowhere =
        LeapHand::new(LeapSettings { port: "/dev/no-such-port".into(), ..LeapSettings::default() }).unwrap();
    let findings = nowhere.check(PATIENT).await.unwrap();
    assert!(findings.len() == 1 && findings[0].found.contains("/dev/no-such-port"), "{findings:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_answer_that_comes_late_is_not_taken_for_another() {
    use graspd_adapters_dynamixel::table;
    use graspd_adapters_leap::bus::{Bus, BusError};
    let emulator = BusEmulator::start(BusConfig::leap(false), KinematicPlant::new()).unwrap();
    let path = emulator.path().display().to_string();
    let mut bus = Bus::open(&path, 4_000_000, Duration::from_millis(200), 1).await.unwrap();
    assert_eq!(bus.read(3, table::PRESENT_TEMPERATURE).await.unwrap().data, [30]);
    for _ in 0..3 {
        emulator.faults().change(|now| now.delay = Duration::from_millis(300));
        let error = bus.read(3, table::PRESENT_TEMPERATURE).await.unwrap_err();
        assert!(matches!(error, BusError::NoReply { .. }), "{error}");
        emulator.faults().clear();
        // The temperature comes while this is asked: one byte as well.
        assert_eq!(bus.read(3, table::TORQUE_ENABLE).await.unwrap().data, [0]);
    }
}

/// Something at the end of the line that answers whatever it likes.
struct Babble(Vec<u8>);

impl LineDevice for Babble {
    fn receive(&mut self, _: &[u8], _: Instant) -> Vec<Reply> {
        vec![Reply { bytes: self.0.clone(), after: Duration::ZERO }]
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn whatever_answers_on_the_line_is_an_error_in_time(
        bytes in proptest::collection::vec(prop_oneof![any::<u8>(), Just(0xFF), Just(0xFD)], 0..80),
        whole in any::<bool>(), id in 0u8..16, params in proptest::collection::vec(any::<u8>(), 0..20),
    ) {
        let mut answer = bytes;
        if whole {
            // A packet that is one, but no answer of a whole hand.
            let packet = Packet { id, instruction: 0x55, params };
            answer.extend(packet.encode().unwrap());
        }
        let line = SerialLine::start(Babble(answer), None).unwrap();
        let settings = LeapSettings {
            port: line.path().display().to_string(),
            reply_timeout_ms: 2,
            attempts: 1,
            ..LeapSettings::default()
        };
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
        runtime.block_on(async {
            let hand = LeapHand::new(settings).unwrap();
            let error = hand.state(PATIENT).await.unwrap_err();
            let told = matches!(error, DeviceError::Disconnected { .. } | DeviceError::Protocol { .. });
            assert!(told, "{error}");
        });
    }
}
