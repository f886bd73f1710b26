//! The one place where typed errors become gRPC status: code, reason, and details that a caller can act on.
//!
//! Every status carries `google.rpc.ErrorInfo` with [`DOMAIN`] and a reason in upper snake case.

use std::borrow::Cow;
use std::collections::HashMap;

use graspd_proto::v1;
use tonic::{Code, Status};
use tonic_types::{ErrorDetails, StatusExt as _};

use crate::convert::shortened;
use crate::error::ServiceError;

/// Domain of every `google.rpc.ErrorInfo` of this server.
pub const DOMAIN: &str = "graspd.dev";

/// Code, reason and details of an error.
struct Mapping {
    code: Code,
    reason: Cow<'static, str>,
    metadata: Vec<(&'static str, String)>,
    details: ErrorDetails,
}

impl Mapping {
    fn new(code: Code, reason: impl Into<Cow<'static, str>>) -> Self {
        Self { code, reason: reason.into(), metadata: Vec::new(), details: ErrorDetails::new() }
    }

    fn with(mut self, key: &'static str, value: impl ToString) -> Self {
        self.metadata.push((key, value.to_string()));
        self
    }

    fn violation(mut self, field: &str, description: impl Into<String>) -> Self {
        self.details.add_bad_request_violation(field, description);
        self
    }

    fn resource(mut self, kind: &str, name: &str, description: &str) -> Self {
        self.details.set_resource_info(kind, name, "", description);
        self
    }
}

impl From<&ServiceError> for Status {
    fn from(error: &ServiceError) -> Self {
        if let ServiceError::Relayed(relayed) = error
            && !relayed.details.is_empty()
        {
            return Self::with_details(relayed.code, relayed.message.clone(), relayed.details.clone());
        }
        let Mapping { code, reason, metadata, mut details } = mapping(error);
        let metadata: HashMap<String, String> =
            metadata.into_iter().map(|(key, value)| (key.to_owned(), value)).collect();
        details.set_error_info(reason, DOMAIN, metadata);
        Self::with_error_details(code, error.to_string(), details)
    }
}

impl From<ServiceError> for Status {
    fn from(error: ServiceError) -> Self {
        Self::from(&error)
    }
}

/// The reason of an error, as in `google.rpc.ErrorInfo.reason`.
pub fn reason(error: &ServiceError) -> Cow<'static, str> {
    mapping(error).reason
}

/// The code of an error.
pub fn code(error: &ServiceError) -> Code {
    mapping(error).code
}

/// The error of one task of several, which ends in a message of its own instead of a status.
pub(crate) fn task_error(error: &ServiceError) -> v1::TaskError {
    let Mapping { code, reason, details, .. } = mapping(error);
    let violations = details.bad_request().map_or(&[][..], |bad| &bad.field_violations);
    v1::TaskError {
        code: code as i32,
        message: error.to_string(),
        reason: reason.into_owned(),
        field_violations: (violations.iter())
            .map(|v| v1::FieldViolation { field: v.field.clone(), description: v.description.clone() })
            .collect(),
    }
}

fn mapping(error: &ServiceError) -> Mapping {
    match error {
        ServiceError::Field(fault) => Mapping::new(Code::InvalidArgument, fault.reason.as_str())
            .with("field", &fault.field)
            .violation(&fault.field, format!("found {}, expected {}", fault.found, fault.expected)),
        ServiceError::UnknownHand { name } => Mapping::new(Code::NotFound, "HAND_NOT_FOUND").resource(
            "graspd.v1.Hand",
            name,
            "no hand of this name; ListHands names those that there are",
        ),
        ServiceError::UnknownEstimator { name, known } => Mapping::new(Code::NotFound, "ESTIMATOR_NOT_FOUND")
            .with("known", known)
            .resource("graspd.v1.Estimator", name, "no contact estimator of this name"),
        ServiceError::HandExists { id } => Mapping::new(Code::AlreadyExists, "HAND_EXISTS").resource(
            "graspd.v1.Hand",
            &format!("hands/{id}"),
            "exists already",
        ),
        ServiceError::HandProtected { id } => {
            let name = format!("hands/{id}");
            let mut mapping = Mapping::new(Code::FailedPrecondition, "HAND_PROTECTED");
            mapping.details.add_precondition_failure_violation(
                "ORIGIN",
                &name,
                "comes with the server; only hands that were created can be deleted",
            );
            mapping.resource("graspd.v1.Hand", &name, "comes with the server")
        }
        ServiceError::TooManyHands { count, limit } => {
            let mut mapping = Mapping::new(Code::ResourceExhausted, "TOO_MANY_HANDS");
            mapping.details.add_quota_failure_violation(
                "hands",
                format!("{count} hands were created and at most {limit} are kept"),
            );
            mapping.with("limit", limit)
        }
        ServiceError::BadHand { problems, more } => {
            let mapping = Mapping::new(Code::InvalidArgument, "INVALID_HAND").with("more", more);
            problems.iter().fold(mapping, |m, p| m.violation(&p.field, &p.problem))
        }
        ServiceError::BadUpload { field, problem } => Mapping::new(Code::InvalidArgument, "INVALID_UPLOAD")
            .with("field", field)
            .violation(field, problem),
        ServiceError::QueueFull { waiting, limit, retry_after } => {
            let mut mapping = Mapping::new(Code::ResourceExhausted, "QUEUE_FULL");
            mapping.details.set_retry_info(Some(*retry_after));
            mapping.with("waiting", waiting).with("limit", limit)
        }
        ServiceError::CannotFinish { needs, left, retry_after } => {
            let mut mapping = Mapping::new(Code::ResourceExhausted, "CANNOT_FINISH");
            mapping.details.set_retry_info(Some(*retry_after));
            mapping.with("needs_ms", needs.as_millis()).with("left_ms", left.as_millis())
        }
        ServiceError::Shed { retry_after } => {
            let mut mapping = Mapping::new(Code::ResourceExhausted, "SHED");
            mapping.details.set_retry_info(Some(*retry_after));
            mapping
        }
        ServiceError::Unauthenticated { .. } => Mapping::new(Code::Unauthenticated, "UNAUTHENTICATED"),
        ServiceError::Forbidden { needs, has, .. } => {
            Mapping::new(Code::PermissionDenied, "FORBIDDEN").with("needs_role", needs).with("has_role", has)
        }
        ServiceError::TooUrgent { asked, most_urgent, .. } => {
            Mapping::new(Code::PermissionDenied, "PRIORITY_FORBIDDEN")
                .with("asked", asked)
                .with("most_urgent", most_urgent)
        }
        ServiceError::Quota { what, limit } => {
            let mut mapping = Mapping::new(Code::ResourceExhausted, "QUOTA");
            mapping.details.add_quota_failure_violation(*what, format!("at most {limit} for one caller"));
            mapping.with("limit", limit)
        }
        ServiceError::SlowRequest { limit } => {
            Mapping::new(Code::DeadlineExceeded, "SLOW_REQUEST").with("limit_ms", limit.as_millis())
        }
        ServiceError::Idle { limit, .. } => {
            Mapping::new(Code::DeadlineExceeded, "IDLE_STREAM").with("limit_ms", limit.as_millis())
        }
        ServiceError::RequestIdReused => Mapping::new(Code::InvalidArgument, "REQUEST_ID_REUSED")
            .violation("request_id", "found one that was used for another request, expected a new one"),
        ServiceError::UnknownPlan { id } => Mapping::new(Code::NotFound, "PLAN_NOT_FOUND").resource(
            "graspd.v1.Plan",
            &shortened(id),
            "no plan of this name, or not any more",
        ),
        ServiceError::NoRecording => Mapping::new(Code::FailedPrecondition, "NO_RECORDING"),
        ServiceError::NotRecorded => Mapping::new(Code::Unavailable, "NOT_RECORDED"),
        ServiceError::Deadline { elapsed, stage } => {
            Mapping::new(Code::DeadlineExceeded, "DEADLINE_EXCEEDED")
                .with("elapsed_ms", elapsed.as_millis())
                .with("stage", stage)
        }
        ServiceError::Cancelled => Mapping::new(Code::Cancelled, "CANCELLED"),
        ServiceError::EngineAway { .. } => Mapping::new(Code::Unavailable, "ENGINE_AWAY"),
        ServiceError::Relayed(relayed) => {
            let mapping = Mapping::new(relayed.code, relayed.reason.clone());
            relayed.violations.iter().fold(mapping, |m, (field, problem)| m.violation(field, problem))
        }
        ServiceError::Draining => Mapping::new(Code::Unavailable, "DRAINING"),
        ServiceError::JobPanicked => Mapping::new(Code::Internal, "JOB_PANICKED"),
        ServiceError::Internal { .. } => Mapping::new(Code::Internal, "INTERNAL"),
        ServiceError::UnknownMethod { .. } => Mapping::new(Code::Unimplemented, "METHOD_NOT_FOUND"),
        ServiceError::MessageTooLarge { found_bytes, limit_bytes } => {
            Mapping::new(Code::ResourceExhausted, "MESSAGE_TOO_LARGE")
                .with("found_bytes", found_bytes)
                .with("limit_bytes", limit_bytes)
        }
        ServiceError::MalformedMessage { .. } => Mapping::new(Code::InvalidArgument, "MALFORMED_MESSAGE"),
    }
}

/// What tonic itself says before a handler runs, in our words; `None` for a status that is ours already.
/// A method that does not exist is left to `unknown_method`, which needs its path.
pub fn from_transport(status: &Status) -> Option<ServiceError> {
    let message = status.message();
    match status.code() {
        Code::OutOfRange if message.contains("decoded message length too large") => {
            let mut numbers = message.split(|c: char| !c.is_ascii_digit()).filter_map(|n| n.parse().ok());
            Some(ServiceError::MessageTooLarge {
                found_bytes: numbers.next().unwrap_or(0),
                limit_bytes: numbers.next().unwrap_or(0),
            })
        }
        Code::Internal if message.starts_with("failed to decode Protobuf message") => {
            Some(ServiceError::MalformedMessage { problem: message.to_owned() })
        }
        _ => None,
    }
}

/// What tonic says without a word where there is no such method, in our words.
pub(crate) fn unknown_method(status: &Status, path: &str) -> Option<ServiceError> {
    (status.code() == Code::Unimplemented && status.message().is_empty())
        .then(|| ServiceError::UnknownMethod { path: shortened(path) })
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use tonic_types::StatusExt as _;

    use super::*;
    use crate::error::{FieldError, FieldReason, HandProblem};
    use crate::jobs::Relayed;

    /// One of each variant, with its code and reason.
    fn table() -> Vec<(ServiceError, Code, &'static str)> {
        let text = || "x".to_owned();
        // As it arrives from another machine: with its details and all.
        let relayed = Relayed::from(&Status::from(ServiceError::UnknownHand { name: text() }));
        let mut table = vec![
            (ServiceError::UnknownHand { name: text() }, Code::NotFound, "HAND_NOT_FOUND"),
            (
                ServiceError::UnknownEstimator { name: text(), known: text() },
                Code::NotFound,
                "ESTIMATOR_NOT_FOUND",
            ),
            (ServiceError::HandExists { id: text() }, Code::AlreadyExists, "HAND_EXISTS"),
            (ServiceError::HandProtected { id: text() }, Code::FailedPrecondition, "HAND_PROTECTED"),
            (ServiceError::TooManyHands { count: 9, limit: 9 }, Code::ResourceExhausted, "TOO_MANY_HANDS"),
            (
                ServiceError::BadHand {
                    problems: vec![HandProblem { field: text(), problem: text() }],
                    more: 1,
                },
                Code::InvalidArgument,
                "INVALID_HAND",
            ),
            (
                ServiceError::BadUpload { field: text(), problem: text() },
                Code::InvalidArgument,
                "INVALID_UPLOAD",
            ),
            (
                ServiceError::QueueFull { waiting: 4, limit: 4, retry_after: Duration::from_millis(70) },
                Code::ResourceExhausted,
                "QUEUE_FULL",
            ),
            (
                ServiceError::Deadline { elapsed: Duration::from_millis(80), stage: "in the queue" },
                Code::DeadlineExceeded,
                "DEADLINE_EXCEEDED",
            ),
            (
                ServiceError::CannotFinish {
                    needs: Duration::from_millis(80),
                    left: Duration::from_millis(50),
                    retry_after: Duration::from_millis(30),
                },
                Code::ResourceExhausted,
                "CANNOT_FINISH",
            ),
            (ServiceError::Shed { retry_after: Duration::from_millis(30) }, Code::ResourceExhausted, "SHED"),
            (ServiceError::Unauthenticated { problem: "no token" }, Code::Unauthenticated, "UNAUTHENTICATED"),
            (
                ServiceError::Forbidden { what: text(), needs: "operator", caller: text(), has: "viewer" },
                Code::PermissionDenied,
                "FORBIDDEN",
            ),
            (
                ServiceError::TooUrgent { asked: "high", caller: text(), most_urgent: "low" },
                Code::PermissionDenied,
                "PRIORITY_FORBIDDEN",
            ),
            (ServiceError::Quota { what: "calls", limit: 4 }, Code::ResourceExhausted, "QUOTA"),
            (
                ServiceError::SlowRequest { limit: Duration::from_secs(1) },
                Code::DeadlineExceeded,
                "SLOW_REQUEST",
            ),
            (
                ServiceError::Idle { what: "no frame came", limit: Duration::from_secs(1) },
                Code::DeadlineExceeded,
                "IDLE_STREAM",
            ),
            (ServiceError::RequestIdReused, Code::InvalidArgument, "REQUEST_ID_REUSED"),
            (ServiceError::UnknownPlan { id: text() }, Code::NotFound, "PLAN_NOT_FOUND"),
            (ServiceError::NoRecording, Code::FailedPrecondition, "NO_RECORDING"),
            (ServiceError::NotRecorded, Code::Unavailable, "NOT_RECORDED"),
            (ServiceError::Cancelled, Code::Cancelled, "CANCELLED"),
            (ServiceError::EngineAway { what: text() }, Code::Unavailable, "ENGINE_AWAY"),
            (ServiceError::Relayed(Box::new(relayed)), Code::NotFound, "HAND_NOT_FOUND"),
            (ServiceError::Draining, Code::Unavailable, "DRAINING"),
            (ServiceError::JobPanicked, Code::Internal, "JOB_PANICKED"),
            (ServiceError::Internal { what: text() }, Code::Internal, "INTERNAL"),
            (ServiceError::UnknownMethod { path: text() }, Code::Unimplemented, "METHOD_NOT_FOUND"),
            (
                ServiceError::MessageTooLarge { found_bytes: 2, limit_bytes: 1 },
                Code::ResourceExhausted,
                "MESSAGE_TOO_LARGE",
            ),
            (ServiceError::MalformedMessage { problem: text() }, Code::InvalidArgument, "MALFORMED_MESSAGE"),
        ];
        for reason in FieldReason::ALL {
            let fault = FieldError::new(reason, "frames[0].width_px", "-1", "at least 1");
            table.push((fault.into(), Code::InvalidArgument, reason.as_str()));
        }
        table
    }

    #[test]
    fn every_error_has_its_code_its_reason_and_its_text() {
        for (error, code, reason) in table() {
            let status = Status::from(&error);
            assert_eq!(status.code(), code, "{error:?}");
            assert_eq!(status.message(), error.to_string());
            let info = status.get_details_error_info().unwrap();
            assert_eq!((info.domain.as_str(), info.reason.as_str()), (DOMAIN, reason), "{error:?}");
            assert!(from_transport(&status).is_none(), "{error:?}");
        }
    }

    #[test]
    fn details_say_what_to_do() {
        let field = Status::from(ServiceError::from(FieldError::value("options.min_score", 2, "0 to 1")));
        let violations = field.get_details_bad_request().unwrap().field_violations;
        assert_eq!(violations[0].field, "options.min_score");
        assert_eq!(violations[0].description, "found 2, expected 0 to 1");

        let full = ServiceError::QueueFull { waiting: 4, limit: 4, retry_after: Duration::from_millis(70) };
        let retry = Status::from(full).get_details_retry_info().unwrap();
        assert_eq!(retry.retry_delay, Some(Duration::from_millis(70)));

        let unknown = Status::from(ServiceError::UnknownHand { name: "hands/claw".to_owned() });
        assert_eq!(unknown.get_details_resource_info().unwrap().resource_name, "hands/claw");

        let protected = Status::from(ServiceError::HandProtected { id: "leap".to_owned() });
        assert_eq!(protected.get_details_precondition_failure().unwrap().violations[0].subject, "hands/leap");
    }

    #[test]
    fn a_tasks_error_says_what_a_calls_error_says() {
        for (error, code, reason) in table() {
            let task = task_error(&error);
            assert_eq!((task.code, task.reason.as_str()), (code as i32, reason), "{error:?}");
            assert_eq!(task.message, error.to_string());
        }
        let field = task_error(&FieldError::value("tasks[1].options.min_score", 2, "0 to 1").into());
        assert_eq!(
            field.field_violations,
            [v1::FieldViolation {
                field: "tasks[1].options.min_score".to_owned(),
                description: "found 2, expected 0 to 1".to_owned()
            }]
        );
    }

    #[test]
    fn what_the_transport_says_is_translated() {
        let large = Status::out_of_range(
            "Error, decoded message length too large: found 20971526 bytes, the limit is: 16777216 bytes",
        );
        assert_eq!(
            from_transport(&large),
            Some(ServiceError::MessageTooLarge { found_bytes: 20_971_526, limit_bytes: 16_777_216 })
        );
        assert!(from_transport(&Status::out_of_range("page")).is_none());
    }
}
