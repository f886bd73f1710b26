//! `graspd.v1.PlannerService`.

use std::hash::{DefaultHasher, Hasher as _};
use std::pin::Pin;
use std::sync::Arc;

use graspd_proto::v1;
use graspd_proto::v1::plan_record::Request as Recorded;
use graspd_proto::v1::planner_service_server::PlannerService;
use graspd_proto::v1::{plan_multi_hand_response, stream_grasps_response};
use tokio::sync::{mpsc, watch};
use tokio::task::JoinSet;
use tokio_stream::Stream;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status};

use super::{caller, clock};
use crate::answers::{Joined, Leader, RequestKey};
use crate::call_record::CallRecord;
use crate::caller::Caller;
use crate::convert::{self, AssignmentJob, HandJobs, Parsed, count_message, duration_message};
use crate::deadline::{CallClock, CancelOnDrop};
use crate::engine::{Answer, Begun, Call, Engine, OnBetter, Repeatable, Task, Wire};
use crate::error::{FieldError, ServiceError};
use crate::status;

/// The planning service.
#[derive(Debug, Clone)]
pub(crate) struct PlannerApi {
    /// What every call shares.
    pub(crate) engine: Arc<Engine>,
}

type BoxStream<T> = Pin<Box<dyn Stream<Item = Result<T, Status>> + Send>>;

#[tonic::async_trait]
impl PlannerService for PlannerApi {
    type StreamGraspsStream = BoxStream<v1::StreamGraspsResponse>;
    type PlanMultiHandStream = BoxStream<v1::PlanMultiHandResponse>;

    async fn plan_grasps(
        &self,
        request: Request<v1::PlanGraspsRequest>,
    ) -> Result<Response<v1::PlanGraspsResponse>, Status> {
        let (clock, caller) = (clock(request.extensions()), caller(request.extensions()));
        let request = request.into_inner();
        name_in_log(&request.request_id);
        let asked = asked(&request.request_id, &request);
        let record = self.record(request.record, &clock, || Recorded::PlanGrasps(request.clone()));
        let wire = self.engine.wire(&request, &caller.name);
        let Parsed { scene, jobs, request_id } =
            convert::plan_grasps(request, "").map_err(ServiceError::from)?;
        let task = self.engine.task(&caller, jobs)?;
        let call = self.engine.call(clock, &caller, scene)?;
        let _cancel = call.budget.cancel_on_drop();
        let repeatable = repeatable(request_id, &caller, asked);
        let plan = async || {
            let begun = self.engine.begin_single(&call, &task, wire, None)?;
            let mut answer = begun.answer.await;
            self.engine.leaves_alone(record, &task, &mut answer);
            answer
        };
        Ok(Response::new(self.engine.once(repeatable.as_ref(), plan).await?))
    }

    async fn stream_grasps(
        &self,
        request: Request<v1::StreamGraspsRequest>,
    ) -> Result<Response<Self::StreamGraspsStream>, Status> {
        let (clock, caller) = (clock(request.extensions()), caller(request.extensions()));
        let plan = request
            .into_inner()
            .plan
            .ok_or_else(|| ServiceError::from(FieldError::missing("plan", "a request")))?;
        name_in_log(&plan.request_id);
        let asked = asked(&plan.request_id, &plan);
        let record = self.record(plan.record, &clock, || Recorded::PlanGrasps(plan.clone()));
        let wire = self.engine.wire(&plan, &caller.name);
        let Parsed { scene, jobs, request_id } =
            convert::plan_grasps(plan, "plan").map_err(ServiceError::from)?;
        let task = self.engine.task(&caller, jobs)?;
        let call = self.engine.call(clock, &caller, scene)?;
        let cancel = call.budget.cancel_on_drop();
        let repeatable = repeatable(request_id, &caller, asked);
        let (sender, receiver) = mpsc::channel(4);
        let leader = match repeatable.as_ref().map(|r| self.engine.answers.join(&r.key, r.asked)) {
            None => None,
            Some(Joined::Lead(leader)) => Some(leader),
            Some(Joined::Reused) => return Err(ServiceError::RequestIdReused.into()),
            Some(Joined::Follow(_) | Joined::Answered(_)) => {
                let engine = Arc::clone(&self.engine);
                let stream = GraspStream { engine, call, task, record, sender, _cancel: cancel };
                tokio::spawn(stream.repeat(repeatable, wire));
                return Ok(Response::new(Box::pin(ReceiverStream::new(receiver))));
            }
        };
        let (better, improved) = watch::channel(None);
        let on_better: OnBetter = Box::new(move |response| {
            // Nobody may be listening any more; the budget tells the planner so.
            better.send(Some(response)).ok();
        });
        let begun = self.engine.begin_single(&call, &task, wire, Some(on_better))?;
        let engine = Arc::clone(&self.engine);
        let stream = GraspStream { engine, call, task, record, sender, _cancel: cancel };
        tokio::spawn(stream.run(begun, improved, leader));
        Ok(Response::new(Box::pin(ReceiverStream::new(receiver))))
    }

    async fn plan_multi_hand(
        &self,
        request: Request<v1::PlanMultiHandRequest>,
    ) -> Result<Response<Self::PlanMultiHandStream>, Status> {
        let (clock, caller) = (clock(request.extensions()), caller(request.extensions()));
        let request = request.into_inner();
        name_in_log(&request.request_id);
        let asked = asked(&request.request_id, &request);
        let mut record = self.record(request.record, &clock, || Recorded::PlanMultiHand(request.clone()));
        let wire = self.engine.wire(&request, &caller.name);
        let is_recorded = record.as_ref().is_some_and(CallRecord::is_recorded);
        let Parsed { scene, jobs, request_id } = convert::multi_hand(request).map_err(ServiceError::from)?;
        let HandJobs { jobs, assignment } = jobs;
        let tasks =
            jobs.into_iter().map(|job| self.engine.task(&caller, job)).collect::<Result<Vec<_>, _>>()?;
        let call = self.engine.call(clock, &caller, scene)?;
        let cancel = call.budget.cancel_on_drop();
        let repeatable = repeatable(request_id, &caller, asked);
        let (sender, receiver) = mpsc::channel(tasks.len() + 1);
        let plannings = self.engine.begin_hands(&call, tasks, wire, repeatable.is_none()).await?;
        let engine = Arc::clone(&self.engine);
        tokio::spawn(async move {
            let _cancel = cancel;
            let mut answers = JoinSet::new();
            for (task, planning) in plannings {
                let engine = Arc::clone(&engine);
                let repeatable = repeatable.as_ref().map(|r| r.task(&task));
                answers.spawn(async move {
                    let plan = async || {
                        let mut answer = planning().await;
                        engine.leaves(is_recorded, &mut answer);
                        answer
                    };
                    let answer = engine.once(repeatable.as_ref(), plan).await;
                    (task, answer)
                });
            }
            tokio::select! {
                biased;
                () = sender.closed() => {}
                () = send_results(&call, answers, assignment.as_ref(), &sender, &mut record) => {}
                () = call.answer_due() => {
                    // What has been answered is on its way; the rest was not done in time.
                    sender.send(Err(call.late("with hands that have no answer").into())).await.ok();
                }
            }
            if let Some(record) = record {
                engine.end_record(record);
            }
        });
        Ok(Response::new(Box::pin(ReceiverStream::new(receiver))))
    }

    async fn read_scene(
        &self,
        request: Request<v1::ReadSceneRequest>,
    ) -> Result<Response<v1::ReadSceneResponse>, Status> {
        let (clock, caller) = (clock(request.extensions()), caller(request.extensions()));
        Ok(Response::new(super::scene::read(&self.engine, clock, &caller, request.into_inner()).await?))
    }

    async fn report_outcome(
        &self,
        request: Request<v1::ReportOutcomeRequest>,
    ) -> Result<Response<v1::ReportOutcomeResponse>, Status> {
        let recorder = self.engine.recorder.as_ref().ok_or(ServiceError::NoRecording)?;
        let report = convert::report_outcome(request.into_inner()).map_err(ServiceError::from)?;
        let repeated_report = recorder.report(report).await?;
        Ok(Response::new(v1::ReportOutcomeResponse { repeated_report }))
    }
}

impl PlannerApi {
    /// Begins to keep a call, if it is to be recorded or shown.
    fn record(
        &self,
        asked: bool,
        clock: &CallClock,
        request: impl FnOnce() -> Recorded,
    ) -> Option<CallRecord> {
        self.engine.begin_record(asked, clock, request)
    }
}

/// The caller's name for the request, in each line of the log that is about it.
fn name_in_log(request_id: &str) {
    if !request_id.is_empty() {
        tracing::Span::current().record("request_id", convert::shortened(request_id));
    }
}

/// A hash of a request that has an id; 0 for one that has none.
fn asked(request_id: &str, request: &impl prost::Message) -> u64 {
    if request_id.is_empty() {
        return 0;
    }
    let mut hasher = DefaultHasher::new();
    hasher.write(&request.encode_to_vec());
    hasher.finish()
}

/// How a request is known again.
fn repeatable(request_id: Option<String>, caller: &Caller, asked: u64) -> Option<Repeatable> {
    let key = |request_id| RequestKey { caller: caller.identity(), request_id, task_id: String::new() };
    Some(Repeatable { key: key(request_id?), asked })
}

/// Sends each task's result as it comes, then the summary.
async fn send_results(
    call: &Call,
    mut answers: JoinSet<(Task, Answer)>,
    assignment: Option<&AssignmentJob>,
    sender: &mpsc::Sender<Result<v1::PlanMultiHandResponse, Status>>,
    record: &mut Option<CallRecord>,
) {
    let mut summary = v1::MultiHandSummary::default();
    let mut failed = 0;
    let (mut with, mut without) = (0, 0);
    let mut planned: Vec<(Task, v1::PlanGraspsResponse)> = Vec::new();
    while let Some(joined) = answers.join_next().await {
        // A task of the runtime ends early only when the runtime itself ends.
        let Ok((task, answer)) = joined else { return };
        if let Some(record) = record {
            record.push(task.id(), Some(task.hand()), &answer);
        }
        if let (Some(_), Ok(response)) = (assignment, &answer) {
            planned.push((task.clone(), response.clone()));
        }
        match &answer {
            Ok(response) if response.grasps.is_empty() => without += 1,
            Ok(_) => with += 1,
            Err(_) => failed += 1,
        }
        let outcome = match answer {
            Ok(response) => v1::hand_task_result::Outcome::Response(response),
            Err(error) => v1::hand_task_result::Outcome::Error(status::task_error(&error)),
        };
        let result = v1::HandTaskResult { task_id: task.id().to_owned(), outcome: Some(outcome) };
        let event = Some(plan_multi_hand_response::Event::Result(result));
        if sender.send(Ok(v1::PlanMultiHandResponse { event })).await.is_err() {
            return;
        }
    }
    summary.with_grasp_count = count_message(with);
    summary.without_grasp_count = count_message(without);
    summary.failed_count = count_message(failed);
    summary.assignment = assignment.map(|job| {
        job.assign(|id| planned.iter().find(|(task, _)| task.id() == id).map(|(task, r)| (&**task.hand(), r)))
    });
    summary.total_duration = Some(duration_message(call.elapsed()));
    let event = Some(plan_multi_hand_response::Event::Summary(summary));
    // A caller that left before the last message needs no summary.
    sender.send(Ok(v1::PlanMultiHandResponse { event })).await.ok();
}

/// The sending side of `StreamGrasps`.
struct GraspStream {
    engine: Arc<Engine>,
    call: Call,
    task: Task,
    record: Option<CallRecord>,
    sender: mpsc::Sender<Result<v1::StreamGraspsResponse, Status>>,
    /// Dropped with the stream: stops the planner.
    _cancel: CancelOnDrop,
}

impl GraspStream {
    async fn run(
        mut self,
        begun: Begun,
        mut improved: watch::Receiver<Option<v1::PlanGraspsResponse>>,
        leader: Option<Leader>,
    ) {
        let accepted = v1::Accepted { queue_position: count_message(begun.position) };
        if !self.send(Ok(stream_grasps_response::Event::Accepted(accepted))).await {
            return;
        }
        let mut answer = begun.answer;
        let expired = self.call.answer_due();
        tokio::pin!(expired);
        let mut more = true;
        loop {
            tokio::select! {
                biased;
                () = self.sender.closed() => return,
                mut answer = &mut answer => {
                    self.engine.leaves_alone(self.record.take(), &self.task, &mut answer);
                    if let (Some(leader), Ok(answer)) = (leader, &answer) {
                        leader.answer(answer);
                    }
                    self.send(answer.map(stream_grasps_response::Event::Finished)).await;
                    return;
                }
                () = &mut expired => {
                    self.send(Err(self.call.late("with nothing to answer"))).await;
                    return;
                }
                changed = improved.changed(), if more => {
                    // The planner lets go of its end when it is done; the answer follows.
                    more = changed.is_ok();
                    let better = improved.borrow_and_update().clone();
                    if let (true, Some(better)) = (more, better)
                        && !self.send(Ok(stream_grasps_response::Event::Improved(better))).await
                    {
                        return;
                    }
                }
            }
        }
    }

    /// The answer of the call that has the same id, without what it found on the way; this one plans only if that
    /// one ends without an answer.
    async fn repeat(mut self, repeatable: Option<Repeatable>, wire: Option<Wire>) {
        let accepted = v1::Accepted { queue_position: 0 };
        if !self.send(Ok(stream_grasps_response::Event::Accepted(accepted))).await {
            return;
        }
        let record = self.record.take();
        let plan = async || {
            let begun = self.engine.begin_single(&self.call, &self.task, wire, None)?;
            let mut answer = begun.answer.await;
            self.engine.leaves_alone(record, &self.task, &mut answer);
            answer
        };
        let answer = tokio::select! {
            biased;
            () = self.sender.closed() => return,
            answer = self.engine.once(repeatable.as_ref(), plan) => answer,
            () = self.call.answer_due() => Err(self.call.late("with nothing to answer")),
        };
        self.send(answer.map(stream_grasps_response::Event::Finished)).await;
    }

    /// False when the caller is gone.
    async fn send(&self, event: Result<stream_grasps_response::Event, ServiceError>) -> bool {
        let message =
            event.map(|event| v1::StreamGraspsResponse { event: Some(event) }).map_err(Status::from);
        self.sender.send(message).await.is_ok()
    }
}
