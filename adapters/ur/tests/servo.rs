//! How streams of targets are followed: whatever comes, joints and flange keep their speeds and accelerations.

#![allow(clippy::unwrap_used, clippy::expect_used)] // Helpers of tests.

mod bench;

use std::sync::Mutex;
use std::time::Duration;

use bench::{Bench, LIMITS, SOON, apart, bench_with, settings};
use graspd_adapters_core::follow::lead;
use graspd_adapters_core::{Arm as _, DeviceError, Limits};
use graspd_adapters_emulators::ur::UrSnapshot;
use graspd_adapters_ur::ServoSettings;
use graspd_adapters_ur::kinematics::{Kinematics, Model};
use nalgebra::Vector3;

/// Bounds that streams of this file would break by far if `servoj` were given their targets as they come.
const SPEED: f64 = 0.8;
const ACCELERATION: f64 = 2.0;
/// Quick following: the emulator smooths least.
const STIFF: ServoSettings = ServoSettings { lookahead_s: 0.03, gain: 2000.0 };

async fn bounded() -> Bench {
    bounded_by(2.0).await
}

/// A bench whose flange may have so much acceleration.
async fn bounded_by(acceleration_m_s2: f64) -> Bench {
    bench_with(settings(), None, |config| {
        config.limits.joint_speed_rad_s = SPEED;
        config.limits.joint_acceleration_rad_s2 = ACCELERATION;
        config.limits.acceleration_m_s2 = acceleration_m_s2;
        // Machines of tests pause for long; that streams dry up is tested elsewhere.
        config.heartbeat.stream_s = 1.0;
        config.heartbeat.timeout_s = 1.0;
    })
    .await
}

/// What was seen of joints and flange while something else ran, by the controller's own clock.
#[derive(Debug, Default)]
struct Seen {
    speed: f64,
    acceleration: f64,
    flange: f64,
    flange_acceleration: f64,
    samples: usize,
}

/// How fast the flange is commanded to move, metres per second.
fn flange_velocity(seen: &UrSnapshot) -> Vector3<f64> {
    const MOMENT_S: f64 = 1e-5;
    let arm = Kinematics::new(Model::Ur5e);
    let at = |t: f64| {
        let joints = std::array::from_fn(|i| seen.joints[i] + t * seen.target_speeds[i]);
        arm.forward(&joints).translation.vector
    };
    (at(MOMENT_S) - at(-MOMENT_S)) / (2.0 * MOMENT_S)
}

impl Seen {
    fn take(&mut self, before: &UrSnapshot, now: &UrSnapshot) {
        let time = (now.steps - before.steps) as f64 * 0.002;
        for i in 0..6 {
            self.speed = self.speed.max(now.target_speeds[i].abs());
            let change = (now.target_speeds[i] - before.target_speeds[i]).abs();
            self.acceleration = self.acceleration.max(change / time);
        }
        let change = (flange_velocity(now) - flange_velocity(before)).norm();
        self.flange_acceleration = self.flange_acceleration.max(change / time);
        self.flange = self.flange.max(apart(&now.base_from_flange, &before.base_from_flange) / time);
        self.samples += 1;
    }
}

/// Runs a stream and watches the arm meanwhile.
async fn watched(bench: &Bench, stream: impl Future<Output = ()>) -> Seen {
    let seen = Mutex::new(Seen::default());
    let watch = async {
        let mut before = bench.emulator.snapshot();
        loop {
            tokio::time::sleep(Duration::from_millis(4)).await;
            let now = bench.emulator.snapshot();
            if now.steps > before.steps {
                seen.lock().unwrap().take(&before, &now);
                before = now;
            }
        }
    };
    tokio::select! {
        () = watch => {}
        () = stream => {}
    }
    seen.into_inner().unwrap()
}

fn beats() -> tokio::time::Interval {
    let mut clock = tokio::time::interval(Duration::from_millis(8));
    clock.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    clock
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_jump_is_followed_at_the_bounded_rate() {
    let bench = bounded().await;
    let start = bench.emulator.snapshot().joints;
    let mut target = start;
    let seen = watched(&bench, async {
        let mut stream = bench.arm.servo_joints(STIFF, LIMITS, SOON).await.unwrap();
        let mut clock = beats();
        for turn in 0..6 {
            // Time is saved up, and used at once: there and back.
            for _ in 0..20 {
                clock.tick().await;
                stream.send_joints(&target).unwrap();
            }
            let jump = if turn % 2 == 0 { 0.035 } else { -0.035 };
            target = std::array::from_fn(|i| target[i] + if i == 5 { jump } else { 0.0 });
            clock.tick().await;
            stream.send_joints(&target).unwrap();
        }
        for _ in 0..60 {
            clock.tick().await;
            stream.send_joints(&target).unwrap();
        }
    })
    .await;
    assert!(seen.samples > 50, "{seen:?}");
    // The jump is followed to its end, and not faster than it may be.
    let off = (bench.emulator.snapshot().joints[5] - target[5]).abs();
    assert!(off < 1e-3, "{off}");
    assert!(seen.speed > 0.1 && seen.acceleration > 0.5 * ACCELERATION, "{seen:?}");
    assert!(seen.acceleration < 1.1 * ACCELERATION && seen.speed < 1.02 * SPEED, "{seen:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn streams_that_begin_turn_round_and_end_at_full_speed_keep_the_bounds_of_joints() {
    let bench = bounded().await;
    let mut target = bench.emulator.snapshot().joints;
    let seen = watched(&bench, async {
        let mut stream = bench.arm.servo_joints(STIFF, LIMITS, SOON).await.unwrap();
        let mut clock = beats();
        // Nearly as fast as joints may be, from one target to the next, to and fro.
        for (ticks, speed) in [(60, 0.7), (60, -0.7), (60, 0.7), (100, 0.0)] {
            for _ in 0..ticks {
                clock.tick().await;
                target[4] += speed * 0.008;
                target[5] -= speed * 0.008;
                stream.send_joints(&target).unwrap();
            }
        }
    })
    .await;
    assert!(seen.samples > 100, "{seen:?}");
    let joints = bench.emulator.snapshot().joints;
    assert!((4..6).all(|i| (joints[i] - target[i]).abs() < 2e-3), "{joints:?} {target:?}");
    assert!(seen.speed > 0.6 && seen.acceleration > 0.7 * ACCELERATION, "{seen:?}");
    assert!(seen.acceleration < 1.1 * ACCELERATION && seen.speed < 1.02 * SPEED, "{seen:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_catches_up_with_a_stream_keeps_the_speed_of_the_flange() {
    let bench = bounded().await;
    let limits = Limits { speed_m_s: 0.1, acceleration_m_s2: 1.0 };
    let mut goal = bench.flange();
    let seen = watched(&bench, async {
        let mut stream = bench.arm.servo_pose(STIFF, limits, SOON).await.unwrap();
        let mut clock = beats();
        for ticks in [80, -80] {
            for _ in 0..i32::abs(ticks) {
                clock.tick().await;
                // As fast as allowed; joints fall behind when it turns round, and catch up.
                goal.translation.vector.z -= 0.0958 * 0.008 * f64::from(ticks.signum());
                stream.send_pose(&goal).unwrap();
            }
        }
        for _ in 0..80 {
            clock.tick().await;
            stream.send_pose(&goal).unwrap();
        }
    })
    .await;
    assert!(apart(&bench.flange(), &goal) < 1e-3, "{}", apart(&bench.flange(), &goal));
    assert!(seen.flange > 0.08 && seen.flange < 0.105, "{seen:?}");
    assert!(seen.acceleration < 1.1 * ACCELERATION, "{seen:?}");
    assert!(seen.flange_acceleration < 1.1 * limits.acceleration_m_s2, "{seen:?}");
}

/// Joints alone would be within their bounds here with several times the acceleration of the flange: a shoulder that
/// turns carries the whole arm.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn streams_keep_the_acceleration_of_the_flange() {
    for limits in [
        Limits { speed_m_s: 0.3, acceleration_m_s2: 0.4 },
        // What the caller allows counts where it is less than what is configured.
        Limits { speed_m_s: 0.2, acceleration_m_s2: 0.2 },
    ] {
        let bench = bounded_by(0.4).await;
        let mut target = bench.emulator.snapshot().joints;
        let seen = watched(&bench, async {
            let mut stream = bench.arm.servo_joints(STIFF, limits, SOON).await.unwrap();
            let mut clock = beats();
            for (ticks, speed) in [(80, 0.2), (80, -0.2), (40, 0.2), (250, 0.0)] {
                for _ in 0..ticks {
                    clock.tick().await;
                    target[0] += speed * 0.008;
                    target[3] -= 2.0 * speed * 0.008;
                    stream.send_joints(&target).unwrap();
                }
            }
        })
        .await;
        assert!(seen.samples > 200, "{seen:?}");
        let joints = bench.emulator.snapshot().joints;
        assert!((0..6).all(|i| (joints[i] - target[i]).abs() < 2e-3), "{joints:?} {target:?}");
        let most = limits.acceleration_m_s2;
        assert!(seen.flange_acceleration > 0.6 * most, "the bound was not reached: {seen:?}");
        assert!(seen.flange_acceleration < 1.1 * most && seen.flange < 1.02 * limits.speed_m_s, "{seen:?}");
        assert!(seen.speed < 1.02 * SPEED && seen.acceleration < 1.1 * ACCELERATION, "{seen:?}");
    }
}

/// What is sent is within the speeds, turns corners in space, and never waits.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stream_of_poses_round_sharp_corners_keeps_the_acceleration_of_the_flange() {
    let bench = bounded_by(0.8).await;
    let limits = Limits { speed_m_s: 0.2, acceleration_m_s2: 0.8 };
    let mut goal = bench.flange();
    let seen = watched(&bench, async {
        let mut stream = bench.arm.servo_pose(STIFF, limits, SOON).await.unwrap();
        let mut clock = beats();
        let sides = [Vector3::z(), -Vector3::x(), -Vector3::z(), Vector3::x(), Vector3::zeros()];
        for side in sides {
            for _ in 0..80 {
                clock.tick().await;
                goal.translation.vector -= side * 0.15 * 0.008;
                stream.send_pose(&goal).unwrap();
            }
        }
    })
    .await;
    assert!(apart(&bench.flange(), &goal) < 1e-3, "{}", apart(&bench.flange(), &goal));
    assert!(seen.flange_acceleration > 0.5 * limits.acceleration_m_s2, "{seen:?}");
    assert!(seen.flange_acceleration < 1.1 * limits.acceleration_m_s2, "{seen:?}");
    assert!(seen.flange < 1.03 * limits.speed_m_s && seen.acceleration < 1.1 * ACCELERATION, "{seen:?}");
}

/// Poses come as a planner sends them, centimetres apart and a tenth of a second after each other.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn poses_far_apart_are_followed_within_the_bounds_until_nobody_leads() {
    let bench = bounded_by(0.8).await;
    let limits = Limits { speed_m_s: 0.2, acceleration_m_s2: 0.8 };
    let mut last = bench.flange();
    let seen = watched(&bench, async {
        let (lead, goals) = lead();
        let leading = async {
            for way in [[0.0, 0.0, -0.06], [0.05, 0.03, -0.06], [0.0, 0.03, 0.0], [0.0, 0.0, -0.02]] {
                last = bench.flange();
                last.translation.vector += Vector3::from(way);
                for _ in 0..8 {
                    assert!(lead.to(&last), "it follows no more");
                    tokio::time::sleep(Duration::from_millis(100)).await;
                }
            }
            drop(lead);
        };
        let (followed, ()) = tokio::join!(bench.arm.follow(goals, limits, SOON, SOON), leading);
        followed.unwrap();
    })
    .await;
    assert!(!bench.moves(), "it stands");
    assert!(apart(&bench.flange(), &last) < 2e-3, "{}", apart(&bench.flange(), &last));
    assert!(seen.samples > 100 && seen.flange > 0.08, "{seen:?}");
    assert!(seen.flange < 1.03 * limits.speed_m_s, "{seen:?}");
    assert!(seen.flange_acceleration < 1.1 * limits.acceleration_m_s2, "{seen:?}");
    assert!(seen.speed < 1.02 * SPEED && seen.acceleration < 1.1 * ACCELERATION, "{seen:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_arm_that_follows_stops_when_nobody_leads_it_on_and_says_so() {
    let bench = bounded().await;
    let far = bench.beside(0.0, 0.0, 0.25);
    let limits = Limits { speed_m_s: 0.05, acceleration_m_s2: 1.0 };
    let (lead, goals) = lead();
    lead.to(&far);
    let followed = bench.arm.follow(goals, limits, Duration::from_millis(600), SOON).await;
    assert!(matches!(followed, Err(DeviceError::Timeout { .. })), "{followed:?}");
    assert!(!bench.moves() && apart(&bench.flange(), &far) > 0.05);
    // And is there for whoever comes next.
    bench.arm.move_linear(&bench.beside(0.0, 0.0, 0.02), LIMITS, SOON).await.unwrap();
}
