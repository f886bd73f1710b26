//! Every fault of the emulated controller: the documented error, then recovery, nothing hung, nothing moving.

#![allow(clippy::unwrap_used, clippy::expect_used)] // Helpers of tests.

mod bench;

use std::time::{Duration, Instant};

use bench::{Bench, LIMITS, LONG, SOON, apart, bench, bench_with, settings};
use graspd_adapters_core::{Arm, ArmMode, DeviceError, FaultKind};
use graspd_adapters_emulators::faults::{Garble, Misbehaviour};
use graspd_adapters_emulators::ur::{Safety, UrSettings};
use graspd_adapters_ur::{Dashboard, DashboardError, SafetyStatus, UrEvent};
use nalgebra::Isometry3;
use tokio::task::JoinHandle;

/// A long way down, under way.
async fn moving(bench: &Bench) -> (JoinHandle<Result<(), DeviceError>>, Isometry3<f64>) {
    let goal = bench.beside(0.0, 0.0, -0.3);
    let arm = bench.arm.clone();
    let motion = tokio::spawn(async move { arm.move_linear(&goal, LIMITS, LONG).await });
    bench.until("moves", Bench::moves).await;
    (motion, goal)
}

async fn ended(motion: JoinHandle<Result<(), DeviceError>>) -> DeviceError {
    tokio::time::timeout(SOON, motion).await.expect("the motion hangs").unwrap().unwrap_err()
}

/// It works again: a small motion.
async fn works(bench: &Bench) {
    let until = Instant::now() + LONG;
    loop {
        // On the wire, what was broken may be noticed a moment later.
        let goal = bench.beside(0.0, 0.0, 0.01);
        match bench.arm.move_linear(&goal, LIMITS, SOON).await {
            Ok(()) => {
                assert!(apart(&bench.flange(), &goal) < 1e-3);
                return;
            }
            Err(error) => assert!(Instant::now() < until && error.is_transient(), "{error}"),
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

fn misbehave(change: impl FnOnce(&mut Misbehaviour)) -> Misbehaviour {
    let mut misbehaviour = Misbehaviour::default();
    change(&mut misbehaviour);
    misbehaviour
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_protective_stop_is_a_fault_and_is_unlocked_only_where_that_is_allowed() {
    let bench = bench_with(settings(), None, |config| config.unlock_protective_stop = true).await;
    let mut events = bench.arm.events();
    let (motion, goal) = moving(&bench).await;
    bench.emulator.protective_stop("C153: it hit something");
    let error = ended(motion).await;
    assert!(matches!(error, DeviceError::Fault { kind: FaultKind::ProtectiveStop, .. }), "{error}");
    assert!(error.is_clearable() && apart(&bench.flange(), &goal) > 0.05);
    bench.until("stands", |b| !b.moves()).await;
    let state = bench.arm.state(SOON).await.unwrap();
    assert_eq!(state.mode, ArmMode::Stopped(FaultKind::ProtectiveStop));
    let again = bench.arm.move_linear(&goal, LIMITS, SOON).await.unwrap_err();
    assert!(matches!(again, DeviceError::Fault { kind: FaultKind::ProtectiveStop, .. }), "{again}");
    // Too short for the controller's waiting time, then long enough.
    let late = bench.arm.clear_fault(Duration::from_millis(50)).await.unwrap_err();
    assert!(matches!(late, DeviceError::Timeout { operation: "clear_fault", .. }), "{late}");
    bench.arm.clear_fault(SOON).await.unwrap();
    works(&bench).await;
    let mut seen = Vec::new();
    while let Ok(event) = events.try_recv() {
        if let UrEvent::Safety { from: Some(from), to } = event {
            seen.push((from, to));
        }
    }
    let (normal, stopped) = (SafetyStatus::Normal, SafetyStatus::ProtectiveStop);
    assert_eq!(seen, [(normal, stopped), (stopped, normal)]);

    let strict = bench::bench().await;
    strict.arm.state(SOON).await.unwrap();
    strict.emulator.protective_stop("C153");
    strict.until("stopped", |b| b.emulator.snapshot().safety == Safety::ProtectiveStop).await;
    tokio::time::sleep(Duration::from_millis(50)).await;
    let error = strict.arm.clear_fault(SOON).await.unwrap_err();
    assert!(error.to_string().contains("unlock_protective_stop") && !error.is_clearable(), "{error}");
    assert_eq!(strict.emulator.snapshot().safety, Safety::ProtectiveStop);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn stops_that_need_a_person_say_so() {
    let bench = bench_with(settings(), None, |config| config.power_up = true).await;
    let (motion, _) = moving(&bench).await;
    bench.emulator.emergency_stop(true);
    let error = ended(motion).await;
    assert!(matches!(error, DeviceError::Fault { kind: FaultKind::EmergencyStop, .. }), "{error}");
    let error = bench.arm.clear_fault(SOON).await.unwrap_err();
    assert!(matches!(error, DeviceError::Fault { kind: FaultKind::EmergencyStop, .. }), "{error}");
    bench.emulator.emergency_stop(false);
    tokio::time::sleep(Duration::from_millis(50)).await;
    assert_eq!(bench.arm.state(SOON).await.unwrap().mode, ArmMode::Off);
    bench.arm.clear_fault(SOON).await.unwrap();
    works(&bench).await;
    bench.emulator.safeguard(true);
    tokio::time::sleep(Duration::from_millis(50)).await;
    let error = bench.arm.clear_fault(SOON).await.unwrap_err();
    assert!(error.to_string().contains("SafeguardStop"), "{error}");
    bench.emulator.safeguard(false);
    tokio::time::sleep(Duration::from_millis(50)).await;
    works(&bench).await;
    bench.emulator.violation();
    tokio::time::sleep(Duration::from_millis(50)).await;
    let error = bench.arm.clear_fault(SOON).await.unwrap_err();
    assert!(error.to_string().contains("Violation"), "{error}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn without_power_nothing_moves_and_power_comes_only_where_that_is_allowed() {
    let bench = bench_with(UrSettings { powered: false, ..settings() }, None, |_| {}).await;
    assert_eq!(bench.arm.state(SOON).await.unwrap().mode, ArmMode::Off);
    let goal = bench.beside(0.0, 0.0, 0.01);
    let error = bench.arm.move_to(&goal, LIMITS, SOON).await.unwrap_err();
    assert!(error.to_string().contains("found PowerOff, expected Running"), "{error}");
    for error in [bench.arm.clear_fault(SOON).await, bench.arm.power_up(SOON).await] {
        assert!(error.unwrap_err().to_string().contains("power_up"));
    }
    let allowed = bench_with(UrSettings { powered: false, ..settings() }, None, |c| c.power_up = true).await;
    allowed.arm.power_up(SOON).await.unwrap();
    works(&allowed).await;
    allowed.dashboard().power_off().await.unwrap();
    allowed.until("off", |b| b.emulator.snapshot().robot_mode == 3).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn out_of_remote_control_is_a_clear_refusal() {
    let bench = bench().await;
    bench.emulator.set_remote_control(false);
    let goal = bench.beside(0.0, 0.0, 0.01);
    let error = bench.arm.move_to(&goal, LIMITS, SOON).await.unwrap_err();
    assert!(error.to_string().contains("not in remote control"), "{error}");
    let error = bench.dashboard().power_on().await.unwrap_err();
    assert!(matches!(error, DashboardError::NotRemote { .. }), "{error}");
    bench.emulator.set_remote_control(true);
    works(&bench).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_link_that_is_cut_in_a_motion_stops_the_arm_and_comes_back() {
    let bench = bench().await;
    let (motion, goal) = moving(&bench).await;
    let rtde = &bench.emulator.faults().rtde;
    rtde.set(misbehave(|m| m.refuse = true));
    rtde.cut();
    let cut = Instant::now();
    let error = ended(motion).await;
    assert!(matches!(error, DeviceError::Disconnected { .. }) && error.is_transient(), "{error}");
    // The arm stops although nobody can tell it to: no heartbeat.
    bench.until("stands", |b| !b.moves()).await;
    // 0.5 s without a beat, 0.09 s of braking; the rest is this machine.
    assert!(cut.elapsed() < Duration::from_millis(1500), "{:?}", cut.elapsed());
    assert!(apart(&bench.flange(), &goal) > 0.03 && !bench.emulator.snapshot().program_running);
    let error = bench.arm.state(Duration::from_millis(100)).await.unwrap_err();
    assert!(matches!(error, DeviceError::Disconnected { .. }), "{error}");
    rtde.clear();
    works(&bench).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_link_that_is_back_at_once_does_not_let_the_motion_go_on() {
    // A heartbeat that is missed so late that it does not stop the arm here.
    let bench = bench_with(settings(), None, |config| config.heartbeat.timeout_s = 1.0).await;
    let (motion, goal) = moving(&bench).await;
    bench.emulator.faults().rtde.cut();
    let error = ended(motion).await;
    assert!(matches!(error, DeviceError::Disconnected { .. }), "{error}");
    let cut = Instant::now();
    bench.until("stands", |b| !b.moves()).await;
    assert!(cut.elapsed() < Duration::from_millis(900), "{:?}", cut.elapsed());
    assert!(apart(&bench.flange(), &goal) > 0.03);
    works(&bench).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_heartbeat_that_is_lost_stops_the_arm() {
    let bench = bench_with(settings(), None, |config| config.heartbeat.timeout_s = 0.2).await;
    bench.arm.state(SOON).await.unwrap();
    // A runtime of its own, which stands still: a client that hangs with its connections open.
    let config = bench.arm.config().clone();
    let Bench { emulator, arm } = bench;
    drop(arm);
    tokio::time::sleep(Duration::from_millis(100)).await;
    let (stop, stopped) = std::sync::mpsc::channel::<()>();
    let client = std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let (arm, motion) = runtime.block_on(async {
            let arm = std::sync::Arc::new(graspd_adapters_ur::UrArm::new(config).unwrap());
            let mut goal = arm.state(SOON).await.unwrap().world_from_flange;
            goal.translation.vector.z -= 0.3;
            let theirs = arm.clone();
            let motion = tokio::spawn(async move { theirs.move_linear(&goal, LIMITS, LONG).await });
            while arm.robot_state(SOON).await.unwrap().is_standing() {
                tokio::time::sleep(Duration::from_millis(2)).await;
            }
            (arm, motion)
        });
        stopped.recv().unwrap();
        // Awake again: it hears why the motion ended.
        let error = runtime.block_on(motion).unwrap().unwrap_err();
        drop(arm);
        error
    });
    let bench_moves = |emulator: &graspd_adapters_emulators::ur::UrEmulator| {
        emulator.snapshot().joint_speeds.iter().any(|v| v.abs() > 0.01)
    };
    let until = Instant::now() + SOON;
    while !bench_moves(&emulator) {
        assert!(Instant::now() < until);
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    let began = Instant::now();
    while bench_moves(&emulator) {
        assert!(Instant::now() < until);
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    assert!(began.elapsed() < Duration::from_millis(1200), "{:?}", began.elapsed());
    assert_eq!(emulator.snapshot().output_ints[29], 1);
    stop.send(()).unwrap();
    let error = client.join().unwrap();
    assert!(matches!(&error, DeviceError::Disconnected { .. }), "{error}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn packets_in_pieces_are_no_fault() {
    let bench = bench_with(settings(), None, |config| config.frequency_hz = 50.0).await;
    let pieces = misbehave(|m| m.pieces = Some((29, Duration::from_micros(50))));
    bench.emulator.faults().rtde.set(pieces.clone());
    bench.emulator.faults().dashboard.set(pieces.clone());
    bench.emulator.faults().scripts.set(pieces);
    bench.emulator.faults().rtde.cut();
    works(&bench).await;
    bench.dashboard().safety_status().await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_controller_that_falls_silent_is_disconnected() {
    let bench = bench().await;
    let (motion, _) = moving(&bench).await;
    bench.emulator.faults().rtde.set(misbehave(|m| m.mute = true));
    let error = ended(motion).await;
    assert!(error.to_string().contains("no frame of state within 500ms"), "{error}");
    bench.until("stands", |b| !b.moves()).await;
    bench.emulator.faults().rtde.clear();
    works(&bench).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn slow_replies_end_in_time() {
    let bench = bench().await;
    bench.arm.state(SOON).await.unwrap();
    let faults = bench.emulator.faults();
    faults.dashboard.set(misbehave(|m| m.delay = Duration::from_secs(3)));
    let began = Instant::now();
    let error = bench.dashboard().robot_mode().await.unwrap_err();
    assert!(matches!(error, DashboardError::Timeout { .. }), "{error}");
    assert!(began.elapsed() < Duration::from_secs(2));
    let goal = bench.beside(0.0, 0.0, 0.01);
    let began = Instant::now();
    let error = bench.arm.move_to(&goal, LIMITS, Duration::from_millis(300)).await.unwrap_err();
    assert!(matches!(error, DeviceError::Timeout { .. }), "{error}");
    assert!(began.elapsed() < Duration::from_secs(1));
    faults.dashboard.clear();
    faults.rtde.set(misbehave(|m| m.delay = Duration::from_secs(3)));
    faults.rtde.cut();
    tokio::time::sleep(Duration::from_millis(1500)).await;
    let error = bench.arm.state(Duration::from_millis(100)).await.unwrap_err();
    assert!(error.to_string().contains("no answer within"), "{error}");
    faults.rtde.clear();
    works(&bench).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn garbled_packages_break_the_link_with_their_field_and_it_comes_back() {
    let bench = bench().await;
    // Length, type, recipe; then a number that is none.
    for (at, mask, expected) in [
        (0, 0xf0, "RTDE size: found"),
        (2, 0x0f, "RTDE type: found"),
        (3, 0x02, "RTDE recipe of data: found 3, expected 1"),
    ] {
        works(&bench).await;
        let mut events = bench.arm.events();
        let garble = Garble { packets: 1, at, mask };
        bench.emulator.faults().rtde.set(misbehave(|m| m.garble = Some(garble)));
        let why = tokio::time::timeout(SOON, async {
            loop {
                if let UrEvent::Disconnected { why } = events.recv().await.unwrap() {
                    return why;
                }
            }
        });
        let why = why.await.unwrap();
        assert!(why.contains(expected), "{why}");
    }
    works(&bench).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn registers_that_something_else_owns_are_named() {
    let emulator = graspd_adapters_emulators::ur::UrEmulator::start(settings()).await.unwrap();
    emulator.occupy("input_int_register_24", true);
    let arm = graspd_adapters_ur::UrArm::new(bench::config(&emulator)).unwrap();
    let error = arm.state(Duration::from_millis(500)).await.unwrap_err();
    assert!(error.to_string().contains("input_int_register_24: in use by another RTDE client"), "{error}");
    emulator.occupy("input_int_register_24", false);
    arm.state(SOON).await.unwrap();
    // A second client that would move is told so; one that only watches is welcome.
    let second = graspd_adapters_ur::UrArm::new(bench::config(&emulator)).unwrap();
    let error = second.state(Duration::from_millis(500)).await.unwrap_err();
    assert!(error.to_string().contains("in use"), "{error}");
    let mut watching = bench::config(&emulator);
    watching.armed = false;
    let watcher = graspd_adapters_ur::UrArm::new(watching).unwrap();
    watcher.state(SOON).await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn scripts_that_do_not_arrive_or_are_ended_by_others_are_reported() {
    let bench = bench().await;
    bench.arm.state(SOON).await.unwrap();
    let scripts = &bench.emulator.faults().scripts;
    scripts.set(misbehave(|m| m.refuse = true));
    let goal = bench.beside(0.0, 0.0, 0.01);
    let error = bench.arm.move_to(&goal, LIMITS, LONG).await.unwrap_err();
    let text = error.to_string();
    assert!(text.contains("primary interface") || text.contains("control script"), "{text}");
    scripts.clear();
    works(&bench).await;
    let (motion, _) = moving(&bench).await;
    bench.emulator.stop_program();
    let error = ended(motion).await;
    assert!(error.to_string().contains("ended in the middle of a motion"), "{error}");
    bench.until("stands", |b| !b.moves()).await;
    works(&bench).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_program_of_somebody_else_is_stopped_by_a_stop() {
    use tokio::io::AsyncWriteExt;
    let bench = bench().await;
    bench.arm.state(SOON).await.unwrap();
    let mut stream = tokio::net::TcpStream::connect(bench.emulator.addresses().secondary).await.unwrap();
    let program = "def other():\n  movej([1.0, -1.57, 1.57, -1.57, -1.57, 0.0], a=0.5, v=0.2)\nend\n";
    stream.write_all(program.as_bytes()).await.unwrap();
    bench.until("moves", Bench::moves).await;
    bench.arm.stop(SOON).await.unwrap();
    assert!(!bench.moves() && !bench.emulator.snapshot().program_running);
    works(&bench).await;
}

#[tokio::test]
async fn a_dashboard_that_is_none_is_told_apart() {
    use tokio::io::AsyncWriteExt;
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let port = listener.local_addr().unwrap().port();
    let server = tokio::spawn(async move {
        let (mut stream, _) = listener.accept().await.unwrap();
        stream.write_all(b"SSH-2.0-OpenSSH\r\n").await.unwrap();
        let (mut stream, _) = listener.accept().await.unwrap();
        let _cut = stream.write_all(&vec![b'x'; 100_000]).await;
    });
    let dashboard = Dashboard::new("127.0.0.1", port, Duration::from_secs(1));
    let error = dashboard.robot_mode().await.unwrap_err();
    assert!(error.to_string().contains("found \"SSH-2.0-OpenSSH\", expected the greeting"), "{error}");
    let error = dashboard.robot_mode().await.unwrap_err();
    assert!(error.to_string().contains("a line of more than 4096 bytes"), "{error}");
    server.await.unwrap();
    let error = dashboard.robot_mode().await.unwrap_err();
    assert!(matches!(error, DashboardError::Link(_)), "{error}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_check_says_what_is_wrong_and_what_to_do() {
    let emulator = graspd_adapters_emulators::ur::UrEmulator::start(settings()).await.unwrap();
    let config = bench::config(&emulator);
    let findings = graspd_adapters_ur::diagnose(&config).await;
    assert!(findings.iter().all(|f| f.ok && f.advice.is_empty()), "{findings:#?}");
    assert_eq!(findings.len(), 10);
    emulator.set_remote_control(false);
    emulator.occupy("input_int_register_26", true);
    emulator.protective_stop("C153");
    let mut wrong = config.clone();
    (wrong.armed, wrong.model) = (false, graspd_adapters_ur::kinematics::Model::Ur10e);
    let findings = graspd_adapters_ur::diagnose(&wrong).await;
    let bad: Vec<_> = findings.iter().filter(|f| !f.ok).map(|f| f.subject.as_str()).collect();
    assert_eq!(bad, ["remote control", "model", "registers", "safety", "motion"]);
    assert!(findings.iter().all(|f| f.ok || !f.advice.is_empty()));
    assert!(!emulator.snapshot().program_running);
    let mut nobody = config;
    drop(emulator);
    nobody.connect_timeout_s = 0.3;
    tokio::time::sleep(Duration::from_millis(50)).await;
    let findings = graspd_adapters_ur::diagnose(&nobody).await;
    let bad: Vec<_> = findings.iter().filter(|f| !f.ok).map(|f| f.subject.as_str()).collect();
    assert_eq!(bad, ["dashboard", "RTDE", "primary interface"]);
}
