//! From a checked request to answers: one scene and one inference per request, then one job for each hand.

use std::sync::atomic::AtomicBool;
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use graspd_hands::Hand;
use graspd_live::Live;
use graspd_planner::budget::{Budget as _, Stop};
use graspd_planner::estimator::ContactEstimator;
use graspd_planner::grasp::Plan;
use graspd_planner::grid::{GridError, MAX_RESOLUTION, MAX_SIZE_M, MIN_RESOLUTION, MIN_SIZE_M};
use graspd_planner::options::{PlanOptions, Scheme};
use graspd_planner::scene::{self, Scene, SceneError};
use graspd_proto::v1;

use crate::answers::{Answers, Joined, RequestKey};
use crate::calibration::Calibration;
use crate::call_record::CallRecord;
use crate::caller::Caller;
use crate::convert::{HandJob, PlanContext, SceneRequest, out_of_time_response, plan_response};
use crate::deadline::{CallBudget, CallClock, Overrun};
use crate::error::{FieldError, FieldReason, ServiceError};
use crate::estimates::{Estimates, SceneKind};
use crate::estimators::Estimators;
use crate::health::Health;
use crate::jobs::JobEngine;
use crate::metrics::{Metrics, PlanOutcome};
use crate::pool::{Estimate, Flow, Order, Pool, PoolError, Priority, SceneRoom, Ticket, Turn};
use crate::recorder::{Recorder, new_plan_id};
use crate::registry::{HandStore, Registry};
use crate::scenes::{Scenes, SharedScene};
use crate::trace::{Stages, Tracer, Value};

mod begin;

pub(crate) use begin::{Begun, Wire};

/// Iterations that an answer needs to be worth having, where the caller takes the best so far.
const LEAST_ITERATIONS: usize = 20;

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
    /// Where hands that are created are kept, for other servers too.
    pub(crate) hand_store: Option<Arc<dyn HandStore>>,
}

/// A hand's answer.
pub(crate) type Answer = Result<v1::PlanGraspsResponse, ServiceError>;

/// Gets each better answer, on a planning thread.
pub(crate) type OnBetter = Box<dyn FnMut(v1::PlanGraspsResponse) + Send>;

/// A scene that is being prepared or is ready, and what is known of the call.
#[derive(Clone)]
pub(crate) struct Call {
    clock: CallClock,
    caller: Flow,
    /// Ends with the call; jobs take their share of it.
    pub(crate) budget: CallBudget,
    shared: Arc<SharedScene>,
    scene: Arc<SceneRequest>,
    estimator: Arc<dyn ContactEstimator>,
    overrun: Arc<Overrun>,
    estimates: Arc<Estimates>,
    metrics: Arc<Metrics>,
    calibration: Option<Arc<Calibration>>,
    tracer: Tracer,
    /// How long the call's first job waited, where others continue it.
    scene_queued: Arc<OnceLock<Duration>>,
}

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

/// A scene and how long it took.
#[derive(Debug)]
pub(crate) struct ReadScene {
    scene: Scene,
    /// Stages before those that the scene itself has timed.
    stages: Vec<(&'static str, Duration)>,
    invalid_pixels: usize,
    /// Given back when the last job of the call lets go of the scene.
    _room: SceneRoom,
}

impl ReadScene {
    /// The scene, and the stages before those that it has timed itself.
    pub(crate) fn parts(&self) -> (&Scene, &[(&'static str, Duration)]) {
        (&self.scene, &self.stages)
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

impl Call {
    /// The error of a call whose time is up.
    pub(crate) fn late(&self, stage: &'static str) -> ServiceError {
        ServiceError::Deadline { elapsed: self.clock.elapsed(), stage }
    }

    /// Ready when the last word must be sent; never, if the caller named no time.
    pub(crate) async fn answer_due(&self) {
        match self.clock.answer_deadline() {
            Some(deadline) => tokio::time::sleep_until(deadline.into()).await,
            None => std::future::pending().await,
        }
    }

    /// What was asked to be read, and the estimator's name.
    pub(crate) fn asked(&self) -> (&Arc<SceneRequest>, &str) {
        (&self.scene, self.estimator.name())
    }

    /// Time since the arrival.
    pub(crate) fn elapsed(&self) -> Duration {
        self.clock.elapsed()
    }

    /// The error of a job without a result.
    fn pool_error(&self, error: &PoolError) -> ServiceError {
        ServiceError::of_pool(error, || self.clock.elapsed())
    }

    /// What the scheduler is told of these tasks together, where the scene takes that long.
    fn order(&self, tasks: &[Task], scene: Duration) -> Order {
        let mut estimate = Estimate { least: scene, expected: scene };
        for task in tasks {
            let job = &task.job;
            let search = |iterations| self.estimates.search(&task.hand.id, job.options.batch, iterations);
            let whole = job.options.scheme.iterations;
            let (least, expected) = match (job.scheme_is_fixed, job.require_complete) {
                (true, true) => (search(whole), search(whole)),
                (true, false) => (search(whole.min(LEAST_ITERATIONS)), search(whole)),
                (false, _) => (search(Scheme::QUICK.iterations), search(Scheme::QUICK.iterations)),
            };
            estimate.least += least;
            estimate.expected += expected;
        }
        // A budget of the caller's own is spent as well as it can be: refused is only what would not begin in it.
        if tasks.iter().any(|task| task.job.budget.is_some() && !self.call_ends_first(task)) {
            estimate.least = Duration::ZERO;
        }
        Order {
            priority: tasks.iter().map(|t| t.job.priority).max().unwrap_or(Priority::Normal),
            caller: self.caller,
            hand: tasks.first().map_or(Flow(0), |t| Caller::number(&t.hand.id)),
            estimate,
        }
    }

    /// True for a job whose turn has come too late for the whole search that its caller insists on: the time would be
    /// wasted on it.
    fn is_hopeless(&self, task: &Task, budget: &CallBudget) -> bool {
        let (job, Some(deadline)) = (&task.job, budget.deadline()) else { return false };
        let iterations =
            if job.scheme_is_fixed { job.options.scheme.iterations } else { Scheme::QUICK.iterations };
        let scene = if self.shared.read().is_some() {
            Duration::ZERO
        } else {
            self.estimates.scene(&self.scene_kind())
        };
        let needs = scene + self.estimates.search(&task.hand.id, job.options.batch, iterations);
        // Estimates are on the careful side.
        job.require_complete && Instant::now() + needs.mul_f64(0.85) > deadline
    }

    /// How long the scene will take to read: nothing if another call has it already.
    fn scene_time(&self) -> Duration {
        if self.shared.is_unread() { self.estimates.scene(&self.scene_kind()) } else { Duration::ZERO }
    }

    fn scene_kind(&self) -> SceneKind {
        SceneKind {
            estimator: self.estimator.name().to_owned(),
            resolution: self.scene.options.grid.resolution,
            pixels_log2: self.scene.pixel_count().max(1).ilog2(),
        }
    }

    /// The options of a task: where the caller left the scheme open, the largest that fits before the deadline and
    /// lets waiting calls meet theirs.
    fn options(&self, task: &Task, turn: &Turn, began: Instant, budget: &CallBudget) -> PlanOptions {
        let options = &task.job.options;
        let needs = |s: Scheme| self.estimates.search(&task.hand.id, options.batch, s.iterations);
        let scheme = match budget.deadline() {
            Some(deadline) if !task.job.scheme_is_fixed => {
                let left = deadline.saturating_duration_since(Instant::now());
                let fits = |s: &Scheme| needs(*s) <= left && turn.has_time(needs(*s));
                [Scheme::THOROUGH, Scheme::BALANCED].into_iter().find(fits).unwrap_or(Scheme::QUICK)
            }
            _ => options.scheme,
        };
        turn.expect(began.elapsed() + needs(scheme));
        PlanOptions { scheme, ..options.clone() }
    }

    /// The scene: the one that another call has read, or read now. On a planning thread.
    fn read_scene(&self, turn: &mut Turn) -> Result<Arc<ReadScene>, ServiceError> {
        if let Some(read) = self.shared.read() {
            return Ok(read);
        }
        let reading = self.shared.reading();
        let read = self.prepare(&reading, turn.take_room()).map(|read| reading.done(read));
        // Whoever waited for it goes on, or reads it in this one's place.
        turn.wake_others();
        read
    }

    /// Decodes the frames and prepares the scene.
    fn prepare(&self, budget: &crate::scenes::Reading, room: SceneRoom) -> Result<ReadScene, ServiceError> {
        let began = Instant::now();
        let mut frames = Vec::with_capacity(self.scene.frames.len());
        let mut invalid_pixels = 0;
        for encoded in &self.scene.frames {
            let (frame, invalid) = encoded.decode()?;
            invalid_pixels += invalid;
            frames.push(frame);
        }
        let stages = vec![("decode", began.elapsed())];
        let scene = scene::prepare(&frames, &self.scene.options, self.estimator.as_ref(), budget)
            .map_err(|error| self.scene_error(&error))?;
        self.estimates.observe_scene(self.scene_kind(), began.elapsed());
        self.metrics.stages(stages.iter().chain(&scene.stages));
        let attributes = vec![("estimator", Value::Text(self.estimator.name().to_owned()))];
        self.tracer.stages(Stages {
            call: &self.clock.trace,
            name: "read scene",
            began,
            stages: stages.iter().chain(&scene.stages),
            attributes,
        });
        Ok(ReadScene { scene, stages, invalid_pixels, _room: room })
    }

    fn scene_error(&self, error: &SceneError) -> ServiceError {
        match error {
            SceneError::Stopped(Stop::Deadline) => self.late("while the scene was read"),
            SceneError::Stopped(Stop::Cancelled) => ServiceError::Cancelled,
            SceneError::ContactField(_) | SceneError::SolidSize { .. } => {
                ServiceError::Internal { what: format!("the contact estimator's answer: {error}") }
            }
            wrong => scene_fault(wrong, &self.scene).into(),
        }
    }

    /// Plans for one hand in a scene that is read; on a planning thread.
    fn plan(
        &self,
        read: &ReadScene,
        turn: &Turn,
        task: &Task,
        budget: &CallBudget,
        on_better: Option<OnBetter>,
    ) -> Answer {
        if budget.stop() == Some(Stop::Cancelled) {
            return Err(ServiceError::Cancelled);
        }
        let began = Instant::now();
        let options = self.options(task, turn, began, budget);
        let context = |elapsed| PlanContext {
            stages: &read.stages,
            invalid_pixels: read.invalid_pixels,
            queued: self.scene_queued.get().copied().unwrap_or_default() + turn.queued,
            elapsed,
            ..self.context(task)
        };
        let workspace = &read.scene.workspace;
        let context = &context;
        let mut tell = on_better.map(|mut on_better| {
            move |better: &Plan| on_better(plan_response(better, workspace, &context(self.elapsed())))
        });
        let plan = graspd_planner::plan::plan(
            &read.scene,
            &task.hand,
            &options,
            budget,
            tell.as_mut().map(|tell| tell as &mut dyn FnMut(&Plan)),
        );
        if let (Some(Stop::Deadline), Some(deadline)) = (plan.stats.stopped, budget.deadline()) {
            self.overrun.observe(deadline);
        }
        self.estimates.observe_search(&task.hand.id, &plan.stats);
        // The scene's own stages come first and were counted when it was read.
        self.metrics.stages(plan.stats.stages.iter().skip(read.scene.stages.len()));
        self.metrics.queued(task.job.priority, turn.queued);
        if let Some(queued_at) = began.checked_sub(turn.queued) {
            self.tracer.span(&self.clock.trace, "wait", (queued_at, began), Vec::new());
        }
        self.tracer.stages(Stages {
            call: &self.clock.trace,
            name: "search grasps",
            began,
            stages: plan.stats.stages.iter().skip(read.scene.stages.len()),
            attributes: vec![
                ("hand", Value::Text(task.hand.id.clone())),
                ("plan_id", Value::Text(task.plan_id.to_string())),
                ("grasps", Value::Number(plan.grasps.len())),
                ("iterations", Value::Number(plan.stats.iterations)),
            ],
        });
        let outcome = match plan.stats.stopped {
            Some(Stop::Cancelled) => PlanOutcome::Failed,
            _ if plan.grasps.is_empty() => PlanOutcome::NoGrasp,
            _ => PlanOutcome::Grasps,
        };
        self.metrics.plan(&task.hand.id, outcome);
        match plan.stats.stopped {
            Some(Stop::Cancelled) => Err(ServiceError::Cancelled),
            Some(Stop::Deadline)
                if task.job.require_complete || (plan.grasps.is_empty() && self.call_ends_first(task)) =>
            {
                Err(self.late("while grasps were searched"))
            }
            _ => Ok(plan_response(&plan, workspace, &context(budget.elapsed()))),
        }
    }

    /// The answer of a task that has no scene: where the caller's own budget ended it, that is an answer.
    pub(crate) fn without_scene(&self, error: ServiceError, task: &Task) -> Answer {
        let late = matches!(error, ServiceError::Deadline { .. });
        if late && !self.call_ends_first(task) && !task.job.require_complete {
            return Ok(out_of_time_response(&self.context(task)));
        }
        Err(error)
    }

    /// True when the call's own deadline comes before the end of the task's budget.
    fn call_ends_first(&self, task: &Task) -> bool {
        match (self.budget.deadline(), task.job.budget) {
            (None, _) => false,
            (Some(_), None) => true,
            (Some(deadline), Some(budget)) => deadline <= self.clock.arrived + budget,
        }
    }

    fn context<'a>(&'a self, task: &'a Task) -> PlanContext<'a> {
        PlanContext {
            hand: &task.hand,
            world: self.scene.world_frame_id(),
            camera: self.scene.camera_frame_id(),
            capture_time: self.scene.capture_time(),
            estimator: self.estimator.name(),
            seed: task.job.options.seed,
            plan_id: &task.plan_id,
            calibration: self.calibration.as_deref(),
            stages: &[],
            invalid_pixels: 0,
            queued: Duration::ZERO,
            elapsed: self.elapsed(),
        }
    }
}

/// The field of a request that does not make a scene. The conversion refuses nearly all of them before.
fn scene_fault(error: &SceneError, scene: &SceneRequest) -> FieldError {
    let value = |field: &str, found: &dyn std::fmt::Display, expected: &str| {
        FieldError::value(scene.field(field), found, expected)
    };
    match error {
        SceneError::NoFrames => FieldError::missing(scene.field("frames"), "at least one depth frame"),
        SceneError::Frame { index, source } => FieldError::new(
            FieldReason::Image,
            scene.field(&format!("frames[{index}]")),
            source,
            "a frame that can be read",
        ),
        SceneError::MissingPose { index, .. } => FieldError::missing(
            scene.field(&format!("frames[{index}].camera_pose")),
            "a pose for each of several frames",
        ),
        SceneError::Workspace { field: "table_m", found, expected } => {
            value("scene_options.workspace.table_height_m", found, expected)
        }
        SceneError::Workspace { found, expected, .. } => {
            value("scene_options.workspace.pose", found, expected)
        }
        SceneError::Region { field, found, expected } => {
            let field = if *field == "world_from_box" { "pose" } else { field };
            value(&format!("scene_options.grasp_region.{field}"), found, expected)
        }
        SceneError::Threshold { field, found } => {
            value(&format!("scene_options.{field}"), found, "a share from 0 to 1")
        }
        SceneError::Grid(GridError::Resolution { found }) => {
            let expected = format!("{MIN_RESOLUTION} to {MAX_RESOLUTION} voxels");
            value("scene_options.volume_resolution", found, &expected)
        }
        SceneError::Grid(GridError::Size { found }) => {
            value("scene_options.volume_size_m", found, &format!("{MIN_SIZE_M} to {MAX_SIZE_M}"))
        }
        other => value("scene_options", other, "options that make a scene"),
    }
}

#[cfg(test)]
mod tests;
