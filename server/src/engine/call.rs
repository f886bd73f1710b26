//! One call: what is known of it, its scene, and what planning for one of its hands takes and gives.

use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use graspd_planner::budget::{Budget as _, Stop};
use graspd_planner::estimator::ContactEstimator;
use graspd_planner::grasp::Plan;
use graspd_planner::options::{PlanOptions, Scheme};
use graspd_planner::scene::{self, Scene, SceneError};

use super::fault::scene_fault;
use super::{Answer, OnBetter, Task};
use crate::calibration::Calibration;
use crate::caller::Caller;
use crate::convert::{PlanContext, SceneRequest, out_of_time_response, plan_response};
use crate::deadline::{CallBudget, CallClock, Overrun};
use crate::error::ServiceError;
use crate::estimates::{Estimates, SceneKind};
use crate::metrics::{Metrics, PlanOutcome};
use crate::pool::{Estimate, Flow, Order, PoolError, Priority, SceneRoom, Turn};
use crate::scenes::SharedScene;
use crate::trace::{Stages, Tracer, Value};

/// Iterations that an answer needs to be worth having, where the caller takes the best so far.
const LEAST_ITERATIONS: usize = 20;

/// A scene that is being prepared or is ready, and what is known of the call.
#[derive(Clone)]
pub(crate) struct Call {
    pub(super) clock: CallClock,
    pub(super) caller: Flow,
    /// Ends with the call; jobs take their share of it.
    pub(crate) budget: CallBudget,
    pub(super) shared: Arc<SharedScene>,
    pub(super) scene: Arc<SceneRequest>,
    pub(super) estimator: Arc<dyn ContactEstimator>,
    pub(super) overrun: Arc<Overrun>,
    pub(super) estimates: Arc<Estimates>,
    pub(super) metrics: Arc<Metrics>,
    pub(super) calibration: Option<Arc<Calibration>>,
    pub(super) tracer: Tracer,
    /// How long the call's first job waited, where others continue it.
    pub(super) scene_queued: Arc<OnceLock<Duration>>,
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
    pub(super) fn pool_error(&self, error: &PoolError) -> ServiceError {
        ServiceError::of_pool(error, || self.clock.elapsed())
    }

    /// What the scheduler is told of these tasks together, where the scene takes that long.
    pub(super) fn order(&self, tasks: &[Task], scene: Duration) -> Order {
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
    pub(super) fn is_hopeless(&self, task: &Task, budget: &CallBudget) -> bool {
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
    pub(super) fn scene_time(&self) -> Duration {
        if self.shared.is_unread() { self.estimates.scene(&self.scene_kind()) } else { Duration::ZERO }
    }

    pub(super) fn scene_kind(&self) -> SceneKind {
        SceneKind {
            estimator: self.estimator.name().to_owned(),
            resolution: self.scene.options.grid.resolution,
            pixels_log2: self.scene.pixel_count().max(1).ilog2(),
        }
    }

    /// The options of a task: where the caller left the scheme open, the largest that fits before the deadline and
    /// lets waiting calls meet theirs.
    pub(super) fn options(
        &self,
        task: &Task,
        turn: &Turn,
        began: Instant,
        budget: &CallBudget,
    ) -> PlanOptions {
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
    pub(super) fn read_scene(&self, turn: &mut Turn) -> Result<Arc<ReadScene>, ServiceError> {
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
    pub(super) fn prepare(
        &self,
        budget: &crate::scenes::Reading,
        room: SceneRoom,
    ) -> Result<ReadScene, ServiceError> {
        let began = Instant::now();
        let mut frames = Vec::with_capacity(self.scene.frames.len());
        let mut invalid_pixels = 0;
        for encoded in &self.scene.frames {
            let (frame, invalid) = encoded.decode()?;
            invalid_pixels += invalid;
            frames.push(frame);
            budget.check().map_err(|stop| self.scene_error(&SceneError::Stopped(stop)))?;
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

    pub(super) fn scene_error(&self, error: &SceneError) -> ServiceError {
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
    pub(super) fn plan(
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
        let budget = &budget.clone().indivisible(task.job.require_complete);
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
    pub(super) fn call_ends_first(&self, task: &Task) -> bool {
        match (self.budget.deadline(), task.job.budget) {
            (None, _) => false,
            (Some(_), None) => true,
            (Some(deadline), Some(budget)) => deadline <= self.clock.arrived + budget,
        }
    }

    pub(super) fn context<'a>(&'a self, task: &'a Task) -> PlanContext<'a> {
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
