//! Grippers over real pseudo-terminals and sockets, against the emulated ones: what they do, and every fault.
#![allow(clippy::unwrap_used)]

use std::net::{Ipv4Addr, SocketAddr};
use std::time::{Duration, Instant};

use graspd_adapters_core::{CloseCommand, DeviceError, FaultKind, GripCommand, Hand, HandState};
use graspd_adapters_emulators::faults::LinkFaults;
use graspd_adapters_emulators::line::SerialLine;
use graspd_adapters_emulators::robotiq as emulator;
use graspd_adapters_emulators::robotiq::{Gripper, GripperConfig, KinematicPlant, Objects};
use graspd_adapters_robotiq::settings::LinkSettings;
use graspd_adapters_robotiq::wire::{Mode, Motion, Phase};
use graspd_adapters_robotiq::{Model, RobotiqHand, RobotiqSettings};

const PATIENT: Duration = Duration::from_secs(30);

/// Which server a test uses.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Wire {
    Rtu,
    ModbusTcp,
    RtuOverTcp,
    Socket,
}

/// Held so that it goes on serving.
enum Server {
    Line(SerialLine),
    Tcp(emulator::Server),
}

struct Bench {
    hand: RobotiqHand,
    gripper: Gripper,
    objects: Objects,
    server: Server,
}

impl Bench {
    fn faults(&self) -> &LinkFaults {
        match &self.server {
            Server::Line(line) => line.faults(),
            Server::Tcp(server) => server.faults(),
        }
    }
}

async fn bench_with(model: Model, wire: Wire, change: impl FnOnce(&mut RobotiqSettings)) -> Bench {
    let three = model == Model::ThreeFinger;
    let (kind, plant) = if three {
        (emulator::Model::ThreeFinger, KinematicPlant::three_finger().times_as_fast(4.0))
    } else {
        (emulator::Model::TwoFinger, KinematicPlant::two_finger().times_as_fast(3.0))
    };
    let objects = plant.objects();
    // Slow to take a request: an adapter that believes the old status is caught.
    let takes = Duration::from_millis(30);
    let gripper = Gripper::new(GripperConfig { takes, ..GripperConfig::new(kind) }, plant);
    let anywhere = SocketAddr::new(Ipv4Addr::LOCALHOST.into(), 0);
    let (server, link) = match wire {
        Wire::Rtu => {
            let line = gripper.serve_rtu(None).unwrap();
            let link = LinkSettings::Rtu { port: line.path().display().to_string(), baud: 115_200 };
            (Server::Line(line), link)
        }
        Wire::ModbusTcp => {
            let server = gripper.serve_modbus_tcp(anywhere).await.unwrap();
            let link = LinkSettings::ModbusTcp { address: server.address().to_string() };
            (Server::Tcp(server), link)
        }
        Wire::RtuOverTcp => {
            let server = gripper.serve_rtu_over_tcp(anywhere).await.unwrap();
            let link = LinkSettings::RtuOverTcp { address: server.address().to_string() };
            (Server::Tcp(server), link)
        }
        Wire::Socket => {
            let server = gripper.serve_socket(anywhere).await.unwrap();
            let link = LinkSettings::Socket { address: server.address().to_string() };
            (Server::Tcp(server), link)
        }
    };
    let mut settings =
        RobotiqSettings { model, link, armed: true, reply_timeout_ms: 300, ..RobotiqSettings::default() };
    change(&mut settings);
    Bench { hand: RobotiqHand::new(settings).unwrap(), gripper, objects, server }
}

async fn bench(model: Model, wire: Wire) -> Bench {
    bench_with(model, wire, |_| {}).await
}

/// One that is activated.
async fn ready(wire: Wire) -> Bench {
    let b = bench(Model::TwoFinger85, wire).await;
    b.hand.clear_fault(PATIENT).await.unwrap();
    b
}

fn grip(metres: f64) -> GripCommand {
    GripCommand { actuators: vec![metres], speed: 1.0, force: 0.5 }
}

fn close() -> CloseCommand {
    CloseCommand {
        contact: vec![0.02],
        squeezed: vec![0.022],
        farthest: vec![0.0425],
        meet: Duration::from_millis(300),
        speed: 0.5,
        force: 0.5,
    }
}

fn assert_near(state: &HandState, expected: f64) {
    assert!((state.actuators[0] - expected).abs() < 4e-4, "{state:?}, expected {expected}");
}

#[tokio::test(flavor = "multi_thread")]
async fn every_link_activates_opens_closes_and_feels() {
    for wire in [Wire::Rtu, Wire::ModbusTcp, Wire::RtuOverTcp, Wire::Socket] {
        let b = bench(Model::TwoFinger85, wire).await;
        let refused = b.hand.grip(&grip(0.01), PATIENT).await.unwrap_err();
        assert!(refused.is_clearable(), "{wire:?}: {refused}");
        b.hand.clear_fault(PATIENT).await.unwrap();
        assert_near(&b.hand.grip(&grip(0.0), PATIENT).await.unwrap(), 0.0);
        let half = b.hand.grip(&grip(0.02), PATIENT).await.unwrap();
        assert_near(&half, 0.02);
        assert!(half.settled && !half.feels_object(), "{wire:?}: {half:?}");
        b.hand.grip(&grip(0.0), PATIENT).await.unwrap();
        b.objects.between(0, Some(150.0));
        let held = b.hand.close(&close(), PATIENT).await.unwrap();
        assert!(held.settled && held.held == [true], "{wire:?}: {held:?}");
        assert!((held.actuators[0] - 0.02753).abs() < 4e-4, "{wire:?}: {held:?}");
        // Sent on until something stops it, with no more force than asked: (0.5 * 235 - 20) / 215 of 255.
        assert_eq!(b.gripper.request()[..6], [9, 0, 0, 255, 108, 116], "{wire:?}");
        assert!(b.hand.state(PATIENT).await.unwrap().feels_object());
        // What slips away is noticed.
        b.objects.between(0, None);
        let until = Instant::now() + PATIENT;
        while b.hand.state(PATIENT).await.unwrap().feels_object() {
            assert!(Instant::now() < until, "{wire:?}: the loss was not noticed");
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        // A ready gripper is left alone.
        b.hand.clear_fault(PATIENT).await.unwrap();
        assert_eq!(b.gripper.status()[0] >> 4 & 3, 3);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_for_the_same_place_is_not_taken_for_done_too_early() {
    let b = ready(Wire::Rtu).await;
    for target in [0.03, 0.03, 0.01, 0.03] {
        assert_near(&b.hand.grip(&grip(target), PATIENT).await.unwrap(), target);
    }
    // Something in the way of opening.
    b.objects.around(0, Some(120.0));
    let state = b.hand.grip(&grip(0.0), PATIENT).await.unwrap();
    assert_eq!(state.held, [true]);
    assert_eq!(b.hand.report(PATIENT).await.unwrap().axes[0].motion, Motion::HeldOpening);
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_moves_before_it_is_armed_nor_beyond_limits() {
    let b = bench_with(Model::TwoFinger85, Wire::Rtu, |s| {
        s.armed = false;
        s.max_speed_mm_s = Some(50.0);
        s.max_force_n = Some(60.0);
        s.openings_mm = Some([10.0, 60.0]);
    })
    .await;
    let (from, to) = (0.0125, 0.0375);
    for error in
        [b.hand.grip(&grip(0.02), PATIENT).await.unwrap_err(), b.hand.clear_fault(PATIENT).await.unwrap_err()]
    {
        assert!(error.to_string().contains("motion is not armed"), "{error}");
    }
    assert_eq!(b.gripper.request(), [0; 16]);
    b.hand.arm(true, PATIENT).await.unwrap();
    b.hand.clear_fault(PATIENT).await.unwrap();
    for outside in [0.0, 0.0425, f64::NAN] {
        let error = b.hand.grip(&grip(outside), PATIENT).await.unwrap_err();
        assert!(error.to_string().contains(&format!("expected {from} to {to}")), "{error}");
    }
    let fast = GripCommand { force: 1.0, ..grip(0.03) };
    assert_near(&b.hand.grip(&fast, PATIENT).await.unwrap(), 0.03);
    // 50 of 20 to 150 mm/s, 60 of 20 to 235 N.
    assert_eq!(b.gripper.request()[4..6], [59, 47]);
    let long = GripCommand { actuators: vec![0.02; 2], ..grip(0.02) };
    assert!(matches!(b.hand.grip(&long, PATIENT).await, Err(DeviceError::OutOfRange { .. })));
    b.hand.arm(false, PATIENT).await.unwrap();
    assert!(b.hand.grip(&grip(0.02), PATIENT).await.is_err());
}

#[tokio::test(flavor = "multi_thread")]
async fn motions_are_exclusive_stoppable_and_end_with_their_caller() {
    let b = ready(Wire::Rtu).await;
    let slow = GripCommand { speed: 0.0, ..grip(0.0425) };
    let (first, (), stopped) = tokio::join!(
        b.hand.grip(&slow, PATIENT),
        async {
            tokio::time::sleep(Duration::from_millis(150)).await;
            let busy = b.hand.grip(&slow, PATIENT).await.unwrap_err();
            assert!(matches!(busy, DeviceError::Busy { .. }), "{busy}");
        },
        async {
            tokio::time::sleep(Duration::from_millis(300)).await;
            b.hand.stop(PATIENT).await
        },
    );
    assert!(matches!(first, Err(DeviceError::Stopped { operation: "grip", .. })), "{first:?}");
    stopped.unwrap();
    assert_eq!(b.gripper.request()[0], 1, "stopped, still activated");
    b.hand.grip(&grip(0.0), PATIENT).await.unwrap();
    // A caller that gives up stops the fingers.
    let given_up = tokio::time::timeout(Duration::from_millis(200), b.hand.grip(&slow, PATIENT)).await;
    assert!(given_up.is_err());
    tokio::time::sleep(Duration::from_millis(200)).await;
    let there = b.hand.state(PATIENT).await.unwrap();
    tokio::time::sleep(Duration::from_millis(200)).await;
    assert_eq!(there.actuators, b.hand.state(PATIENT).await.unwrap().actuators);
    assert!(there.actuators[0] < 0.04);
    let began = Instant::now();
    let late = b.hand.grip(&slow, Duration::from_millis(300)).await.unwrap_err();
    assert!(matches!(late, DeviceError::Timeout { operation: "grip", .. }), "{late}");
    assert!(began.elapsed() < Duration::from_millis(350));
    b.hand.grip(&grip(0.0), PATIENT).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn disturbances_of_the_line_are_overcome() {
    for wire in [Wire::Rtu, Wire::ModbusTcp, Wire::RtuOverTcp, Wire::Socket] {
        let b = ready(wire).await;
        let faults = b.faults();
        faults.change(|now| now.halve = 1);
        b.hand.state(PATIENT).await.unwrap();
        faults.change(|now| now.lose = 2);
        b.hand.state(PATIENT).await.unwrap();
        if matches!(wire, Wire::Rtu | Wire::RtuOverTcp) {
            // A check protects against these.
            faults.garble(2);
            b.hand.state(PATIENT).await.unwrap();
            faults.change(|now| now.noise = 1);
            b.hand.state(PATIENT).await.unwrap();
        }
        faults.change(|now| now.delay = Duration::from_millis(30));
        b.hand.state(PATIENT).await.unwrap();
        assert_near(&b.hand.grip(&grip(0.015), PATIENT).await.unwrap(), 0.015);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_line_that_stays_disturbed_is_an_error_that_says_so() {
    let b = ready(Wire::Rtu).await;
    b.faults().garble(20);
    let error = b.hand.state(PATIENT).await.unwrap_err();
    assert!(matches!(error, DeviceError::Disconnected { .. }), "{error}");
    assert!(error.to_string().contains("a garbled line: grounding, baud rate, two masters?"), "{error}");
    b.faults().clear();
    b.hand.state(PATIENT).await.unwrap();
    b.faults().change(|now| now.lose = 1000);
    let error = b.hand.state(PATIENT).await.unwrap_err();
    assert!(error.to_string().contains("power, cable, address 9, or another master"), "{error}");
    let short = b.hand.state(Duration::from_millis(60)).await.unwrap_err();
    assert!(matches!(short, DeviceError::Timeout { operation: "state", .. }), "{short}");
    b.faults().clear();
    assert_near(&b.hand.grip(&grip(0.03), PATIENT).await.unwrap(), 0.03);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_comes_late_is_not_taken_for_the_next_answer() {
    let b = bench_with(Model::TwoFinger85, Wire::Rtu, |s| s.attempts = 1).await;
    b.hand.clear_fault(PATIENT).await.unwrap();
    b.faults().change(|now| now.delay = Duration::from_millis(700));
    let late = b.hand.state(PATIENT).await.unwrap_err();
    assert!(late.is_transient(), "{late}");
    b.faults().clear();
    tokio::time::sleep(Duration::from_millis(900)).await;
    for target in [0.03, 0.01] {
        assert_near(&b.hand.grip(&grip(target), PATIENT).await.unwrap(), target);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_hang_up_ends_a_motion_and_the_next_call_connects_again() {
    for wire in [Wire::Rtu, Wire::ModbusTcp, Wire::Socket] {
        let b = ready(wire).await;
        let slow = GripCommand { speed: 0.0, ..grip(0.0425) };
        let (ended, ()) = tokio::join!(b.hand.grip(&slow, PATIENT), async {
            tokio::time::sleep(Duration::from_millis(200)).await;
            b.faults().hang_up(Duration::from_millis(1200));
        });
        let error = ended.unwrap_err();
        assert!(matches!(error, DeviceError::Disconnected { .. }), "{wire:?}: {error}");
        let until = Instant::now() + PATIENT;
        while let Err(error) = b.hand.state(PATIENT).await {
            assert!(error.is_transient(), "{wire:?}: {error}");
            assert!(Instant::now() < until, "{wire:?}: the gripper did not come back");
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        assert_near(&b.hand.grip(&grip(0.01), PATIENT).await.unwrap(), 0.01);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn faults_of_the_gripper_stop_a_motion_by_name_until_they_are_cleared() {
    let b = ready(Wire::Rtu).await;
    for (code, kind, name) in [
        (0x0E, FaultKind::Overload, "over-current"),
        (0x0A, FaultKind::NotActivated, "under-voltage"),
        (0x0D, FaultKind::NotActivated, "activation fault"),
        (0x0F, FaultKind::NotActivated, "automatic release completed"),
    ] {
        let slow = GripCommand { speed: 0.0, ..grip(0.0425) };
        let (ended, ()) = tokio::join!(b.hand.grip(&slow, PATIENT), async {
            tokio::time::sleep(Duration::from_millis(200)).await;
            b.gripper.fault(code);
        });
        match ended.unwrap_err() {
            DeviceError::Fault { kind: found, detail, .. } => {
                assert_eq!(found, kind);
                assert!(detail.contains(name), "{detail}");
            }
            other => panic!("{other}"),
        }
        assert!(b.hand.grip(&grip(0.0), PATIENT).await.unwrap_err().is_clearable());
        assert!(b.hand.report(PATIENT).await.unwrap().fault.is_some());
        b.hand.clear_fault(PATIENT).await.unwrap();
        b.hand.grip(&grip(0.0), PATIENT).await.unwrap();
    }
    // Over-temperature goes away by itself.
    b.gripper.fault(8);
    let hot = b.hand.grip(&grip(0.02), PATIENT).await.unwrap_err();
    assert!(hot.to_string().contains("over-temperature"), "{hot}");
    b.gripper.fault(0);
    b.hand.grip(&grip(0.02), PATIENT).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_gripper_that_lost_power_says_that_it_is_not_activated() {
    let b = ready(Wire::Rtu).await;
    let slow = GripCommand { speed: 0.0, ..grip(0.0425) };
    let (ended, ()) = tokio::join!(b.hand.grip(&slow, PATIENT), async {
        tokio::time::sleep(Duration::from_millis(200)).await;
        b.gripper.power_cycle();
    });
    let error = ended.unwrap_err();
    assert!(matches!(&error, DeviceError::Fault { kind: FaultKind::NotActivated, .. }), "{error}");
    // Nobody has asked for an activation: stopping it must not have begun one.
    b.hand.stop(PATIENT).await.unwrap();
    tokio::time::sleep(Duration::from_millis(200)).await;
    assert_eq!((b.gripper.request()[0], b.gripper.status()[0]), (0, 0));
    b.hand.clear_fault(PATIENT).await.unwrap();
    b.hand.grip(&grip(0.0), PATIENT).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_hand_that_is_dropped_stops_frees_its_port_and_another_can_stop_what_moves() {
    let b = ready(Wire::Rtu).await;
    let Server::Line(line) = &b.server else { panic!("no serial line") };
    let link = LinkSettings::Rtu { port: line.path().display().to_string(), baud: 115_200 };
    drop(b.hand);
    // Ports are opened for one user alone: this one waits until the port is free.
    let other = RobotiqHand::new(RobotiqSettings { link, ..RobotiqSettings::default() }).unwrap();
    let until = Instant::now() + PATIENT;
    while other.state(PATIENT).await.is_err() {
        assert!(Instant::now() < until, "the port is still taken");
    }
    assert!(b.gripper.request()[0] & 1 == 1, "a grip is kept");
    // Somebody else let it go; whoever connects later can stop it, armed or not.
    let mut request = b.gripper.request();
    request[0] = 9;
    request[3] = 255;
    assert_eq!(b.gripper.status()[0] & 1, 1);
    b.gripper.overwrite(request);
    tokio::time::sleep(Duration::from_millis(60)).await;
    other.stop(PATIENT).await.unwrap();
    assert_eq!(b.gripper.request()[..4], [1, 0, 0, 255]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_gripper_measures_its_own_counts() {
    let b = ready(Wire::Rtu).await;
    let found = b.hand.calibrate(PATIENT).await.unwrap();
    assert_eq!((found.open_count, found.closed_count, found.open_mm), (3.0, 230.0, 85.0));
    b.objects.between(0, Some(100.0));
    let met = b.hand.calibrate(PATIENT).await.unwrap_err();
    assert!(met.to_string().contains("something held the fingers"), "{met}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_released_gripper_must_be_activated_anew() {
    for wire in [Wire::Rtu, Wire::Socket] {
        let b = ready(wire).await;
        b.hand.grip(&grip(0.0425), PATIENT).await.unwrap();
        b.hand.release(true, PATIENT).await.unwrap();
        let report = b.hand.report(PATIENT).await.unwrap();
        assert!(report.opening_mm.unwrap() > 84.0, "{report:?}");
        assert!(b.hand.grip(&grip(0.02), PATIENT).await.unwrap_err().is_clearable());
        b.hand.clear_fault(PATIENT).await.unwrap();
        b.hand.grip(&grip(0.02), PATIENT).await.unwrap();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_emergency_stop_of_the_arm_makes_the_gripper_unavailable() {
    let b = ready(Wire::Socket).await;
    b.gripper.out_of_reach(true);
    let error = b.hand.state(PATIENT).await.unwrap_err();
    assert!(error.is_transient() && error.to_string().contains("cannot be reached by the arm"), "{error}");
    b.gripper.out_of_reach(false);
    b.hand.grip(&grip(0.02), PATIENT).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn the_gripper_is_looked_at_often_enough_that_it_never_feels_alone() {
    let b = ready(Wire::Rtu).await;
    tokio::time::sleep(Duration::from_millis(1500)).await;
    assert_eq!(b.gripper.status()[2], 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn three_fingers_move_each_alone_and_in_modes() {
    for wire in [Wire::Rtu, Wire::ModbusTcp] {
        let b = bench(Model::ThreeFinger, wire).await;
        b.hand.clear_fault(PATIENT).await.unwrap();
        assert_eq!(b.hand.info().actuators, ["scissor", "finger_1", "finger_2", "finger_middle"]);
        let targets = vec![0.1, 0.3, 0.5, 0.7];
        let command = GripCommand { actuators: targets.clone(), speed: 1.0, force: 1.0 };
        let state = b.hand.grip(&command, PATIENT).await.unwrap();
        for (found, expected) in state.actuators.iter().zip(&targets) {
            assert!((found - expected).abs() < 0.01, "{wire:?}: {state:?}");
        }
        assert!(!state.feels_object());
        // Finger A is the middle one, B the first: it meets something.
        b.objects.between(1, Some(70.0));
        let closing = CloseCommand {
            contact: vec![0.1, 0.6, 0.6, 0.75],
            squeezed: vec![0.1, 0.65, 0.65, 0.8],
            farthest: vec![0.1, 1.2218, 1.0, 1.0],
            meet: Duration::from_millis(500),
            speed: 1.0,
            force: 0.5,
        };
        let state = b.hand.close(&closing, PATIENT).await.unwrap();
        assert_eq!(state.held, [false, true, false, false], "{wire:?}: {state:?}");
        assert!((state.actuators[1] - 70.0 / 148.0 * 1.2218).abs() < 0.01);
        assert_eq!(b.gripper.request()[6], 255, "sent on until it is held");
        b.objects.between(1, None);
        let state = b.hand.grip_in_mode(Mode::Pinch, 0.2, 1.0, 0.5, PATIENT).await.unwrap();
        assert!(state.settled);
        let report = b.hand.report(PATIENT).await.unwrap();
        assert_eq!((report.mode, report.phase), (Mode::Pinch, Phase::Ready));
        // All three fingers by one request.
        assert!(report.axes[1..].iter().all(|a| a.count == 51), "{report:?}");
        // And each alone again, without turning to another mode first.
        b.hand.grip(&command, PATIENT).await.unwrap();
        assert_eq!(b.hand.report(PATIENT).await.unwrap().mode, Mode::Pinch);
    }
    let two = bench(Model::TwoFinger85, Wire::Rtu).await;
    let error = two.hand.grip_in_mode(Mode::Wide, 0.5, 1.0, 1.0, PATIENT).await.unwrap_err();
    assert!(matches!(error, DeviceError::Unsupported { .. }));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_check_says_what_is_wrong_and_what_to_do() {
    let b = bench_with(Model::TwoFinger85, Wire::Rtu, |s| s.armed = false).await;
    let findings = b.hand.check(PATIENT).await.unwrap();
    let bad: Vec<_> = findings.iter().filter(|f| !f.ok).map(|f| f.subject.as_str()).collect();
    assert_eq!(bad, ["activation", "motion"]);
    let link = LinkSettings::Rtu { port: "/dev/no-such-port".into(), baud: 115_200 };
    let nowhere = RobotiqHand::new(RobotiqSettings { link, ..RobotiqSettings::default() }).unwrap();
    let findings = nowhere.check(PATIENT).await.unwrap();
    assert!(findings.len() == 1 && findings[0].found.contains("/dev/no-such-port"), "{findings:?}");
    // Nobody listens.
    let link = LinkSettings::Socket { address: "127.0.0.1:9".into() };
    let nobody = RobotiqHand::new(RobotiqSettings { link, ..RobotiqSettings::default() }).unwrap();
    assert!(matches!(nobody.state(PATIENT).await, Err(DeviceError::Disconnected { .. })));
}
