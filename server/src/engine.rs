//! From a checked request to answers: one scene and one inference per request, then one job for each hand.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use graspd_hands::Hand;
use graspd_live::Live;
use graspd_proto::v1;

use crate::answers::{Answers, Joined, RequestKey};
use crate::calibration::Calibration;
use crate::call_record::CallRecord;
use crate::caller::Caller;
use crate::convert::{HandJob, SceneRequest};
use crate::deadline::{CallBudget, CallClock, Overrun};
use crate::error::ServiceError;
use crate::estimates::Estimates;
use crate::estimators::Estimators;
use crate::health::Health;
use crate::jobs::JobEngine;
use crate::metrics::Metrics;
use crate::outgoing::Outgoing;
use crate::pool::{Flow, Order, Pool, PoolError, Ticket};
use crate::recorder::{Recorder, new_plan_id};
use crate::registry::{HandStore, Registry};
use crate::scenes::Scenes;
use crate::trace::Tracer;

mod begin;
mod call;
mod elsewhere;
mod fault;

pub(crate) use begin::Begun;
pub(crate) use call::{Call, ReadScene};
pub(crate) use elsewhere::Wire;

/// What every call shares.
#[derive(Debug)]
pub(crate) struct Engine {
    /// Where planning runs.
    pub(crate) pool: Pool,
    /// The hands.
    pub(crate) registry: Registry,
    /// The contact estimators.
    pub(crate) estimators: Estimators,
    /// Set when the server ends and running jobs are not waited for any longer.
    pub(crate) aborted: Arc<AtomicBool>,
    /// How far jobs run past their end.
    pub(crate) overrun: Arc<Overrun>,
    /// How long jobs take.
    pub(crate) estimates: Arc<Estimates>,
    /// What is counted and timed.
    pub(crate) metrics: Arc<Metrics>,
    /// Scenes that calls share.
    pub(crate) scenes: Scenes,
    /// Answers by request id.
    pub(crate) answers: Arc<Answers>,
    /// Records calls, where somebody wants that.
    pub(crate) recorder: Option<Recorder>,
    /// Shows calls to viewers, where somebody wants that.
    pub(crate) live: Option<Live>,
    /// What scores become on their way out.
    pub(crate) calibration: Option<Arc<Calibration>>,
    /// Who is well.
    pub(crate) health: Health,
    /// Spans on their way out.
    pub(crate) tracer: Tracer,
    /// Who plans instead of this process.
    pub(crate) elsewhere: Option<Arc<dyn JobEngine>>,
    /// Calls on their way there.
    pub(crate) outgoing: Outgoing,
    /// Where hands that are created are kept, for other servers too.
    pub(crate) hand_store: Option<Arc<dyn HandStore>>,
}

/// A hand's answer.
pub(crate) type Answer = Result<v1::PlanGraspsResponse, ServiceError>;

/// Gets each better answer, on a planning thread.
pub(crate) type OnBetter = Box<dyn FnMut(v1::PlanGraspsResponse) + Send>;

/// A request that may be repeated: its name, and what was asked.
#[derive(Debug, Clone)]
pub(crate) struct Repeatable {
    /// Its name.
    pub(crate) key: RequestKey,
    /// A hash of the request.
    pub(crate) asked: u64,
}

impl Repeatable {
    /// The same for one of its tasks.
    pub(crate) fn task(&self, task: &Task) -> Self {
        Self { key: RequestKey { task_id: task.id().to_owned(), ..self.key.clone() }, asked: self.asked }
    }
}

/// What one hand's job needs.
#[derive(Clone)]
pub(crate) struct Task {
    hand: Arc<Hand>,
    job: Arc<HandJob>,
    /// The plan's name.
    plan_id: Arc<str>,
}

impl Task {
    /// The caller's name for it.
    pub(crate) fn id(&self) -> &str {
        &self.job.task_id
    }

    /// The hand.
    pub(crate) fn hand(&self) -> &Arc<Hand> {
        &self.hand
    }
}

impl Engine {
    /// A call with its scene; unknown estimators are found before anything is queued.
    pub(crate) fn call(
        &self,
        clock: CallClock,
        caller: &Caller,
        scene: SceneRequest,
    ) -> Result<Call, ServiceError> {
        let estimator = self.estimators.get(scene.estimator.as_deref())?;
        let budget = self.budget(&clock);
        let scene = Arc::new(scene);
        let shared = self.scenes.get(&scene, Arc::clone(&estimator));
        Ok(Call {
            clock,
            caller: caller.flow,
            budget,
            shared,
            scene,
            estimator,
            overrun: Arc::clone(&self.overrun),
            estimates: Arc::clone(&self.estimates),
            metrics: Arc::clone(&self.metrics),
            calibration: self.calibration.clone(),
            tracer: self.tracer.clone(),
            scene_queued: Arc::default(),
        })
    }

    /// The budget of a call's work.
    pub(crate) fn budget(&self, clock: &CallClock) -> CallBudget {
        let deadline = clock.planning_deadline(self.overrun.expected());
        CallBudget::new(clock.arrived, deadline).abort_with(&self.aborted)
    }

    /// A task with its hand.
    pub(crate) fn task(&self, caller: &Caller, mut job: HandJob) -> Result<Task, ServiceError> {
        if job.priority > caller.most_urgent {
            let (asked, most_urgent) = (job.priority.name(), caller.most_urgent.name());
            return Err(ServiceError::TooUrgent { asked, caller: caller.name.to_string(), most_urgent });
        }
        if let Some(calibration) = &self.calibration
            && job.options.min_score > 0.0
        {
            // The caller speaks of the score that it gets to see.
            job.options.min_score = calibration.score(job.options.min_score);
        }
        let hand = self.registry.get(&job.hand_id)?.hand;
        Ok(Task { hand, job: Arc::new(job), plan_id: new_plan_id().into() })
    }

    /// An answer leaves: outcomes may be reported for it, and it says whether it is recorded.
    pub(crate) fn leaves(&self, is_recorded: bool, answer: &mut Answer) {
        if let (Some(recorder), Ok(response)) = (&self.recorder, answer) {
            response.recorded = is_recorded;
            recorder.remember(response);
        }
    }

    /// The one answer of a call leaves.
    pub(crate) fn leaves_alone(&self, record: Option<CallRecord>, task: &Task, answer: &mut Answer) {
        self.leaves(record.as_ref().is_some_and(CallRecord::is_recorded), answer);
        if let Some(mut record) = record {
            record.push(task.id(), Some(task.hand()), answer);
            self.end_record(record);
        }
    }

    /// Queues a call for one hand as one job. `on_better` gets each better answer, on a planning thread.
    pub(crate) fn submit_single(
        &self,
        call: &Call,
        task: &Task,
        on_better: Option<OnBetter>,
    ) -> Result<Ticket<Answer>, ServiceError> {
        let (job_call, job_task) = (call.clone(), task.clone());
        let budget = call.budget.within(task.job.budget);
        let job_budget = budget.clone();
        let order = call.order(std::slice::from_ref(task), call.scene_time());
        call.shared.want(&budget);
        let gate = Arc::clone(&call.shared) as Arc<dyn crate::pool::Gate>;
        let ticket = self.pool.submit(&budget, &order, Some(gate), move |mut turn| {
            if job_call.is_hopeless(&job_task, &job_budget) {
                return Err(job_call.late("in the queue"));
            }
            match job_call.read_scene(&mut turn) {
                Ok(read) => job_call.plan(&read, &turn, &job_task, &job_budget, on_better),
                Err(error) => job_call.without_scene(error, &job_task),
            }
        });
        ticket.map_err(|e| call.pool_error(&e))
    }

    /// Queues the reading of a scene for several hands.
    pub(crate) fn submit_scene(
        &self,
        call: &Call,
        tasks: &[Task],
    ) -> Result<Ticket<Result<Arc<ReadScene>, ServiceError>>, ServiceError> {
        // The scene may take as long as the most patient task.
        let longest = tasks.iter().map(|t| t.job.budget).reduce(|a, b| Some(a?.max(b?))).flatten();
        let budget = call.budget.within(longest);
        let order = Order { hand: Flow(0), ..call.order(tasks, call.scene_time()) };
        let job_call = call.clone();
        call.shared.want(&budget);
        let gate = Arc::clone(&call.shared) as Arc<dyn crate::pool::Gate>;
        let ticket = self.pool.submit(&budget, &order, Some(gate), move |mut turn| {
            job_call.scene_queued.set(turn.queued).ok();
            job_call.read_scene(&mut turn)
        });
        ticket.map_err(|e| call.pool_error(&e))
    }

    /// Queues one hand's share of a call whose scene is read.
    pub(crate) fn submit_hand(
        &self,
        call: &Call,
        read: &Arc<ReadScene>,
        task: &Task,
    ) -> Result<Ticket<Answer>, ServiceError> {
        let (job_call, job_read, job_task) = (call.clone(), Arc::clone(read), task.clone());
        let budget = call.budget.within(task.job.budget);
        let job_budget = budget.clone();
        let order = call.order(std::slice::from_ref(task), Duration::ZERO);
        let ticket = self.pool.submit_continuation(&budget, &order, move |turn| {
            job_call.plan(&job_read, &turn, &job_task, &job_budget, None)
        });
        ticket.map_err(|e| call.pool_error(&e))
    }

    /// Plans once for all calls with the same request id: leads, or gets the answer of the one that does.
    pub(crate) async fn once<P>(&self, repeatable: Option<&Repeatable>, plan: P) -> Answer
    where
        P: AsyncFnOnce() -> Answer,
    {
        let Some(Repeatable { key, asked }) = repeatable else { return plan().await };
        loop {
            match self.answers.join(key, *asked) {
                Joined::Lead(leader) => {
                    let answer = plan().await?;
                    leader.answer(&answer);
                    return Ok(answer);
                }
                // Closed when the leader has ended, which is all there is to learn.
                Joined::Follow(mut ended) => drop(ended.changed().await),
                Joined::Answered(answer) => return Ok((*answer).clone()),
                Joined::Reused => return Err(ServiceError::RequestIdReused),
            }
        }
    }

    /// Tasks in the order in which they are queued: the quickest first, so that none waits for a slow one that could
    /// as well come after it. Those of which nothing is known go by how much they search.
    pub(crate) fn quickest_first(&self, tasks: &mut [Task]) {
        tasks.sort_by_cached_key(|task| {
            let options = &task.job.options;
            let iterations = options.scheme.iterations;
            let takes = self.estimates.search(&task.hand.id, options.batch, iterations);
            (takes, options.batch * iterations)
        });
    }

    /// Waits for a task's answer.
    pub(crate) async fn answer(&self, call: &Call, task: &Task, ticket: Ticket<Answer>) -> Answer {
        let budget = call.budget.within(task.job.budget);
        let done = self.finish(&budget, ticket).await;
        match &done {
            Ok(Ok(_)) => self.health.planned(&task.hand.id).await,
            Err(PoolError::Panicked) => self.health.crashed(&task.hand.id).await,
            _ => {}
        }
        match done {
            Ok(answer) => answer,
            Err(PoolError::Expired) => call.without_scene(call.late("in the queue"), task),
            Err(error) => Err(call.pool_error(&error)),
        }
    }

    /// Waits for a scene.
    pub(crate) async fn scene(
        &self,
        call: &Call,
        ticket: Ticket<Result<Arc<ReadScene>, ServiceError>>,
    ) -> Result<Arc<ReadScene>, ServiceError> {
        match self.finish(&call.budget, ticket).await {
            Ok(read) => read,
            Err(error) => Err(call.pool_error(&error)),
        }
    }

    /// Waits for a job; at its deadline it leaves the queue if it is still there.
    pub(crate) async fn finish<T>(&self, budget: &CallBudget, mut ticket: Ticket<T>) -> Result<T, PoolError> {
        if let Some(deadline) = budget.deadline() {
            let wait = tokio::time::timeout_at(deadline.into(), ticket.wait());
            match wait.await {
                Ok(done) => return done,
                Err(_) => self.pool.drop_dead(),
            }
        }
        ticket.wait().await
    }
}

#[cfg(test)]
mod tests;
