//! Failed trials, kept so that anyone can look at them: the world's file, the grasp, and what was thought of
//! it.

use std::sync::Arc;

use graspd_hands::Hand;
use graspd_planner::estimator::ContactEstimator;
use graspd_planner::options::{PlanOptions, Scheme, VolumeKind};
use graspd_sim::execute::{ExecuteSettings, GraspCommand, Moment};
use graspd_sim::scene;
use graspd_sim::world::World;
use serde::{Deserialize, Serialize};

use super::EvaluationError;
use super::attempt::{Attempt, Class, Conditions, Figures, command};
use super::station::Station;

/// The layout of the file; raised with every change that old files do not survive.
const VERSION: u32 = 1;

/// One failed attempt: all it takes to execute it again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FailedTrial {
    /// Layout of the file.
    pub version: u32,
    /// The attempt.
    pub attempt: Attempt,
    /// Revision of the hand's files.
    pub hand_revision: String,
    /// The grasp that was executed; none where none was found.
    pub command: Option<GraspCommand>,
    /// How it was executed.
    pub execute: ExecuteSettings,
    /// Candidates of the search.
    pub batch: usize,
    /// Iterations, and how many of them with penetration.
    pub scheme: [usize; 2],
    /// True where the volume stored occupancy.
    pub occupancy: bool,
    /// Seed of the depth camera's noise.
    pub noise_seed: u64,
    /// Seed of the search.
    pub plan_seed: u64,
    /// The world before the attempt, as the scene's own file.
    pub scene: serde_json::Value,
}

impl FailedTrial {
    #[expect(clippy::too_many_arguments, reason = "it gathers what one attempt consists of")]
    pub(crate) fn new(
        attempt: &Attempt,
        hand: &Hand,
        scene_json: &str,
        command: Option<GraspCommand>,
        execute: &ExecuteSettings,
        search: &PlanOptions,
        volume: VolumeKind,
        [noise_seed, plan_seed]: [u64; 2],
    ) -> Result<Self, EvaluationError> {
        Ok(Self {
            version: VERSION,
            attempt: attempt.clone(),
            hand_revision: hand.revision.clone(),
            command,
            execute: execute.clone(),
            batch: search.batch,
            scheme: [search.scheme.iterations, search.scheme.with_penetration],
            occupancy: volume == VolumeKind::Occupancy,
            noise_seed,
            plan_seed,
            scene: serde_json::from_str(scene_json)?,
        })
    }

    /// A name for its file, for example `leap_clutter_run3_attempt2_lost_lifting`.
    pub fn name(&self) -> String {
        let a = &self.attempt;
        let class = format!("{:?}", a.class);
        // LostLifting becomes lost_lifting.
        let mut snake = String::new();
        for c in class.chars() {
            if c.is_uppercase() && !snake.is_empty() {
                snake.push('_');
            }
            snake.extend(c.to_lowercase());
        }
        let setup = a.setup.title().to_lowercase();
        format!("{}_{setup}_run{}_attempt{}_{snake}", a.hand, a.run, a.number)
    }

    /// A trial from its file.
    ///
    /// # Errors
    /// [`EvaluationError`] for a file that is none, or of another layout.
    pub fn from_json(text: &str) -> Result<Self, EvaluationError> {
        let trial: Self = serde_json::from_str(text)?;
        if trial.version != VERSION {
            return Err(EvaluationError::Setting {
                field: "version",
                found: trial.version.to_string(),
                expected: VERSION.to_string(),
            });
        }
        Ok(trial)
    }

    /// Its file.
    ///
    /// # Errors
    /// [`EvaluationError::Trial`] for numbers that JSON has no words for.
    pub fn to_json(&self) -> Result<String, EvaluationError> {
        Ok(serde_json::to_string(self)?)
    }

    /// The world before the attempt.
    ///
    /// # Errors
    /// [`EvaluationError::World`] for a scene that cannot be read.
    pub fn world(&self) -> Result<World, EvaluationError> {
        Ok(scene::from_json(&self.scene.to_string())?)
    }

    /// How its search was asked.
    fn search(&self) -> PlanOptions {
        let [iterations, with_penetration] = self.scheme;
        PlanOptions {
            batch: self.batch,
            scheme: Scheme { iterations, with_penetration },
            ..PlanOptions::default()
        }
    }

    fn volume(&self) -> VolumeKind {
        if self.occupancy { VolumeKind::Occupancy } else { VolumeKind::Tsdf }
    }
}

/// What came of executing again.
#[derive(Debug, Clone, PartialEq)]
pub struct Replay {
    /// What became of it now.
    pub class: Class,
    /// True when it is what it was then.
    pub same: bool,
    /// What the planner thinks; without a new plan, what it thought then.
    pub figures: Figures,
    /// The grasp.
    pub command: Option<GraspCommand>,
}

/// Executes the grasp of a failed trial again; `watch` sees the moments that are worth a picture.
/// A trial in which no grasp was found has nothing to execute and stays what it was.
///
/// # Errors
/// [`EvaluationError`] for a world that cannot be read.
pub fn replay(
    trial: &FailedTrial,
    hand: &Arc<Hand>,
    estimator: &dyn ContactEstimator,
    watch: &mut dyn FnMut(Moment, &World),
) -> Result<Replay, EvaluationError> {
    under(trial, hand, estimator, |conditions| {
        again(trial, conditions, trial.command.clone(), trial.attempt.figures.clone(), watch)
    })
}

/// Looks at the world of a failed trial again, with the same noise, plans as the planner plans today, and
/// executes.
///
/// # Errors
/// [`EvaluationError`] for a world that cannot be read.
pub fn plan_again(
    trial: &FailedTrial,
    hand: &Arc<Hand>,
    estimator: &dyn ContactEstimator,
    watch: &mut dyn FnMut(Moment, &World),
) -> Result<Replay, EvaluationError> {
    under(trial, hand, estimator, |conditions| {
        let (plan, _) = conditions.plan(&trial.world()?, trial.noise_seed, trial.plan_seed)?;
        again(trial, conditions, plan.grasps.first().map(command), Figures::of(&plan, hand), watch)
    })
}

/// Does something under the conditions of a trial.
fn under<T>(
    trial: &FailedTrial,
    hand: &Arc<Hand>,
    estimator: &dyn ContactEstimator,
    what: impl FnOnce(&Conditions<'_>) -> Result<T, EvaluationError>,
) -> Result<T, EvaluationError> {
    let station = Station::tray();
    what(&Conditions {
        station: &station,
        hand,
        estimator,
        scene: &station.scene_options(trial.volume()),
        search: &trial.search(),
        execute: &trial.execute,
    })
}

fn again(
    trial: &FailedTrial,
    conditions: &Conditions<'_>,
    command: Option<GraspCommand>,
    figures: Figures,
    watch: &mut dyn FnMut(Moment, &World),
) -> Result<Replay, EvaluationError> {
    let mut world = trial.world()?;
    let class = match &command {
        Some(command) => Class::of(&conditions.execute(&mut world, command, watch)),
        None => {
            watch(Moment::Before, &world);
            Class::NoGrasp
        }
    };
    Ok(Replay { class, same: class == trial.attempt.class, figures, command })
}
