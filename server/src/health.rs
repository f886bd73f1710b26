//! Health as grpc.health.v1 and `/readyz` tell it: the server, each service, and each hand as `hand/NAME`.
//!
//! One that lets others plan is ready while they are there. A server is ready when it has planned: before it listens it reads a small scene and searches a grasp in it, with the
//! default estimator. If that fails it says so and tries again. A hand whose jobs crash several times in a row is
//! NOT_SERVING until one of them ends well; its calls are planned all the same, that is how it recovers.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use graspd_hands::{Hand, library};
use graspd_planner::budget::Budget;
use graspd_planner::frame::{DepthImage, Frame, Intrinsics};
use graspd_planner::options::{PlanOptions, SceneOptions, Scheme};
use graspd_planner::{plan, scene};
use tonic_health::ServingStatus;
use tonic_health::server::HealthReporter;

use crate::caller::Caller;
use crate::deadline::CallBudget;
use crate::engine::Engine;
use crate::jobs::Presence;
use crate::pool::Order;

/// Services that are ready when the server is.
const SERVICES: [&str; 5] = [
    "",
    "graspd.v1.PlannerService",
    "graspd.v1.ServoService",
    "graspd.v1.HandService",
    "graspd.v1.InfoService",
];
/// Those that are worth nothing without whoever plans elsewhere.
const NEED_PLANS: [&str; 2] = ["", "graspd.v1.PlannerService"];
/// Jobs of one hand that crash one after the other before the hand is not well.
const CRASHES: u32 = 3;
/// A first plan that takes longer is none.
const PATIENCE: Duration = Duration::from_secs(60);
/// Hands whose crashes are counted.
const MOST_HANDS: usize = 1024;

/// Who is well.
#[derive(Debug, Default)]
pub(crate) struct Health {
    reporter: HealthReporter,
    /// The server has planned.
    warm: AtomicBool,
    draining: Arc<AtomicBool>,
    /// Why whoever plans elsewhere cannot now.
    elsewhere: Mutex<Option<&'static str>>,
    /// Jobs that crashed since the last one that did not, by hand.
    crashes: Mutex<BTreeMap<String, u32>>,
}

/// The name of a hand in the health service.
fn name_of(hand: &str) -> String {
    format!("hand/{hand}")
}

impl Health {
    /// What answers in the health service.
    pub(crate) fn reporter(&self) -> &HealthReporter {
        &self.reporter
    }

    /// Set when the server drains.
    pub(crate) fn draining(&self) -> &Arc<AtomicBool> {
        &self.draining
    }

    /// True while calls are taken and planning works.
    pub(crate) fn is_ready(&self) -> bool {
        self.is_well_here() && self.elsewhere().is_none()
    }

    /// True once this process has planned.
    pub(crate) fn is_warm(&self) -> bool {
        self.warm.load(Ordering::Relaxed)
    }

    /// True while calls are taken and planning works in this process, which is what servo streams need.
    fn is_well_here(&self) -> bool {
        self.is_warm() && !self.draining.load(Ordering::Relaxed)
    }

    /// Why the server is not ready, in a word.
    pub(crate) fn why_not(&self) -> &'static str {
        match *self.elsewhere() {
            _ if self.draining.load(Ordering::Relaxed) => "draining",
            _ if !self.is_warm() => "the first plan has failed so far",
            Some(why) => why,
            None => "ready",
        }
    }

    /// How whoever plans elsewhere is now; true if that is news.
    pub(crate) fn set_elsewhere(&self, presence: &Presence) -> bool {
        let why = match presence {
            Presence { is_here: false, .. } => Some("the broker is away"),
            Presence { workers: 0, .. } => Some("no worker is there"),
            _ => None,
        };
        std::mem::replace(&mut *self.elsewhere(), why) != why
    }

    fn elsewhere(&self) -> std::sync::MutexGuard<'_, Option<&'static str>> {
        self.elsewhere.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tells the health service how the server is, with these hands.
    pub(crate) async fn tell(&self, hands: Vec<String>) {
        for service in SERVICES {
            let well = if NEED_PLANS.contains(&service) { self.is_ready() } else { self.is_well_here() };
            let status = if well { ServingStatus::Serving } else { ServingStatus::NotServing };
            self.reporter.set_service_status(service, status).await;
        }
        for hand in hands {
            let well = self.is_ready() && self.count(&hand) < CRASHES;
            self.tell_hand(&hand, well).await;
        }
    }

    /// A hand has come.
    pub(crate) async fn hand_created(&self, hand: &str) {
        self.crashes().remove(hand);
        self.tell_hand(hand, self.is_ready()).await;
    }

    /// A hand has gone.
    pub(crate) async fn hand_deleted(&self, hand: &str) {
        self.crashes().remove(hand);
        // Whoever watches hears of it; whoever asks is told that there is none.
        self.tell_hand(hand, false).await;
        self.reporter.clone().clear_service_status(&name_of(hand)).await;
    }

    /// A job of a hand has ended without crashing.
    pub(crate) async fn planned(&self, hand: &str) {
        let before = self.crashes().remove(hand);
        if before.is_some_and(|crashes| crashes >= CRASHES) {
            tracing::info!(hand, "planning for the hand works again");
            self.tell_hand(hand, self.is_ready()).await;
        }
    }

    /// A job of a hand has crashed.
    pub(crate) async fn crashed(&self, hand: &str) {
        let count = {
            let mut crashes = self.crashes();
            if crashes.len() >= MOST_HANDS && !crashes.contains_key(hand) {
                return;
            }
            let count = crashes.entry(hand.to_owned()).or_default();
            *count = count.saturating_add(1);
            *count
        };
        if count == CRASHES {
            tracing::error!(hand, crashes = count, "planning for the hand crashes every time");
            self.tell_hand(hand, false).await;
        }
    }

    async fn tell_hand(&self, hand: &str, well: bool) {
        let status = if well { ServingStatus::Serving } else { ServingStatus::NotServing };
        self.reporter.set_service_status(name_of(hand), status).await;
    }

    fn count(&self, hand: &str) -> u32 {
        self.crashes().get(hand).copied().unwrap_or_default()
    }

    fn crashes(&self) -> std::sync::MutexGuard<'_, BTreeMap<String, u32>> {
        self.crashes.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Engine {
    /// Plans once in a small scene, on a planning thread, with the default estimator. True if that works.
    pub(crate) async fn warm_up(&self) -> bool {
        let estimator = match self.estimators.get(None) {
            Ok(estimator) => estimator,
            Err(error) => {
                tracing::error!(%error, "the first plan failed");
                return false;
            }
        };
        let now = std::time::Instant::now();
        let budget = CallBudget::new(now, now.checked_add(PATIENCE)).abort_with(&self.aborted);
        let _cancel = budget.cancel_on_drop();
        let (job_budget, hand) = (budget.clone(), library::ids().iter().find_map(|id| library::hand(id)));
        let order = Order::brief(Caller::named("the first plan").flow);
        let job = move |_| first_plan(estimator.as_ref(), hand, &job_budget);
        let done = match self.pool.submit(&budget, &order, None, job) {
            Ok(ticket) => self.finish(&budget, ticket).await,
            Err(error) => Err(error),
        };
        match done.map_err(|error| error.to_string()).and_then(|planned| planned) {
            Ok(()) => {
                tracing::info!(took_ms = now.elapsed().as_secs_f64() * 1e3, "planned once: ready");
                self.health.warm.store(true, Ordering::Relaxed);
                true
            }
            Err(error) => {
                tracing::error!(%error, "the first plan failed");
                false
            }
        }
    }

    /// Tries to plan until it works; the health service says when it does.
    pub(crate) async fn warm_up_in_the_end(&self) {
        while !self.health.is_warm() {
            tokio::time::sleep(Duration::from_secs(2)).await;
            if self.warm_up().await {
                self.health.tell(self.registry.ids()).await;
            }
        }
    }
}

/// Everything that a call goes through, as small as it can be: a block on a table, seen from above.
fn first_plan(
    estimator: &dyn graspd_planner::estimator::ContactEstimator,
    hand: Option<&Hand>,
    budget: &dyn Budget,
) -> Result<(), String> {
    let (width, height) = (80usize, 60usize);
    let depth = |i: usize| {
        let (row, column) = (i / width, i % width);
        if (22..38).contains(&row) && (32..48).contains(&column) { 0.45 } else { 0.5 }
    };
    let image = DepthImage { width, height, depth_m: (0..width * height).map(depth).collect() };
    let intrinsics = Intrinsics { fx_px: 80.0, fy_px: 80.0, cx_px: 39.5, cy_px: 29.5, distortion: [0.0; 8] };
    let frame = Frame { image, intrinsics, world_from_camera: None, labels: None };
    let scene = scene::prepare(&[frame], &SceneOptions::default(), estimator, budget);
    let scene = scene.map_err(|error| error.to_string())?;
    let scheme = Scheme { iterations: 5, with_penetration: 2 };
    let options = PlanOptions { batch: 8, scheme, ..PlanOptions::default() };
    match hand.and_then(|hand| plan::plan(&scene, hand, &options, budget, None).stats.stopped) {
        None => Ok(()),
        Some(stop) => Err(format!("stopped: {stop:?}")),
    }
}
