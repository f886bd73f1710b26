//! The camera as its callers see it.

use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use async_trait::async_trait;
use graspd_adapters_core::check::{Finding, SettingsError};
use graspd_adapters_core::feed::{Feed, FeedCounts};
use graspd_adapters_core::streaming::{self, Control};
use graspd_adapters_core::{CameraInfo, DepthCamera, DepthFrame, DeviceError};
use tokio::sync::oneshot;

use crate::check;
use crate::live::{DeviceState, Live};
use crate::playback::{Asked, Playback};
use crate::recording::{Recording, RecordingError};
use crate::settings::{KinectSettings, Pace, Source};

/// Calls that wait for a frame of a recording at most.
const MOST_ASKED: usize = 32;

/// Why there is no camera.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum OpenError {
    /// A setting is wrong.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The recording cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
}

/// An Azure Kinect, live or recorded. It begins to stream with the first capture; its thread ends when this is dropped.
#[derive(Debug)]
pub struct KinectCamera {
    info: CameraInfo,
    settings: KinectSettings,
    feed: Arc<Feed>,
    state: Arc<Mutex<DeviceState>>,
    control: Control,
    /// Of a recording that is played as asked.
    asked: Option<SyncSender<Asked>>,
}

impl KinectCamera {
    /// A camera. A recording is opened here; a device is looked for by the first call that needs it.
    ///
    /// # Errors
    /// [`OpenError`].
    pub async fn new(settings: KinectSettings) -> Result<Self, OpenError> {
        settings.check()?;
        let (control, orders) = streaming::channel();
        let feed = Arc::new(Feed::new(settings.name.clone()));
        let state = Arc::new(Mutex::new(DeviceState::default()));
        let mut asked = None;
        let (mode, frame_rate_hz) = match &settings.source {
            Source::Device(device) => {
                let live = Live::new(settings.name.clone(), device.clone(), feed.clone(), state.clone());
                thread(move || live.run(&orders));
                (device.mode, f64::from(device.frames_per_second.hz()))
            }
            Source::Recording(source) => {
                let (path, pace, repeat) = (source.path.clone(), source.pace, source.repeat);
                let name = settings.name.clone();
                let shown = path.display().to_string();
                let open = tokio::task::spawn_blocking(move || {
                    let recording = Recording::open(&path)?;
                    let about = (recording.mode(), recording.period(), recording.serial().map(str::to_owned));
                    Ok::<_, RecordingError>((Playback::new(name, recording, repeat)?, about))
                });
                let ended = |_| RecordingError::Open { path: shown, detail: "reading it ended early".into() };
                let (playback, (mode, period, serial)) = open.await.map_err(ended)??;
                state.lock().unwrap_or_else(PoisonError::into_inner).serial = serial;
                match pace {
                    Pace::AsAsked => {
                        let (sender, receiver) = sync_channel(MOST_ASKED);
                        asked = Some(sender);
                        thread(move || playback.serve(&receiver));
                    }
                    Pace::RealTime => {
                        let feed = feed.clone();
                        thread(move || playback.stream(&orders, &feed));
                    }
                }
                (mode, 1.0 / period.as_secs_f64())
            }
        };
        let (width, height) = mode.size();
        let info = CameraInfo {
            name: settings.name.clone(),
            model: format!("Azure Kinect {}", mode.label()),
            width,
            height,
            frame_rate_hz,
            range_m: mode.range_m(),
        };
        Ok(Self { info, settings, feed, state, control, asked })
    }

    /// Frames that came, exposures that were lost, times that the device was not reached. A recording that is played as
    /// asked counts nothing.
    pub fn counts(&self) -> FeedCounts {
        self.feed.counts()
    }

    /// What is known of the device; of a recording, its serial number.
    pub fn state(&self) -> DeviceState {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Begins to stream before somebody waits for a frame: a device needs a second or two.
    pub fn start(&self) {
        if self.asked.is_none() {
            self.control.wake(&self.feed);
        }
    }

    /// Stops streaming: the illumination goes off, a recording pauses. The next capture begins again.
    ///
    /// # Errors
    /// [`DeviceError::Timeout`] when the library does not return in time, [`DeviceError::Disconnected`].
    pub async fn stop(&self, timeout: Duration) -> Result<(), DeviceError> {
        if self.asked.is_some() {
            return Ok(());
        }
        self.control.stop(&self.info.name, timeout).await
    }

    /// What is wrong with the camera and what to do about it. A device, or a recording in real time, begins to stream for it.
    pub async fn check(&self, timeout: Duration) -> Vec<Finding> {
        let until = tokio::time::Instant::now() + timeout;
        let settings = self.settings.clone();
        let mut found =
            match tokio::time::timeout(timeout, tokio::task::spawn_blocking(move || check::still(&settings)))
                .await
            {
                Ok(Ok(found)) => found,
                _ => vec![Finding::bad(
                    "check",
                    format!("not done within {timeout:?}"),
                    "unplug the device, end other programs that use it, and check again",
                )],
            };
        if self.asked.is_some() {
            // Every frame was looked at already, and none may be taken from who asks next.
            return found;
        }
        let left = until.saturating_duration_since(tokio::time::Instant::now());
        let frame = self.capture(Duration::from_secs(60), left).await;
        found.push(check::frame(&frame));
        found
    }

    async fn ask(&self, asked: &SyncSender<Asked>, timeout: Duration) -> Result<DepthFrame, DeviceError> {
        let device = || self.info.name.clone();
        let ended = || DeviceError::Disconnected { device: device(), detail: "its thread has ended".into() };
        let (reply, answer) = oneshot::channel();
        asked.try_send(reply).map_err(|error| match error {
            TrySendError::Full(_) => DeviceError::Busy { device: device(), with: "earlier calls".into() },
            TrySendError::Disconnected(_) => ended(),
        })?;
        match tokio::time::timeout(timeout, answer).await {
            Ok(answer) => answer.map_err(|_| ended())?,
            Err(_) => Err(DeviceError::Timeout { device: device(), operation: "capture", after: timeout }),
        }
    }
}

/// The thread of a camera. Nobody waits for its end: a call into a vendor's library may take its time.
fn thread(work: impl FnOnce() + Send + 'static) {
    let spawned = std::thread::Builder::new().name("azure-kinect".into()).spawn(work);
    if let Err(error) = spawned {
        // Its receiver is dropped with `work`: every call says that the thread has ended.
        tracing::error!("no thread for a camera: {error}");
    }
}

#[async_trait]
impl DepthCamera for KinectCamera {
    fn info(&self) -> CameraInfo {
        self.info.clone()
    }

    async fn capture(&self, max_age: Duration, timeout: Duration) -> Result<DepthFrame, DeviceError> {
        match &self.asked {
            Some(asked) => self.ask(asked, timeout).await,
            None => self.feed.next(max_age, timeout, || self.start()).await,
        }
    }
}
