//! A live device as a source of frames, on a thread of its own: the manufacturer's library blocks.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use graspd_adapters_core::feed::Feed;
use graspd_adapters_core::stamps::{DeviceClock, ExposureCounter};
use graspd_adapters_core::streaming::{self, Ended, Order, Orders};
use graspd_adapters_core::{DeviceError, Lens};

use crate::calibration::Calibration;
use crate::frames::frame;
use crate::sdk::{self, Configuration, Device, Sdk, SdkError};
use crate::settings::DeviceSettings;

/// How long the library waits for a frame at a time: so soon an order is obeyed.
const POLL: Duration = Duration::from_millis(100);

/// What is known of the device.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DeviceState {
    /// The library that was loaded.
    pub library: Option<PathBuf>,
    /// Serial number of the device that was opened last.
    pub serial: Option<String>,
    /// True while it streams.
    pub streaming: bool,
    /// Its temperature with the last frame, degrees Celsius.
    pub temperature_c: Option<f32>,
}

/// The thread's own.
pub(crate) struct Live {
    name: String,
    settings: DeviceSettings,
    feed: Arc<Feed>,
    state: Arc<Mutex<DeviceState>>,
    sdk: Option<Arc<Sdk>>,
    counter: ExposureCounter,
}

impl Live {
    pub(crate) fn new(
        name: String,
        settings: DeviceSettings,
        feed: Arc<Feed>,
        state: Arc<Mutex<DeviceState>>,
    ) -> Self {
        let period = Duration::from_secs_f64(1.0 / f64::from(settings.frames_per_second.hz()));
        Self { name, settings, feed, state, sdk: None, counter: ExposureCounter::new(period) }
    }

    /// Streams while somebody looks; reaches the device again when it was lost.
    pub(crate) fn run(mut self, orders: &Orders) {
        let feed = self.feed.clone();
        let retry = Duration::from_millis(self.settings.retry_ms);
        streaming::run(&feed, orders, retry, |orders| {
            let ended = match self.begin() {
                Ok((device, lens)) => self.stream(device, lens, orders),
                Err(error) => Ended::Lost(error),
            };
            self.tell(|state| state.streaming = false);
            ended
        });
    }

    /// A device that streams, and its lens.
    fn begin(&mut self) -> Result<(Device, Lens), DeviceError> {
        let sdk = self.library()?;
        let mut device = self.open(&sdk)?;
        let text = device.raw_calibration().map_err(|error| self.away(&error))?;
        let calibration = Calibration::from_json(&text).map_err(|error| self.wrong(error.to_string()))?;
        let lens = calibration.depth_lens(self.settings.mode);
        let lens = lens.to_frame().map_err(|error| self.wrong(error.to_string()))?;
        let configuration =
            Configuration::depth(self.settings.mode, self.settings.frames_per_second, self.settings.dark);
        device.start(&configuration).map_err(|error| {
            let advice = "(another program may use the device; its depth engine needs libdepthengine and OpenGL 4.4 \
                          with a display)";
            self.disconnected(format!("{error} {advice}"))
        })?;
        Ok((device, lens))
    }

    fn library(&mut self) -> Result<Arc<Sdk>, DeviceError> {
        if let Some(sdk) = &self.sdk {
            return Ok(sdk.clone());
        }
        let loaded = sdk::load(self.settings.library.as_deref());
        let (sdk, place) = loaded.map_err(|missing| self.disconnected(missing.to_string()))?;
        self.tell(|state| state.library = Some(place));
        self.sdk = Some(sdk.clone());
        Ok(sdk)
    }

    fn open(&self, sdk: &Arc<Sdk>) -> Result<Device, DeviceError> {
        let installed = sdk.installed();
        if installed == 0 {
            return Err(self.disconnected(
                "no Azure Kinect is on the bus: power supply, USB 3 cable, udev rule for vendor 045e?",
            ));
        }
        let mut found = Vec::new();
        let mut refused = None;
        for index in 0..installed {
            let opened = sdk.open(index).and_then(|device| Ok((device.serial()?, device)));
            match opened {
                Ok((serial, device)) => {
                    if self.settings.serial.as_ref().is_none_or(|wanted| *wanted == serial) {
                        self.tell(|state| state.serial = Some(serial));
                        return Ok(device);
                    }
                    found.push(serial);
                }
                Err(error) => refused = Some(error),
            }
        }
        let mut detail = match &self.settings.serial {
            Some(wanted) => format!("found [{}], expected serial number {wanted}", found.join(", ")),
            None => format!("none of {installed} devices can be opened (used by another program?)"),
        };
        if let Some(error) = refused {
            detail = format!("{detail}; {error}");
        }
        Err(self.disconnected(detail))
    }

    fn stream(&mut self, mut device: Device, lens: Lens, orders: &Orders) -> Ended {
        self.tell(|state| state.streaming = true);
        let silence = Duration::from_millis(self.settings.silence_ms);
        let mut clock = DeviceClock::new(self.settings.latency());
        let mut last = Instant::now();
        loop {
            match orders.look() {
                Some(Order::Stop(done)) => {
                    drop(device);
                    return Ended::Stopped(done);
                }
                Some(Order::Quit) => return Ended::Quit,
                Some(Order::Wake) | None => {}
            }
            match device.capture(POLL) {
                Ok(Some(image)) => {
                    let arrived = Instant::now();
                    last = arrived;
                    let size = (image.width, image.height);
                    if size != self.settings.mode.size() {
                        let (mode, tag) = (self.settings.mode.size(), self.settings.mode.tag());
                        let detail = format!("found a frame of {size:?} pixels, expected {mode:?} ({tag})");
                        return Ended::Lost(self.wrong(detail));
                    }
                    let known = image.temperature_c.is_finite();
                    self.tell(|state| state.temperature_c = known.then_some(image.temperature_c));
                    let sequence = self.counter.count(image.stamp);
                    let frame = frame(size, &image.mm, lens, sequence, image.stamp);
                    self.feed.publish(frame, clock.exposed(image.stamp, arrived));
                }
                Ok(None) if last.elapsed() > silence => {
                    return Ended::Lost(self.disconnected(format!("no frame for {silence:?}")));
                }
                Ok(None) => {}
                Err(error) => return Ended::Lost(self.away(&error)),
            }
        }
    }

    fn away(&self, error: &SdkError) -> DeviceError {
        match error {
            SdkError::Failed { .. } => self.disconnected(error.to_string()),
            SdkError::Impossible { .. } => self.wrong(error.to_string()),
        }
    }

    fn disconnected(&self, detail: impl Into<String>) -> DeviceError {
        DeviceError::Disconnected { device: self.name.clone(), detail: detail.into() }
    }

    fn wrong(&self, detail: String) -> DeviceError {
        DeviceError::Protocol { device: self.name.clone(), detail }
    }

    fn tell(&self, change: impl FnOnce(&mut DeviceState)) {
        change(&mut self.state.lock().unwrap_or_else(PoisonError::into_inner));
    }
}
