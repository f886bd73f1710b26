//! What the server counts and times, in the OpenMetrics format.

use std::sync::Mutex;
use std::sync::PoisonError;
use std::time::Duration;

use graspd_live::Counts;
use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::registry::Registry;

use crate::jobs::Presence;
use crate::pool::{Pool, Priority};

/// Seconds, from a millisecond to a minute.
const BUCKETS: [f64; 16] =
    [0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.175, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0];

#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
struct Call {
    method: &'static str,
    code: &'static str,
}

#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
struct Method {
    method: &'static str,
}

#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
struct Reason {
    reason: &'static str,
}

#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
struct Outcome {
    outcome: &'static str,
}

#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
struct Stage {
    stage: &'static str,
}

#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
struct ByPriority {
    priority: &'static str,
}

#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
struct EngineJobs {
    priority: &'static str,
    state: &'static str,
}

/// No label: a series that is only there where it says something.
#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
struct Alone {}

#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
struct Within {
    at_most_milliseconds: &'static str,
}

#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
struct Plan {
    hand: String,
    outcome: &'static str,
}

type Times<L> = Family<L, Histogram, fn() -> Histogram>;

fn times() -> Histogram {
    Histogram::new(BUCKETS)
}

/// How a plan ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum PlanOutcome {
    Grasps,
    NoGrasp,
    Failed,
}

/// What became of something that was to be recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum RecordOutcome {
    Written,
    /// There was no place for it.
    Dropped,
    Failed,
}

/// All metrics of a server.
#[derive(Debug)]
pub(crate) struct Metrics {
    registry: Mutex<Registry>,
    calls: Family<Call, Counter>,
    call_seconds: Times<Method>,
    in_flight: Gauge,
    refused: Family<Reason, Counter>,
    stage_seconds: Times<Stage>,
    queue_seconds: Times<ByPriority>,
    plans: Family<Plan, Counter>,
    servo_frames: Family<Outcome, Counter>,
    servo_frame_seconds: Histogram,
    servo_streams: Gauge,
    queue_depth: Family<ByPriority, Gauge>,
    running: Gauge,
    slots: Gauge,
    scene_room: Gauge,
    scenes_read: Gauge,
    slowest_release_ms: Gauge,
    releases: Family<Within, Gauge>,
    records: Family<Outcome, Counter>,
    recording_bytes: Gauge,
    live_clients: Gauge,
    live: Family<Outcome, Counter>,
    ready: Gauge,
    engine_connected: Family<Alone, Gauge>,
    engine_workers: Family<Alone, Gauge>,
    engine_slots: Family<Alone, Gauge>,
    engine_jobs: Family<EngineJobs, Gauge>,
    engine_redelivered: Family<Alone, Gauge>,
    engine_reconnects: Family<Alone, Gauge>,
}

impl Default for Metrics {
    fn default() -> Self {
        let metrics = Self {
            registry: Mutex::default(),
            calls: Family::default(),
            call_seconds: Family::new_with_constructor(times),
            in_flight: Gauge::default(),
            refused: Family::default(),
            stage_seconds: Family::new_with_constructor(times),
            queue_seconds: Family::new_with_constructor(times),
            plans: Family::default(),
            servo_frames: Family::default(),
            servo_frame_seconds: times(),
            servo_streams: Gauge::default(),
            queue_depth: Family::default(),
            running: Gauge::default(),
            slots: Gauge::default(),
            scene_room: Gauge::default(),
            scenes_read: Gauge::default(),
            slowest_release_ms: Gauge::default(),
            releases: Family::default(),
            records: Family::default(),
            recording_bytes: Gauge::default(),
            live_clients: Gauge::default(),
            live: Family::default(),
            ready: Gauge::default(),
            engine_connected: Family::default(),
            engine_workers: Family::default(),
            engine_slots: Family::default(),
            engine_jobs: Family::default(),
            engine_redelivered: Family::default(),
            engine_reconnects: Family::default(),
        };
        let mut registry = Registry::with_prefix("graspd");
        registry.register("calls", "Calls that ended, by method and code", metrics.calls.clone());
        registry.register(
            "call_duration_seconds",
            "From the headers of a call to the end of its answer",
            metrics.call_seconds.clone(),
        );
        registry.register("calls_in_flight", "Calls that have not ended", metrics.in_flight.clone());
        registry.register("calls_refused", "Calls that were refused, by reason", metrics.refused.clone());
        registry.register(
            "stage_duration_seconds",
            "Stages of reading scenes and of searching grasps",
            metrics.stage_seconds.clone(),
        );
        registry.register(
            "queue_duration_seconds",
            "Time that jobs waited before they began, by priority",
            metrics.queue_seconds.clone(),
        );
        registry.register("plans", "Plans that ended, by hand and outcome", metrics.plans.clone());
        registry.register(
            "servo_frames",
            "Frames of servo streams, by what became of them",
            metrics.servo_frames.clone(),
        );
        registry.register(
            "servo_frame_seconds",
            "From the arrival of a servo's frame to its answer",
            metrics.servo_frame_seconds.clone(),
        );
        registry.register(
            "servo_streams",
            "Servo streams that have not ended",
            metrics.servo_streams.clone(),
        );
        registry.register("queue_depth", "Jobs that wait, by priority", metrics.queue_depth.clone());
        registry.register("jobs_running", "Jobs that run", metrics.running.clone());
        registry.register("slots", "Jobs that can run at the same time", metrics.slots.clone());
        registry.register("scene_room_taken", "Room that scenes take in memory", metrics.scene_room.clone());
        registry.register(
            "scenes_read",
            "Scenes that were read since the start",
            metrics.scenes_read.clone(),
        );
        registry.register(
            "slowest_release_milliseconds",
            "The longest that a job ran on after its call was dropped",
            metrics.slowest_release_ms.clone(),
        );
        registry.register(
            "releases",
            "Jobs that ran when their call was dropped, by the milliseconds that they ran on at most",
            metrics.releases.clone(),
        );
        registry.register(
            "records",
            "Calls and outcomes that were to be recorded, by what became of that",
            metrics.records.clone(),
        );
        registry.register("recording_bytes", "Disk space of the recording", metrics.recording_bytes.clone());
        registry.register(
            "live_clients",
            "Viewers that are connected to the live view",
            metrics.live_clients.clone(),
        );
        registry.register("live", "What the live view has done, by what became of it", metrics.live.clone());
        registry.register("ready", "1 while calls are taken", metrics.ready.clone());
        let several = &metrics;
        registry.register(
            "engine_connected",
            "1 while the broker can be talked to; only with --engine, as all that begins with engine_",
            several.engine_connected.clone(),
        );
        registry.register("engine_workers", "Workers that are there", several.engine_workers.clone());
        registry.register(
            "engine_slots",
            "Jobs that all workers plan at the same time",
            several.engine_slots.clone(),
        );
        registry.register(
            "engine_jobs",
            "Jobs by priority: at this front before the broker, in the broker, at workers",
            several.engine_jobs.clone(),
        );
        registry.register(
            "engine_redelivered",
            "Jobs of this front that another worker had to begin again, since the start",
            several.engine_redelivered.clone(),
        );
        registry.register(
            "engine_reconnects",
            "How often the broker was lost and found again, since the start",
            several.engine_reconnects.clone(),
        );
        Self { registry: Mutex::new(registry), ..metrics }
    }
}

impl Metrics {
    /// A call begins; how it ends is told to what this returns.
    pub(crate) fn begin(&self) {
        self.in_flight.inc();
    }

    /// A call has ended.
    pub(crate) fn end(&self, path: &str, code: tonic::Code, took: Duration) {
        let method = method(path);
        self.in_flight.dec();
        self.calls.get_or_create(&Call { method, code: code_name(code) }).inc();
        self.call_seconds.get_or_create(&Method { method }).observe(took.as_secs_f64());
    }

    /// A call was refused for a reason of load.
    pub(crate) fn refuse(&self, reason: &'static str) {
        self.refused.get_or_create(&Reason { reason }).inc();
    }

    /// Stages have ended.
    pub(crate) fn stages<'a>(&self, stages: impl IntoIterator<Item = &'a (&'static str, Duration)>) {
        for (stage, took) in stages {
            self.stage_seconds.get_or_create(&Stage { stage }).observe(took.as_secs_f64());
        }
    }

    /// A job has begun after so long.
    pub(crate) fn queued(&self, priority: Priority, waited: Duration) {
        let label = ByPriority { priority: priority.name() };
        self.queue_seconds.get_or_create(&label).observe(waited.as_secs_f64());
    }

    /// A plan has ended.
    pub(crate) fn plan(&self, hand: &str, outcome: PlanOutcome) {
        let outcome = match outcome {
            PlanOutcome::Grasps => "grasps",
            PlanOutcome::NoGrasp => "no_grasp",
            PlanOutcome::Failed => "failed",
        };
        self.plans.get_or_create(&Plan { hand: hand.to_owned(), outcome }).inc();
    }

    /// Something was to be recorded.
    pub(crate) fn recorded(&self, outcome: RecordOutcome) {
        let outcome = match outcome {
            RecordOutcome::Written => "written",
            RecordOutcome::Dropped => "dropped",
            RecordOutcome::Failed => "failed",
        };
        self.records.get_or_create(&Outcome { outcome }).inc();
    }

    /// The recording takes so much.
    pub(crate) fn recording_bytes(&self, bytes: u64) {
        self.recording_bytes.set(i64::try_from(bytes).unwrap_or(i64::MAX));
    }

    /// A servo stream begins, or ends.
    pub(crate) fn servo_stream(&self, begins: bool) {
        self.servo_streams.inc_by(if begins { 1 } else { -1 });
    }

    /// A frame of a servo stream was answered after so long.
    pub(crate) fn servo_answered(&self, age: Duration) {
        self.servo_frame_seconds.observe(age.as_secs_f64());
    }

    /// This became of so many frames of servo streams.
    pub(crate) fn servo_frames(&self, outcome: &'static str, count: u64) {
        if count > 0 {
            self.servo_frames.get_or_create(&Outcome { outcome }).inc_by(count);
        }
    }

    /// The live view has counted so much. One at a time.
    fn live(&self, counts: &Counts) {
        self.live_clients.set(i64::try_from(counts.clients).unwrap_or(i64::MAX));
        let outcomes = [
            ("picture_drawn", counts.drawn),
            ("picture_superseded", counts.superseded),
            ("message_sent", counts.sent),
            ("message_dropped", counts.dropped),
            ("connection_refused", counts.refused),
            ("viewer_put_out", counts.put_out),
        ];
        for (outcome, count) in outcomes {
            let counter = self.live.get_or_create(&Outcome { outcome });
            counter.inc_by(count.saturating_sub(counter.get()));
        }
    }

    /// How whoever plans elsewhere is, and calls that wait before it, by priority.
    pub(crate) fn elsewhere(&self, presence: &Presence, here: [usize; 4]) {
        let set = |family: &Family<Alone, Gauge>, n: u64| {
            family.get_or_create(&Alone {}).set(i64::try_from(n).unwrap_or(i64::MAX));
        };
        set(&self.engine_connected, u64::from(presence.is_here));
        set(&self.engine_workers, presence.workers as u64);
        set(&self.engine_slots, presence.slots as u64);
        set(&self.engine_redelivered, presence.redelivered);
        set(&self.engine_reconnects, presence.reconnects);
        for (state, counts) in [("front", here), ("broker", presence.waiting), ("worker", presence.running)] {
            for (priority, count) in Priority::ALL.iter().zip(counts) {
                let labels = EngineJobs { priority: priority.name(), state };
                self.engine_jobs.get_or_create(&labels).set(i64::try_from(count).unwrap_or(i64::MAX));
            }
        }
    }

    /// Everything as text, with what the pool does right now.
    pub(crate) fn encode(&self, pool: &Pool, scenes_read: u64, ready: bool, live: Option<Counts>) -> String {
        let as_gauge = |n: usize| i64::try_from(n).unwrap_or(i64::MAX);
        for (priority, waiting) in Priority::ALL.iter().zip(pool.waiting_by_priority()) {
            self.queue_depth.get_or_create(&ByPriority { priority: priority.name() }).set(as_gauge(waiting));
        }
        self.running.set(as_gauge(pool.running()));
        self.slots.set(as_gauge(pool.config().slots.max(1) + pool.config().servo_slots));
        self.scene_room.set(as_gauge(pool.scene_room_taken()));
        self.scenes_read.set(i64::try_from(scenes_read).unwrap_or(i64::MAX));
        self.slowest_release_ms.set(i64::try_from(pool.slowest_release().as_millis()).unwrap_or(i64::MAX));
        for (at_most, count) in pool.releases() {
            let label = Within { at_most_milliseconds: at_most };
            self.releases.get_or_create(&label).set(i64::try_from(count).unwrap_or(i64::MAX));
        }
        self.ready.set(i64::from(ready));
        let mut text = String::new();
        let registry = self.registry.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(counts) = &live {
            self.live(counts);
        }
        // Writing to a string cannot fail.
        prometheus_client::encoding::text::encode(&mut text, &registry).ok();
        text
    }
}

/// A method as a label: those that there are, and one name for all others, so that nobody makes labels.
fn method(path: &str) -> &'static str {
    const KNOWN: [&str; 12] = [
        "/graspd.v1.PlannerService/PlanGrasps",
        "/graspd.v1.PlannerService/StreamGrasps",
        "/graspd.v1.PlannerService/PlanMultiHand",
        "/graspd.v1.PlannerService/ReadScene",
        "/graspd.v1.PlannerService/ReportOutcome",
        "/graspd.v1.ServoService/ServoGrasp",
        "/graspd.v1.HandService/ListHands",
        "/graspd.v1.HandService/GetHand",
        "/graspd.v1.HandService/GetHandGeometry",
        "/graspd.v1.HandService/CreateHand",
        "/graspd.v1.HandService/DeleteHand",
        "/graspd.v1.InfoService/GetServerInfo",
    ];
    let known = KNOWN.into_iter().find(|known| *known == path);
    known.and_then(|path| path.rsplit('/').next()).unwrap_or("other")
}

fn code_name(code: tonic::Code) -> &'static str {
    use tonic::Code;
    match code {
        Code::Ok => "OK",
        Code::Cancelled => "CANCELLED",
        Code::Unknown => "UNKNOWN",
        Code::InvalidArgument => "INVALID_ARGUMENT",
        Code::DeadlineExceeded => "DEADLINE_EXCEEDED",
        Code::NotFound => "NOT_FOUND",
        Code::AlreadyExists => "ALREADY_EXISTS",
        Code::PermissionDenied => "PERMISSION_DENIED",
        Code::ResourceExhausted => "RESOURCE_EXHAUSTED",
        Code::FailedPrecondition => "FAILED_PRECONDITION",
        Code::Aborted => "ABORTED",
        Code::OutOfRange => "OUT_OF_RANGE",
        Code::Unimplemented => "UNIMPLEMENTED",
        Code::Internal => "INTERNAL",
        Code::Unavailable => "UNAVAILABLE",
        Code::DataLoss => "DATA_LOSS",
        Code::Unauthenticated => "UNAUTHENTICATED",
    }
}

#[cfg(test)]
mod tests;
