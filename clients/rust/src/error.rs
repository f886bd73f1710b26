//! What a call can end with, as a caller can act on it.

use std::collections::BTreeMap;
use std::error::Error as _;
use std::time::Duration;

use tonic::{Code, Status};
use tonic_types::StatusExt as _;

/// A field of the request that was refused.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Violation {
    /// Path of the field, for example `frames[0].intrinsics.fx_px`.
    pub field: String,
    /// What was found and what was expected.
    pub description: String,
}

/// The server's word on why there is no answer.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{code:?}: {message}")]
pub struct CallError {
    /// The gRPC code.
    pub code: Code,
    /// The machine-readable reason, for example `HAND_NOT_FOUND`; empty when the other side gave none (the
    /// connection failed, or something between client and server answered).
    pub reason: String,
    /// For people.
    pub message: String,
    /// The refused fields of an `INVALID_ARGUMENT`.
    pub violations: Vec<Violation>,
    /// When the server asks to come back.
    pub retry_after: Option<Duration>,
    /// Further figures, for example `limit_bytes`.
    pub metadata: BTreeMap<String, String>,
}

/// Why a call of this client failed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ClientError {
    /// The address is not one, or nobody answers there.
    #[error("cannot connect to {endpoint}: {problem}")]
    Connect {
        /// As configured.
        endpoint: String,
        /// What happened.
        problem: String,
    },
    /// The call ended with an error.
    #[error(transparent)]
    Call(#[from] CallError),
    /// The server broke the protocol.
    #[error("unexpected answer: {0}")]
    Protocol(&'static str),
}

impl ClientError {
    /// The call's error, if it was a call that failed.
    pub fn call(&self) -> Option<&CallError> {
        match self {
            Self::Call(error) => Some(error),
            Self::Connect { .. } | Self::Protocol(_) => None,
        }
    }
}

impl CallError {
    /// The error of a call that took too long for its caller.
    pub(crate) fn late() -> Self {
        Self {
            code: Code::DeadlineExceeded,
            reason: "DEADLINE_EXCEEDED".to_owned(),
            message: "the deadline passed before the server answered".to_owned(),
            violations: Vec::new(),
            retry_after: None,
            metadata: BTreeMap::new(),
        }
    }
}

impl From<&Status> for CallError {
    fn from(status: &Status) -> Self {
        // The transport's own timer, on this side.
        if status.code() == Code::Cancelled && status.message() == "Timeout expired" {
            return Self::late();
        }
        if broken(status) {
            return Self {
                code: Code::Unavailable,
                reason: "CONNECTION_LOST".to_owned(),
                message: format!("the connection broke: {}", causes(status)),
                ..Self::late()
            };
        }
        let details = status.get_error_details();
        let (reason, metadata) = details
            .error_info()
            .map(|info| (info.reason.clone(), info.metadata.clone().into_iter().collect()))
            .unwrap_or_default();
        let violations = details
            .bad_request()
            .map(|bad| {
                (bad.field_violations.iter())
                    .map(|v| Violation { field: v.field.clone(), description: v.description.clone() })
                    .collect()
            })
            .unwrap_or_default();
        Self {
            code: status.code(),
            reason,
            message: status.message().to_owned(),
            violations,
            retry_after: details.retry_info().and_then(|r| r.retry_delay),
            metadata,
        }
    }
}

/// True for a status that no server sent: a connection or stream that ended in the middle of a call. tonic gives those
/// codes by which of its layers noticed (`UNKNOWN`, `CANCELLED`); other gRPC libraries say `UNAVAILABLE`.
fn broken(status: &Status) -> bool {
    matches!(status.code(), Code::Unknown | Code::Cancelled) && status.source().is_some()
}

/// What is known of an error, from the outside in, each thing once.
fn causes(status: &Status) -> String {
    let mut said = status.message().to_owned();
    let mut cause = status.source();
    while let Some(error) = cause {
        let words = error.to_string();
        if !said.contains(&words) {
            said = if said.is_empty() { words } else { format!("{said}: {words}") };
        }
        cause = error.source();
    }
    said
}

impl From<Status> for ClientError {
    fn from(status: Status) -> Self {
        Self::Call(CallError::from(&status))
    }
}

#[cfg(test)]
mod tests {
    use tonic_types::{ErrorDetails, StatusExt as _};

    use super::*;

    #[test]
    fn details_become_fields() {
        let mut details = ErrorDetails::new();
        details.set_error_info("QUEUE_FULL", "graspd.dev", [("limit".to_owned(), "4".to_owned())]);
        details.set_retry_info(Some(Duration::from_millis(20)));
        details.add_bad_request_violation("frames[0].data", "found 1 bytes");
        let status = Status::with_error_details(Code::ResourceExhausted, "full", details);
        let error = CallError::from(&status);
        assert_eq!((error.code, error.reason.as_str()), (Code::ResourceExhausted, "QUEUE_FULL"));
        assert_eq!(error.retry_after, Some(Duration::from_millis(20)));
        assert_eq!(error.violations[0].field, "frames[0].data");
        assert_eq!(error.metadata["limit"], "4");
    }

    #[test]
    fn a_status_without_details_and_the_local_timer_are_understood() {
        let bare = CallError::from(&Status::unavailable("gone"));
        assert_eq!((bare.code, bare.reason.as_str(), bare.retry_after), (Code::Unavailable, "", None));
        assert_eq!(CallError::from(&Status::cancelled("Timeout expired")).code, Code::DeadlineExceeded);
        assert_eq!(CallError::from(&Status::cancelled("by hand")).code, Code::Cancelled);
    }
}
