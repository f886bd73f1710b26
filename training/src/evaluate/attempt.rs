//! One attempt: look, plan, execute the best grasp, and what is written down of it.

use std::collections::BTreeMap;
use std::sync::Arc;

use graspd_hands::Hand;
use graspd_planner::budget::Budget as _;
use graspd_planner::estimator::ContactEstimator;
use graspd_planner::grasp::{Grasp, Plan};
use graspd_planner::options::{PlanOptions, SceneOptions};
use graspd_planner::{plan, scene};
use graspd_sim::execute::{ExecuteSettings, Failure, GraspCommand, Moment, Trial, execute, set_down};
use graspd_sim::world::World;
use serde::{Deserialize, Serialize};

use super::EvaluationError;
use super::clear::Setup;
use super::clock::Stopwatch;
use super::station::Station;

/// What became of an attempt; the failures are those of Supplementary Fig. 8.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Class {
    /// At least one object was lifted, held and shaken, and not lost.
    Success,
    /// The planner returned no grasp, though there are objects.
    NoGrasp,
    /// See [`Failure::CollisionTable`].
    CollisionTable,
    /// See [`Failure::CollisionObject`].
    CollisionObject,
    /// See [`Failure::LostClosing`].
    LostClosing,
    /// See [`Failure::UnstableContact`].
    UnstableContact,
    /// See [`Failure::LostLifting`].
    LostLifting,
    /// See [`Failure::LostShaking`].
    LostShaking,
}

impl Class {
    /// All failures, in the order of the tables.
    pub const FAILURES: [Self; 7] = [
        Self::NoGrasp,
        Self::CollisionTable,
        Self::CollisionObject,
        Self::LostClosing,
        Self::UnstableContact,
        Self::LostLifting,
        Self::LostShaking,
    ];

    /// As people read it.
    pub fn title(self) -> &'static str {
        match self {
            Self::Success => "success",
            Self::NoGrasp => "no grasp found",
            Self::CollisionTable => "collision with table",
            Self::CollisionObject => "collision with object",
            Self::LostClosing => "lost while closing",
            Self::UnstableContact => "unstable contact",
            Self::LostLifting => "lost while lifting",
            Self::LostShaking => "lost while shaking",
        }
    }

    /// The class of an executed grasp. Any object in the container counts (Supplementary Note 7), also where it
    /// is not the one that was meant.
    pub(crate) fn of(trial: &Trial) -> Self {
        match trial.failure {
            None => Self::Success,
            Some(Failure::CollisionTable) => Self::CollisionTable,
            Some(Failure::CollisionObject) => Self::CollisionObject,
            Some(Failure::LostClosing) => Self::LostClosing,
            Some(Failure::UnstableContact) => Self::UnstableContact,
            Some(Failure::LostLifting) => Self::LostLifting,
            Some(Failure::LostShaking) => Self::LostShaking,
        }
    }
}

/// Why the planner returned nothing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Nothing {
    /// The planner's reason, for example `all_rejected`.
    pub reason: String,
    /// What would help.
    pub nearest_fix: String,
}

/// What the planner thought of its best grasp.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Figures {
    /// Score of the best grasp; 0 without one.
    pub score: f64,
    /// Its parts, by name.
    pub parts: BTreeMap<String, f64>,
    /// Ferrari-Canny margin of the best grasp.
    pub epsilon: f64,
    /// Clearance of the best grasp, metres.
    pub clearance_m: f64,
    /// Expected contacts of the best grasp, by name of the finger.
    pub contacts: Vec<String>,
    /// Grasps that were returned.
    pub grasps: usize,
    /// Focal contacts, focal centroids, centred centroids of the scene.
    pub features: [usize; 3],
    /// Candidates that were rejected, by reason.
    pub rejected: BTreeMap<String, usize>,
    /// Without a grasp: why.
    pub nothing: Option<Nothing>,
}

impl Figures {
    /// The figures of a plan.
    pub(crate) fn of(plan: &Plan, hand: &Hand) -> Self {
        let best = plan.grasps.first();
        let finger = |i: usize| hand.fingers.get(i).map_or_else(|| i.to_string(), |f| f.name.clone());
        Self {
            score: best.map_or(0.0, |g| g.score),
            parts: best.map_or_else(BTreeMap::new, |g| {
                let p = &g.parts;
                [
                    ("objective", p.objective),
                    ("force_closure", p.force_closure),
                    ("clearance", p.clearance),
                    ("certainty", p.certainty),
                ]
                .map(|(name, value)| (name.to_owned(), value))
                .into()
            }),
            epsilon: best.map_or(0.0, |g| g.epsilon),
            clearance_m: best.map_or(0.0, |g| g.clearance_m),
            contacts: best.map_or_else(Vec::new, |g| g.contacts.iter().map(|c| finger(c.finger)).collect()),
            grasps: plan.grasps.len(),
            features: [plan.stats.focal_contacts, plan.stats.focal_centroids, plan.stats.centered_centroids],
            rejected: plan.stats.rejected.iter().map(|(r, &n)| (r.as_str().to_owned(), n)).collect(),
            nothing: plan.no_grasp.as_ref().map(|n| Nothing {
                reason: n.reason.as_str().to_owned(),
                nearest_fix: n.nearest_fix.clone(),
            }),
        }
    }
}

/// One attempt, written down.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Attempt {
    /// Id of the hand.
    pub hand: String,
    /// Single object or clutter.
    pub setup: Setup,
    /// Run, from 0.
    pub run: usize,
    /// Attempt within the run, from 1.
    pub number: usize,
    /// What became of it.
    pub class: Class,
    /// True where something was held, but not what was meant.
    pub other_held: bool,
    /// Name of the object that was meant, where there was one.
    pub meant: Option<String>,
    /// Names of the objects that were held.
    pub held: Vec<String>,
    /// Objects in the tray before the attempt.
    pub objects: usize,
    /// How far the meant object slid in the hand, metres.
    pub slip_m: f64,
    /// What the planner thought.
    pub figures: Figures,
}

/// Everything that stays the same over the attempts of one hand.
#[derive(Clone, Copy)]
pub(crate) struct Conditions<'a> {
    pub(crate) station: &'a Station,
    pub(crate) hand: &'a Arc<Hand>,
    pub(crate) estimator: &'a dyn ContactEstimator,
    pub(crate) scene: &'a SceneOptions,
    pub(crate) search: &'a PlanOptions,
    pub(crate) execute: &'a ExecuteSettings,
}

impl Conditions<'_> {
    /// Looks at the world and plans; also how long that took, milliseconds.
    pub(crate) fn plan(
        &self,
        world: &World,
        noise_seed: u64,
        plan_seed: u64,
    ) -> Result<(Plan, f64), EvaluationError> {
        let frame = self.station.frame(world, noise_seed);
        let watch = Stopwatch::start();
        let scene = scene::prepare(&[frame], self.scene, self.estimator, &watch)?;
        let options =
            PlanOptions { seed: plan_seed, keep_out: self.station.keep_out(), ..self.search.clone() };
        let plan = plan::plan(&scene, self.hand, &options, &watch, None);
        Ok((plan, watch.elapsed().as_secs_f64() * 1e3))
    }

    /// Puts the hand into the world at the pre-grasp, open, executes, and takes the hand out again: what it
    /// held is left where it was.
    pub(crate) fn execute(
        &self,
        world: &mut World,
        command: &GraspCommand,
        watch: &mut dyn FnMut(Moment, &World),
    ) -> Trial {
        let id = set_down(world, self.hand, command);
        let trial = execute(world, id, command, self.execute, watch);
        world.remove_hand(id);
        trial
    }
}

/// What is executed of a planned grasp: poses and postures, without the planner's opinion.
pub fn command(grasp: &Grasp) -> GraspCommand {
    GraspCommand {
        world_from_pregrasp: grasp.world_from_pregrasp,
        world_from_hand: grasp.world_from_hand,
        open: grasp.actuators.open.clone(),
        contact: grasp.actuators.contact.clone(),
        squeezed: grasp.actuators.squeezed.clone(),
    }
}
