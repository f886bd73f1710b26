//! One simulated world that several devices share.

use std::future::Future;
use std::pin::pin;
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Weak};
use std::time::Duration;

use graspd_adapters_core::DeviceError;
use graspd_adapters_core::check::{SettingsError, require};
use graspd_sim::world::{HandId, World};
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};
use tokio::sync::oneshot;

use crate::bins::Bin;
use crate::clock::Clock;
use crate::stage::{self, Job, Pace, Process, Stage, Watcher};

/// How a shared world runs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SharedWorldSettings {
    /// How many times as fast as the wall clock the world runs; 0: on demand.
    ///
    /// *On demand* time moves only while some device call takes time (a motion, a frame, a latency), and then as
    /// fast as the machine can. A timeout is counted on the world's clock, so a slow machine causes none, and one
    /// caller that makes the same calls gets the same answers, bit for bit. Should the world stand still during
    /// a call (it is paused, or stuck in a step), the timeout counts on the wall clock.
    ///
    /// *At a speed* the world moves all the time and timeouts are those of the wall clock. A machine that is too
    /// slow makes the world slower than asked.
    pub speed: f64,
    /// Bins in the table.
    pub bins: Vec<Bin>,
}

impl Default for SharedWorldSettings {
    fn default() -> Self {
        Self { speed: 0.0, bins: vec![Bin::default()] }
    }
}

impl From<crate::faults::FaultsError> for SettingsError {
    fn from(e: crate::faults::FaultsError) -> Self {
        Self { field: format!("faults.{}", e.field), found: e.found.to_string(), expected: e.expected.into() }
    }
}

/// `Ok` when a number is finite and above zero.
pub(crate) fn positive(field: &str, found: f64) -> Result<(), SettingsError> {
    require(field, found, found.is_finite() && found > 0.0, "a number above 0")
}

/// `Ok` when a number is finite.
pub(crate) fn finite(field: &str, found: f64) -> Result<(), SettingsError> {
    require(field, found, found.is_finite(), "a finite number")
}

/// The world's thread has ended: a step of the physics failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the simulated world has ended")]
pub struct WorldEnded;

/// A world on a thread of its own, shared by any number of devices. Clones are the same world; its thread ends
/// when the last clone and the last device are gone.
///
/// Nothing here blocks: what is asked of the world is done on its thread between two steps.
#[derive(Clone)]
pub struct SharedWorld {
    jobs: Arc<Sender<Job>>,
    clock: Arc<Clock>,
    pace: Pace,
}

impl std::fmt::Debug for SharedWorld {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SharedWorld").field("time_s", &self.time_s()).field("pace", &self.pace).finish()
    }
}

impl SharedWorld {
    /// Gives a world a thread.
    ///
    /// # Errors
    /// [`SettingsError`] for a speed that is negative or no number, for a bin without an opening or over the tray, and when the
    /// system gives no thread.
    pub fn new(world: World, settings: SharedWorldSettings) -> Result<Self, SettingsError> {
        let pace = match settings.speed {
            0.0 => Pace::OnDemand,
            speed => {
                positive("speed", speed)?;
                Pace::Wall(speed)
            }
        };
        for bin in &settings.bins {
            for half in bin.half_extents_m {
                positive(&format!("bins.{}.half_extents_m", bin.name), half)?;
            }
            for middle in bin.center_m {
                finite(&format!("bins.{}.center_m", bin.name), middle)?;
            }
            if world.settings().tray.is_some_and(|tray| bin.overlaps(&tray)) {
                return Err(SettingsError {
                    field: format!("bins.{}.center_m", bin.name),
                    found: format!("{:?} with half extents {:?}", bin.center_m, bin.half_extents_m),
                    expected: "a bin that does not overlap the tray and its walls".into(),
                });
            }
        }
        let clock = Arc::new(Clock::default());
        clock.set(world.time_s());
        let (jobs, queue) = channel();
        let stage = Stage::new(world, settings.bins);
        let thread_clock = clock.clone();
        std::thread::Builder::new()
            .name("simulated world".into())
            .spawn(move || stage::run(stage, &queue, &thread_clock, pace))
            .map_err(|e| SettingsError {
                field: "thread".into(),
                found: e.to_string(),
                expected: "a thread for the simulated world".into(),
            })?;
        Ok(Self { jobs: Arc::new(jobs), clock, pace })
    }

    /// Seconds on the world's clock.
    pub fn time_s(&self) -> f64 {
        self.clock.now_s()
    }

    /// Stops the world's clock. Calls that need time end with their timeout (wall clock) unless it goes on.
    pub fn pause(&self) {
        self.clock.pause(true);
        self.wake();
    }

    /// Lets the world's clock go on.
    pub fn resume(&self) {
        self.clock.pause(false);
        self.wake();
    }

    /// Does something with the world between two steps, on its thread: to look at it, or to set it up.
    ///
    /// # Errors
    /// [`WorldEnded`].
    pub async fn with<R: Send + 'static>(
        &self,
        job: impl FnOnce(&mut World) -> R + Send + 'static,
    ) -> Result<R, WorldEnded> {
        self.on_stage(move |stage| job(&mut stage.world)).await
    }

    /// Lets somebody look at the world every so many seconds of its clock (at least one step), for as long as it lives. It
    /// lets no time go by: who watches sees what others do.
    ///
    /// # Errors
    /// [`WorldEnded`].
    pub async fn watch(
        &self,
        every_s: f64,
        look: impl FnMut(&World) + Send + 'static,
    ) -> Result<(), WorldEnded> {
        self.on_stage(move |stage| {
            let steps = (every_s / stage.world.settings().dt_s).round().max(1.0);
            stage.watch(Watcher { every: steps as u64, look: Box::new(look) });
        })
        .await
    }

    /// Puts a hand into the world, its root link at a pose, its fingers as its description says that it opens or
    /// at the coordinates given. A [`crate::MockArm`] carries it, a [`crate::MockHand`] moves its fingers.
    ///
    /// # Errors
    /// [`WorldEnded`].
    pub async fn add_hand(
        &self,
        hand: Arc<graspd_hands::Hand>,
        world_from_hand: Isometry3<f64>,
        coordinates: Option<Vec<f64>>,
    ) -> Result<HandId, WorldEnded> {
        let coordinates = coordinates.unwrap_or_else(|| hand.actuation.open());
        self.with(move |world| world.add_hand(hand, &world_from_hand, &coordinates)).await
    }

    /// Lets this many seconds go by on the world's clock. Waits as long as the world is paused.
    ///
    /// # Errors
    /// [`WorldEnded`].
    pub async fn wait(&self, seconds: f64) -> Result<(), WorldEnded> {
        let until_s = self.time_s() + seconds.max(0.0);
        self.wait_until(until_s).await
    }

    /// Lets this many seconds go by and then stops the clock until the answer is dropped: to press a button, or to
    /// change a fault, at an exact moment of somebody else's motion.
    ///
    /// # Errors
    /// [`WorldEnded`].
    pub async fn hold_after(&self, seconds: f64) -> Result<Hold, WorldEnded> {
        hold_after(&self.clock, &self.jobs, seconds).await.map_err(|_| WorldEnded)
    }

    /// Stops the clock at once, between two steps, until the answer is dropped.
    pub fn hold(&self) -> Hold {
        self.holder()()
    }

    /// What stops the clock at once, for somebody on the world's own thread: it does not keep the world alive.
    pub(crate) fn holder(&self) -> impl Fn() -> Hold + Send + use<> {
        let (clock, jobs) = (self.clock.clone(), Arc::downgrade(&self.jobs));
        move || {
            clock.hold();
            Hold { clock: clock.clone(), jobs: jobs.clone() }
        }
    }

    pub(crate) async fn wait_until(&self, until_s: f64) -> Result<(), WorldEnded> {
        if self.time_s() >= until_s {
            return Ok(());
        }
        let (reply, answer) = oneshot::channel();
        self.send(Box::new(move |stage| stage.start(Wait { until_s, reply: Some(reply) })))?;
        answer.await.map_err(|_| WorldEnded)
    }

    /// Runs a job between two steps and brings back what it returns.
    pub(crate) async fn on_stage<R: Send + 'static>(
        &self,
        job: impl FnOnce(&mut Stage) -> R + Send + 'static,
    ) -> Result<R, WorldEnded> {
        let (reply, answer) = oneshot::channel();
        self.send(Box::new(move |stage| {
            // Nobody may be waiting any more.
            let _unheard = reply.send(job(stage));
        }))?;
        answer.await.map_err(|_| WorldEnded)
    }

    /// Runs a job that hands the reply on, to be sent when what it asks for is done.
    pub(crate) async fn request<R: Send + 'static>(
        &self,
        job: impl FnOnce(&mut Stage, Reply<R>) + Send + 'static,
    ) -> Result<Result<R, DeviceError>, WorldEnded> {
        let (reply, answer) = oneshot::channel();
        self.send(Box::new(move |stage| job(stage, reply)))?;
        answer.await.map_err(|_| WorldEnded)
    }

    /// When a call with this timeout must end, on the world's clock. A little before the wall clock's end in a
    /// world with a speed, so that the device's own words come first.
    pub(crate) fn deadline_s(&self, timeout: Duration) -> f64 {
        let seconds = timeout.as_secs_f64();
        self.time_s()
            + match self.pace {
                Pace::OnDemand => seconds,
                Pace::Wall(speed) => 0.97 * seconds * speed,
            }
    }

    /// Runs a device call that watches its deadline on the world's clock, and ends it when the wall clock must:
    /// see [`SharedWorldSettings::speed`].
    pub(crate) async fn bounded<R>(
        &self,
        device: &str,
        operation: &'static str,
        timeout: Duration,
        call: impl Future<Output = Result<R, DeviceError>>,
    ) -> Result<R, DeviceError> {
        let mut call = pin!(call);
        loop {
            let before_s = self.time_s();
            tokio::select! {
                biased;
                answer = &mut call => return answer,
                () = tokio::time::sleep(timeout) => {
                    let moves = self.time_s() > before_s && !self.clock.stands();
                    if self.pace != Pace::OnDemand || !moves {
                        return Err(DeviceError::Timeout { device: device.into(), operation, after: timeout });
                    }
                }
            }
        }
    }

    /// True for a world that moves all the time, at its speed.
    pub fn is_paced(&self) -> bool {
        matches!(self.pace, Pace::Wall(_))
    }

    pub(crate) fn clock(&self) -> Arc<Clock> {
        self.clock.clone()
    }

    fn send(&self, job: Job) -> Result<(), WorldEnded> {
        self.jobs.send(job).map_err(|_| WorldEnded)
    }

    fn wake(&self) {
        // A world that has ended needs no waking.
        let _ended = self.send(Box::new(|_| ()));
    }
}

/// Where the answer to a device call goes; closed when the caller has dropped its future.
pub(crate) type Reply<R> = oneshot::Sender<Result<R, DeviceError>>;

/// What a caller hears of a world that has ended.
pub(crate) fn ended(device: &str) -> DeviceError {
    DeviceError::Disconnected { device: device.into(), detail: WorldEnded.to_string() }
}

/// The clock of a world stands still until this is dropped. Calls that need time go on then, or end with their
/// timeout (wall clock).
#[derive(Debug)]
pub struct Hold {
    clock: Arc<Clock>,
    jobs: Weak<Sender<Job>>,
}

impl Hold {
    /// Lets this many seconds go by and stops the clock again. Whoever was asked for something during this hold
    /// begins at its end, however late the caller's own thread comes to run.
    ///
    /// # Errors
    /// [`WorldEnded`].
    pub async fn go_on(self, seconds: f64) -> Result<Hold, WorldEnded> {
        let jobs = self.jobs.upgrade().ok_or(WorldEnded)?;
        let answer = hold_after(&self.clock, &jobs, seconds);
        drop((self, jobs));
        answer.await.map_err(|_| WorldEnded)
    }
}

/// Asks the world to stop its clock in this many seconds; a world that has ended drops the question.
fn hold_after(clock: &Arc<Clock>, jobs: &Arc<Sender<Job>>, seconds: f64) -> oneshot::Receiver<Hold> {
    let until_s = clock.now_s() + seconds.max(0.0);
    let (reply, answer) = oneshot::channel();
    let (clock, weak) = (clock.clone(), Arc::downgrade(jobs));
    let _ended = jobs
        .send(Box::new(move |stage| stage.start(HoldAt { until_s, reply: Some(reply), clock, jobs: weak })));
    answer
}

impl Drop for Hold {
    fn drop(&mut self) {
        self.clock.release();
        if let Some(jobs) = self.jobs.upgrade() {
            // A world that has ended needs no waking.
            let _ended = jobs.send(Box::new(|_| ()));
        }
    }
}

/// Stops the clock at a time.
struct HoldAt {
    until_s: f64,
    reply: Option<oneshot::Sender<Hold>>,
    clock: Arc<Clock>,
    jobs: Weak<Sender<Job>>,
}

impl Process for HoldAt {
    fn after_step(&mut self, world: &mut World) -> bool {
        if self.reply.as_ref().is_none_or(oneshot::Sender::is_closed) {
            return true;
        }
        if world.time_s() + 0.5 * world.settings().dt_s < self.until_s {
            return false;
        }
        if let Some(reply) = self.reply.take() {
            self.clock.hold();
            // Where nobody hears of it, the hold is dropped and ends.
            let _unheard = reply.send(Hold { clock: self.clock.clone(), jobs: self.jobs.clone() });
        }
        true
    }
}

/// Lets time go by.
struct Wait {
    until_s: f64,
    reply: Option<oneshot::Sender<()>>,
}

impl Process for Wait {
    fn after_step(&mut self, world: &mut World) -> bool {
        let abandoned = self.reply.as_ref().is_none_or(oneshot::Sender::is_closed);
        if abandoned {
            return true;
        }
        // Times are sums of steps: half a step is far more than their rounding.
        if world.time_s() + 0.5 * world.settings().dt_s < self.until_s {
            return false;
        }
        if let Some(reply) = self.reply.take() {
            let _unheard = reply.send(());
        }
        true
    }
}
