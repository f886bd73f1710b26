//! Records calls off the planning path: which calls, how much of them may be held at the same time, and the thread
//! that writes them.
//!
//! A call that is to be recorded takes its place when it begins and keeps it until it is written. Where there is no
//! place, because the disk is slower than the calls, it is not recorded and that is counted; it is planned as any
//! other.

mod plans;

use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use graspd_proto::v1;
use graspd_recording::{Bundle, Folder, FolderError, PlanId};
use tokio::sync::oneshot;

use crate::call_record::CallRecord;
use crate::error::ServiceError;
use crate::metrics::{Metrics, RecordOutcome};
use crate::picture;
use plans::Plans;

/// Calls that may be held for the recording at the same time.
const MOST_CALLS: usize = 64;
/// Bytes of requests that may be held for it.
const MOST_BYTES: usize = 256 << 20;

/// What is recorded, and where.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordConfig {
    /// Folder of the files.
    pub folder: PathBuf,
    /// Share of calls that are recorded without being asked to, 0 to 1.
    pub share: f64,
    /// Disk space that the files may take, bytes.
    pub budget_bytes: u64,
}

/// The recording of a server.
#[derive(Debug)]
pub(crate) struct Recorder {
    share: f64,
    folder: PathBuf,
    held: Arc<Held>,
    /// None once the recording has ended.
    work: Mutex<Option<Sender<Work>>>,
    writer: Mutex<Option<JoinHandle<()>>>,
    plans: Plans,
    metrics: Arc<Metrics>,
}

enum Work {
    Call(Box<CallRecord>),
    Outcome(Box<v1::OutcomeRecord>, oneshot::Sender<bool>),
}

/// Places that are taken.
#[derive(Debug, Default)]
struct Held {
    calls: AtomicUsize,
    bytes: AtomicUsize,
}

/// The place of a call; given back when it is dropped.
#[derive(Debug)]
pub(crate) struct Place {
    held: Arc<Held>,
    bytes: usize,
}

impl Place {
    fn take(held: &Arc<Held>, bytes: usize) -> Option<Self> {
        let place = Self { held: Arc::clone(held), bytes };
        let calls = held.calls.fetch_add(1, Ordering::Relaxed) + 1;
        let total = held.bytes.fetch_add(bytes, Ordering::Relaxed) + bytes;
        // Dropping the place gives back what was too much.
        (calls <= MOST_CALLS && total <= MOST_BYTES).then_some(place)
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.held.calls.fetch_sub(1, Ordering::Relaxed);
        self.held.bytes.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

impl Recorder {
    /// Opens the folder and starts the thread that writes.
    pub(crate) fn start(config: &RecordConfig, metrics: Arc<Metrics>) -> Result<Self, FolderError> {
        let (folder, opened) = Folder::open(&config.folder, config.budget_bytes)?;
        tracing::info!(
            folder = %config.folder.display(),
            share = config.share,
            budget_bytes = config.budget_bytes,
            files = opened.files,
            repaired = opened.repaired,
            "recording"
        );
        let (sender, receiver) = channel();
        let counted = Arc::clone(&metrics);
        let writer = std::thread::Builder::new()
            .name("record".to_owned())
            .spawn(move || write(folder, &receiver, &counted))
            .map_err(|source| FolderError::Io { path: config.folder.clone(), source })?;
        Ok(Self {
            share: config.share,
            folder: config.folder.clone(),
            held: Arc::default(),
            work: Mutex::new(Some(sender)),
            writer: Mutex::new(Some(writer)),
            plans: Plans::default(),
            metrics,
        })
    }

    /// True if a call is to be recorded: because it asks for it, or by its share.
    pub(crate) fn wants(&self, asked: bool) -> bool {
        asked || crate::random::unit() < self.share
    }

    /// A place for a request of so many bytes, if there is one.
    pub(crate) fn place(&self, bytes: usize) -> Option<Place> {
        let place = Place::take(&self.held, bytes);
        if place.is_none() {
            self.metrics.recorded(RecordOutcome::Dropped);
        }
        place
    }

    /// A call has ended: hands it to the thread that writes.
    pub(crate) fn finish(&self, call: CallRecord) {
        self.send(Work::Call(Box::new(call)));
    }

    /// A plan was answered: outcomes may be reported for it.
    pub(crate) fn remember(&self, answer: &v1::PlanGraspsResponse) {
        self.plans.remember(answer);
    }

    /// Keeps what became of a grasp; true if the same was reported before. Returns when it is written.
    pub(crate) async fn report(&self, report: v1::ReportOutcomeRequest) -> Result<bool, ServiceError> {
        let unknown = || ServiceError::UnknownPlan { id: report.plan_id.clone() };
        let id = PlanId::parse(&report.plan_id).ok_or_else(unknown)?;
        let plan = match self.plans.get(id) {
            Some(plan) => plan,
            None => self.plans.look_for(id, &self.folder).await?.ok_or_else(unknown)?,
        };
        let score = usize::try_from(report.grasp_index).ok().and_then(|i| plan.scores.get(i).copied());
        let Some((uncalibrated_score, score)) = score else {
            return Err(crate::error::FieldError::value(
                "grasp_index",
                report.grasp_index,
                format!("an index into the {} grasps of the plan", plan.scores.len()),
            )
            .into());
        };
        let key = (id, report.grasp_index);
        let said = (report.outcome, report.note.clone());
        if self.plans.reported(key).as_ref() == Some(&said) {
            return Ok(true);
        }
        let plan_time = timestamp(Duration::from_millis(id.unix_ms()));
        let record = v1::OutcomeRecord {
            report: Some(report),
            report_time: Some(timestamp(unix_time())),
            hand: plan.hand.clone(),
            uncalibrated_score,
            score,
            calibration: plan.calibration.clone(),
            plan_time: Some(plan_time),
        };
        let (written, is_written) = oneshot::channel();
        self.send(Work::Outcome(Box::new(record), written));
        if is_written.await != Ok(true) {
            return Err(ServiceError::NotRecorded);
        }
        self.plans.note_report(key, said);
        Ok(false)
    }

    /// Ends the recording; returns when everything is written.
    pub(crate) fn close(&self) {
        drop(self.work.lock().unwrap_or_else(PoisonError::into_inner).take());
        let writer = self.writer.lock().unwrap_or_else(PoisonError::into_inner).take();
        // A thread that panicked has said so itself.
        writer.map(JoinHandle::join).map(Result::ok);
    }

    fn send(&self, work: Work) {
        if let Some(sender) = &*self.work.lock().unwrap_or_else(PoisonError::into_inner) {
            // The thread ends after its sender only.
            sender.send(work).ok();
        }
    }
}

/// The life of the thread that writes.
fn write(mut folder: Folder, work: &Receiver<Work>, metrics: &Metrics) {
    /// Times of bundles differ, so that viewers show one after the other.
    static LAST_NS: AtomicU64 = AtomicU64::new(0);
    while let Ok(work) = work.recv() {
        let (bundle, told, _place) = match work {
            Work::Call(call) => {
                let CallRecord { place, time_ns, record, hands, .. } = *call;
                let last = LAST_NS.fetch_max(time_ns, Ordering::Relaxed);
                let time_ns =
                    if time_ns > last { time_ns } else { LAST_NS.fetch_add(1, Ordering::Relaxed) + 1 };
                let mut bundle = Bundle::at(time_ns);
                picture::draw_call(&mut bundle, record, &hands);
                (bundle, None, place)
            }
            Work::Outcome(outcome, told) => {
                let mut bundle = Bundle::at(u64::try_from(unix_time().as_nanos()).unwrap_or(u64::MAX));
                bundle.push_outcome(&outcome);
                (bundle, Some(told), None)
            }
        };
        let now_ms = u64::try_from(unix_time().as_millis()).unwrap_or(u64::MAX);
        let written = folder.write(now_ms, &bundle);
        let is_written = written.is_ok();
        match written {
            Ok(()) => metrics.recorded(RecordOutcome::Written),
            Err(error) => {
                let error: &dyn std::error::Error = &error;
                tracing::error!(error, "not recorded");
                metrics.recorded(RecordOutcome::Failed);
            }
        }
        metrics.recording_bytes(folder.used_bytes());
        if let Some(told) = told {
            // Whoever reported may be gone.
            told.send(is_written).ok();
        }
    }
    if let Err(error) = folder.end_file() {
        tracing::error!(%error, "the last file of the recording has no index");
    }
}

/// Time since 1970.
pub(crate) fn unix_time() -> Duration {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default()
}

/// A time since 1970 on the wire.
pub(crate) fn timestamp(since: Duration) -> prost_types::Timestamp {
    prost_types::Timestamp {
        seconds: i64::try_from(since.as_secs()).unwrap_or(i64::MAX),
        nanos: i32::try_from(since.subsec_nanos()).unwrap_or(0),
    }
}

/// A new name for a plan.
pub(crate) fn new_plan_id() -> String {
    let unix_ms = u64::try_from(unix_time().as_millis()).unwrap_or(u64::MAX);
    PlanId::new(unix_ms, crate::random::bytes()).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_limited_by_number_and_by_bytes_and_come_back() {
        let held = Arc::new(Held::default());
        let places: Vec<Place> = (0..MOST_CALLS).map(|_| Place::take(&held, 10).unwrap()).collect();
        assert!(Place::take(&held, 10).is_none());
        drop(places);
        let large = Place::take(&held, MOST_BYTES).unwrap();
        assert!(Place::take(&held, 1).is_none());
        drop(large);
        assert!(Place::take(&held, 1).is_some());
        assert_eq!((held.calls.load(Ordering::Relaxed), held.bytes.load(Ordering::Relaxed)), (0, 0));
    }
}
