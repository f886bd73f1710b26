//! Jobs and replies as messages of the broker: the gRPC messages' own bytes, and headers.

use std::time::Duration;

use async_nats::HeaderMap;
use async_nats::header::IntoHeaderName;
use bytes::Bytes;
use graspd_server::jobs::{HandRef, Job, JobKind};
use graspd_server::pool::Priority;
use tonic::{Code, Status};

const JOB: &str = "Graspd-Job";
const FRONT: &str = "Graspd-Front";
const METHOD: &str = "Graspd-Method";
const PRIORITY: &str = "Graspd-Priority";
const HAND: &str = "Graspd-Hand";
const CALLER: &str = "Graspd-Caller";
const AGE: &str = "Graspd-Age-Us";
const TIMEOUT: &str = "Graspd-Timeout-Us";
const REQUEST_ID: &str = "Graspd-Request-Id";
const TRACEPARENT: &str = "traceparent";
const OBJECT: &str = "Graspd-Object";
const REPLY: &str = "Graspd-Reply";
const ATTEMPT: &str = "Graspd-Attempt";
const CODE: &str = "Graspd-Code";
const MESSAGE: &str = "Graspd-Message";

/// Longest value of a header that is taken from outside, bytes.
const LONGEST: usize = 1024;

/// A message that is not one of ours.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("header {header}: found {found}, expected {expected}")]
pub(crate) struct Malformed {
    header: &'static str,
    found: String,
    expected: &'static str,
}

/// A job as a worker gets it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Posted {
    /// Its name.
    pub(crate) id: String,
    /// Who waits for it.
    pub(crate) front: String,
    /// Name of the object that has the request, where the message has it not.
    pub(crate) object: Option<String>,
    /// The job; its request is empty where an object has it.
    pub(crate) job: Job,
}

impl Posted {
    /// Headers of the job's message.
    pub(crate) fn headers(&self) -> HeaderMap {
        let mut headers = HeaderMap::new();
        let job = &self.job;
        put(&mut headers, JOB, &self.id);
        put(&mut headers, FRONT, &self.front);
        put(&mut headers, METHOD, job.kind.name());
        put(&mut headers, PRIORITY, job.priority.name());
        put(&mut headers, CALLER, &job.caller);
        for hand in &job.hands {
            headers.append(HAND, clean(&format!("{} {}", hand.id, hand.revision)).as_str());
        }
        put(&mut headers, AGE, &job.age.as_micros().to_string());
        if let Some(timeout) = job.timeout {
            put(&mut headers, TIMEOUT, &timeout.as_micros().to_string());
        }
        for (name, value) in [(REQUEST_ID, &job.request_id), (TRACEPARENT, &job.traceparent)] {
            if !value.is_empty() {
                put(&mut headers, name, value);
            }
        }
        if let Some(object) = &self.object {
            put(&mut headers, OBJECT, object);
        }
        headers
    }

    /// Reads a job's message.
    pub(crate) fn read(headers: &HeaderMap, payload: Bytes) -> Result<Self, Malformed> {
        let kind = required(headers, METHOD)?;
        let kind = JobKind::by_name(kind).ok_or_else(|| wrong(METHOD, kind, "a method of the planner"))?;
        let priority = required(headers, PRIORITY)?;
        let priority = (Priority::ALL.into_iter().find(|p| p.name() == priority))
            .ok_or_else(|| wrong(PRIORITY, priority, "low, normal, high or servo"))?;
        let mut hands = Vec::new();
        for hand in headers.get_all(HAND).map(|value| value.as_str()) {
            let (id, revision) = hand.split_once(' ').ok_or_else(|| wrong(HAND, hand, "id and revision"))?;
            hands.push(HandRef { id: id.to_owned(), revision: revision.to_owned() });
        }
        let micros = |name, text: &str| {
            text.parse().map(Duration::from_micros).map_err(|_| wrong(name, text, "microseconds"))
        };
        let timeout = optional(headers, TIMEOUT)?.map(|text| micros(TIMEOUT, text)).transpose()?;
        let text = |name| Ok(optional(headers, name)?.unwrap_or_default().to_owned());
        Ok(Self {
            id: name(headers, JOB)?,
            front: name(headers, FRONT)?,
            object: optional(headers, OBJECT)?.map(str::to_owned),
            job: Job {
                kind,
                request: payload,
                priority,
                hands,
                age: micros(AGE, required(headers, AGE)?)?,
                caller: required(headers, CALLER)?.to_owned(),
                timeout,
                request_id: text(REQUEST_ID)?,
                traceparent: text(TRACEPARENT)?,
            },
        })
    }
}

/// What a worker says of a job.
#[derive(Debug, Clone)]
pub(crate) enum Said {
    /// A response of the job's method; there may be more.
    Response(Bytes),
    /// There are no more responses.
    End,
    /// The job ends with this status.
    Error(Status),
}

/// True for a response after which its method has none. For several hands the end is said by itself.
pub(crate) fn is_last(kind: JobKind, response: &[u8]) -> bool {
    /// Key of `StreamGraspsResponse.finished`: field 3, with a length.
    const FINISHED: u8 = 3 << 3 | 2;
    match kind {
        JobKind::PlanGrasps => true,
        JobKind::StreamGrasps => response.first() == Some(&FINISHED),
        JobKind::PlanMultiHand => false,
    }
}

impl Said {
    /// True if nothing comes after it.
    pub(crate) fn is_last(&self, kind: JobKind) -> bool {
        match self {
            Self::Response(bytes) => is_last(kind, bytes),
            Self::End | Self::Error(_) => true,
        }
    }
}

/// Something that a worker says of a job, and which worker in turn it is.
#[derive(Debug, Clone)]
pub(crate) struct Reply {
    pub(crate) attempt: u64,
    pub(crate) said: Said,
}

impl Reply {
    /// As headers and payload.
    pub(crate) fn message(&self) -> (HeaderMap, Bytes) {
        let mut headers = HeaderMap::new();
        put(&mut headers, ATTEMPT, &self.attempt.to_string());
        let payload = match &self.said {
            Said::Response(bytes) => {
                put(&mut headers, REPLY, "response");
                bytes.clone()
            }
            Said::End => {
                put(&mut headers, REPLY, "end");
                Bytes::new()
            }
            Said::Error(status) => {
                put(&mut headers, REPLY, "error");
                put(&mut headers, CODE, &i32::from(status.code()).to_string());
                put(&mut headers, MESSAGE, status.message());
                Bytes::copy_from_slice(status.details())
            }
        };
        (headers, payload)
    }

    /// Reads it back.
    pub(crate) fn read(headers: &HeaderMap, payload: Bytes) -> Result<Self, Malformed> {
        let attempt = required(headers, ATTEMPT)?;
        let attempt = attempt.parse().map_err(|_| wrong(ATTEMPT, attempt, "a number"))?;
        let said = match required(headers, REPLY)? {
            "response" => Said::Response(payload),
            "end" => Said::End,
            "error" => {
                let code = required(headers, CODE)?;
                let code =
                    code.parse::<i32>().map(Code::from).map_err(|_| wrong(CODE, code, "a code of gRPC"))?;
                let message = optional(headers, MESSAGE)?.unwrap_or_default();
                Said::Error(Status::with_details(code, message, payload))
            }
            other => return Err(wrong(REPLY, other, "response, end or error")),
        };
        Ok(Self { attempt, said })
    }
}

fn put(headers: &mut HeaderMap, name: impl IntoHeaderName, value: &str) {
    headers.insert(name, clean(value).as_str());
}

/// A value without what would end a header's line.
fn clean(value: &str) -> String {
    value.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}

fn wrong(header: &'static str, found: &str, expected: &'static str) -> Malformed {
    let found = found.chars().take(60).collect();
    Malformed { header, found, expected }
}

fn optional<'a>(headers: &'a HeaderMap, name: &'static str) -> Result<Option<&'a str>, Malformed> {
    match headers.get(name).map(|value| value.as_str()) {
        Some(value) if value.len() > LONGEST && name != MESSAGE => {
            Err(wrong(name, value, "at most 1024 bytes"))
        }
        value => Ok(value),
    }
}

fn required<'a>(headers: &'a HeaderMap, name: &'static str) -> Result<&'a str, Malformed> {
    optional(headers, name)?.ok_or_else(|| wrong(name, "nothing", "a value"))
}

/// A name that can be a part of a subject.
fn name(headers: &HeaderMap, header: &'static str) -> Result<String, Malformed> {
    let name = required(headers, header)?;
    let in_order = !name.is_empty() && name.len() <= 64 && name.chars().all(|c| c.is_ascii_alphanumeric());
    if in_order { Ok(name.to_owned()) } else { Err(wrong(header, name, "letters and digits")) }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn posted() -> Posted {
        Posted {
            id: "job1".to_owned(),
            front: "front1".to_owned(),
            object: Some("job1".to_owned()),
            job: Job {
                kind: JobKind::PlanMultiHand,
                request: Bytes::from_static(b"\x00\xffbytes"),
                priority: Priority::High,
                hands: vec![
                    HandRef { id: "a".to_owned(), revision: "1".to_owned() },
                    HandRef { id: "b".to_owned(), revision: "2".to_owned() },
                ],
                caller: "arm left".to_owned(),
                age: Duration::from_micros(77),
                timeout: Some(Duration::from_micros(1_234_567)),
                request_id: "id".to_owned(),
                traceparent: "00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01".to_owned(),
            },
        }
    }

    #[test]
    fn a_job_is_the_same_after_the_broker() {
        let posted = posted();
        let request = posted.job.request.clone();
        assert_eq!(Posted::read(&posted.headers(), request).unwrap(), posted);
    }

    #[test]
    fn what_is_missing_or_wrong_is_named() {
        for header in [JOB, FRONT, METHOD, PRIORITY, CALLER, AGE] {
            let mut headers = HeaderMap::new();
            for (name, values) in posted().headers().iter().filter(|(name, _)| name.to_string() != header) {
                values.iter().for_each(|value| headers.append(name.clone(), value.clone()));
            }
            let error = Posted::read(&headers, Bytes::new()).unwrap_err();
            assert_eq!(error.header, header);
        }
        for (header, value) in [(JOB, "a.b"), (FRONT, ">"), (METHOD, "Fly"), (TIMEOUT, "soon"), (HAND, "one")]
        {
            let mut headers = posted().headers();
            headers.insert(header, value);
            assert_eq!(Posted::read(&headers, Bytes::new()).unwrap_err().header, header);
        }
    }

    #[test]
    fn a_status_keeps_its_details_and_cannot_forge_headers() {
        let details = Bytes::from_static(b"\x08\x05details");
        let status = Status::with_details(Code::NotFound, "hand\r\nGraspd-Reply: end", details.clone());
        let (headers, payload) = Reply { attempt: 3, said: Said::Error(status) }.message();
        let reply = Reply::read(&headers, payload).unwrap();
        let Said::Error(status) = reply.said else { panic!("expected an error") };
        assert_eq!((reply.attempt, status.code(), status.details()), (3, Code::NotFound, &details[..]));
        assert_eq!(status.message(), "hand  Graspd-Reply: end");
    }

    proptest! {
        #[test]
        fn any_headers_are_a_job_or_an_error(values in prop::collection::vec("[ -~]{0,40}", 15)) {
            let names = [AGE, JOB, FRONT, METHOD, PRIORITY, HAND, CALLER, TIMEOUT, REQUEST_ID, TRACEPARENT, OBJECT,
                REPLY, ATTEMPT, CODE, MESSAGE];
            let mut headers = HeaderMap::new();
            for (name, value) in names.into_iter().zip(values) {
                headers.insert(name, value.as_str());
            }
            Posted::read(&headers, Bytes::new()).ok();
            Reply::read(&headers, Bytes::new()).ok();
        }
    }
}
