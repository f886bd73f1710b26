//! Plans of an engine elsewhere: which call goes there when, its request's own bytes on their way out, and replies on their way in.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use graspd_planner::budget::Stop;
use graspd_planner::grasp::PlanStats;
use graspd_proto::v1;
use graspd_proto::v1::{hand_task_result, plan_multi_hand_response, stream_grasps_response};
use prost::Message as _;
use tokio::sync::oneshot;
use tokio_stream::StreamExt as _;
use tonic::Code;

use super::begin::{Begun, Planning};
use super::{Answer, Call, Engine, OnBetter, Task};
use crate::error::ServiceError;
use crate::jobs::{HandRef, Job, JobEngine, JobKind, Presence, Relayed, Replies};
use crate::outgoing::Pass;
use crate::pool::{Order, PoolError, Priority};

/// Stages of an answer that belong to its scene.
const SCENE_STAGES: [&str; 5] = ["decode", "frame", "volume", "estimate", "refine"];
/// Stages of an answer that belong to its search.
const SEARCH_STAGES: [&str; 3] = ["initialize", "optimize", "rank"];

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
    /// How whoever plans elsewhere is, where there is somebody.
    pub(crate) fn presence(&self) -> Option<Presence> {
        Some(self.elsewhere.as_ref()?.presence()?.borrow().clone())
    }

    /// Goes by how whoever plans elsewhere is now; true if readiness may have changed.
    pub(crate) fn heed(&self, presence: &Presence) -> bool {
        self.outgoing.set_slots(if presence.is_here { presence.slots } else { 0 });
        self.health.set_elsewhere(presence)
    }

    /// Goes by how whoever plans elsewhere is, for as long as that is told.
    pub(crate) async fn watch_elsewhere(&self) {
        let Some(mut presence) = self.elsewhere.as_ref().and_then(|engine| engine.presence()) else { return };
        loop {
            let now = presence.borrow_and_update().clone();
            if self.heed(&now) {
                tracing::info!(
                    ready = self.health.is_ready(),
                    workers = now.workers,
                    "whoever plans has changed"
                );
                self.health.tell(self.registry.ids()).await;
            }
            if presence.changed().await.is_err() {
                return;
            }
        }
    }

    /// What another engine needs of the request, where there is one.
    pub(crate) fn wire(&self, request: &impl Elsewhere, caller: &str) -> Option<Wire> {
        self.elsewhere.as_ref()?;
        // Pixels are shared with the request until they are encoded.
        let mut request = request.clone();
        let request_id = request.strip();
        Some(Wire { request: request.encode_to_vec().into(), request_id, caller: caller.to_owned() })
    }

    /// Takes a call for one hand in, and has it planned elsewhere when its turn comes.
    pub(super) fn begin_single_elsewhere(
        self: &Arc<Self>,
        call: Call,
        task: Task,
        elsewhere: Arc<dyn JobEngine>,
        wire: Wire,
        on_better: Option<OnBetter>,
    ) -> Result<Begun, ServiceError> {
        let budget = call.budget.within(task.job.budget);
        let order = self.order_elsewhere(&call, std::slice::from_ref(&task));
        let waiting = self.outgoing.admit(&budget, &order).map_err(|e| call.pool_error(&e))?;
        let position = waiting.position;
        let engine = Arc::clone(self);
        let answer = Box::pin(async move {
            let pass = match waiting.turn().await {
                Ok(pass) => pass,
                Err(PoolError::Expired) => return call.without_scene(call.late("in the queue"), &task),
                Err(error) => return Err(call.pool_error(&error)),
            };
            let kind = if on_better.is_some() { JobKind::StreamGrasps } else { JobKind::PlanGrasps };
            let mut job = engine.job(&call, std::slice::from_ref(&task), kind, wire);
            if kind == JobKind::StreamGrasps {
                // A field of a message around it, as it is on the wire: no copy of pixels is decoded for this.
                job.request = within_stream_request(&job.request);
            }
            let replies = elsewhere.submit(job).await?;
            let answer = last_reply(replies, on_better).await;
            if let Ok(response) = &answer {
                engine.learn(&call, &task, response, &pass);
                engine.health.planned(&task.hand().id).await;
            }
            answer
        });
        Ok(Begun { position, answer })
    }

    /// Has a call for several hands planned elsewhere, when its turn comes; ready with the first reply.
    pub(super) async fn begin_hands_elsewhere(
        &self,
        call: &Call,
        tasks: Vec<Task>,
        elsewhere: &dyn JobEngine,
        wire: Wire,
    ) -> Result<Vec<(Task, Planning)>, ServiceError> {
        let order = self.order_elsewhere(call, &tasks);
        let turn = async { self.outgoing.admit(&call.budget, &order)?.turn().await };
        let pass = match turn.await {
            Ok(pass) => pass,
            Err(error) => return Err(call.pool_error(&error)),
        };
        let mut replies = elsewhere.submit(self.job(call, &tasks, JobKind::PlanMultiHand, wire)).await?;
        // As here: a frame that cannot be read is an error of the call, and then the first reply.
        let first = replies.next().await.ok_or_else(ended_early)??;
        Ok(distribute(Box::pin(tokio_stream::once(Ok(first)).chain(replies)), tasks, pass))
    }

    /// What is known of how long tasks take elsewhere, the way there and back included.
    fn order_elsewhere(&self, call: &Call, tasks: &[Task]) -> Order {
        let mut order = call.order(tasks, call.scene_time());
        let detour = self.estimates.detour();
        if !order.estimate.least.is_zero() {
            order.estimate.least += detour;
        }
        order.estimate.expected += detour;
        order
    }

    /// An answer says how long its stages took elsewhere: what is expected of the next call.
    fn learn(&self, call: &Call, task: &Task, response: &v1::PlanGraspsResponse, pass: &Pass) {
        let Some(stats) = &response.stats else { return };
        let count = |n: i32| usize::try_from(n).unwrap_or(0);
        let stages = |names: &[&'static str]| -> Vec<(&'static str, Duration)> {
            let own = |stage: &v1::StageDuration| {
                let name = names.iter().find(|name| **name == stage.name)?;
                Some((*name, Duration::try_from(stage.duration?).ok()?))
            };
            stats.stages.iter().filter_map(own).collect()
        };
        let (scene, search) = (stages(&SCENE_STAGES), stages(&SEARCH_STAGES));
        let sum = |stages: &[(&str, Duration)]| stages.iter().map(|(_, took)| *took).sum::<Duration>();
        if scene.len() == SCENE_STAGES.len() {
            self.estimates.observe_scene(call.scene_kind(), sum(&scene));
        }
        self.estimates.observe_detour(pass.elapsed().saturating_sub(sum(&scene) + sum(&search)));
        let learned = PlanStats {
            candidates: count(stats.candidate_count),
            iterations: count(stats.iteration_count),
            stopped: stats.budget_exhausted.then_some(Stop::Deadline),
            stages: search,
            ..PlanStats::default()
        };
        self.estimates.observe_search(&task.hand().id, &learned);
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
fn distribute(mut replies: Replies, tasks: Vec<Task>, pass: Pass) -> Vec<(Task, Planning)> {
    let (mut senders, mut receivers) = (BTreeMap::new(), Vec::new());
    for task in tasks {
        let (sender, receiver) = oneshot::channel::<Answer>();
        senders.insert(task.id().to_owned(), sender);
        receivers.push((task, receiver));
    }
    // Dropped when nobody wants a reply any more.
    let (wanted, mut unwanted) = oneshot::channel::<()>();
    tokio::spawn(async move {
        // The call's turn ends with its replies.
        let _pass = pass;
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
