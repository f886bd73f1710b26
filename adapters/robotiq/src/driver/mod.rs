//! The task that owns the link.

mod exchange;
mod orders;
mod steps;

use std::time::Duration;

use graspd_adapters_core::{DeviceError, FaultKind, HandState};
use tokio::sync::mpsc;
use tokio::time::{Instant, MissedTickBehavior, interval};

pub(crate) use orders::{Order, Own, Together};
use steps::Running;

use crate::calibration::Actuators;
use crate::link::Link;
use crate::settings::RobotiqSettings;
use crate::wire::{Request, Status};

/// Looks at a gripper that does nothing: it reports a fault when nobody talks to it for a second.
const IDLE: Duration = Duration::from_millis(300);

/// What the task knows of the gripper.
pub(crate) struct Driver {
    settings: RobotiqSettings,
    actuators: Actuators,
    armed: bool,
    /// Open once a call needed it; gone when it broke.
    link: Option<Link>,
    /// As written last.
    request: Request,
    /// As read last, and when.
    status: Option<Status>,
    looked: Instant,
    running: Option<Running>,
}

impl Driver {
    pub(crate) fn new(settings: RobotiqSettings, actuators: Actuators) -> Self {
        Self {
            armed: settings.armed,
            settings,
            actuators,
            link: None,
            request: Request::default(),
            status: None,
            looked: Instant::now(),
            running: None,
        }
    }

    /// Obeys orders, and looks at the gripper, until nobody can give orders any more.
    pub(crate) async fn run(mut self, mut orders: mpsc::Receiver<Order>) {
        let mut ticks = interval(Duration::from_secs_f64(1.0 / self.settings.poll_hz));
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                biased;
                order = orders.recv() => match order {
                    Some(order) => self.obey(order).await,
                    None => break,
                },
                _ = ticks.tick(), if self.running.is_some() || self.link.is_some() => {
                    if self.running.is_some() { self.tick().await } else { self.idle().await }
                }
            }
        }
        if self.running.is_some() {
            // Nobody is left to be told that it failed.
            let _stopped = self.halt().await;
        }
    }

    /// Keeps the gripper from thinking that it is alone, and notes when an object is lost.
    async fn idle(&mut self) {
        if self.looked.elapsed() < IDLE {
            return;
        }
        if let Err(error) = self.look().await {
            tracing::debug!(device = self.settings.name, %error, "a look at the idle gripper failed");
        }
    }

    fn device(&self) -> String {
        self.settings.name.clone()
    }

    fn stopped(&self, kind: FaultKind, detail: impl Into<String>) -> DeviceError {
        DeviceError::Fault { device: self.device(), kind, detail: detail.into() }
    }

    /// What a caller is told of a status.
    fn state_of(&self, status: &Status) -> HandState {
        let motions: Vec<_> = status.axes.iter().map(|a| a.motion).collect();
        let motions = self.actuators.in_order(&motions);
        let goes = status.goes && self.taken(status);
        let moving = goes && motions.contains(&crate::wire::Motion::Moving);
        HandState {
            actuators: self.actuators.values(&status.axes),
            held: motions.iter().map(|m| goes && !moving && m.is_held()).collect(),
            settled: !moving && self.running.is_none(),
        }
    }

    /// True when a status is about the request that was written last.
    fn taken(&self, status: &Status) -> bool {
        // Fingers that move as one are asked through the first of them. What the others then echo is their own request, which
        // nothing obeys, or that of the first: the register table leaves it open.
        let own = if self.request.individual { status.axes.len() } else { 1 };
        status
            .axes
            .iter()
            .zip(&self.request.axes)
            .take(own)
            .all(|(axis, asked)| axis.requested == asked.position)
    }
}
