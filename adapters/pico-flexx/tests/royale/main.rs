//! The camera through a stand-in of the Royale library that is built here with the C compiler: callbacks on a foreign thread,
//! with faults on request.
#![allow(clippy::unwrap_used)]

use std::path::Path;
use std::time::Duration;

use graspd_adapters_core::testing::StandIn;
use graspd_adapters_core::{DepthCamera, DeviceError};
use graspd_adapters_pico_flexx::settings::{Exposure, RoyaleSettings, Source};
use graspd_adapters_pico_flexx::{FlexxCamera, FlexxSettings};

const AGE: Duration = Duration::from_secs(1);
const LONG: Duration = Duration::from_secs(20);

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
        let source = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/royale/royale.c"));
        StandIn::new(source, Path::new(env!("CARGO_TARGET_TMPDIR")), "libroyaleCAPI", test).map(Self)
    }

    fn source(&self) -> RoyaleSettings {
        RoyaleSettings {
            library: Some(self.path().to_owned()),
            use_case: "MODE_5_45FPS_500".into(),
            ..RoyaleSettings::default()
        }
    }

    fn camera(&self, source: RoyaleSettings) -> FlexxCamera {
        let settings = FlexxSettings {
            name: "flexx".into(),
            latency_ms: Some(0.0),
            silence_ms: 300,
            retry_ms: 20,
            frame_rate_hz: Some(45.0),
            source: Source::Royale(source),
            ..FlexxSettings::default()
        };
        FlexxCamera::new(settings).unwrap()
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
    multi(async {
        let camera = library.camera(RoyaleSettings {
            exposure: Exposure::Us(640),
            frames_per_second: Some(30),
            ..library.source()
        });
        let info = camera.info();
        assert_eq!((info.width, info.height, info.frame_rate_hz, info.range_m.1), (224, 172, 30.0, 1.0));
        let first = camera.capture(AGE, LONG).await.unwrap();
        assert_eq!(first.lens.distortion, [0.4f32, -2.5, 0.001, -0.002, 3.5, 0.0, 0.0, 0.0].map(f64::from));
        assert_eq!((first.lens.fx_px, first.lens.cy_px), (212.5, 86.25));
        assert_eq!(first.depth_m.len(), 224 * 172);
        // No confidence, too much noise, not a number; little confidence is enough.
        assert_eq!(first.depth_m[..3], [0.0; 3]);
        assert!(first.depth_m[3] >= 1.0 && first.depth_m[3] == first.depth_m[224 * 172 - 1]);
        let second = camera.capture(AGE, LONG).await.unwrap();
        assert!(second.sequence > first.sequence && second.stamp > first.stamp && second.age < AGE);
        assert!(first.stamp > Duration::from_secs(1_700_000_000));
        let state = camera.state();
        assert_eq!(state.id.as_deref(), Some("0005-1203-0034-2210"));
        assert!(state.source.unwrap().ends_with("3.10.1"));
        assert_eq!((state.use_case.as_deref(), state.exposure_us), (Some("MODE_5_45FPS_500"), Some(640)));
        camera.stop(LONG).await.unwrap();
        assert_eq!(
            library.report(),
            "managers=0 cameras=0 strings=0 starts=1 stops=1 listens=0 case=MODE_5_45FPS_500 exposure=0/640 rate=30\n"
        );
        camera.capture(AGE, LONG).await.unwrap();
        assert!(library.report().contains("starts=2"));
    });
}

#[test]
fn confidence_is_a_setting_and_one_stream_of_two_is_kept() {
    let Some(library) = Library::new("streams") else { return };
    library.control("streams=1\n");
    multi(async {
        let camera =
            library.camera(RoyaleSettings { min_confidence: 4, stream: Some(0), ..library.source() });
        let error = camera.capture(AGE, Duration::from_millis(300)).await.unwrap_err();
        assert!(error.is_transient(), "{error}");
        drop(camera);
        library.control("streams=1\nstream=0\n");
        let camera =
            library.camera(RoyaleSettings { min_confidence: 4, stream: Some(0), ..library.source() });
        for _ in 0..6 {
            let frame = match camera.capture(AGE, LONG).await {
                // The first camera may still be closing.
                Err(DeviceError::Protocol { .. }) => continue,
                other => other.unwrap(),
            };
            assert!(frame.depth_m[3] == 0.0 && frame.depth_m[4] >= 1.0 && frame.depth_m[4] < 2.0);
        }
        assert!(camera.counts().arrived > 0);
    });
}

#[test]
fn lost_exposures_are_counted() {
    let Some(library) = Library::new("skip") else { return };
    multi(async {
        let settings = |source| FlexxSettings {
            frame_rate_hz: Some(45.0),
            source: Source::Royale(source),
            silence_ms: 300,
            ..FlexxSettings::default()
        };
        let camera = FlexxCamera::new(settings(library.source())).unwrap();
        camera.capture(AGE, LONG).await.unwrap();
        library.control("skip=2\n");
        for _ in 0..4 {
            camera.capture(AGE, LONG).await.unwrap();
        }
        assert!(camera.counts().lost >= 4, "{:?}", camera.counts());
    });
}

#[test]
fn an_unplugged_camera_is_a_typed_error_and_comes_back() {
    let Some(library) = Library::new("lost") else { return };
    multi(async {
        let camera = library.camera(library.source());
        let before = camera.capture(AGE, LONG).await.unwrap();
        library.control("unplugged=1\n");
        let error = loop {
            if let Err(error) = camera.capture(AGE, LONG).await {
                break error;
            }
        };
        assert!(
            matches!(&error, DeviceError::Disconnected { detail, .. } if detail.contains("unplugged")),
            "{error}"
        );
        library.control("unplugged=1\ncameras=0\n");
        // The try before may still have seen it.
        while !camera.capture(AGE, LONG).await.unwrap_err().to_string().contains("no camera is connected") {}
        library.control("");
        let after = loop {
            match camera.capture(AGE, LONG).await {
                Ok(frame) => break frame,
                Err(error) => assert!(error.is_transient(), "{error}"),
            }
        };
        assert!(after.sequence > before.sequence && camera.counts().failures >= 2);
        // Silent, though still there.
        library.control("silent=1\n");
        tokio::time::sleep(Duration::from_millis(60)).await;
        let error = camera.capture(AGE, Duration::from_millis(50)).await.unwrap_err();
        assert!(matches!(error, DeviceError::Timeout { .. }), "{error}");
        let error = camera.capture(AGE, LONG).await.unwrap_err();
        assert!(error.to_string().contains("no frame for 300ms"), "{error}");
        library.control("");
        while camera.capture(AGE, LONG).await.is_err() {}
        camera.stop(LONG).await.unwrap();
        assert!(library.report().starts_with("managers=0 cameras=0 strings=0 "), "{}", library.report());
    });
}

#[test]
fn what_cannot_be_is_refused_and_leaks_nothing() {
    let Some(library) = Library::new("wrong") else { return };
    multi(async {
        let source = || library.source();
        for (control, source, expected) in [
            ("short=1\n", source(), "found 19264 points of 224 x 172 pixels"),
            ("null=1\n", source(), "found 38528 points"),
            ("radial=2\n", source(), "found 2 radial coefficients"),
            ("width=225\n", source(), "(225, 172)"),
            ("initialize=5006\n", source(), "insufficient privileges"),
            ("initialize=4100\n", source(), "resource busy"),
            ("start=5011\n", source(), "duty cycle"),
            (
                "other_case=1\n",
                RoyaleSettings { use_case: "MODE_9_10FPS_1000".into(), ..source() },
                "found use case",
            ),
            ("no_manager=1\n", source(), "no camera manager"),
            ("", RoyaleSettings { camera: Some("elsewhere".into()), ..source() }, "cannot be opened"),
            ("", RoyaleSettings { exposure: Exposure::Us(5000), ..source() }, "expected 80 to 1000"),
            ("", RoyaleSettings { frames_per_second: Some(60), ..source() }, "expected at most 45"),
            ("", RoyaleSettings { use_case: "MODE_9_5FPS_2000".into(), ..source() }, "MODE_MIXED_30_5"),
        ] {
            library.control(control);
            let camera = library.camera(source);
            let error = camera.capture(AGE, LONG).await.unwrap_err();
            assert!(error.to_string().contains(expected), "{control}: {error}");
            camera.stop(LONG).await.unwrap();
        }
        library.control("");
        let camera = library.camera(source());
        camera.capture(AGE, LONG).await.unwrap();
        // No more than one process, and no more than one of these, has the camera.
        let error = library.camera(source()).capture(AGE, LONG).await.unwrap_err();
        assert!(error.to_string().contains("cannot be opened"), "{error}");
        camera.stop(LONG).await.unwrap();
        assert!(library.report().starts_with("managers=0 cameras=0 strings=0 "), "{}", library.report());
    });
}

#[test]
fn a_missing_or_newer_library_is_said_with_places_and_remedy() {
    multi(async {
        let source =
            RoyaleSettings { library: Some("/nowhere/libroyaleCAPI.so".into()), ..RoyaleSettings::default() };
        let settings = FlexxSettings { source: Source::Royale(source), ..FlexxSettings::default() };
        let camera = FlexxCamera::new(settings).unwrap();
        let error = camera.capture(AGE, LONG).await.unwrap_err().to_string();
        for expected in ["/nowhere/libroyaleCAPI.so", "ROYALE_LIB", "rosbridge"] {
            assert!(error.contains(expected), "{error}");
        }
        let found = camera.check(LONG).await;
        assert!(found.len() == 2 && !found.iter().any(|f| f.ok), "{found:?}");
        let Some(library) = Library::new("newer") else { return };
        library.control("major=5\n");
        let error = library.camera(library.source()).capture(AGE, LONG).await.unwrap_err().to_string();
        assert!(error.contains("found version 5.10.1, expected 3.x"), "{error}");
    });
}

#[test]
fn given_up_calls_lose_nothing_and_check_is_content() {
    let Some(library) = Library::new("cancel") else { return };
    multi(async {
        let camera = library.camera(library.source());
        for _ in 0..50 {
            let _given_up = tokio::time::timeout(Duration::from_micros(200), camera.capture(AGE, LONG)).await;
        }
        camera.capture(AGE, LONG).await.unwrap();
        let found = camera.check(LONG).await;
        assert!(found.len() == 2 && found.iter().all(|f| f.ok), "{found:?}");
    });
}
