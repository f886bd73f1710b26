//! Clearing trays, as in the paper's Task 1 (Supplementary Note 7): look, plan, grasp, drop, until the tray is
//! empty.

use std::sync::Arc;

use graspd_hands::Hand;
use graspd_planner::estimator::ContactEstimator;
use graspd_planner::options::{PlanOptions, VolumeKind};
use graspd_sim::clutter::settle;
use graspd_sim::execute::ExecuteSettings;
use graspd_sim::object::Object;
use graspd_sim::scene;
use serde::{Deserialize, Serialize};

use super::EvaluationError;
use super::attempt::{Attempt, Class, Conditions, Figures, command};
use super::contents::{Contents, SETTLE_S, put_back};
use super::replay::FailedTrial;
use super::seeds::derive;
use super::station::Station;
use super::workers::in_turn;

/// A row of Supplementary Table 4.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Setup {
    /// One object in the tray.
    Single,
    /// Five objects in the tray, poured.
    Clutter,
}

impl Setup {
    /// As the table names it.
    pub fn title(self) -> &'static str {
        match self {
            Self::Single => "Single",
            Self::Clutter => "Clutter",
        }
    }
}

/// What is measured, and how.
#[derive(Debug, Clone)]
pub struct ClearSettings {
    /// The hands.
    pub hands: Vec<Arc<Hand>>,
    /// The objects, the same for every hand and for both setups; the supplement has 25.
    pub objects: Vec<Arc<Object>>,
    /// Objects in a tray of clutter; the supplement has 5.
    pub per_tray: usize,
    /// The setups.
    pub setups: Vec<Setup>,
    /// After so many failed attempts at one object it is taken away and counts as not cleared; after so many
    /// plans without a grasp in a row everything left in the tray is.
    pub give_up: usize,
    /// Same seed, same settings: same attempts.
    pub seed: u64,
    /// What the volume stores.
    pub volume: VolumeKind,
    /// How grasps are searched; the seed in it is not used.
    pub search: PlanOptions,
    /// How they are executed.
    pub execute: ExecuteSettings,
    /// Runs at the same time, each on one thread.
    pub workers: usize,
}

impl ClearSettings {
    /// Objects of one run.
    fn objects_of(&self, setup: Setup, run: usize) -> &[Arc<Object>] {
        let size = self.tray_size(setup);
        let begin = (run * size).min(self.objects.len());
        &self.objects[begin..(begin + size).min(self.objects.len())]
    }

    fn tray_size(&self, setup: Setup) -> usize {
        match setup {
            Setup::Single => 1,
            Setup::Clutter => self.per_tray,
        }
    }

    fn validate(&self) -> Result<(), EvaluationError> {
        let counts = [
            ("hands", self.hands.len()),
            ("objects", self.objects.len()),
            ("setups", self.setups.len()),
            ("per_tray", self.per_tray),
            ("give_up", self.give_up),
            ("workers", self.workers),
        ];
        match counts.into_iter().find(|&(_, n)| n == 0) {
            Some((field, _)) => {
                Err(EvaluationError::Setting { field, found: "0".into(), expected: "at least 1".into() })
            }
            None => Ok(()),
        }
    }
}

/// One object's fate in one run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Item {
    /// Name of the object.
    pub name: String,
    /// True when it was dropped in the container.
    pub cleared: bool,
    /// Executed grasps that meant it, the one that cleared it included.
    pub attempts: usize,
}

/// The number of candidates is doubled at most this often where plan after plan finds nothing.
const MOST_DOUBLINGS: usize = 2;

/// One tray, cleared or given up.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Run {
    /// Id of the hand.
    pub hand: String,
    /// Single object or clutter.
    pub setup: Setup,
    /// Which run, from 0.
    pub run: usize,
    /// Every attempt, in order.
    pub attempts: Vec<Attempt>,
    /// What became of every object.
    pub items: Vec<Item>,
    /// Times that an object had left the tray and was put back.
    pub put_back: usize,
    /// From the frame to the grasps, milliseconds on one thread; one per attempt. The only part of a run that
    /// differs from time to time.
    pub planning_ms: Vec<f64>,
}

/// Who wants to know while it runs; called from several threads.
pub trait Observer: Sync {
    /// An attempt has ended.
    fn attempt(&self, attempt: &Attempt);
    /// An attempt has failed; this is all it takes to see it again.
    fn failed(&self, trial: &FailedTrial);
    /// A run has ended.
    fn run(&self, run: &Run);
}

/// Nobody wants to know.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Observer for Silent {
    fn attempt(&self, _: &Attempt) {}
    fn failed(&self, _: &FailedTrial) {}
    fn run(&self, _: &Run) {}
}

/// Clears every tray with every hand. The runs are in the order of setups, hands and runs, and their attempts
/// do not depend on the number of workers.
///
/// # Errors
/// [`EvaluationError`] for settings of no use, and for what the planner or the world refuses.
pub fn clear(
    settings: &ClearSettings,
    station: &Station,
    estimator: &dyn ContactEstimator,
    observer: &dyn Observer,
) -> Result<Vec<Run>, EvaluationError> {
    settings.validate()?;
    let mut jobs = Vec::new();
    for &setup in &settings.setups {
        for hand in &settings.hands {
            let runs = settings.objects.len().div_ceil(settings.tray_size(setup));
            jobs.extend((0..runs).map(|run| (setup, hand, run)));
        }
    }
    let scene_options = station.scene_options(settings.volume);
    in_turn(jobs.len(), settings.workers, |index| {
        let (setup, hand, run) = jobs[index];
        let conditions = Conditions {
            station,
            hand,
            estimator,
            scene: &scene_options,
            search: &settings.search,
            execute: &settings.execute,
        };
        let done = clear_tray(settings, &conditions, setup, run, observer)?;
        observer.run(&done);
        Ok(done)
    })
}

/// One run. Setup, objects and noise are the same for every hand.
fn clear_tray(
    settings: &ClearSettings,
    conditions: &Conditions<'_>,
    setup: Setup,
    run: usize,
    observer: &dyn Observer,
) -> Result<Run, EvaluationError> {
    let objects = settings.objects_of(setup, run);
    let run_seed = derive(settings.seed, &[setup as u64, run as u64]);
    let mut world = conditions.station.poured(objects, derive(run_seed, &[0]))?;
    let mut contents = Contents::new(objects);
    let hand = conditions.hand.id.clone();
    let mut done = Run {
        hand: hand.clone(),
        setup,
        run,
        attempts: Vec::new(),
        items: Vec::new(),
        put_back: 0,
        planning_ms: Vec::new(),
    };
    // Plans without a grasp, or grasps of nothing, one after the other.
    let mut in_vain = 0;
    while !contents.present.is_empty() && in_vain < settings.give_up {
        let before = done.attempts.len() as u64;
        // Nobody is asked for an object that is not there.
        done.put_back += put_back(&mut world, conditions.station, derive(run_seed, &[3, before]));
        let number = done.attempts.len() + 1;
        let [noise_seed, plan_seed] = [1, 2].map(|purpose| derive(run_seed, &[purpose, number as u64]));
        // Every attempt begins in a world that was read from its file, so that it can be repeated from it exactly.
        let scene_json = scene::to_json(&world);
        world = scene::from_json(&scene_json)?;
        // Where nothing was found, twice as many hands look again.
        let batch = settings.search.batch << in_vain.min(MOST_DOUBLINGS);
        let search = PlanOptions { batch, ..settings.search.clone() };
        let conditions = &Conditions { search: &search, ..*conditions };
        let (plan, planning_ms) = conditions.plan(&world, noise_seed, plan_seed)?;
        done.planning_ms.push(planning_ms);
        let figures = Figures::of(&plan, conditions.hand);
        let mut attempt = Attempt {
            hand: hand.clone(),
            setup,
            run,
            number,
            class: Class::NoGrasp,
            other_held: false,
            meant: None,
            held: Vec::new(),
            objects: contents.present.len(),
            slip_m: 0.0,
            figures,
        };
        let executed = plan.grasps.first().map(command);
        if let Some(command) = &executed {
            let ids = world.ids();
            let trial = conditions.execute(&mut world, command, &mut |_, _| {});
            let place = |id| ids.iter().position(|&i| i == id);
            let meant = trial.meant.and_then(place);
            let mut held: Vec<usize> = trial.held.iter().filter_map(|&id| place(id)).collect();
            let name = |at: &usize| contents.items[contents.present[*at]].name.clone();
            attempt.class = Class::of(&trial);
            attempt.other_held = !held.is_empty() && meant.is_none_or(|m| !held.contains(&m));
            attempt.meant = meant.as_ref().map(name);
            attempt.held = held.iter().map(name).collect();
            attempt.slip_m = trial.slip_m;
            if let Some(at) = meant {
                contents.items[contents.present[at]].attempts += 1;
            }
            in_vain = if meant.is_some() || !held.is_empty() { 0 } else { in_vain + 1 };
            let mut gone = None;
            if attempt.class != Class::Success
                && let Some(at) = meant
            {
                let failures = &mut contents.failures[contents.present[at]];
                *failures += 1;
                gone = (*failures >= settings.give_up).then_some(at);
            }
            // What is held is dropped in the container; from the last to the first, so that places stay true.
            for &at in &held {
                contents.items[contents.present[at]].cleared = true;
            }
            held.extend(gone);
            held.sort_unstable();
            for &at in held.iter().rev() {
                contents.take(&mut world, at);
            }
            settle(&mut world, SETTLE_S);
        } else {
            in_vain += 1;
        }
        observer.attempt(&attempt);
        if attempt.class != Class::Success {
            let search = &search;
            observer.failed(&FailedTrial::new(
                &attempt,
                conditions.hand,
                &scene_json,
                executed,
                &settings.execute,
                search,
                settings.volume,
                [noise_seed, plan_seed],
            )?);
        }
        done.attempts.push(attempt);
    }
    done.items = contents.items;
    Ok(done)
}
