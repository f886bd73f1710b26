//! Mock depth cameras.

use std::sync::Arc;
use std::time::Duration;

use async_trait::async_trait;
use graspd_adapters_core::check::SettingsError;
use graspd_adapters_core::{CameraInfo, DepthCamera, DepthFrame, DeviceError, Lens};
use graspd_sim::render::{self, View};
use graspd_sim::sensor::Sensor;
use graspd_sim::world::{HandId, World};
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};
use tokio::sync::oneshot::Sender;

use crate::clock::duration;
use crate::fault_handle::{Fate, FaultHandle};
use crate::faults::Faults;
use crate::link::{Call, Link};
use crate::shared::{Hold, Reply, SharedWorld, positive};
use crate::stage::Process;

/// Most exposures per second: more than there are steps of the world, and few enough to be counted for ever.
const MOST_HZ: f64 = 1e4;

/// Where a camera is mounted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Mount {
    /// It stands still.
    Fixed {
        /// Pose of the optical frame.
        world_from_camera: Isometry3<f64>,
    },
    /// It moves with the root link of a hand (a palm camera).
    OnHand {
        /// The hand.
        hand: HandId,
        /// Pose of the optical frame in the hand's root link.
        hand_from_camera: Isometry3<f64>,
    },
}

impl Mount {
    fn world_from_camera(&self, world: &World) -> Option<Isometry3<f64>> {
        match self {
            Self::Fixed { world_from_camera } => Some(*world_from_camera),
            Self::OnHand { hand, hand_from_camera } => {
                Some(world.hand_state(*hand)?.world_from_hand * hand_from_camera)
            }
        }
    }
}

/// What a mock camera says of itself, and how often it exposes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CameraSettings {
    /// Name for logs and errors.
    pub name: String,
    /// Model.
    pub model: String,
    /// Exposures per second, above 0, at most 10,000.
    pub frame_rate_hz: f64,
    /// Closest and farthest depth, as it says of itself, metres.
    pub range_m: (f64, f64),
}

impl Default for CameraSettings {
    fn default() -> Self {
        Self {
            name: "camera".into(),
            model: "Azure Kinect NFOV unbinned".into(),
            frame_rate_hz: 30.0,
            range_m: (0.25, 3.86),
        }
    }
}

/// A depth camera in a shared world.
///
/// Exposures are made at whole multiples of the frame's duration on the world's clock, and counted from the
/// world's beginning: `sequence` is the same for all cameras of one rate.
#[derive(Debug)]
pub struct MockCamera {
    link: Link,
    settings: CameraSettings,
    mount: Mount,
    sensor: Arc<Sensor>,
}

impl MockCamera {
    /// A camera in a world.
    ///
    /// # Errors
    /// [`SettingsError`]: a number is impossible.
    pub fn new(
        shared: &SharedWorld,
        settings: CameraSettings,
        sensor: Sensor,
        mount: Mount,
        faults: Faults,
    ) -> Result<Self, SettingsError> {
        positive("frame_rate_hz", settings.frame_rate_hz)?;
        if settings.frame_rate_hz > MOST_HZ {
            return Err(SettingsError {
                field: "frame_rate_hz".into(),
                found: settings.frame_rate_hz.to_string(),
                expected: "at most 10000".into(),
            });
        }
        let faults = FaultHandle::new(shared.clock(), faults)?;
        let link = Link { device: settings.name.clone(), shared: shared.clone(), faults };
        Ok(Self { link, settings, mount, sensor: Arc::new(sensor) })
    }

    /// Changes the camera's faults at run time.
    pub fn faults(&self) -> FaultHandle {
        self.link.faults.clone()
    }

    async fn frame(&self, call: Call, max_age_s: f64) -> Result<DepthFrame, DeviceError> {
        self.link.reach(&call, false).await?;
        let exposure = self.link.shared.request({
            let (mount, lens) = (self.mount, self.sensor.lens);
            let (rate_hz, faults) = (self.settings.frame_rate_hz, self.link.faults.clone());
            let call = call.clone();
            // How long the noise takes to be computed is the machine's affair: on demand, arms that are at work stand as
            // they were seen until the frame is there. Who follows a frame from the hand itself paces the world by that.
            let stands = !self.link.shared.is_paced() && matches!(mount, Mount::Fixed { .. });
            let holder = stands.then(|| self.link.shared.holder());
            move |stage, reply| {
                let next = (stage.world.time_s() * rate_hz + 1e-9).floor() as u64 + 1;
                let look = Box::new(move |world: &World| {
                    mount.world_from_camera(world).map(|pose| render::capture(world, &lens, &pose))
                });
                stage.start(Watch {
                    reply: Some(reply),
                    holder: holder.map(|h| Box::new(h) as Box<dyn Fn() -> Hold + Send>),
                    call,
                    max_age_s,
                    rate_hz,
                    faults,
                    next,
                    look,
                    coming: Vec::new(),
                    too_old_s: None,
                });
            }
        });
        let (exposure, _still) = exposure.await.map_err(|_| self.link.ended())??;
        let sensor = self.sensor.clone();
        let seed = self.link.faults.noise_seed(exposure.sequence);
        let lens = exposure.view.lens;
        let world_from_camera = exposure.view.world_from_camera;
        let image = tokio::task::spawn_blocking(move || sensor.observe(&exposure.view, seed))
            .await
            .map_err(|e| DeviceError::Protocol { device: call.device.clone(), detail: e.to_string() })?;
        Ok(DepthFrame {
            width: image.width,
            height: image.height,
            depth_m: image.depth_m.into(),
            lens: Lens {
                fx_px: lens.fx_px,
                fy_px: lens.fy_px,
                cx_px: lens.cx_px,
                cy_px: lens.cy_px,
                distortion: [0.0; 8],
            },
            world_from_camera: Some(world_from_camera),
            sequence: exposure.sequence,
            stamp: duration(exposure.at_s),
            age: duration(self.link.shared.time_s() - exposure.at_s),
        })
    }
}

#[async_trait]
impl DepthCamera for MockCamera {
    fn info(&self) -> CameraInfo {
        CameraInfo {
            name: self.settings.name.clone(),
            model: self.settings.model.clone(),
            width: self.sensor.lens.width,
            height: self.sensor.lens.height,
            frame_rate_hz: self.settings.frame_rate_hz,
            range_m: self.settings.range_m,
        }
    }

    async fn capture(&self, max_age: Duration, timeout: Duration) -> Result<DepthFrame, DeviceError> {
        let call = self.link.call("capture", timeout);
        let attempts = async {
            loop {
                let frame = self.frame(call.clone(), max_age.as_secs_f64()).await?;
                // In a world with a speed, time goes on while the noise is computed.
                if frame.age <= max_age {
                    return Ok(frame);
                }
                if self.link.shared.time_s() >= call.until_s {
                    let device = call.device.clone();
                    return Err(DeviceError::Stale { device, age: frame.age, limit: max_age });
                }
            }
        };
        self.link.shared.bounded(&call.device, call.operation, timeout, attempts).await
    }
}

/// One exposure.
struct Exposure {
    sequence: u64,
    at_s: f64,
    view: View,
}

/// Takes a picture of the world; `None` when what the camera is mounted on is gone.
type Look = Box<dyn Fn(&World) -> Option<View> + Send>;

/// Waits for the next exposure and its delivery.
struct Watch {
    reply: Option<Reply<(Exposure, Option<Hold>)>>,
    /// Stops the clock.
    holder: Option<Box<dyn Fn() -> Hold + Send>>,
    call: Call,
    max_age_s: f64,
    rate_hz: f64,
    faults: FaultHandle,
    /// Number of the next exposure.
    next: u64,
    look: Look,
    /// Exposures on their way, with the time when they arrive.
    coming: Vec<(f64, Exposure)>,
    /// Age of the newest image among those that came too old.
    too_old_s: Option<f64>,
}

impl Watch {
    /// What happened by now; `None` when the watch goes on.
    fn look(&mut self, world: &World) -> Option<Result<Exposure, DeviceError>> {
        let now_s = world.time_s();
        let exposed = (now_s * self.rate_hz + 1e-9).floor() as u64;
        if exposed >= self.next {
            self.next = exposed + 1;
            match self.faults.fate(exposed) {
                Fate::Lost => {}
                Fate::Stuck(since_s) if now_s - since_s > self.max_age_s => {
                    self.too_old_s = Some(now_s - since_s);
                }
                // Young enough, but exposed before the call: nothing new has come.
                Fate::Stuck(_) => {}
                // Not worth a rendering: too old when it comes, or another comes before it.
                Fate::Arrives(after_s) if after_s > self.max_age_s => {
                    self.too_old_s = Some(self.too_old_s.map_or(after_s, |age| age.min(after_s)));
                }
                Fate::Arrives(after_s) if self.coming.iter().any(|(at, _)| *at <= now_s + after_s) => {}
                Fate::Arrives(after_s) => match (self.look)(world) {
                    Some(view) => {
                        self.coming
                            .push((now_s + after_s, Exposure { sequence: exposed, at_s: now_s, view }));
                    }
                    None => {
                        return Some(Err(DeviceError::Disconnected {
                            device: self.call.device.clone(),
                            detail: "the hand that carries the camera is no longer in the world".into(),
                        }));
                    }
                },
            }
        }
        if let Some(at) = self.coming.iter().position(|(arrives_s, _)| *arrives_s <= now_s + 1e-9) {
            return Some(Ok(self.coming.swap_remove(at).1));
        }
        (now_s >= self.call.until_s).then(|| {
            Err(match self.too_old_s {
                Some(age_s) => DeviceError::Stale {
                    device: self.call.device.clone(),
                    age: duration(age_s),
                    limit: duration(self.max_age_s),
                },
                None => self.call.timed_out(),
            })
        })
    }
}

impl Process for Watch {
    fn after_step(&mut self, world: &mut World) -> bool {
        if self.reply.as_ref().is_none_or(Sender::is_closed) {
            return true;
        }
        let Some(answer) = self.look(world) else { return false };
        if let Some(reply) = self.reply.take() {
            let still = self.holder.as_ref().filter(|_| answer.is_ok()).map(|hold| hold());
            // Where nobody hears of it, the hold is dropped and ends.
            let _unheard = reply.send(answer.map(|exposure| (exposure, still)));
        }
        true
    }
}
