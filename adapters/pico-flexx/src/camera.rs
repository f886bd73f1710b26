//! The camera as its callers see it.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use async_trait::async_trait;
use graspd_adapters_core::check::{Finding, SettingsError};
use graspd_adapters_core::feed::{Feed, FeedCounts};
use graspd_adapters_core::streaming::{self, Control};
use graspd_adapters_core::{CameraInfo, DepthCamera, DepthFrame, DeviceError};

use crate::CameraState;
use crate::check;
use crate::live::Live;
use crate::rosbridge::Bridge;
use crate::settings::{FlexxSettings, Source};
use crate::use_case::UseCase;

/// Range of a use case whose name does not tell: that of the data sheet.
const RANGE_M: (f64, f64) = (0.1, 4.0);

/// A pico flexx. It begins to stream with the first capture; its thread ends when this is dropped.
#[derive(Debug)]
pub struct FlexxCamera {
    settings: FlexxSettings,
    feed: Arc<Feed>,
    state: Arc<Mutex<CameraState>>,
    control: Control,
}

impl FlexxCamera {
    /// A camera. It is looked for by the first call that needs it.
    ///
    /// # Errors
    /// [`SettingsError`] with the first setting that is wrong.
    pub fn new(settings: FlexxSettings) -> Result<Self, SettingsError> {
        settings.check()?;
        let (control, orders) = streaming::channel();
        let feed = Arc::new(Feed::new(settings.name.clone()));
        let state = Arc::new(Mutex::new(CameraState::default()));
        match &settings.source {
            Source::Royale(source) => {
                let live = Live::new(settings.clone(), source.clone(), feed.clone(), state.clone());
                thread(move || live.run(&orders));
            }
            Source::Rosbridge(source) => {
                let bridge = Bridge::new(settings.clone(), source.clone(), feed.clone(), state.clone());
                thread(move || bridge.run(&orders));
            }
        }
        Ok(Self { settings, feed, state, control })
    }

    /// Frames that came, exposures that were lost, times that the camera was not reached.
    pub fn counts(&self) -> FeedCounts {
        self.feed.counts()
    }

    /// What is known of the camera.
    pub fn state(&self) -> CameraState {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Begins to stream before somebody waits for a frame.
    pub fn start(&self) {
        self.control.wake(&self.feed);
    }

    /// Stops streaming: the illumination goes off. The next capture begins again.
    ///
    /// # Errors
    /// [`DeviceError::Timeout`] when the library does not return in time, [`DeviceError::Disconnected`].
    pub async fn stop(&self, timeout: Duration) -> Result<(), DeviceError> {
        self.control.stop(&self.settings.name, timeout).await
    }

    /// What is wrong with the camera and what to do about it. It begins to stream for it.
    pub async fn check(&self, timeout: Duration) -> Vec<Finding> {
        let until = tokio::time::Instant::now() + timeout;
        let settings = self.settings.clone();
        let still = tokio::task::spawn_blocking(move || check::still(&settings));
        let mut found = match tokio::time::timeout(timeout, still).await {
            Ok(Ok(found)) => found,
            _ => vec![Finding::bad(
                "check",
                format!("not done within {timeout:?}"),
                "unplug the camera, end other programs that use it, and check again",
            )],
        };
        let left = until.saturating_duration_since(tokio::time::Instant::now());
        let frame = self.capture(Duration::from_secs(60), left).await;
        found.push(check::frame(&self.settings, &frame));
        found
    }
}

/// The thread of a camera. Nobody waits for its end: a call into a vendor's library may take its time.
fn thread(work: impl FnOnce() + Send + 'static) {
    let spawned = std::thread::Builder::new().name("pico-flexx".into()).spawn(work);
    if let Err(error) = spawned {
        // Its orders are dropped with `work`: every call says that the thread has ended.
        tracing::error!("no thread for a camera: {error}");
    }
}

#[async_trait]
impl DepthCamera for FlexxCamera {
    fn info(&self) -> CameraInfo {
        let case = self.settings.use_case();
        CameraInfo {
            name: self.settings.name.clone(),
            model: format!("CamBoard pico flexx {case}"),
            width: self.settings.size_px.0,
            height: self.settings.size_px.1,
            frame_rate_hz: self.settings.rate_hz(),
            range_m: UseCase::parse(case).map_or(RANGE_M, UseCase::range_m),
        }
    }

    async fn capture(&self, max_age: Duration, timeout: Duration) -> Result<DepthFrame, DeviceError> {
        self.feed.next(max_age, timeout, || self.start()).await
    }
}
