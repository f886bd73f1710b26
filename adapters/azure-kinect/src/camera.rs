//! The camera as its callers see it.

use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use async_trait::async_trait;
use graspd_adapters_core::feed::{Feed, FeedCounts};
use graspd_adapters_core::{CameraInfo, DepthCamera, DepthFrame, DeviceError};
use tokio::sync::oneshot;

use crate::check::{self, Checked};
use crate::live::{DeviceState, Live};
use crate::playback::Playback;
use crate::recording::{Recording, RecordingError};
use crate::settings::{KinectSettings, Pace, SettingsError, Source};

/// Orders that wait for the thread at most.
const ORDERS: usize = 32;

/// What callers ask of the thread.
pub(crate) enum Command {
    /// Somebody waits for a frame: stream, and try at once where the device was lost.
    Wake,
    /// The next frame of a recording.
    Next(oneshot::Sender<Result<DepthFrame, DeviceError>>),
    /// Stop streaming until somebody waits again.
    Stop(oneshot::Sender<()>),
    /// End.
    Quit,
}

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
    commands: SyncSender<Command>,
}

impl KinectCamera {
    /// A camera. A recording is opened here; a device is looked for by the first call that needs it.
    ///
    /// # Errors
    /// [`OpenError`].
    pub async fn new(settings: KinectSettings) -> Result<Self, OpenError> {
        settings.check()?;
        let (commands, orders) = sync_channel(ORDERS);
        let feed = Arc::new(Feed::new(settings.name.clone()));
        let state = Arc::new(Mutex::new(DeviceState::default()));
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
                    Ok::<_, RecordingError>((Playback::new(name, recording, pace, repeat)?, about))
                });
                let ended = |_| RecordingError::Open { path: shown, detail: "reading it ended early".into() };
                let (playback, (mode, period, serial)) = open.await.map_err(ended)??;
                state.lock().unwrap_or_else(PoisonError::into_inner).serial = serial;
                play(playback, orders, feed.clone());
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
        Ok(Self { info, settings, feed, state, commands })
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
        // A full queue is one that wakes the thread anyway.
        let _full = self.commands.try_send(Command::Wake);
    }

    /// Stops streaming: the illumination goes off, a recording pauses. The next capture begins again.
    ///
    /// # Errors
    /// [`DeviceError::Timeout`] when the library does not return in time, [`DeviceError::Busy`].
    pub async fn stop(&self, timeout: Duration) -> Result<(), DeviceError> {
        let (done, answer) = oneshot::channel();
        self.order(Command::Stop(done))?;
        self.bounded("stop", timeout, answer).await
    }

    /// What is wrong with the camera and what to do about it. A device begins to stream for it.
    pub async fn check(&self, timeout: Duration) -> Vec<Checked> {
        let until = tokio::time::Instant::now() + timeout;
        let settings = self.settings.clone();
        let mut found =
            match tokio::time::timeout(timeout, tokio::task::spawn_blocking(move || check::still(&settings)))
                .await
            {
                Ok(Ok(found)) => found,
                _ => vec![Checked::bad(
                    "check",
                    format!("not done within {timeout:?}"),
                    "unplug the device, end other programs that use it, and check again",
                )],
            };
        let left = until.saturating_duration_since(tokio::time::Instant::now());
        let frame = self.capture(Duration::from_secs(60), left).await;
        found.push(check::frame(&frame));
        found
    }

    fn order(&self, command: Command) -> Result<(), DeviceError> {
        self.commands.try_send(command).map_err(|error| {
            let device = self.info.name.clone();
            match error {
                TrySendError::Full(_) => DeviceError::Busy { device, with: "earlier calls".into() },
                TrySendError::Disconnected(_) => {
                    DeviceError::Disconnected { device, detail: "its thread has ended".into() }
                }
            }
        })
    }

    async fn bounded<T>(
        &self,
        operation: &'static str,
        timeout: Duration,
        answer: oneshot::Receiver<T>,
    ) -> Result<T, DeviceError> {
        let device = || self.info.name.clone();
        match tokio::time::timeout(timeout, answer).await {
            Ok(Ok(answer)) => Ok(answer),
            Ok(Err(_)) => {
                Err(DeviceError::Disconnected { device: device(), detail: "its thread has ended".into() })
            }
            Err(_) => Err(DeviceError::Timeout { device: device(), operation, after: timeout }),
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

fn play(playback: Playback, orders: Receiver<Command>, feed: Arc<Feed>) {
    thread(move || playback.run(&orders, &feed));
}

impl Drop for KinectCamera {
    fn drop(&mut self) {
        // Where the queue is full, the thread ends when it finds its other end gone.
        let _full = self.commands.try_send(Command::Quit);
    }
}

#[async_trait]
impl DepthCamera for KinectCamera {
    fn info(&self) -> CameraInfo {
        self.info.clone()
    }

    async fn capture(&self, max_age: Duration, timeout: Duration) -> Result<DepthFrame, DeviceError> {
        if let Source::Recording(recording) = &self.settings.source
            && recording.pace == Pace::AsAsked
        {
            let (reply, answer) = oneshot::channel();
            self.order(Command::Next(reply))?;
            return self.bounded("capture", timeout, answer).await?;
        }
        let wake = || {
            if let Err(error @ DeviceError::Disconnected { .. }) = self.order(Command::Wake) {
                self.feed.fail(error);
            }
        };
        self.feed.next(max_age, timeout, wake).await
    }
}
