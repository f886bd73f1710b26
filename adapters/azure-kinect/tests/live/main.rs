//! A live device, through a stand-in of the manufacturer's library that is built here with the C compiler: a library boundary
//! like the real one, with faults on request.

#![allow(clippy::unwrap_used)]

use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use graspd_adapters_azure_kinect::KinectCamera;
use graspd_adapters_azure_kinect::calibration::EXAMPLE;
use graspd_adapters_azure_kinect::mode::{DepthMode, FrameRate};
use graspd_adapters_azure_kinect::settings::{DeviceSettings, KinectSettings, Source};
use graspd_adapters_core::testing::{StandIn, built};
use graspd_adapters_core::{DepthCamera, DeviceError};

const AGE: Duration = Duration::from_secs(1);
const LONG: Duration = Duration::from_secs(20);

fn source() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/live/k4a.c"))
}

fn folder() -> &'static Path {
    Path::new(env!("CARGO_TARGET_TMPDIR"))
}

/// A library of one test's own.
struct Library(StandIn);

impl std::ops::Deref for Library {
    type Target = StandIn;

    fn deref(&self) -> &StandIn {
        &self.0
    }
}

impl Library {
    fn new(test: &str) -> Option<Self> {
        let library = StandIn::new(source(), folder(), "libk4a", test)?;
        std::fs::write(library.beside("json"), EXAMPLE).unwrap();
        Some(Self(library))
    }

    fn settings(&self) -> DeviceSettings {
        DeviceSettings {
            library: Some(self.path().to_owned()),
            mode: DepthMode::Nfov2x2binned,
            frames_per_second: FrameRate::Thirty,
            latency_ms: Some(0.0),
            silence_ms: 300,
            retry_ms: 20,
            ..DeviceSettings::default()
        }
    }

    async fn camera(&self, settings: DeviceSettings) -> KinectCamera {
        let settings = KinectSettings { name: "kinect".into(), source: Source::Device(settings) };
        KinectCamera::new(settings).await.unwrap()
    }
}

fn multi(test: impl Future<Output = ()>) {
    tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .unwrap()
        .block_on(test);
}

#[test]
fn frames_come_with_lens_stamps_and_numbers_and_nothing_leaks() {
    let Some(library) = Library::new("frames") else { return };
    library.control("padded=1\ndark=1\n");
    multi(async {
        let camera = library.camera(DeviceSettings { dark: true, ..library.settings() }).await;
        assert_eq!((camera.info().width, camera.info().height), (320, 288));
        let mut before: Option<graspd_adapters_core::DepthFrame> = None;
        for _ in 0..5 {
            let frame = camera.capture(AGE, LONG).await.unwrap();
            assert_eq!((frame.width, frame.height, frame.depth_m.len()), (320, 288, 320 * 288));
            // Row 7 of frame n has 507 + n millimetres, its first pixel none; rows are padded in the library.
            let n = (frame.stamp.as_micros() as u64 - 1_000_000) / 33_333;
            assert_eq!(frame.depth_m[7 * 320], 0.0);
            assert!((frame.depth_m[7 * 320 + 9] - (507 + n) as f32 * 1e-3).abs() < 1e-6);
            assert!((frame.lens.fx_px - 252.303).abs() < 1e-2, "{:?}", frame.lens);
            assert!(frame.age < AGE && frame.world_from_camera.is_none());
            if let Some(before) = &before {
                let frames = (frame.stamp - before.stamp).as_micros() as u64 / 33_333;
                assert_eq!(frame.sequence - before.sequence, frames);
                assert!(frames >= 1);
            }
            before = Some(frame);
        }
        let state = camera.state();
        assert_eq!((state.serial.as_deref(), state.temperature_c), (Some("000001"), Some(31.5)));
        assert!(state.streaming && camera.counts().arrived >= 5 && camera.counts().failures == 0);
        camera.stop(LONG).await.unwrap();
        assert!(!camera.state().streaming);
        assert_eq!(library.report(), "captures=0 images=0 opens=1 closes=1 starts=1 stops=1\n");
        camera.capture(AGE, LONG).await.unwrap();
        assert!(library.report().contains("opens=2"));
    });
}

#[test]
fn lost_exposures_are_counted() {
    let Some(library) = Library::new("skip") else { return };
    multi(async {
        let camera = library.camera(library.settings()).await;
        let first = camera.capture(AGE, LONG).await.unwrap();
        library.control("skip=4\n");
        let mut last = first.sequence;
        for _ in 0..4 {
            last = camera.capture(AGE, LONG).await.unwrap().sequence;
        }
        let counts = camera.counts();
        assert!(counts.lost >= 8 && last >= first.sequence + 12, "{counts:?}, {last}");
    });
}

#[test]
fn a_lost_device_is_a_typed_error_and_comes_back() {
    let Some(library) = Library::new("lost") else { return };
    multi(async {
        let camera = library.camera(library.settings()).await;
        let before = camera.capture(AGE, LONG).await.unwrap();
        library.control("lost=1\n");
        let error = loop {
            // A frame may have been under way.
            if let Err(error) = camera.capture(AGE, LONG).await {
                break error;
            }
        };
        assert!(
            matches!(&error, DeviceError::Disconnected { detail, .. } if detail.contains("USB device was disconnected")),
            "{error}"
        );
        library.control("devices=0\n");
        let error = camera.capture(AGE, LONG).await.unwrap_err();
        let error = if error.to_string().contains("on the bus") {
            error
        } else {
            camera.capture(AGE, LONG).await.unwrap_err()
        };
        assert!(error.to_string().contains("no Azure Kinect is on the bus"), "{error}");
        library.control("");
        let after = loop {
            match camera.capture(AGE, LONG).await {
                Ok(frame) => break frame,
                Err(error) => assert!(error.is_transient(), "{error}"),
            }
        };
        assert!(after.sequence > before.sequence);
        camera.stop(LONG).await.unwrap();
        assert!(library.report().starts_with("captures=0 images=0 "), "{}", library.report());
    });
}

#[test]
fn a_silent_device_times_out_and_is_opened_again() {
    let Some(library) = Library::new("silent") else { return };
    multi(async {
        let camera = library.camera(library.settings()).await;
        camera.capture(AGE, LONG).await.unwrap();
        library.control("silent=1\n");
        tokio::time::sleep(Duration::from_millis(60)).await;
        let began = Instant::now();
        let error = camera.capture(AGE, Duration::from_millis(50)).await.unwrap_err();
        assert!(matches!(error, DeviceError::Timeout { operation: "capture", .. }), "{error}");
        assert!(began.elapsed() < Duration::from_secs(2));
        let error = camera.capture(AGE, LONG).await.unwrap_err();
        assert!(error.to_string().contains("no frame for 300ms"), "{error}");
        library.control("");
        while camera.capture(AGE, LONG).await.is_err() {}
        assert!(library.report().contains("opens="), "{}", library.report());
    });
}

#[test]
fn given_up_calls_lose_nothing() {
    let Some(library) = Library::new("cancel") else { return };
    multi(async {
        let camera = library.camera(library.settings()).await;
        camera.capture(AGE, LONG).await.unwrap();
        for _ in 0..100 {
            let given_up = tokio::time::timeout(Duration::from_micros(200), camera.capture(AGE, LONG)).await;
            assert!(given_up.is_err() || given_up.unwrap().is_ok());
        }
        camera.capture(AGE, LONG).await.unwrap();
        let (a, b) = tokio::join!(camera.capture(AGE, LONG), camera.capture(AGE, LONG));
        assert!(a.unwrap().sequence.abs_diff(b.unwrap().sequence) <= 1);
    });
}

#[test]
fn what_the_library_must_not_do_is_refused() {
    let Some(library) = Library::new("wrong") else { return };
    multi(async {
        for (control, expected) in [
            ("short=1\n", "expected a whole DEPTH16 image"),
            ("format=5\n", "format 5"),
            ("refuse_open=1\n", "libusb device is busy"),
            ("refuse_start=1\n", "error code: 204"),
        ] {
            library.control(control);
            let camera = library.camera(library.settings()).await;
            let error = camera.capture(AGE, LONG).await.unwrap_err();
            assert!(error.to_string().contains(expected), "{error}");
            camera.stop(LONG).await.unwrap();
        }
        // Captures without depth are passed over.
        library.control("without_depth=1\n");
        let camera = library.camera(library.settings()).await;
        let error = camera.capture(AGE, Duration::from_millis(200)).await.unwrap_err();
        assert!(matches!(error, DeviceError::Timeout { .. }), "{error}");
        camera.stop(LONG).await.unwrap();
        library.control("");
        std::fs::write(library.beside("json"), "{}").unwrap();
        let error = library.camera(library.settings()).await.capture(AGE, LONG).await.unwrap_err();
        assert!(
            matches!(&error, DeviceError::Protocol { .. }) && error.to_string().contains("calibration"),
            "{error}"
        );
    });
}

#[test]
fn a_device_is_chosen_by_its_serial_number() {
    let Some(library) = Library::new("serial") else { return };
    library.control("devices=3\n");
    multi(async {
        let wanted = |serial: &str| DeviceSettings { serial: Some(serial.into()), ..library.settings() };
        let camera = library.camera(wanted("000002")).await;
        camera.capture(AGE, LONG).await.unwrap();
        assert_eq!(camera.state().serial.as_deref(), Some("000002"));
        let error = library.camera(wanted("000009")).await.capture(AGE, LONG).await.unwrap_err();
        assert!(
            error.to_string().contains("000001, 000003") && error.to_string().contains("000009"),
            "{error}"
        );
    });
}

#[test]
fn a_missing_library_is_said_with_places_and_remedy() {
    multi(async {
        let device =
            DeviceSettings { library: Some("/nowhere/libk4a.so".into()), ..DeviceSettings::default() };
        let settings = KinectSettings { source: Source::Device(device), ..KinectSettings::default() };
        let camera = KinectCamera::new(settings).await.unwrap();
        let error = camera.capture(AGE, LONG).await.unwrap_err().to_string();
        for expected in ["/nowhere/libk4a.so", "libdepthengine", "K4A_LIB"] {
            assert!(error.contains(expected), "{error}");
        }
        let found = camera.check(LONG).await;
        assert!(!found[0].ok && found.len() == 2, "{found:?}");
        // A library that is not the one that is meant.
        let Some(other) = built(source(), folder()) else { return };
        let other = other.with_file_name(format!("other-{}.so", std::process::id()));
        let status =
            Command::new("cc").args(["-shared", "-x", "c", "/dev/null", "-o"]).arg(&other).status().unwrap();
        assert!(status.success());
        let device = DeviceSettings { library: Some(other.clone()), ..DeviceSettings::default() };
        let settings = KinectSettings { source: Source::Device(device), ..KinectSettings::default() };
        let error =
            KinectCamera::new(settings).await.unwrap().capture(AGE, LONG).await.unwrap_err().to_string();
        assert!(error.contains("it is no libk4a 1.4"), "{error}");
        std::fs::remove_file(other).unwrap();
    });
}

#[test]
fn check_says_what_is_wrong() {
    let Some(library) = Library::new("check") else { return };
    multi(async {
        let camera = library.camera(library.settings()).await;
        let found = camera.check(LONG).await;
        assert!(found.len() == 4 && found.iter().all(|f| f.ok), "{found:?}");
        camera.stop(LONG).await.unwrap();
        library.control("devices=0\n");
        let found = camera.check(LONG).await;
        let bad: Vec<&str> = found
            .iter()
            .filter(|f| !f.ok)
            .map(|f| {
                assert!(!f.advice.is_empty());
                f.subject.as_str()
            })
            .collect();
        assert_eq!(bad, ["devices", "frame"]);
    });
}
