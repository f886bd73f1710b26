//! Where a call's plans begin: in this process's pool, or with the engine that the server was given.

use std::collections::BTreeMap;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;

use bytes::Bytes;
use graspd_proto::v1;
use graspd_proto::v1::{hand_task_result, plan_multi_hand_response, stream_grasps_response};
use prost::Message as _;
use tokio::sync::oneshot;
use tokio_stream::StreamExt as _;
use tonic::Code;

use super::{Answer, Call, Engine, OnBetter, Task};
use crate::error::ServiceError;
use crate::jobs::{HandRef, Job, JobKind, Relayed, Replies};
use crate::pool::Priority;

/// An answer that is on its way.
pub(crate) type Answering = Pin<Box<dyn Future<Output = Answer> + Send>>;
/// Begins one hand's share of a call when it is called, if it has not begun.
pub(crate) type Planning = Box<dyn FnOnce() -> Answering + Send>;

/// A plan for one hand that has begun.
pub(crate) struct Begun {
    /// Jobs before it, where that is known.
    pub(crate) position: usize,
    /// Its answer.
    pub(crate) answer: Answering,
}

/// A call's request, kept only where somebody else plans.
pub(crate) struct Wire {
    request: Bytes,
    request_id: String,
    caller: String,
}

/// What other machines need of a request; recording and knowing repetitions is this server's.
pub(crate) trait Elsewhere: prost::Message + Clone {
    /// Takes out what is this server's; the caller's name for the request.
    fn strip(&mut self) -> String;
}

impl Elsewhere for v1::PlanGraspsRequest {
    fn strip(&mut self) -> String {
        self.record = false;
        std::mem::take(&mut self.request_id)
    }
}

impl Elsewhere for v1::PlanMultiHandRequest {
    fn strip(&mut self) -> String {
        self.record = false;
        self.assignment = None;
        std::mem::take(&mut self.request_id)
    }
}

impl Engine {
    /// What another engine needs of the request, where there is one.
    pub(crate) fn wire(&self, request: &impl Elsewhere, caller: &str) -> Option<Wire> {
        self.elsewhere.as_ref()?;
        // Pixels are shared with the request until they are encoded.
        let mut request = request.clone();
        let request_id = request.strip();
        Some(Wire { request: request.encode_to_vec().into(), request_id, caller: caller.to_owned() })
    }

    /// Begins to plan for one hand. `on_better` gets each better answer.
    pub(crate) async fn begin_single(
        self: &Arc<Self>,
        call: &Call,
        task: &Task,
        wire: Option<Wire>,
        on_better: Option<OnBetter>,
    ) -> Result<Begun, ServiceError> {
        let (engine, call, task) = (Arc::clone(self), call.clone(), task.clone());
        let Some((elsewhere, wire)) = self.elsewhere.as_ref().zip(wire) else {
            let ticket = self.submit_single(&call, &task, on_better)?;
            let position = ticket.position;
            let answer = Box::pin(async move { engine.answer(&call, &task, ticket).await });
            return Ok(Begun { position, answer });
        };
        let kind = if on_better.is_some() { JobKind::StreamGrasps } else { JobKind::PlanGrasps };
        let mut job = self.job(&call, std::slice::from_ref(&task), kind, wire);
        if kind == JobKind::StreamGrasps {
            // A field of a message around it, as it is on the wire: no copy of pixels is decoded for this.
            job.request = within_stream_request(&job.request);
        }
        let replies = elsewhere.submit(job).await?;
        let answer = Box::pin(async move {
            let answer = last_reply(replies, on_better).await;
            if answer.is_ok() {
                engine.health.planned(&task.hand().id).await;
            }
            answer
        });
        Ok(Begun { position: 0, answer })
    }

    /// Begins to plan for several hands in one scene; ready when the scene is read, or will not be in time. With
    /// `at_once` every hand's search is queued then, in this order; else when it is asked for.
    pub(crate) async fn begin_hands(
        self: &Arc<Self>,
        call: &Call,
        mut tasks: Vec<Task>,
        wire: Option<Wire>,
        at_once: bool,
    ) -> Result<Vec<(Task, Planning)>, ServiceError> {
        if let Some((elsewhere, wire)) = self.elsewhere.as_ref().zip(wire) {
            let mut replies = elsewhere.submit(self.job(call, &tasks, JobKind::PlanMultiHand, wire)).await?;
            // As here: a frame that cannot be read is an error of the call, and then the first reply.
            let first = replies.next().await.ok_or_else(ended_early)??;
            return Ok(distribute(Box::pin(tokio_stream::once(Ok(first)).chain(replies)), tasks));
        }
        let ticket = self.submit_scene(call, &tasks)?;
        // A frame that cannot be read is an error of the call, so the stream begins when the scene is there.
        let read = match self.scene(call, ticket).await {
            Ok(read) => Ok(read),
            Err(late @ ServiceError::Deadline { .. }) => Err(late),
            Err(error) => return Err(error),
        };
        self.quickest_first(&mut tasks);
        let plannings = tasks.into_iter().map(|task| {
            let (engine, call, read) = (Arc::clone(self), call.clone(), read.clone());
            // What may have an answer already is only queued if it has none.
            let queued = match &read {
                Ok(read) if at_once => Some(engine.submit_hand(&call, read, &task)),
                _ => None,
            };
            let own = task.clone();
            let planning: Planning = Box::new(move || {
                Box::pin(async move {
                    // From here on the scene lives as long as the jobs that need it.
                    let ticket = match (queued, read) {
                        (Some(queued), _) => queued?,
                        (None, Ok(read)) => engine.submit_hand(&call, &read, &own)?,
                        (None, Err(late)) => return call.without_scene(late, &own),
                    };
                    engine.answer(&call, &own, ticket).await
                })
            });
            (task, planning)
        });
        Ok(plannings.collect())
    }

    fn job(&self, call: &Call, tasks: &[Task], kind: JobKind, wire: Wire) -> Job {
        let hand = |task: &Task| HandRef { id: task.hand.id.clone(), revision: task.hand.revision.clone() };
        Job {
            kind,
            request: wire.request,
            priority: tasks.iter().map(|t| t.job.priority).max().unwrap_or(Priority::Normal),
            hands: tasks.iter().map(hand).collect(),
            caller: wire.caller,
            age: call.clock.elapsed(),
            timeout: call.clock.timeout,
            request_id: wire.request_id,
            traceparent: call.clock.trace.traceparent(),
        }
    }
}

/// `StreamGraspsRequest { plan }` around an encoded `PlanGraspsRequest`.
fn within_stream_request(plan: &Bytes) -> Bytes {
    let mut request = Vec::with_capacity(plan.len() + 8);
    prost::encoding::encode_key(1, prost::encoding::WireType::LengthDelimited, &mut request);
    prost::encoding::encode_varint(plan.len() as u64, &mut request);
    request.extend_from_slice(plan);
    request.into()
}

/// A reply that is not one.
fn malformed(error: &impl std::fmt::Display) -> ServiceError {
    ServiceError::Internal { what: format!("a worker's reply: {error}") }
}

fn ended_early() -> ServiceError {
    ServiceError::Internal { what: "a worker's replies end before the last one".to_owned() }
}

/// The last of a job's replies; what comes before it goes to `on_better`.
async fn last_reply(mut replies: Replies, mut on_better: Option<OnBetter>) -> Answer {
    while let Some(reply) = replies.next().await {
        let reply = reply?;
        let Some(on_better) = &mut on_better else {
            return v1::PlanGraspsResponse::decode(reply).map_err(|e| malformed(&e));
        };
        match v1::StreamGraspsResponse::decode(reply).map_err(|e| malformed(&e))?.event {
            Some(stream_grasps_response::Event::Improved(better)) => on_better(better),
            Some(stream_grasps_response::Event::Finished(answer)) => return Ok(answer),
            // Where it waits there is nobody's business here.
            Some(stream_grasps_response::Event::Accepted(_)) | None => {}
        }
    }
    Err(ended_early())
}

/// Gives each task the reply that is its own. Replies are read until the last task has one or nobody wants any.
fn distribute(mut replies: Replies, tasks: Vec<Task>) -> Vec<(Task, Planning)> {
    let (mut senders, mut receivers) = (BTreeMap::new(), Vec::new());
    for task in tasks {
        let (sender, receiver) = oneshot::channel::<Answer>();
        senders.insert(task.id().to_owned(), sender);
        receivers.push((task, receiver));
    }
    // Dropped when nobody wants a reply any more.
    let (wanted, mut unwanted) = oneshot::channel::<()>();
    tokio::spawn(async move {
        let error = loop {
            let reply = tokio::select! {
                biased;
                // With every reply where it belongs only the job's end is waited for.
                _ = &mut unwanted, if !senders.is_empty() => return,
                reply = replies.next() => reply,
            };
            match reply {
                None => break ended_early(),
                Some(Err(error)) => break error.into(),
                Some(Ok(reply)) => match v1::PlanMultiHandResponse::decode(reply) {
                    Err(error) => break malformed(&error),
                    Ok(v1::PlanMultiHandResponse {
                        event: Some(plan_multi_hand_response::Event::Result(result)),
                    }) => {
                        // After a redelivery a task's reply may come twice: the first one counts.
                        if let Some(sender) = senders.remove(&result.task_id) {
                            sender.send(outcome(result)).ok();
                        }
                    }
                    // The summary is made here, of what has arrived here.
                    Ok(_) => {}
                },
            }
        };
        for (_, sender) in senders {
            sender.send(Err(error.clone())).ok();
        }
    });
    let wanted = Arc::new(wanted);
    let plannings = receivers.into_iter().map(|(task, receiver)| {
        let wanted = Arc::clone(&wanted);
        let planning: Planning = Box::new(move || {
            Box::pin(async move {
                let answer = receiver.await.unwrap_or_else(|_| Err(ended_early()));
                drop(wanted);
                answer
            })
        });
        (task, planning)
    });
    plannings.collect()
}

fn outcome(result: v1::HandTaskResult) -> Answer {
    match result.outcome {
        Some(hand_task_result::Outcome::Response(response)) => Ok(response),
        Some(hand_task_result::Outcome::Error(error)) => Err(ServiceError::Relayed(Box::new(Relayed {
            code: Code::from(error.code),
            message: error.message,
            reason: error.reason,
            violations: error.field_violations.into_iter().map(|v| (v.field, v.description)).collect(),
            details: Bytes::new(),
        }))),
        None => Err(malformed(&"found a result without an outcome")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::JobError;

    #[test]
    fn a_plan_within_a_stream_request_is_what_the_protocol_says() {
        for length in [0usize, 1, 127, 128, 70_000] {
            let plan = v1::PlanGraspsRequest {
                hand: "hands/antipodal".to_owned(),
                request_id: "x".repeat(length),
                ..Default::default()
            };
            let bytes = within_stream_request(&plan.encode_to_vec().into());
            assert_eq!(v1::StreamGraspsRequest::decode(bytes).unwrap().plan.unwrap(), plan, "{length}");
        }
    }

    #[tokio::test]
    async fn replies_without_a_last_one_and_replies_that_are_none_are_errors() {
        let replies =
            |items: Vec<Result<Bytes, JobError>>| -> Replies { Box::pin(tokio_stream::iter(items)) };
        let nothing = last_reply(replies(vec![]), None).await.unwrap_err();
        assert!(nothing.to_string().contains("end before the last one"), "{nothing}");
        let noise = last_reply(replies(vec![Ok(Bytes::from_static(b"\xff"))]), None).await.unwrap_err();
        assert!(noise.to_string().contains("a worker's reply"), "{noise}");
        let away = last_reply(replies(vec![Err(JobError::Away("gone".to_owned()))]), None).await.unwrap_err();
        assert_eq!(crate::status::code(&away), Code::Unavailable);
    }
}
