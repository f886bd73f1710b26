//! The seam between calls and whoever plans for them: this process, or workers on other machines.
//!
//! A [`Job`] is a call to `PlannerService` as it came, its request's own bytes, and what must be known of it without
//! reading them. [`JobEngine`] is what plans it. [`LocalEngine`](crate::LocalEngine) plans on this machine's cores; a
//! server that is given another engine ([`ServerConfig::engine`](crate::ServerConfig::engine)) checks calls, knows
//! repeated ones, records them and keeps their deadlines itself, and lets that engine plan.

use std::pin::Pin;
use std::time::Duration;

use bytes::Bytes;
use graspd_proto::v1;
use graspd_scheduler::Priority;
use tokio::sync::watch;
use tokio_stream::Stream;
use tonic::{Code, Status};
use tonic_types::StatusExt as _;

use crate::convert;
use crate::error::{FieldError, ServiceError};

/// Which method of `graspd.v1.PlannerService` was called; the request is that method's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JobKind {
    /// `PlanGrasps`: one reply.
    PlanGrasps,
    /// `StreamGrasps`: better replies, and a last one.
    StreamGrasps,
    /// `PlanMultiHand`: a reply for each hand, and a summary.
    PlanMultiHand,
}

impl JobKind {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::PlanGrasps, Self::StreamGrasps, Self::PlanMultiHand];

    /// The method's name.
    pub fn name(self) -> &'static str {
        match self {
            Self::PlanGrasps => "PlanGrasps",
            Self::StreamGrasps => "StreamGrasps",
            Self::PlanMultiHand => "PlanMultiHand",
        }
    }

    /// By the method's name.
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }
}

/// A hand that a job needs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HandRef {
    /// Its id.
    pub id: String,
    /// The hash of its files.
    pub revision: String,
}

/// A call to the planner.
#[derive(Debug, Clone, PartialEq)]
pub struct Job {
    /// The method.
    pub kind: JobKind,
    /// The encoded request.
    pub request: Bytes,
    /// How urgent it is: of several hands the most urgent.
    pub priority: Priority,
    /// The hands that it is for.
    pub hands: Vec<HandRef>,
    /// Who calls.
    pub caller: String,
    /// How long ago the call arrived.
    pub age: Duration,
    /// How long after its arrival the caller stops waiting; `None`: it named no time.
    pub timeout: Option<Duration>,
    /// The caller's name for the request; may be empty.
    pub request_id: String,
    /// What the job is part of, as W3C `traceparent`; empty: of nothing.
    pub traceparent: String,
}

impl Job {
    /// Time until the caller stops waiting.
    pub fn left(&self) -> Option<Duration> {
        self.timeout.map(|timeout| timeout.saturating_sub(self.age))
    }
}

/// Encoded responses of the job's method, in their order. Dropping them cancels the job.
pub type Replies = Pin<Box<dyn Stream<Item = Result<Bytes, JobError>> + Send>>;

/// Why a job has no reply.
#[derive(Debug, Clone, thiserror::Error)]
#[non_exhaustive]
pub enum JobError {
    /// The engine cannot be reached. Said at once, not at the deadline.
    #[error("the planning engine is away: {0}")]
    Away(String),
    /// No more jobs are taken for now.
    #[error("{limit} jobs wait or run, and more are not taken")]
    Full {
        /// At most so many.
        limit: usize,
        /// When a place is likely to be free.
        retry_after: Duration,
    },
    /// Workers were lost with it, one after the other, until it was given up.
    #[error("{workers} workers were lost while they planned it")]
    Lost {
        /// How many.
        workers: usize,
    },
    /// What the engine says to the caller.
    #[error("{}", .0.message())]
    Refused(Status),
}

/// How an engine elsewhere is.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Presence {
    /// It can be talked to.
    pub is_here: bool,
    /// Workers that are there.
    pub workers: usize,
    /// Jobs that they plan at the same time, all together.
    pub slots: usize,
    /// Jobs that nobody has begun, of all servers, by priority in the order of [`Priority::ALL`].
    pub waiting: [usize; 4],
    /// Jobs that somebody is at, likewise.
    pub running: [usize; 4],
    /// Jobs of this server that another worker had to begin again, since the start.
    pub redelivered: u64,
    /// How often the engine was lost and found again, since the start.
    pub reconnects: u64,
}

/// Plans jobs.
#[tonic::async_trait]
pub trait JobEngine: std::fmt::Debug + Send + Sync + 'static {
    /// Takes a job. Its replies come by themselves; whoever drops them, or this future, wants them no more.
    ///
    /// # Errors
    /// [`JobError`] when it is not taken.
    async fn submit(&self, job: Job) -> Result<Replies, JobError>;

    /// How it is, for readiness, metrics and how many jobs to give it; `None` for one of this process.
    fn presence(&self) -> Option<watch::Receiver<Presence>> {
        None
    }
}

/// What a server says to an encoded request before it looks for hands or plans: whether it is one, and its fields are in
/// range. Images are looked at as far as their headers.
///
/// # Errors
/// The status that a caller would get.
pub fn check_request(kind: JobKind, request: &[u8]) -> Result<(), Status> {
    fn decoded<T: prost::Message + Default>(request: &[u8]) -> Result<T, ServiceError> {
        T::decode(request).map_err(|e| ServiceError::MalformedMessage { problem: e.to_string() })
    }
    let checked = || -> Result<(), ServiceError> {
        match kind {
            JobKind::PlanGrasps => convert::plan_grasps(decoded(request)?, "").map(drop)?,
            JobKind::StreamGrasps => {
                let wire: v1::StreamGraspsRequest = decoded(request)?;
                let plan = wire.plan.ok_or_else(|| FieldError::missing("plan", "a request"))?;
                convert::plan_grasps(plan, "plan").map(drop)?;
            }
            JobKind::PlanMultiHand => convert::multi_hand(decoded(request)?).map(drop)?,
        }
        Ok(())
    };
    checked().map_err(Status::from)
}

/// A status that another machine has made, as it is relayed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Relayed {
    /// Its code.
    pub code: Code,
    /// For people.
    pub message: String,
    /// `google.rpc.ErrorInfo.reason`.
    pub reason: String,
    /// Fields that were refused: path, and what was found and expected.
    pub violations: Vec<(String, String)>,
    /// Encoded `google.rpc.Status`; may be empty.
    pub details: Bytes,
}

impl From<&Status> for Relayed {
    fn from(status: &Status) -> Self {
        let info = status.get_details_error_info();
        let bad = status.get_details_bad_request();
        Self {
            code: status.code(),
            message: status.message().to_owned(),
            reason: info.map_or_else(|| "REMOTE".to_owned(), |info| info.reason),
            violations: (bad.into_iter().flat_map(|bad| bad.field_violations))
                .map(|v| (v.field, v.description))
                .collect(),
            details: Bytes::copy_from_slice(status.details()),
        }
    }
}

impl From<JobError> for ServiceError {
    fn from(error: JobError) -> Self {
        match error {
            JobError::Away(what) => Self::EngineAway { what },
            JobError::Full { limit, retry_after } => Self::QueueFull { waiting: limit, limit, retry_after },
            JobError::Lost { .. } => Self::Internal { what: error.to_string() },
            JobError::Refused(status) => Self::Relayed(Box::new(Relayed::from(&status))),
        }
    }
}
