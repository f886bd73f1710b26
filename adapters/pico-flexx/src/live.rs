//! The camera at this machine as a source of frames, on a thread of its own: the manufacturer's library blocks.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use graspd_adapters_core::feed::Feed;
use graspd_adapters_core::stamps::{DeviceClock, ExposureCounter};
use graspd_adapters_core::streaming::{self, Ended, Order, Orders};
use graspd_adapters_core::{DepthFrame, DeviceError, Lens};

use crate::CameraState;
use crate::royale::{self, Camera, Picture, Royale, RoyaleError};
use crate::settings::{Exposure, FlexxSettings, RoyaleSettings};

/// How long a frame is waited for at a time: so soon an order is obeyed.
const POLL: Duration = Duration::from_millis(100);

/// The thread's own.
pub(crate) struct Live {
    settings: FlexxSettings,
    source: RoyaleSettings,
    feed: Arc<Feed>,
    state: Arc<Mutex<CameraState>>,
    royale: Option<Arc<Royale>>,
    counter: ExposureCounter,
}

impl Live {
    pub(crate) fn new(
        settings: FlexxSettings,
        source: RoyaleSettings,
        feed: Arc<Feed>,
        state: Arc<Mutex<CameraState>>,
    ) -> Self {
        let counter = ExposureCounter::new(settings.period());
        Self { settings, source, feed, state, royale: None, counter }
    }

    /// Streams while somebody looks; reaches the camera again when it was lost.
    pub(crate) fn run(mut self, orders: &Orders) {
        let feed = self.feed.clone();
        let retry = self.settings.retry();
        streaming::run(&feed, orders, retry, |orders| {
            let ended = match self.begin() {
                Ok((camera, lens)) => self.stream(camera, lens, orders),
                Err(error) => Ended::Lost(error),
            };
            self.tell(|state| state.streaming = false);
            ended
        });
    }

    /// A camera that streams, and its lens.
    fn begin(&mut self) -> Result<(Camera, Lens), DeviceError> {
        let royale = self.library()?;
        let opened = royale.open(self.source.camera.as_deref()).map_err(|error| self.away(&error))?;
        let Some(mut camera) = opened else {
            let detail =
                "no camera is connected: cable, udev rule for vendor 1c28, another process that has it?";
            return Err(self.disconnected(detail));
        };
        self.tell(|state| state.id = Some(camera.id().to_owned()));
        let use_case = self.set_up(&mut camera)?;
        self.tell(|state| state.use_case = Some(use_case));
        let size = camera.size().map_err(|error| self.away(&error))?;
        self.check_size(size)?;
        let lens = camera.lens().map_err(|error| self.away(&error))?;
        let numbers = [lens.c, lens.f, lens.p].concat();
        if numbers.iter().chain(&lens.k).any(|v| !v.is_finite()) || lens.f.iter().any(|f| *f <= 0.0) {
            return Err(self.wrong(format!("found the lens {lens:?}, expected finite numbers")));
        }
        let [c, f, p] = [lens.c, lens.f, lens.p].map(|pair| pair.map(f64::from));
        let k = lens.k.map(f64::from);
        let lens = Lens {
            fx_px: f[0],
            fy_px: f[1],
            cx_px: c[0],
            cy_px: c[1],
            distortion: [k[0], k[1], p[0], p[1], k[2], 0.0, 0.0, 0.0],
        };
        camera.start().map_err(|error| self.away(&error))?;
        Ok((camera, lens))
    }

    fn library(&mut self) -> Result<Arc<Royale>, DeviceError> {
        if let Some(royale) = &self.royale {
            return Ok(royale.clone());
        }
        let loaded = royale::load(self.source.library.as_deref());
        let (royale, place) = loaded.map_err(|missing| self.disconnected(missing.to_string()))?;
        let [major, minor, patch] = royale.version();
        let about = format!("{} {major}.{minor}.{patch}", place.display());
        self.tell(|state| state.source = Some(about));
        self.royale = Some(royale.clone());
        Ok(royale)
    }

    /// Use case, frame rate and exposure; the use case that runs.
    fn set_up(&self, camera: &mut Camera) -> Result<String, DeviceError> {
        let wanted = &self.source.use_case;
        let cases = camera.use_cases().map_err(|error| self.away(&error))?;
        if !cases.contains(wanted) {
            let expected = format!("one of {}", cases.join(", "));
            return Err(self.refused("use_case", wanted.clone(), expected));
        }
        let runs = camera.take_use_case(wanted).map_err(|error| self.away(&error))?;
        if runs != *wanted {
            return Err(self.wrong(format!("found use case {runs}, expected {wanted}")));
        }
        if let Some(hz) = self.source.frames_per_second
            && let Err(most) = camera.take_frame_rate(hz).map_err(|error| self.away(&error))?
        {
            return Err(self.refused("frames_per_second", hz.to_string(), format!("at most {most}")));
        }
        let stream = self.source.stream.unwrap_or(0);
        match self.source.exposure {
            Exposure::Auto => camera.expose_automatically(stream).map_err(|error| self.away(&error))?,
            Exposure::Us(us) => {
                if let Err((least, most)) = camera.expose(stream, us).map_err(|error| self.away(&error))? {
                    return Err(self.refused("exposure.us", us.to_string(), format!("{least} to {most}")));
                }
            }
        }
        Ok(runs)
    }

    fn stream(&mut self, mut camera: Camera, lens: Lens, orders: &Orders) -> Ended {
        self.tell(|state| state.streaming = true);
        let silence = self.settings.silence();
        let mut clock = DeviceClock::new(self.settings.latency());
        let mut stream = self.source.stream;
        let mut last = Instant::now();
        loop {
            match orders.look() {
                Some(Order::Stop(done)) => {
                    drop(camera);
                    return Ended::Stopped(done);
                }
                Some(Order::Quit) => return Ended::Quit,
                Some(Order::Wake) | None => {}
            }
            match camera.next(POLL) {
                Ok(Some(picture)) => {
                    let arrived = Instant::now();
                    last = arrived;
                    if picture.stream != *stream.get_or_insert(picture.stream) {
                        continue;
                    }
                    if let Err(error) = self.check_size((picture.width, picture.height)) {
                        return Ended::Lost(error);
                    }
                    self.tell(|state| state.exposure_us = picture.exposure_us);
                    let exposed = clock.exposed(picture.stamp, arrived);
                    let frame = self.frame(&picture, lens);
                    self.feed.publish(frame, exposed);
                }
                Ok(None) => match camera.is_connected() {
                    Ok(true) if last.elapsed() > silence => {
                        return Ended::Lost(self.disconnected(format!("no frame for {silence:?}")));
                    }
                    Ok(true) => {}
                    Ok(false) => return Ended::Lost(self.disconnected("the camera was unplugged")),
                    Err(error) => return Ended::Lost(self.away(&error)),
                },
                Err(error) => return Ended::Lost(self.away(&error)),
            }
        }
    }

    /// Depth of points that are sure enough.
    fn frame(&mut self, picture: &Picture, lens: Lens) -> DepthFrame {
        let sure = |point: &royale::Point| {
            let noise = point.noise_m < self.settings.max_noise_m;
            let depth = point.z_m.is_finite() && point.z_m > 0.0;
            if noise && depth && point.confidence >= self.source.min_confidence { point.z_m } else { 0.0 }
        };
        DepthFrame {
            width: picture.width,
            height: picture.height,
            depth_m: picture.points.iter().map(sure).collect(),
            lens,
            world_from_camera: None,
            sequence: self.counter.count(picture.stamp),
            stamp: picture.stamp,
            age: Duration::ZERO,
        }
    }

    fn check_size(&self, found: (usize, usize)) -> Result<(), DeviceError> {
        let expected = self.settings.size_px;
        if found == expected {
            return Ok(());
        }
        Err(self.wrong(format!("found {found:?} pixels, expected {expected:?} (`size_px`)")))
    }

    fn away(&self, error: &RoyaleError) -> DeviceError {
        if error.is_transient() {
            return self.disconnected(error.to_string());
        }
        self.wrong(error.to_string())
    }

    fn disconnected(&self, detail: impl Into<String>) -> DeviceError {
        DeviceError::Disconnected { device: self.settings.name.clone(), detail: detail.into() }
    }

    fn wrong(&self, detail: String) -> DeviceError {
        DeviceError::Protocol { device: self.settings.name.clone(), detail }
    }

    fn refused(&self, field: &str, found: String, expected: String) -> DeviceError {
        let (device, field) = (self.settings.name.clone(), field.to_owned());
        DeviceError::OutOfRange { device, field, found, expected }
    }

    fn tell(&self, change: impl FnOnce(&mut CameraState)) {
        change(&mut self.state.lock().unwrap_or_else(PoisonError::into_inner));
    }
}
