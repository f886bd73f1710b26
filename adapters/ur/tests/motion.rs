//! Motion over real sockets: adapter, control script and emulated controller.

#![allow(clippy::unwrap_used, clippy::expect_used)] // Helpers of tests.

mod bench;

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;
use std::time::{Duration, Instant};

use bench::{LIMITS, LONG, SOON, apart, bench, bench_with, settings};
use graspd_adapters_core::{Arm, ArmMode, DeviceError, FaultKind, Leg, Limits, Reach, Reached};
use graspd_adapters_emulators::ur::{JointServo, Plant, PlantState, PlantTarget, UrPorts, UrSettings, Wall};
use graspd_adapters_ur::ServoSettings;
use nalgebra::{UnitQuaternion, UnitVector3, Vector3};

const HOME: [f64; 6] = [0.0, -FRAC_PI_2, FRAC_PI_2, -FRAC_PI_2, -FRAC_PI_2, 0.0];

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn state_comes_at_the_rate_of_the_controller() {
    let bench = bench().await;
    let state = bench.arm.state(SOON).await.unwrap();
    assert_eq!(state.mode, ArmMode::Ready);
    assert!(apart(&state.world_from_flange, &bench.flange()) < 1e-9);
    assert!(state.joints.iter().zip(bench.emulator.snapshot().joints).all(|(a, b)| (a - b).abs() < 1e-9));
    // Every frame of the controller comes: on its clock, not on that of a machine that does other things, too.
    let mut last = bench.arm.robot_state(SOON).await.unwrap().timestamp_s;
    let (mut frames, mut least) = (0, f64::INFINITY);
    let until = Instant::now() + LONG;
    while frames < 100 {
        assert!(Instant::now() < until, "{frames} frames");
        let stamp = bench.arm.robot_state(SOON).await.unwrap().timestamp_s;
        if stamp != last {
            frames += 1;
            least = least.min(stamp - last);
            last = stamp;
        }
        tokio::time::sleep(Duration::from_micros(300)).await;
    }
    assert!((least - 0.002).abs() < 1e-6, "{least}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn motions_arrive_and_the_flange_keeps_its_limits() {
    let bench = bench().await;
    let start = bench.flange();
    let away = start * UnitQuaternion::from_scaled_axis(Vector3::new(0.2, 0.3, 0.4));
    let mut goal = away;
    goal.translation.vector += Vector3::new(0.15, -0.2, -0.1);
    let watched = async {
        // Speeds between moments of the controller's clock, not of this machine's.
        let (mut fastest, mut before) = (0.0f64, bench.emulator.snapshot());
        loop {
            tokio::time::sleep(Duration::from_millis(10)).await;
            let now = bench.emulator.snapshot();
            let time = (now.steps - before.steps) as f64 * 0.002;
            if time > 0.0 {
                fastest = fastest.max(apart(&now.base_from_flange, &before.base_from_flange) / time);
                before = now;
            }
            if fastest > LIMITS.speed_m_s * 1.05 {
                return fastest;
            }
        }
    };
    let moving = async {
        bench.arm.move_to(&goal, LIMITS, LONG).await.unwrap();
        assert!(apart(&bench.flange(), &goal) < 1e-3);
        let up = bench.beside(0.0, 0.0, 0.1);
        bench.arm.move_linear(&up, LIMITS, LONG).await.unwrap();
        assert!(apart(&bench.flange(), &up) < 1e-3);
        let mut turned = up;
        turned.rotation = start.rotation;
        bench.arm.move_linear(&turned, LIMITS, LONG).await.unwrap();
        assert!(bench.flange().rotation.angle_to(&turned.rotation) < 1e-2);
        bench.arm.move_joints(&HOME, LIMITS, LONG).await.unwrap();
        assert!(apart(&bench.flange(), &start) < 1e-3);
    };
    tokio::select! {
        fastest = watched => panic!("{fastest} m/s"),
        () = moving => {}
    }
    assert_eq!(bench.arm.state(SOON).await.unwrap().mode, ArmMode::Ready);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_base_stands_where_it_is_said_to() {
    let bench = bench_with(settings(), None, |config| {
        config.world_from_base.position_m = [0.3, 0.2, 0.1];
        config.world_from_base.orientation = [0.0, 0.0, 1.0, 0.0];
        config.limits.workspace.lower_m[2] = 0.1;
    })
    .await;
    let state = bench.arm.state(SOON).await.unwrap();
    let mut goal = state.world_from_flange;
    goal.translation.vector.x += 0.05;
    let before = bench.flange();
    bench.arm.move_linear(&goal, LIMITS, LONG).await.unwrap();
    let moved = bench.flange().translation.vector - before.translation.vector;
    assert!((moved - Vector3::new(-0.05, 0.0, 0.0)).norm() < 1e-3, "{moved}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stop_stops_and_the_motion_says_so() {
    let bench = bench().await;
    let goal = bench.beside(0.0, 0.0, -0.3);
    let arm = bench.arm.clone();
    let motion = tokio::spawn(async move { arm.move_linear(&goal, LIMITS, LONG).await });
    bench.until("moves", |b| b.moves()).await;
    assert_eq!(bench.arm.state(SOON).await.unwrap().mode, ArmMode::Moving);
    let asked = Instant::now();
    bench.arm.stop(SOON).await.unwrap();
    assert!(!bench.moves());
    // 0.25 m/s at 3 m/s² make 0.09 s; the rest is this machine.
    assert!(asked.elapsed() < Duration::from_millis(800), "{:?}", asked.elapsed());
    let error = motion.await.unwrap().unwrap_err();
    assert!(matches!(error, DeviceError::Stopped { operation: "move_linear", .. }), "{error}");
    assert!(apart(&bench.flange(), &goal) > 0.05);
    // Ready for the next.
    let up = bench.beside(0.0, 0.0, 0.05);
    bench.arm.move_linear(&up, LIMITS, LONG).await.unwrap();
    bench.arm.stop(SOON).await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_dropped_motion_stops_the_arm() {
    let bench = bench().await;
    let goal = bench.beside(0.0, 0.0, -0.3);
    let arm = bench.arm.clone();
    let motion = tokio::spawn(async move { arm.move_to(&goal, LIMITS, LONG).await });
    bench.until("moves", |b| b.moves()).await;
    motion.abort();
    bench.until("stands", |b| !b.moves()).await;
    tokio::time::sleep(Duration::from_millis(200)).await;
    assert!(!bench.moves() && apart(&bench.flange(), &goal) > 0.05);
    bench.arm.move_linear(&bench.beside(0.0, 0.0, 0.02), LIMITS, LONG).await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_newer_motion_replaces_the_one_that_runs() {
    let bench = bench().await;
    let (goal, other) = (bench.beside(0.0, 0.0, -0.3), bench.beside(0.0, 0.1, 0.05));
    let arm = bench.arm.clone();
    let motion = tokio::spawn(async move { arm.move_linear(&goal, LIMITS, LONG).await });
    bench.until("moves", |b| b.moves()).await;
    bench.arm.move_to(&other, LIMITS, LONG).await.unwrap();
    assert!(matches!(motion.await.unwrap(), Err(DeviceError::Stopped { .. })));
    assert!(apart(&bench.flange(), &other) < 1e-3);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_motion_that_is_too_slow_is_stopped_in_time() {
    let bench = bench().await;
    // The script is uploaded before the clock runs.
    bench.arm.move_linear(&bench.beside(0.0, 0.0, 0.01), LIMITS, LONG).await.unwrap();
    let goal = bench.beside(0.0, 0.0, -0.3);
    let slow = Limits { speed_m_s: 0.05, ..LIMITS };
    let (began, limit) = (Instant::now(), Duration::from_millis(1500));
    let error = bench.arm.move_linear(&goal, slow, limit).await.unwrap_err();
    assert!(matches!(error, DeviceError::Timeout { operation: "move_linear", .. }), "{error}");
    assert!(began.elapsed() < limit + Duration::from_millis(300), "{:?}", began.elapsed());
    assert!(!bench.moves() && apart(&bench.flange(), &goal) > 0.1);
}

fn wall_below(depth_m: f64, bias_n: f64) -> Box<JointServo> {
    let start = graspd_adapters_emulators::ur::UrModel::Ur5e.flange(&HOME);
    let mut point = nalgebra::Point3::from(start.translation.vector);
    point.z -= depth_m;
    let wall = Wall { point, normal: UnitVector3::new_unchecked(Vector3::z()), stiffness_n_m: 5000.0 };
    Box::new(JointServo::new(HOME).with_wall(wall).with_force_bias(Vector3::new(0.0, bias_n, 0.0)))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_guarded_motion_ends_at_contact_or_at_its_goal() {
    // A sensor that is off by 20 N feels contact as well: force counts from where the motion begins.
    let settings = UrSettings { joints: Some(HOME), ..settings() };
    let bench = bench_with(settings, Some(wall_below(0.1, 20.0)), |_| {}).await;
    let start = bench.flange();
    let slow = Limits { speed_m_s: 0.05, acceleration_m_s2: 1.0 };
    let free = bench.beside(0.0, 0.0, -0.05);
    assert_eq!(bench.arm.move_until_contact(&free, slow, 15.0, LONG).await.unwrap(), Reached::Goal);
    let inside = bench.beside(0.0, 0.0, -0.2);
    assert_eq!(bench.arm.move_until_contact(&inside, slow, 15.0, LONG).await.unwrap(), Reached::Contact);
    let way = start.translation.vector.z - bench.flange().translation.vector.z;
    // 15 N at 5 N/mm are 3 mm; braking from 0.05 m/s at 3 m/s² half a millimetre.
    assert!(way > 0.102 && way < 0.108, "{way}");
    let out = start;
    bench.arm.move_linear(&out, LIMITS, LONG).await.unwrap();
    // Without a guard the configured limit stops it.
    let error = bench.arm.move_linear(&inside, slow, LONG).await.unwrap_err();
    assert!(
        matches!(&error, DeviceError::Fault { kind: FaultKind::Overload, detail, .. } if detail.contains("80 N")),
        "{error}"
    );
    let error = bench.arm.move_until_contact(&out, slow, 500.0, LONG).await.unwrap_err();
    assert!(matches!(&error, DeviceError::OutOfRange { field, .. } if field == "force_n"), "{error}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_may_not_be_is_refused_before_anything_moves() {
    let bench = bench().await;
    let (arm, near) = (&bench.arm, bench.beside(0.0, 0.0, 0.05));
    let mut below = near;
    below.translation.vector.z = 0.0;
    let mut nan = near;
    nan.translation.vector.x = f64::NAN;
    let far = bench.beside(-3.0, 0.0, 0.0);
    for (error, field) in [
        (arm.move_to(&far, LIMITS, SOON).await, "world_from_flange"),
        (arm.move_linear(&far, LIMITS, SOON).await, "world_from_flange"),
        (arm.move_to(&nan, LIMITS, SOON).await, "world_from_flange"),
        (arm.move_to(&below, LIMITS, SOON).await, "workspace"),
        (arm.move_linear(&below, LIMITS, SOON).await, "workspace"),
        (arm.move_to(&near, Limits { speed_m_s: 3.0, ..LIMITS }, SOON).await, "speed_m_s"),
        (arm.move_to(&near, Limits { acceleration_m_s2: 9.0, ..LIMITS }, SOON).await, "acceleration_m_s2"),
        (arm.move_joints(&[9.0; 6], LIMITS, SOON).await, "joints"),
    ] {
        let error = error.unwrap_err();
        assert!(matches!(&error, DeviceError::OutOfRange { field: f, .. } if f == field), "{error}");
    }
    assert!(!bench.emulator.snapshot().program_running && !bench.moves());
    let unarmed = bench_with(settings(), None, |config| config.armed = false).await;
    let error = unarmed.arm.move_to(&near, LIMITS, SOON).await.unwrap_err();
    assert!(matches!(&error, DeviceError::OutOfRange { field, .. } if field == "armed"), "{error}");
    unarmed.arm.stop(SOON).await.unwrap();
    assert!(!unarmed.emulator.snapshot().program_running);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stream_is_followed_stopped_when_it_dries_up_and_refused_when_too_fast() {
    // The test's own pauses on a busy machine are no end of the stream.
    let bench = bench_with(settings(), None, |config| config.heartbeat.stream_s = 1.0).await;
    let mut target: [f64; 6] = bench.emulator.snapshot().joints;
    let first = target[5];
    let mut stream = bench.arm.servo_joints(ServoSettings::default(), LIMITS, SOON).await.unwrap();
    let mut clock = tokio::time::interval(Duration::from_millis(8));
    clock.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    for _ in 0..100 {
        clock.tick().await;
        target[5] += 0.004;
        stream.send_joints(&target).unwrap();
    }
    bench.until("follows", |b| (b.emulator.snapshot().joints[5] - target[5]).abs() < 0.05).await;
    assert!(target[5] - first > 0.39);
    let error = stream.send_joints(&target.map(|q| q + 0.5)).unwrap_err();
    assert!(
        matches!(&error, DeviceError::OutOfRange { found, .. } if found.contains("rad of a joint")),
        "{error}"
    );
    // The control script's word for a stream that dried up.
    bench.until("dries up", |b| b.emulator.snapshot().output_ints[26] == 4).await;
    let until = Instant::now() + SOON;
    let error = loop {
        // Whether the script has ended it shows with the next frame of state.
        match stream.send_joints(&target) {
            Ok(()) => assert!(Instant::now() < until, "the stream goes on"),
            Err(error) => break error,
        }
        tokio::time::sleep(Duration::from_millis(5)).await;
    };
    assert!(matches!(error, DeviceError::Timeout { .. }), "{error}");
    bench.until("stands", |b| !b.moves()).await;
    drop(stream);

    let mut goal = bench.flange();
    let mut stream = bench.arm.servo_pose(ServoSettings::default(), LIMITS, SOON).await.unwrap();
    for _ in 0..60 {
        clock.tick().await;
        goal.translation.vector.z -= 0.001;
        stream.send_pose(&goal).unwrap();
    }
    // It is followed a little behind: whoever wants to get there stays there.
    for _ in 0..60 {
        clock.tick().await;
        stream.send_pose(&goal).unwrap();
    }
    bench.until("follows", |b| apart(&b.flange(), &goal) < 0.005).await;
    stream.finish(SOON).await.unwrap();
    assert!(!bench.moves());

    let mut stream = bench.arm.servo_pose(ServoSettings::default(), LIMITS, SOON).await.unwrap();
    for _ in 0..30 {
        clock.tick().await;
        goal.translation.vector.z += 0.001;
        stream.send_pose(&goal).unwrap();
    }
    drop(stream);
    bench.until("stands", |b| !b.moves()).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nothing_is_left_behind() {
    let bench = bench().await;
    bench.arm.move_linear(&bench.beside(0.0, 0.0, 0.02), LIMITS, LONG).await.unwrap();
    assert!(bench.emulator.snapshot().program_running);
    bench.arm.release(SOON).await.unwrap();
    assert!(!bench.emulator.snapshot().program_running);
    bench.arm.move_linear(&bench.beside(0.0, 0.0, 0.02), LIMITS, LONG).await.unwrap();
    let bench::Bench { emulator, arm } = bench;
    assert_eq!(Arc::strong_count(&arm), 1);
    drop(arm);
    let until = Instant::now() + SOON;
    // Without a heartbeat the script ends; without its owner no connection stays.
    while emulator.connections() > 0 || emulator.snapshot().program_running {
        assert!(Instant::now() < until, "{} connections", emulator.connections());
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_model_is_driven_with_its_own_geometry() {
    use graspd_adapters_emulators::ur::UrModel;
    use graspd_adapters_ur::kinematics::Model;
    for (emulated, model) in
        [(UrModel::Ur3e, Model::Ur3e), (UrModel::Ur5, Model::Ur5), (UrModel::Ur16e, Model::Ur16e)]
    {
        let bench =
            bench_with(UrSettings { ports: UrPorts::FREE, ..UrSettings::of(emulated) }, None, |config| {
                config.model = model
            })
            .await;
        let goal = bench.beside(0.02, -0.03, 0.02);
        bench.arm.move_to(&goal, LIMITS, LONG).await.unwrap();
        assert!(apart(&bench.flange(), &goal) < 1e-3, "{model:?}");
        bench.arm.move_until_contact(&bench.beside(0.0, 0.0, 0.03), LIMITS, 20.0, LONG).await.unwrap();
    }
}

/// A world that has something hard in it.
#[derive(Debug)]
struct Hard(JointServo, f64);

impl Plant for Hard {
    fn step(&mut self, target: &PlantTarget) -> PlantState {
        let mut state = self.0.step(target);
        if target.base_from_flange.translation.vector.z < self.1 {
            state.protective_stop = Some("the world is hard here".into());
        }
        state
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_plant_of_ones_own_can_stop_the_arm() {
    let start = graspd_adapters_emulators::ur::UrModel::Ur5e.flange(&HOME).translation.vector.z;
    let settings = UrSettings { joints: Some(HOME), ..settings() };
    let bench = bench_with(settings, Some(Box::new(Hard(JointServo::new(HOME), start - 0.05))), |_| {}).await;
    let error = bench.arm.move_linear(&bench.beside(0.0, 0.0, -0.2), LIMITS, LONG).await.unwrap_err();
    assert!(matches!(&error, DeviceError::Fault { kind: FaultKind::ProtectiveStop, .. }), "{error}");
    bench.until("stands", |b| !b.moves()).await;
    let z = bench.flange().translation.vector.z;
    assert!(z < start - 0.045 && z > start - 0.12, "{}", start - z);
}

/// A spring below a height, so that the force says how deep it is pressed.
fn spring_below(depth_m: f64, stiffness_n_m: f64) -> Box<JointServo> {
    let start = graspd_adapters_emulators::ur::UrModel::Ur5e.flange(&HOME).translation.vector;
    let point = nalgebra::Point3::from(start - nalgebra::Vector3::z() * depth_m);
    Box::new(JointServo::new(HOME).with_wall(Wall {
        point,
        normal: nalgebra::Vector3::z_axis(),
        stiffness_n_m,
    }))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_guarded_motion_does_not_stay_pressed_by_its_braking() {
    let settings = UrSettings { joints: Some(HOME), ..settings() };
    let bench = bench_with(settings, Some(spring_below(0.03, 20_000.0)), |_| {}).await;
    let start = bench.flange().translation.vector.z;
    let fast = Limits { speed_m_s: 0.1, acceleration_m_s2: 1.0 };
    let goal = bench.beside(0.0, 0.0, -0.06);
    let reached = bench.arm.move_until_contact(&goal, fast, 20.0, LONG).await.unwrap();
    assert_eq!(reached, graspd_adapters_core::Reached::Contact);
    bench.until("stands", |b| !b.moves()).await;
    let pressed = bench.arm.robot_state(SOON).await.unwrap().wrench[2];
    // 20 N at 1 mm; braking from 0.1 m/s with 3 m/s² alone would add 1.7 mm, 33 N.
    assert!(pressed < 35.0, "{pressed} N, {:.4} m", start - bench.flange().translation.vector.z);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn motions_that_begin_pressed_do_not_add_up_to_any_force() {
    let settings = UrSettings { joints: Some(HOME), stop_force_n: 1000.0, ..settings() };
    let plant = spring_below(0.01, 20_000.0);
    let bench = bench_with(settings, Some(plant), |c| c.limits.force_n = 40.0).await;
    let slow = Limits { speed_m_s: 0.02, acceleration_m_s2: 1.0 };
    let mut most: f64 = 0.0;
    for _ in 0..8 {
        let goal = bench.beside(0.0, 0.0, -0.05);
        // Each ends at its force, one way or another.
        let _ended = bench.arm.move_linear(&goal, slow, LONG).await;
        bench.until("stands", |b| !b.moves()).await;
        most = most.max(bench.arm.robot_state(SOON).await.unwrap().wrench[2]);
    }
    // 40 N of drift and 40 N of limit, and what braking adds; without that bound it would be 320 N.
    assert!(most > 60.0 && most < 100.0, "{most} N");
    let error = bench.arm.move_linear(&bench.beside(0.0, 0.0, -0.01), slow, LONG).await.unwrap_err();
    assert!(matches!(&error, DeviceError::OutOfRange { field, .. } if field == "force"), "{error}");
    let error = bench.arm.servo_pose(ServoSettings::default(), LIMITS, SOON).await.unwrap_err();
    assert!(matches!(&error, DeviceError::OutOfRange { field, .. } if field == "force"), "{error}");
    let up = bench.beside(0.0, 0.0, 0.03);
    bench.arm.move_linear(&up, slow, LONG).await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn however_long_a_caller_would_wait_no_clock_overflows() {
    let bench = bench().await;
    bench.arm.state(Duration::MAX).await.unwrap();
    bench.arm.move_linear(&bench.beside(0.0, 0.0, 0.01), LIMITS, Duration::MAX).await.unwrap();
    bench.arm.stop(Duration::MAX).await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_is_not_armed_moves_nothing_by_any_call() {
    let bench = bench_with(UrSettings { powered: true, ..settings() }, None, |c| {
        (c.armed, c.power_up, c.unlock_protective_stop) = (false, true, true);
    })
    .await;
    let goal = bench.beside(0.0, 0.0, 0.02);
    let arm = &bench.arm;
    let joints = bench.emulator.snapshot().joints;
    let refused = [
        arm.move_to(&goal, LIMITS, SOON).await,
        arm.move_linear(&goal, LIMITS, SOON).await,
        arm.move_until_contact(&goal, LIMITS, 10.0, SOON).await.map(|_| ()),
        arm.move_joints(&joints, LIMITS, SOON).await,
        arm.servo_joints(ServoSettings::default(), LIMITS, SOON).await.map(|_| ()),
        arm.servo_pose(ServoSettings::default(), LIMITS, SOON).await.map(|_| ()),
        arm.power_up(SOON).await,
    ];
    for error in refused.map(Result::unwrap_err) {
        assert!(matches!(error, DeviceError::OutOfRange { .. }), "{error}");
    }
    // Neither does unlocking: it is the first step of moving again.
    bench.emulator.protective_stop("test");
    bench
        .until("stops", |b| {
            b.emulator.snapshot().safety == graspd_adapters_emulators::ur::Safety::ProtectiveStop
        })
        .await;
    tokio::time::sleep(Duration::from_millis(700)).await;
    arm.clear_fault(SOON).await.unwrap_err();
    let snapshot = bench.emulator.snapshot();
    assert_eq!(snapshot.safety, graspd_adapters_emulators::ur::Safety::ProtectiveStop);
    assert!(snapshot.joints == joints && !snapshot.program_running);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_out_of_reach_is_known_before_anything_moves_and_then_refused() {
    let bench = bench().await;
    let arm = &bench.arm;
    arm.state(SOON).await.unwrap();
    let leg = |straight, world_from_flange| Leg { world_from_flange, straight, limits: LIMITS };
    let above = bench.beside(0.1, 0.1, 0.05);
    let lower = |by: f64| {
        let mut pose = above;
        pose.translation.vector.z -= by;
        pose
    };
    let mut turned = above;
    turned.rotation *= UnitQuaternion::from_scaled_axis(Vector3::z() * 0.8);
    let mut outwards = above;
    outwards.translation.vector -= Vector3::new(0.45, 0.0, 0.0);
    let mut nan = above;
    nan.translation.vector.y = f64::NAN;
    let fast = Leg { limits: Limits { speed_m_s: 2.0, ..LIMITS }, ..leg(true, lower(0.1)) };
    let ways = [
        (vec![leg(false, above), leg(true, lower(0.1)), leg(true, lower(0.2))], None),
        (vec![leg(false, turned), leg(true, above)], None),
        (vec![leg(false, above), leg(true, outwards)], Some((1, "world_from_flange"))),
        (vec![leg(false, above), leg(true, lower(0.1)), leg(true, lower(0.7))], Some((2, "workspace"))),
        (vec![leg(false, bench.beside(-3.0, 0.0, 0.0))], Some((0, "world_from_flange"))),
        (vec![leg(false, nan)], Some((0, "world_from_flange"))),
        (vec![leg(false, above), fast], Some((1, "speed_m_s"))),
        (vec![], None),
    ];
    let home = bench.emulator.snapshot().joints;
    for (way, expected) in ways {
        let said = arm.reaches(&way);
        match (&said, expected) {
            (Reach::Reaches, None) => {}
            (Reach::Beyond { leg, why }, Some((at, field))) => {
                assert!(*leg == at && why.contains(field), "{said:?} {expected:?}");
            }
            _ => panic!("{said:?}, expected {expected:?}"),
        }
        // The word is kept: what was said to be in reach is reached, and what was not is refused by the motion itself.
        for (i, leg) in way.iter().enumerate() {
            let (to, limits) = (&leg.world_from_flange, leg.limits);
            let gone = if leg.straight {
                arm.move_linear(to, limits, LONG).await
            } else {
                arm.move_to(to, limits, LONG).await
            };
            match expected {
                Some((at, field)) if at == i => {
                    let error = gone.unwrap_err();
                    assert!(
                        matches!(&error, DeviceError::OutOfRange { field: f, .. } if f == field),
                        "{error}"
                    );
                }
                _ => gone.unwrap(),
            }
        }
        arm.move_joints(&home, LIMITS, LONG).await.unwrap();
    }
    // Who does not know where it stands cannot tell.
    let bench::Bench { emulator, arm } = bench;
    drop(emulator);
    let until = Instant::now() + SOON;
    while arm.reaches(&[leg(false, above)]) != Reach::Unknown {
        assert!(Instant::now() < until);
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}
