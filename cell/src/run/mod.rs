//! Clearing a tray: the state machine that goes from step to step and obeys the table of recoveries.

mod attempt;
mod calls;
mod follow;
mod hold;
mod look;
mod palm;
mod picker;
mod question;
mod reach;
mod recover;
mod wrap_up;

use std::sync::Arc;

use graspd_adapters_core::{Arm, DepthCamera, Hand};
use nalgebra::{Isometry3, Vector3};
use tokio::time::Instant;

use crate::config::{CellConfig, ConfigError};
use crate::observer::{Event, Observer};
use crate::outcome::{End, Holding, Outcome};
use crate::plan::{GraspPlanner, HandFacts, PlannerError};
use crate::pose::pointing_down;
use crate::record::{RecordError, Recorder, RunInfo, StepRecord, TroubleRecord};
use crate::recovery::{Recovery, recovery};
use crate::report::{Report, Tally};
use crate::steps::{Step, Trouble};
use crate::witness::Witness;

use attempt::Attempt;
use calls::Problem;
pub(crate) use calls::{answered, seconds};
use follow::Servoing;
pub(crate) use look::looking;
pub(crate) use picker::{Chosen, Picker};
pub(crate) use question::Asked;

/// A robot cell: one camera that sees the tray, one arm with one hand, a planner.
#[derive(Debug, Clone)]
pub struct Cell {
    /// Sees the tray.
    pub camera: Arc<dyn DepthCamera>,
    /// Carries the hand.
    pub arm: Arc<dyn Arm>,
    /// Grasps.
    pub hand: Arc<dyn Hand>,
    /// Plans grasps: [`crate::plan::PlannerClient`].
    pub planner: Arc<dyn GraspPlanner>,
    /// Knows what became of objects, where somebody does.
    pub witness: Option<Arc<dyn Witness>>,
}

/// Why a run does not begin. Once it has begun it ends with a [`Report`].
#[derive(Debug, thiserror::Error)]
pub enum CellError {
    /// The configuration.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The planner does not know the hand, or was not there within its time.
    #[error(transparent)]
    Planner(#[from] PlannerError),
    /// The hand in the cell is not the hand that is planned for.
    #[error("actuators of {device}: found {found:?}, expected {expected:?}, those of hand {hand}")]
    Actuators {
        /// Name of the device.
        device: String,
        /// Its actuators.
        found: Vec<String>,
        /// Those of the planner's hand.
        expected: Vec<String>,
        /// The planner's hand.
        hand: String,
    },
    /// The folder of the record.
    #[error(transparent)]
    Record(#[from] RecordError),
}

/// Clears a tray (Supplementary Note 7, Task 1): looks, plans, grasps and drops until the tray is empty, the trials
/// are used up or something ends the run. What is done about trouble stands in [`crate::recovery::TABLE`].
///
/// It ends: each call to a device has its timeout, which is enforced here too; tries are bounded; no attempt begins
/// after the time limit. Dropping the future stops the motion that runs; what was recorded stays.
///
/// # Errors
/// [`CellError`] before anything has moved. After that every end is a [`Report`].
pub async fn clear_tray(
    cell: &Cell,
    config: &CellConfig,
    observer: &mut dyn Observer,
) -> Result<Report, CellError> {
    config.check()?;
    let facts = facts(&*cell.planner, config, observer).await?;
    Ok(Run::new(cell, config, facts, observer)?.until_it_ends().await)
}

impl<'a> Run<'a> {
    fn new(
        cell: &'a Cell,
        config: &'a CellConfig,
        facts: HandFacts,
        observer: &'a mut dyn Observer,
    ) -> Result<Self, CellError> {
        let expected: Vec<String> = facts.actuators.iter().map(|a| a.name.clone()).collect();
        let hand = cell.hand.info();
        let (mut a, mut b) = (hand.actuators.clone(), expected.clone());
        a.sort();
        b.sort();
        if a != b {
            let (device, found) = (hand.name, hand.actuators);
            return Err(CellError::Actuators { device, found, expected, hand: facts.id });
        }
        let recorder = config.recording.folder.as_ref().map(|folder| {
            let (camera, arm) = (cell.camera.info(), cell.arm.info());
            let info = RunInfo {
                graspd: env!("CARGO_PKG_VERSION").to_owned(),
                hand: facts.id.clone(),
                hand_revision: facts.revision.clone(),
                devices: [
                    format!("{}: {}", camera.name, camera.model),
                    format!("{}: {}", arm.name, arm.model),
                    hand.name.clone(),
                ],
                config: config.clone(),
            };
            Recorder::create(folder, &info)
        });
        let recorder = recorder.transpose()?;
        Ok(Self {
            cell,
            config,
            observer,
            places: Places::new(config, &facts),
            facts,
            began: Instant::now(),
            recorder,
            record_trouble: None,
            tally: Tally::default(),
            attempt: Attempt::new(1),
            step: Step::ClearView,
            current: None,
            tries: 0,
            holding: Holding::Unknown,
            empty_frames: 0,
            idle_attempts: 0,
            idle_since_success: 0,
            last_exposure: None,
            failed_poses: Vec::new(),
            prepared: false,
            servoing: None,
            led: false,
        })
    }
}

/// Asks the planner about the hand; waits for a planner that is starting.
pub(crate) async fn facts(
    planner: &dyn GraspPlanner,
    config: &CellConfig,
    observer: &mut dyn Observer,
) -> Result<HandFacts, PlannerError> {
    let limit = calls::seconds(config.timeouts.plan_s);
    let deadline = Instant::now() + limit;
    let mut before = 0;
    loop {
        match calls::answered(limit, planner.hand(&config.hand.id, limit)).await {
            Err(PlannerError::Away(text)) if Instant::now() < deadline && !observer.wants_end() => {
                if before == 0 {
                    let (step, trouble, recovery) = (Step::Plan, Trouble::PlannerAway, Recovery::Wait);
                    observer.on(&Event::Trouble { attempt: 1, step, trouble, text: &text, recovery });
                }
                tokio::time::sleep(config.recovery.backoff(before)).await;
                before += 1;
            }
            answer => return answer,
        }
    }
}

/// Where the hand goes besides grasps, as poses of its root link.
#[derive(Debug)]
struct Places {
    drop: Isometry3<f64>,
    wait: Isometry3<f64>,
    /// Height of the tool point when travelling, world frame, metres.
    travel_m: f64,
}

impl Places {
    fn new(config: &CellConfig, facts: &HandFacts) -> Self {
        let at = |position: &[f64; 3]| {
            let position = Vector3::from(*position);
            pointing_down(&facts.approach, &facts.lateral, &facts.tool_point, &position, config.drop.yaw_rad)
        };
        let drop = at(&config.drop.position_m);
        let wait = config.motion.wait_position_m.as_ref().map_or(drop, at);
        Self { drop, wait, travel_m: config.tray.floor_m() + config.motion.travel_height_m }
    }
}

/// What comes after a step.
enum Next {
    /// This step.
    Go(Step),
    /// The same step once more.
    Again,
    /// The attempt is over.
    Finished(Outcome),
    /// The run is over.
    End(End),
}

struct Run<'a> {
    cell: &'a Cell,
    config: &'a CellConfig,
    observer: &'a mut dyn Observer,
    facts: HandFacts,
    places: Places,
    began: Instant,
    recorder: Option<Recorder>,
    record_trouble: Option<String>,
    tally: Tally,
    attempt: Attempt,
    step: Step,
    /// The step's record, while it runs.
    current: Option<StepRecord>,
    /// Trouble in this step so far.
    tries: u32,
    holding: Holding,
    /// Frames in a row in which nothing was seen.
    empty_frames: u32,
    /// Attempts in a row that executed nothing although something was seen.
    idle_attempts: u32,
    /// The same, also where trials that failed lie between them.
    idle_since_success: u32,
    last_exposure: Option<u64>,
    /// Poses of grasps that failed since the last success.
    failed_poses: Vec<Isometry3<f64>>,
    /// True once the hand has been emptied at the drop pose.
    prepared: bool,
    /// The grasp that the planner carries on from frame to frame.
    servoing: Option<Servoing>,
    /// True for an arm of several: somebody else looks, plans and chooses, and says when it ends.
    led: bool,
}

impl Run<'_> {
    async fn until_it_ends(mut self) -> Report {
        loop {
            match self.one_step().await {
                Next::Again => {}
                Next::Go(step) => self.enter(step),
                Next::Finished(outcome) => {
                    if let Some(end) = self.finish_attempt(outcome).await {
                        return self.end(end).await;
                    }
                    self.attempt = Attempt::new(self.attempt.number + 1);
                    self.enter(Step::ClearView);
                }
                Next::End(end) => return self.end(end).await,
            }
        }
    }

    fn enter(&mut self, step: Step) {
        self.step = step;
        self.tries = 0;
    }

    async fn one_step(&mut self) -> Next {
        if self.step == Step::ClearView
            && self.tries == 0
            && !self.led
            && let Some(end) = self.must_end()
        {
            return Next::End(end);
        }
        self.open_step();
        let next = match self.perform().await {
            Ok(next) => {
                self.close_step(true);
                return next;
            }
            Err(problem) => self.met(problem).await,
        };
        if !matches!(next, Next::Again) {
            self.close_step(false);
        }
        next
    }

    async fn perform(&mut self) -> Result<Next, Problem> {
        match self.step {
            Step::ClearView => self.clear_view().await,
            Step::Capture => self.capture().await,
            Step::Plan => self.plan().await,
            Step::Open => self.open().await,
            Step::Pregrasp => self.pregrasp().await,
            Step::Follow => self.follow().await,
            Step::Approach => self.approach().await,
            Step::Close => self.close().await,
            Step::CheckContact => self.check_contact().await,
            Step::Lift => self.lift().await,
            Step::CheckHeld => self.check_held().await,
            Step::Carry => self.carry().await,
            Step::CheckDelivered => self.check_delivered().await,
            Step::Release => self.release().await,
            Step::Retreat => self.retreat().await,
        }
    }

    /// Looks trouble up in the table and does what it says.
    async fn met(&mut self, problem: Problem) -> Next {
        let rules = &self.config.recovery;
        let (before, tries) = match problem.trouble {
            // Counted over attempts, as each has its own frame.
            Trouble::NoGrasp => (self.idle_attempts, rules.no_grasp_frames - 1),
            _ => (self.tries, rules.tries),
        };
        let recovery = recovery(self.step, problem.trouble, before, tries);
        tracing::info!(step = %self.step, trouble = problem.trouble.name(), text = problem.text, ?recovery);
        self.observer.on(&Event::Trouble {
            attempt: self.attempt.number,
            step: self.step,
            trouble: problem.trouble,
            text: &problem.text,
            recovery,
        });
        if let Some(current) = &mut self.current {
            current.troubles.push(TroubleRecord::new(problem.trouble, &problem.text, recovery));
        }
        self.tries += 1;
        self.recover(recovery, problem).await
    }

    /// What forbids another attempt.
    fn must_end(&self) -> Option<End> {
        if self.observer.wants_end() {
            Some(End::Asked)
        } else if self.tally.trials >= self.config.run.trials {
            Some(End::Trials)
        } else if self.out_of_time() {
            Some(End::TimeLimit)
        } else {
            None
        }
    }

    fn out_of_time(&self) -> bool {
        self.began.elapsed() >= calls::seconds(self.config.run.time_limit_s)
    }

    fn open_step(&mut self) {
        if self.current.is_none() {
            let (attempt, step) = (self.attempt.number, self.step);
            let began_s = self.began.elapsed().as_secs_f64();
            self.current = Some(StepRecord { step, began_s, took_s: 0.0, done: false, troubles: Vec::new() });
            self.observer.on(&Event::StepBegan { attempt, step });
        }
    }

    fn close_step(&mut self, done: bool) {
        if let Some(mut record) = self.current.take() {
            record.took_s = self.began.elapsed().as_secs_f64() - record.began_s;
            record.done = done;
            self.observer.on(&Event::StepEnded { attempt: self.attempt.number, record: &record });
            self.attempt.steps.push(record);
        }
    }
}
