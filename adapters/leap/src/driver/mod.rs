//! The task that owns the serial line.

mod bring_up;
mod health;
mod orders;
mod tick;

use std::time::Duration;

use graspd_adapters_core::{DeviceError, FaultKind, HandState};
use tokio::sync::mpsc;
use tokio::time::{Instant, MissedTickBehavior, interval};

use graspd_adapters_core::task::{Patience, Reply};
pub(crate) use orders::{Joints, Order};

use crate::bus::{Bus, BusError};
use crate::joints::Joint;
use crate::motion::{Bounds, Motion, Reading, RestWatch};
use crate::settings::LeapSettings;

/// A motion that runs, and who waits for its end.
struct Running {
    motion: Motion,
    operation: &'static str,
    patience: Patience,
    reply: Reply<HandState>,
}

/// What the task knows of the hand.
pub(crate) struct Driver {
    settings: LeapSettings,
    ids: Vec<u8>,
    started: Instant,
    armed: bool,
    /// Open once a call needed it; gone when it broke.
    bus: Option<Bus>,
    /// True while motors hold their goals and their watchdog waits for us.
    energized: bool,
    /// When they were sent what they have heard last.
    fed: Instant,
    /// True when the motors may have heard nothing for so long that their watchdog has stopped them.
    suspect: bool,
    readings: Vec<Reading>,
    rest: RestWatch,
    resting: bool,
    /// Where the motors were last told to go, radians; `None` before the first motion.
    goals: Option<Vec<f64>>,
    bounds: Bounds,
    running: Option<Running>,
    /// Callers that wait for the next reading.
    waiting: Vec<Reply<HandState>>,
    /// What stopped the hand, until it is cleared.
    fault: Option<(FaultKind, String)>,
    /// Exchanges until temperatures are read again.
    until_supply: u32,
}

impl Driver {
    pub(crate) fn new(settings: LeapSettings) -> Self {
        let now = Instant::now();
        let bounds = Bounds {
            speed_rad_s: settings.max_speed_rad_s,
            acceleration_rad_s2: settings.max_acceleration_rad_s2,
            current_ma: settings.current_ma(),
            held_rad: settings.held_rad,
        };
        Self {
            ids: settings.joints.iter().map(|j| j.id).collect(),
            armed: settings.armed,
            settings,
            started: now,
            bus: None,
            energized: false,
            fed: now,
            suspect: false,
            readings: Vec::new(),
            rest: RestWatch::new(),
            resting: false,
            goals: None,
            bounds,
            running: None,
            waiting: Vec::new(),
            fault: None,
            until_supply: 0,
        }
    }

    /// Obeys orders, and talks to the motors while they hold, until nobody can give orders any more.
    pub(crate) async fn run(mut self, mut orders: mpsc::Receiver<Order>) {
        let mut ticks = interval(Duration::from_secs_f64(1.0 / self.settings.rate_hz));
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                biased;
                order = orders.recv() => match order {
                    Some(order) => self.obey(order).await,
                    None => break,
                },
                _ = ticks.tick(), if self.energized => self.tick().await,
            }
        }
        if self.energized {
            // Whatever fails here, the motors' watchdog does the same a moment later.
            let _held = self.hold().await;
        }
    }

    /// Time since the task began, as motions count it.
    fn now(&self) -> Duration {
        self.started.elapsed()
    }

    fn device(&self) -> String {
        self.settings.name.clone()
    }

    /// The line, opened and its motors known.
    async fn bus(&mut self) -> Result<&mut Bus, DeviceError> {
        if self.bus.is_none() {
            self.connect().await?;
        }
        let closed = self.disconnected("the line closed");
        self.bus.as_mut().ok_or(closed)
    }

    /// An exchange failed for good: the next call begins with a new connection. Motors that still hear and
    /// move are stopped; the others stop by their watchdog.
    async fn lose(&mut self, error: BusError) -> DeviceError {
        let failed = self.explain(error).await;
        // Fingers that rest on something keep pressing: told to be where they are, they would let go of it.
        if self.energized && self.running.is_some() {
            let _held = self.hold().await;
        }
        self.abandon(&failed);
        failed
    }

    /// Gives the line up: nobody may wait for what will not come over it.
    fn abandon(&mut self, error: &DeviceError) {
        self.bus = None;
        self.energized = false;
        for reply in self.waiting.drain(..) {
            let _unheard = reply.send(Err(error.clone()));
        }
        self.finish(Err(error.clone()));
    }

    /// A caller's words for an exchange that failed: which motors are silent, by name.
    async fn explain(&mut self, error: BusError) -> DeviceError {
        let BusError::NoReply { ids, broken, .. } = &error else {
            return match &error {
                BusError::Open { .. } | BusError::Lost { .. } => self.disconnected(error.to_string()),
                _ => DeviceError::Protocol { device: self.device(), detail: error.to_string() },
            };
        };
        let mut silent = Vec::new();
        for id in ids {
            // One of them may be the reason why the others were not heard.
            let Some(bus) = &mut self.bus else { break };
            match bus.answers(*id).await {
                Ok(true) => {}
                Ok(false) => silent.push(self.motor(*id)),
                Err(lost) => return self.disconnected(lost.to_string()),
            }
        }
        if silent.is_empty() {
            return self
                .disconnected(format!("a disturbed line, though every motor answers alone: {broken}"));
        }
        self.disconnected(self.silence(&silent, broken))
    }

    fn silence(&self, silent: &[String], broken: &impl std::fmt::Display) -> String {
        let all = self.ids.len();
        let count = silent.len();
        if count == all {
            let (port, baud) = (&self.settings.port, self.settings.baud);
            return format!(
                "none of {all} motors answers on {port} at {baud} baud ({broken}): power, cable, baud rate?"
            );
        }
        format!(
            "{} of {all} motors do not answer: {} ({broken}): cable, power, address?",
            count,
            silent.join(", ")
        )
    }

    /// A motor as people know it.
    fn motor(&self, id: u8) -> String {
        let joint = self.joint(id);
        joint.map_or_else(|| format!("motor {id}"), |j| format!("motor {id} ({})", j.actuator))
    }

    fn joint(&self, id: u8) -> Option<&Joint> {
        self.settings.joints.iter().find(|j| j.id == id)
    }

    fn disconnected(&self, detail: impl Into<String>) -> DeviceError {
        DeviceError::Disconnected { device: self.device(), detail: detail.into() }
    }

    fn stopped(&self, kind: FaultKind, detail: impl Into<String>) -> DeviceError {
        DeviceError::Fault { device: self.device(), kind, detail: detail.into() }
    }

    /// What a caller is told of the last reading.
    fn report(&self) -> HandState {
        let actuators = self.readings.iter().map(|r| r.position_rad).collect();
        let held = match &self.goals {
            Some(goals) if self.resting && self.running.is_none() => {
                crate::motion::held(goals, &self.readings, &self.bounds)
            }
            _ => vec![false; self.readings.len()],
        };
        HandState { actuators, held, settled: self.resting && self.running.is_none() }
    }
}
