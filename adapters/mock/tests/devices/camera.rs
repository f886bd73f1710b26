//! Cameras: what a frame is, and what goes wrong with frames.

use std::time::{Duration, Instant};

use graspd_adapters_core::{Arm, DepthCamera, DeviceError};
use graspd_adapters_mock::{CameraSettings, Faults, MockCamera, Mount, SharedWorld, Spell, Stale};
use graspd_sim::sensor::Sensor;
use nalgebra::{Isometry3, Translation3};

use crate::fixtures::{HALF, LIMITS, SECOND, TEN, arm, camera, down, lens, shared};

const FRESH: Duration = Duration::from_millis(500);

#[tokio::test]
async fn a_frame_is_the_next_exposure_and_shows_the_world() {
    let shared = shared(0.0);
    let camera = camera(&shared, Faults::default());
    let info = camera.info();
    assert_eq!((info.width, info.height), (64, 48));
    shared.wait(0.25).await.unwrap();
    let frame = camera.capture(FRESH, SECOND).await.unwrap();
    assert_eq!(frame.sequence, 3);
    assert!((frame.stamp.as_secs_f64() - 0.3).abs() < 0.003, "{:?}", frame.stamp);
    assert!(frame.age < Duration::from_millis(1));
    let middle = f64::from(frame.depth_m[24 * 64 + 32]);
    assert!((middle - (0.7 - 2.0 * HALF[2])).abs() < 2e-3, "top of the box at {middle}");
    let beside = f64::from(frame.depth_m[24 * 64 + 44]);
    assert!((beside - 0.7).abs() < 2e-3, "floor of the tray at {beside}");
    assert_eq!(camera.capture(FRESH, SECOND).await.unwrap().sequence, 4);
}

#[tokio::test]
async fn latency_and_jitter_make_the_age_and_are_drawn_from_the_seed() {
    let ages = |seed| async move {
        let shared = shared(0.0);
        let faults = Faults { seed, latency_s: 0.03, jitter_s: 0.04, ..Faults::default() };
        let camera = camera(&shared, faults);
        let mut ages = Vec::new();
        for _ in 0..5 {
            ages.push(camera.capture(FRESH, SECOND).await.unwrap().age);
        }
        ages
    };
    let one = ages(1).await;
    assert!(one.iter().all(|a| (0.03..0.073).contains(&a.as_secs_f64())), "{one:?}");
    assert_eq!(one, ages(1).await);
    assert_ne!(one, ages(2).await);
}

#[tokio::test]
async fn the_same_seed_gives_the_same_noise() {
    let pixels = |seed| async move {
        let shared = shared(0.0);
        let fixed = camera(&shared, Faults::default());
        let mount = Mount::Fixed {
            world_from_camera: fixed.capture(FRESH, SECOND).await.unwrap().world_from_camera.unwrap(),
        };
        let sensor = Sensor { lens: lens(), ..Sensor::pico_flexx() };
        let faults = Faults { seed, ..Faults::default() };
        let noisy = MockCamera::new(&shared, CameraSettings::default(), sensor, mount, faults).unwrap();
        noisy.capture(FRESH, SECOND).await.unwrap().depth_m
    };
    let (a, b, c) = (pixels(1).await, pixels(1).await, pixels(2).await);
    assert_eq!(a, b);
    assert_ne!(a, c);
}

#[tokio::test]
async fn dropped_frames_are_no_error_while_a_later_one_comes() {
    let shared = shared(0.0);
    let camera = camera(&shared, Faults { drop_share: 0.6, seed: 3, ..Faults::default() });
    let mut numbers = Vec::new();
    for _ in 0..10 {
        numbers.push(camera.capture(FRESH, TEN).await.unwrap().sequence);
    }
    assert!(numbers.is_sorted() && numbers[9] > 15, "{numbers:?}");
    camera.faults().update(|f| f.drop_share = 1.0).unwrap();
    let before_s = shared.time_s();
    let error = camera.capture(FRESH, SECOND).await.unwrap_err();
    assert!(matches!(error, DeviceError::Timeout { operation: "capture", after: SECOND, .. }), "{error}");
    assert!((shared.time_s() - before_s - 1.0).abs() < 0.01);
}

#[tokio::test]
async fn late_frames_have_their_true_age_and_are_refused_when_too_old() {
    let shared = shared(0.0);
    let stale = Some(Stale { share: 1.0, age_s: 0.4 });
    let camera = camera(&shared, Faults { stale, latency_s: 0.02, ..Faults::default() });
    let frame = camera.capture(FRESH, SECOND).await.unwrap();
    assert!((frame.age.as_secs_f64() - 0.42).abs() < 0.004, "{:?}", frame.age);
    let limit = Duration::from_millis(100);
    let error = camera.capture(limit, SECOND).await.unwrap_err();
    let DeviceError::Stale { age, limit: found, .. } = &error else { panic!("{error}") };
    assert_eq!(*found, limit);
    assert!((age.as_secs_f64() - 0.42).abs() < 1e-6);
    // Where only some are late, a later one is on time.
    camera.faults().update(|f| f.stale = Some(Stale { share: 0.5, age_s: 0.4 })).unwrap();
    assert!(camera.capture(limit, TEN).await.unwrap().age <= limit);
}

#[tokio::test]
async fn a_stuck_camera_is_stale_until_it_goes_on() {
    let shared = shared(0.0);
    let camera = camera(&shared, Faults::default());
    camera.capture(FRESH, SECOND).await.unwrap();
    camera.faults().update(|f| f.stuck = true).unwrap();
    let error = camera.capture(FRESH, SECOND).await.unwrap_err();
    let DeviceError::Stale { age, .. } = &error else { panic!("{error}") };
    assert!(age.as_secs_f64() > 0.9 && error.is_transient());
    camera.faults().update(|f| f.stuck = false).unwrap();
    camera.capture(FRESH, SECOND).await.unwrap();
}

#[tokio::test]
async fn refused_connections_are_disconnected() {
    let shared = shared(0.0);
    let camera = camera(&shared, Faults { refused: Some(Spell::Calls(2)), ..Faults::default() });
    for _ in 0..2 {
        let error = camera.capture(FRESH, SECOND).await.unwrap_err();
        assert!(matches!(&error, DeviceError::Disconnected { device, .. } if device == "camera"), "{error}");
    }
    camera.capture(FRESH, SECOND).await.unwrap();
    camera.faults().update(|f| f.refused = Some(Spell::Seconds(0.45))).unwrap();
    let mut refused = 0;
    while camera.capture(FRESH, SECOND).await.is_err() {
        refused += 1;
    }
    assert_eq!(refused, 5, "each refusal takes 0.1 s");
}

#[tokio::test]
async fn a_silent_camera_times_out() {
    let shared = shared(0.0);
    let camera = camera(&shared, Faults { silent: Some(Spell::Calls(1)), ..Faults::default() });
    let error = camera.capture(FRESH, SECOND).await.unwrap_err();
    assert!(matches!(error, DeviceError::Timeout { .. }), "{error}");
    assert!((shared.time_s() - 1.0).abs() < 0.005);
    camera.capture(FRESH, SECOND).await.unwrap();
}

#[tokio::test]
async fn a_palm_camera_moves_with_its_hand() {
    let shared = shared(0.0);
    let arm = arm(&shared, Faults::default()).await;
    // Between the fingers, ahead of the palm, looking the way the hand points.
    let hand_from_camera = Isometry3::from_parts(Translation3::new(0.0, 0.0, 0.02), nalgebra::one());
    let mount = Mount::OnHand { hand: arm.hand(), hand_from_camera };
    let camera =
        MockCamera::new(&shared, CameraSettings::default(), Sensor::ideal(lens()), mount, Faults::default());
    let camera = camera.unwrap();
    for height in [0.25, 0.20] {
        arm.move_to(&down(0.0, 0.0, height), LIMITS, TEN).await.unwrap();
        let frame = camera.capture(FRESH, SECOND).await.unwrap();
        let z = frame.world_from_camera.unwrap().translation.z;
        assert!((z - (height - 0.02)).abs() < 2e-3, "{z}");
        let depth = f64::from(frame.depth_m[24 * 64 + 32]);
        assert!((depth - (height - 0.02 - 2.0 * HALF[2])).abs() < 3e-3, "{depth}");
    }
    let hand = arm.hand();
    assert!(shared.with(move |world| world.remove_hand(hand)).await.unwrap());
    let error = camera.capture(FRESH, SECOND).await.unwrap_err();
    assert!(matches!(error, DeviceError::Disconnected { .. }), "{error}");
}

#[tokio::test]
async fn a_world_that_stands_still_ends_calls_by_the_wall_clock() {
    let shared = shared(0.0);
    let camera = camera(&shared, Faults::default());
    shared.pause();
    let (began, timeout) = (Instant::now(), Duration::from_millis(150));
    let error = camera.capture(FRESH, timeout).await.unwrap_err();
    assert!(matches!(error, DeviceError::Timeout { .. }), "{error}");
    assert!((timeout..4 * timeout).contains(&began.elapsed()), "{:?}", began.elapsed());
    shared.resume();
    camera.capture(FRESH, SECOND).await.unwrap();
    // A step that hangs.
    let hung = tokio::spawn({
        let shared = shared.clone();
        async move { shared.with(|_| std::thread::sleep(Duration::from_millis(600))).await }
    });
    tokio::time::sleep(Duration::from_millis(50)).await;
    let error = camera.capture(FRESH, timeout).await.unwrap_err();
    assert!(matches!(error, DeviceError::Timeout { .. }), "{error}");
    hung.await.unwrap().unwrap();
    camera.capture(FRESH, SECOND).await.unwrap();
}

#[tokio::test]
async fn a_world_with_a_speed_keeps_to_the_wall_clock() {
    let shared = shared(4.0);
    let camera = camera(&shared, Faults::default());
    let (began, from_s) = (Instant::now(), shared.time_s());
    for _ in 0..4 {
        camera.capture(FRESH, TEN).await.unwrap();
    }
    let (wall, world) = (began.elapsed().as_secs_f64(), shared.time_s() - from_s);
    assert!(world > 0.25, "{world}");
    assert!(wall > 0.06, "0.3 s at four times the wall clock's speed took {wall}");
    camera.faults().update(|f| f.drop_share = 1.0).unwrap();
    let began = Instant::now();
    let timeout = Duration::from_millis(200);
    let error = camera.capture(FRESH, timeout).await.unwrap_err();
    assert!(matches!(error, DeviceError::Timeout { .. }), "{error}");
    assert!(began.elapsed() > timeout / 2 && began.elapsed() < 4 * timeout);
}

#[tokio::test]
async fn many_cameras_share_a_world() {
    let shared = shared(0.0);
    let cameras: Vec<_> = (0..6).map(|_| camera(&shared, Faults::default())).collect();
    let tasks: Vec<_> = cameras
        .into_iter()
        .map(|camera| tokio::spawn(async move { camera.capture(FRESH, TEN).await.unwrap().depth_m }))
        .collect();
    let mut frames = Vec::new();
    for task in tasks {
        frames.push(task.await.unwrap());
    }
    assert!(frames.iter().all(|f| *f == frames[0]));
}

#[tokio::test]
async fn a_dropped_capture_leaves_a_usable_camera() {
    let shared: SharedWorld = shared(0.0);
    let camera = camera(&shared, Faults { drop_share: 1.0, ..Faults::default() });
    let given_up = tokio::time::timeout(Duration::from_millis(5), camera.capture(FRESH, 1000 * SECOND)).await;
    assert!(given_up.is_err());
    camera.faults().clear();
    camera.capture(FRESH, SECOND).await.unwrap();
    let still_s = shared.time_s();
    tokio::time::sleep(Duration::from_millis(50)).await;
    assert_eq!(shared.time_s(), still_s, "nobody waits: the world stands still");
}

#[tokio::test]
async fn a_frame_rate_that_cannot_be_counted_is_refused() {
    let shared = shared(0.0);
    let mount = Mount::Fixed { world_from_camera: Isometry3::identity() };
    for (frame_rate_hz, expected) in
        [(1e22, "at most 10000"), (0.0, "a number above 0"), (f64::NAN, "a number above 0")]
    {
        let settings = CameraSettings { frame_rate_hz, ..CameraSettings::default() };
        let sensor = Sensor::ideal(lens());
        let error = MockCamera::new(&shared, settings, sensor, mount, Faults::default()).unwrap_err();
        assert_eq!((error.field.as_str(), error.expected.as_str()), ("frame_rate_hz", expected));
    }
}
