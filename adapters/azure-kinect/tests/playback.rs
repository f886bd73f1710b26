//! Recordings as a camera: in real time, as fast as asked, again and again.

#![allow(clippy::unwrap_used)]

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use graspd_adapters_azure_kinect::calibration::EXAMPLE;
use graspd_adapters_azure_kinect::mkv::write::{Header, Recorder};
use graspd_adapters_azure_kinect::mode::DepthMode;
use graspd_adapters_azure_kinect::settings::{KinectSettings, Pace};
use graspd_adapters_azure_kinect::{Finding, KinectCamera};
use graspd_adapters_core::{DepthCamera, DeviceError};

const AGE: Duration = Duration::from_secs(1);
const LONG: Duration = Duration::from_secs(20);
const PERIOD: Duration = Duration::from_micros(66_667);

/// A recording in a file of its own; frame `n` has the depth `1000 + n` everywhere.
struct File(PathBuf);

impl File {
    fn new(name: &str, frames: u16) -> Self {
        let header = Header {
            mode: DepthMode::Nfov2x2binned,
            frame_ns: 66_667_000,
            start_offset_ns: 2_000_000_000,
            calibration: EXAMPLE,
            serial: "000042",
        };
        let mut recorder = Recorder::new(&header);
        for n in 0..frames {
            assert!(recorder.push(u64::from(n) * 66_667, &[1000 + n; 320 * 288], &[7; 320 * 288]));
        }
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}-{}.mkv", std::process::id()));
        std::fs::write(&path, recorder.finish()).unwrap();
        Self(path)
    }

    async fn camera(&self, pace: Pace, repeat: bool) -> KinectCamera {
        KinectCamera::new(KinectSettings::recording(&self.0, pace, repeat)).await.unwrap()
    }
}

impl Drop for File {
    fn drop(&mut self) {
        let _gone = std::fs::remove_file(&self.0);
    }
}

#[tokio::test]
async fn as_asked_no_frame_is_left_out_and_stamps_rise() {
    let file = File::new("asked", 3);
    let camera = file.camera(Pace::AsAsked, true).await;
    assert_eq!(camera.info().model, "Azure Kinect NFOV 2x2 binned");
    assert!((camera.info().frame_rate_hz - 15.0).abs() < 1e-3);
    assert_eq!(camera.state().serial.as_deref(), Some("000042"));
    for n in 0..8u64 {
        if n == 4 {
            // Given up before it is looked at, or after: no more than its own answer is lost.
            let _given_up = tokio::time::timeout(Duration::ZERO, camera.capture(AGE, LONG)).await;
        }
        let frame = camera.capture(AGE, LONG).await.unwrap();
        if n < 4 {
            assert_eq!(frame.sequence, n + 1);
            assert_eq!(frame.stamp, Duration::from_secs(2) + PERIOD * n as u32);
            assert!((frame.depth_m[5] - (1000 + n % 3) as f32 * 1e-3).abs() < 1e-6);
        } else {
            assert!(frame.sequence == n + 1 || frame.sequence == n + 2);
        }
    }
}

#[tokio::test]
async fn a_recording_that_ended_says_so_at_once() {
    let file = File::new("ended", 2);
    for pace in [Pace::AsAsked, Pace::RealTime] {
        let camera = file.camera(pace, false).await;
        camera.capture(AGE, LONG).await.unwrap();
        camera.capture(AGE, LONG).await.unwrap();
        for _ in 0..2 {
            let began = Instant::now();
            let error = camera.capture(AGE, LONG).await.unwrap_err();
            assert!(
                matches!(&error, DeviceError::Disconnected { detail, .. } if detail.contains("ended after 2 frames")),
                "{error}"
            );
            assert!(began.elapsed() < Duration::from_secs(5));
        }
    }
}

#[tokio::test]
async fn in_real_time_frames_come_when_they_came() {
    let file = File::new("real", 6);
    let camera = file.camera(Pace::RealTime, true).await;
    let began = Instant::now();
    let first = camera.capture(AGE, LONG).await.unwrap();
    tokio::time::sleep(PERIOD * 4).await;
    let later = camera.capture(AGE, LONG).await.unwrap();
    let (played, passed) = (later.stamp - first.stamp, began.elapsed());
    // Frames that nobody asked for are gone.
    assert!(later.sequence >= first.sequence + 4, "{} {}", first.sequence, later.sequence);
    assert!(played >= PERIOD * 4 && played <= passed + PERIOD, "{played:?} in {passed:?}");
    camera.stop(LONG).await.unwrap();
    let paused = camera.capture(AGE, LONG).await.unwrap();
    assert!(paused.sequence > later.sequence);
}

#[tokio::test]
async fn a_file_that_is_none_is_refused_at_the_beginning() {
    let missing = KinectSettings::recording("/nowhere/at/all.mkv", Pace::AsAsked, false);
    let error = KinectCamera::new(missing).await.unwrap_err().to_string();
    assert!(error.contains("/nowhere/at/all.mkv"), "{error}");
    let error = KinectCamera::new(KinectSettings::recording("", Pace::AsAsked, false)).await.unwrap_err();
    assert!(error.to_string().contains("source.path"), "{error}");
    let empty = File::new("empty", 0);
    let error = empty.camera(Pace::RealTime, true).await.capture(AGE, LONG).await.unwrap_err();
    assert!(error.to_string().contains("no depth frame"), "{error}");
}

#[tokio::test]
async fn check_counts_the_frames() {
    let file = File::new("check", 3);
    let camera = file.camera(Pace::AsAsked, false).await;
    let found = camera.check(LONG).await;
    assert!(found.iter().all(|f| f.ok), "{found:?}");
    assert!(found.contains(&Finding::good("depth frames", "3")), "{found:?}");
}
