//! What can be wrong with a call: one typed error, mapped to gRPC in [`crate::status`] and nowhere else.

use std::fmt;
use std::time::Duration;

use crate::jobs::Relayed;
use crate::pool::PoolError;

/// Why one field of a request was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{field}: found {found}, expected {expected}")]
pub struct FieldError {
    /// Path of the field, for example `frames[0].intrinsics.fx_px`.
    pub field: String,
    /// What was there.
    pub found: String,
    /// What should have been.
    pub expected: String,
    /// The kind of fault.
    pub reason: FieldReason,
}

/// Kinds of faults of a field; the machine-readable reason of an `INVALID_ARGUMENT`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FieldReason {
    /// A required field is unset or empty.
    Missing,
    /// A number or a name out of its range.
    Value,
    /// A pose that is not rigid: not finite, or a quaternion that is not of unit length.
    Pose,
    /// Intrinsics that no camera has.
    Intrinsics,
    /// Pixels that do not make the image that the frame describes.
    Image,
}

impl FieldReason {
    /// All reasons.
    pub const ALL: [Self; 5] = [Self::Missing, Self::Value, Self::Pose, Self::Intrinsics, Self::Image];

    /// The reason on the wire, for example `INVALID_POSE`.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Missing => "MISSING_FIELD",
            Self::Value => "INVALID_VALUE",
            Self::Pose => "INVALID_POSE",
            Self::Intrinsics => "INVALID_INTRINSICS",
            Self::Image => "INVALID_IMAGE",
        }
    }
}

impl FieldError {
    /// A required field that is not there.
    pub fn missing(field: impl Into<String>, expected: impl Into<String>) -> Self {
        Self {
            field: field.into(),
            found: "nothing".to_owned(),
            expected: expected.into(),
            reason: FieldReason::Missing,
        }
    }

    /// A value out of its range.
    pub fn value(field: impl Into<String>, found: impl fmt::Display, expected: impl Into<String>) -> Self {
        Self::new(FieldReason::Value, field, found, expected)
    }

    /// Any fault.
    pub fn new(
        reason: FieldReason,
        field: impl Into<String>,
        found: impl fmt::Display,
        expected: impl Into<String>,
    ) -> Self {
        Self { field: field.into(), found: found.to_string(), expected: expected.into(), reason }
    }
}

/// Why a call has no answer.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ServiceError {
    /// A field of the request is wrong.
    #[error(transparent)]
    Field(#[from] FieldError),
    /// There is no hand of that name.
    #[error("hand {name:?}: not found; ListHands names the hands of this server")]
    UnknownHand {
        /// Resource name as asked for.
        name: String,
    },
    /// There is no contact estimator of that name.
    #[error("estimator {name:?}: not found; this server has {known}")]
    UnknownEstimator {
        /// As asked for.
        name: String,
        /// Names that there are, separated by commas.
        known: String,
    },
    /// A hand of that id exists.
    #[error("hand \"hands/{id}\": exists already; delete it first or choose another id")]
    HandExists {
        /// The id.
        id: String,
    },
    /// A hand that comes with the server cannot be deleted.
    #[error(
        "hand \"hands/{id}\": comes with the server and cannot be deleted; only hands that were created can"
    )]
    HandProtected {
        /// The id.
        id: String,
    },
    /// There is no room for another hand.
    #[error("{count} hands were created and more than {limit} are not kept; delete one first")]
    TooManyHands {
        /// Hands that were created.
        count: usize,
        /// At most so many.
        limit: usize,
    },
    /// The uploaded files do not make a hand.
    #[error("the files do not make a hand: {}", problems_line(.problems, *.more))]
    BadHand {
        /// What is wrong, the first few problems.
        problems: Vec<HandProblem>,
        /// How many more there are.
        more: usize,
    },
    /// The upload itself breaks a rule.
    #[error("{field}: {problem}")]
    BadUpload {
        /// The field, for example `chunk.path`.
        field: String,
        /// What was found, and what was expected.
        problem: String,
    },
    /// All cores are busy and the queue is full.
    #[error(
        "the planning queue is full: {waiting} jobs wait and at most {limit} may; retry after {retry_after:?}"
    )]
    QueueFull {
        /// Jobs that wait.
        waiting: usize,
        /// At most so many may.
        limit: usize,
        /// When a place is likely to be free.
        retry_after: Duration,
    },
    /// The deadline passed with nothing to answer.
    #[error("the deadline passed after {elapsed:?} {stage}; allow more time or ask for fewer iterations")]
    Deadline {
        /// Time since the call arrived.
        elapsed: Duration,
        /// What was being done, for example `while the scene was read`.
        stage: &'static str,
    },
    /// Nobody waits for the answer any more.
    #[error("the call was cancelled")]
    Cancelled,
    /// The call would not be done before its deadline, or others would not be for it.
    #[error("the server is busy: the call needs about {needs:?} from now and {} to finish in; try again in {retry_after:?}", has(.left))]
    CannotFinish {
        /// How long it would take, what is before it included.
        needs: Duration,
        /// How long it has; zero where calls that wait already would be late for it.
        left: Duration,
        /// When it could.
        retry_after: Duration,
    },
    /// A more urgent call took its place.
    #[error(
        "the server is busy: a more urgent call took the place of this one; try again in {retry_after:?}"
    )]
    Shed {
        /// When a place is likely to be free.
        retry_after: Duration,
    },
    /// The id of the request was used for another one.
    #[error("request_id: found one that was used for another request, expected a new one for each request")]
    RequestIdReused,
    /// There is no such plan, or not any more.
    #[error("plan {id:?}: not found; it is not one of this server, or too old")]
    UnknownPlan {
        /// As given.
        id: String,
    },
    /// Outcomes have no place to be kept.
    #[error("this server keeps no recording, and so no outcomes; start it with --record DIR")]
    NoRecording,
    /// The recording could not be written.
    #[error("the outcome could not be written to the recording; the server's log says why")]
    NotRecorded,
    /// Nobody knows who calls.
    #[error("not authenticated: {problem}")]
    Unauthenticated {
        /// What is wrong.
        problem: &'static str,
    },
    /// The caller may not be so urgent.
    #[error("priority {asked}: {caller} may ask for {most_urgent} at most")]
    TooUrgent {
        /// As asked for.
        asked: &'static str,
        /// The caller's name.
        caller: String,
        /// The most urgent that it may ask for.
        most_urgent: &'static str,
    },
    /// The caller may not call this method.
    #[error("{what} asks for the role {needs}, and {caller} is {has}")]
    Forbidden {
        /// What was asked for.
        what: String,
        /// The least role that may.
        needs: &'static str,
        /// The caller's name.
        caller: String,
        /// The caller's role.
        has: &'static str,
    },
    /// The caller has as much as it may have.
    #[error("quota: {what}: {limit} are the most for one caller")]
    Quota {
        /// Of what.
        what: &'static str,
        /// The most.
        limit: u64,
    },
    /// The request does not arrive.
    #[error("the request has not arrived within {limit:?} of its headers")]
    SlowRequest {
        /// Time for it.
        limit: Duration,
    },
    /// Nothing has come in a stream, or nobody has read from it, for too long.
    #[error("the stream was idle: {what} for {limit:?}")]
    Idle {
        /// What did not happen.
        what: &'static str,
        /// For how long.
        limit: Duration,
    },
    /// The machines that plan, or what is between them and this one, cannot be reached.
    #[error("the planning engine is away: {what}; try again")]
    EngineAway {
        /// What is wrong.
        what: String,
    },
    /// What another machine says to the caller.
    #[error("{}", .0.message)]
    Relayed(Box<Relayed>),
    /// The server is shutting down.
    #[error("the server is shutting down")]
    Draining,
    /// The job crashed; the server goes on.
    #[error("the planning job crashed; this is a fault of the server, other calls are not affected")]
    JobPanicked,
    /// Something that must not happen did.
    #[error("{what}; this is a fault of the server")]
    Internal {
        /// What.
        what: String,
    },
    /// There is no such method.
    #[error(
        "method {path:?}: not found; this server has graspd.v1.PlannerService, graspd.v1.ServoService, \
         graspd.v1.HandService and graspd.v1.InfoService"
    )]
    UnknownMethod {
        /// Path of the method as asked for.
        path: String,
    },
    /// A message is larger than the server takes.
    #[error(
        "the message has {found_bytes} bytes and this server takes at most {limit_bytes}; {MESSAGE_SIZE_ADVICE}"
    )]
    MessageTooLarge {
        /// Size of the message.
        found_bytes: usize,
        /// The server's limit.
        limit_bytes: usize,
    },
    /// The bytes are not a message of the protocol.
    #[error("the bytes are not a message of graspd.v1: {problem}")]
    MalformedMessage {
        /// What the decoder says.
        problem: String,
    },
}

impl ServiceError {
    /// The error of a job without a result; `elapsed` is the time since its call arrived.
    pub(crate) fn of_pool(error: &PoolError, elapsed: impl FnOnce() -> Duration) -> Self {
        match *error {
            PoolError::Full { waiting, limit, retry_after } => {
                Self::QueueFull { waiting, limit, retry_after }
            }
            PoolError::CannotFinish { needs, left, retry_after } => {
                Self::CannotFinish { needs, left, retry_after }
            }
            PoolError::Shed { retry_after } => Self::Shed { retry_after },
            PoolError::Expired => Self::Deadline { elapsed: elapsed(), stage: "in the queue" },
            PoolError::Cancelled => Self::Cancelled,
            PoolError::Panicked => Self::JobPanicked,
            PoolError::Closed => Self::Draining,
            PoolError::Threads(_) => Self::Internal { what: error.to_string() },
        }
    }
}

/// One thing that is wrong with a hand's files.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HandProblem {
    /// The file, and the element or key in it, for example `files["hand.urdf"]: joint "knuckle"`.
    pub field: String,
    /// What was found, and what was expected.
    pub problem: String,
}

fn problems_line(problems: &[HandProblem], more: usize) -> String {
    let mut line: Vec<String> = problems.iter().map(|p| format!("{}: {}", p.field, p.problem)).collect();
    if more > 0 {
        line.push(format!("and {more} more problems"));
    }
    line.join("; ")
}

fn has(left: &Duration) -> String {
    if left.is_zero() { "waiting calls leave no time".to_owned() } else { format!("has {left:?}") }
}

const MESSAGE_SIZE_ADVICE: &str = "send depth as 16-bit pixels or PNG, or raise the server's limit";
