//! Ranked grasps and what became of each: every one is executed in a copy of the tray that was looked at.

use std::sync::Arc;

use graspd_hands::Hand;
use graspd_planner::estimator::ContactEstimator;
use graspd_planner::grasp::ScoreParts;
use graspd_planner::options::{PlanOptions, VolumeKind};
use graspd_sim::execute::ExecuteSettings;
use graspd_sim::object::Object;
use graspd_sim::scene;
use serde::{Deserialize, Serialize};

use crate::evaluate::attempt::{Conditions, command};
use crate::evaluate::clear::Setup;
use crate::evaluate::seeds::derive;
use crate::evaluate::station::Station;
use crate::evaluate::workers::in_turn;
use crate::evaluate::{Class, EvaluationError};

/// What is executed, and how it is planned.
#[derive(Debug, Clone)]
pub struct CalibrationSettings {
    /// The hands.
    pub hands: Vec<Arc<Hand>>,
    /// The objects, the same for every hand; each comes once alone and once in clutter.
    pub objects: Vec<Arc<Object>>,
    /// Objects in a tray of clutter.
    pub per_tray: usize,
    /// Same seed, same trays, plans and outcomes.
    pub seed: u64,
    /// What the volume stores.
    pub volume: VolumeKind,
    /// How grasps are searched, and how many of a plan are executed (`max_grasps`); the seed in it is not used.
    pub search: PlanOptions,
    /// How they are executed.
    pub execute: ExecuteSettings,
    /// Trays at the same time, each on one thread.
    pub workers: usize,
}

/// One executed grasp.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sample {
    /// Id of the hand.
    pub hand: String,
    /// Single object or clutter.
    pub setup: Setup,
    /// Tray, from 0.
    pub run: usize,
    /// Place in the ranking, from 0.
    pub rank: usize,
    /// The weighted mean of the score's parts, 0 to 1.
    pub figure: f64,
    /// Probability that graspd states for it.
    pub score: f64,
    /// What became of it.
    pub class: Class,
}

impl Sample {
    /// True when the object was lifted, held and shaken, and not lost.
    pub fn held(&self) -> bool {
        self.class == Class::Success
    }
}

/// Looks once at every tray with every hand, and executes every grasp of the plan, each in a world as it was when it
/// was looked at. Samples are in the order of setups, hands, trays and ranks; they do not depend on the number of
/// workers. `seen` is told after each tray how many of how many are done.
///
/// # Errors
/// [`EvaluationError`] for settings of no use, and for what the planner or the world refuses.
pub fn collect(
    settings: &CalibrationSettings,
    estimator: &dyn ContactEstimator,
    seen: &(dyn Fn(usize, usize) + Sync),
) -> Result<Vec<Sample>, EvaluationError> {
    validate(settings)?;
    let station = Station::tray();
    let scene_options = station.scene_options(settings.volume);
    let mut jobs = Vec::new();
    for (setup, size) in [(Setup::Single, 1), (Setup::Clutter, settings.per_tray)] {
        for hand in &settings.hands {
            jobs.extend(
                settings.objects.chunks(size).enumerate().map(|(run, objects)| (setup, hand, run, objects)),
            );
        }
    }
    let done = std::sync::atomic::AtomicUsize::new(0);
    let samples = in_turn(jobs.len(), settings.workers, |index| {
        let (setup, hand, run, objects) = jobs[index];
        let conditions = Conditions {
            station: &station,
            hand,
            estimator,
            scene: &scene_options,
            search: &settings.search,
            execute: &settings.execute,
        };
        let samples = of_tray(settings.seed, &conditions, setup, run, objects)?;
        seen(done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1, jobs.len());
        Ok(samples)
    })?;
    Ok(samples.into_iter().flatten().collect())
}

fn validate(settings: &CalibrationSettings) -> Result<(), EvaluationError> {
    let counts = [
        ("hands", settings.hands.len()),
        ("objects", settings.objects.len()),
        ("per_tray", settings.per_tray),
        ("grasps", settings.search.max_grasps),
        ("workers", settings.workers),
    ];
    match counts.into_iter().find(|&(_, n)| n == 0) {
        Some((field, _)) => {
            Err(EvaluationError::Setting { field, found: "0".into(), expected: "at least 1".into() })
        }
        None => Ok(()),
    }
}

/// One tray. Objects, pouring and noise are the same for every hand.
fn of_tray(
    seed: u64,
    conditions: &Conditions<'_>,
    setup: Setup,
    run: usize,
    objects: &[Arc<Object>],
) -> Result<Vec<Sample>, EvaluationError> {
    let seed = derive(seed, &[setup as u64, run as u64]);
    let poured = conditions.station.poured(objects, derive(seed, &[0]))?;
    // What is looked at is what is grasped: both are read from the same file.
    let file = scene::to_json(&poured);
    let (plan, _) = conditions.plan(&scene::from_json(&file)?, derive(seed, &[1]), derive(seed, &[2]))?;
    let executed = plan.grasps.iter().enumerate().map(|(rank, grasp)| {
        let mut world = scene::from_json(&file)?;
        let trial = conditions.execute(&mut world, &command(grasp), &mut |_, _| {});
        Ok(Sample {
            hand: conditions.hand.id.clone(),
            setup,
            run,
            rank,
            figure: ScoreParts::mean(&grasp.parts),
            score: grasp.score,
            class: Class::of(&trial),
        })
    });
    executed.collect()
}

#[cfg(test)]
mod tests {
    use graspd_planner::estimator::Geometric;
    use graspd_planner::options::Scheme;

    use super::*;
    use crate::evaluate::draw;

    #[test]
    fn samples_do_not_depend_on_the_number_of_workers() {
        let settings = |workers| CalibrationSettings {
            hands: vec![Arc::new(graspd_hands::library::hand("robotiq-2f85").unwrap().clone())],
            objects: draw(2, 0.078, 4),
            per_tray: 2,
            seed: 4,
            volume: VolumeKind::Tsdf,
            search: PlanOptions {
                batch: 16,
                scheme: Scheme { iterations: 60, with_penetration: 20 },
                max_grasps: 2,
                ..PlanOptions::default()
            },
            execute: ExecuteSettings::default(),
            workers,
        };
        let samples = collect(&settings(1), &Geometric, &|_, _| {}).unwrap();
        assert_eq!(samples, collect(&settings(3), &Geometric, &|_, _| {}).unwrap());
        assert!(!samples.is_empty() && samples.iter().all(|s| s.rank < 2 && (0.0..=1.0).contains(&s.figure)));
        let none = collect(&CalibrationSettings { per_tray: 0, ..settings(1) }, &Geometric, &|_, _| {});
        assert!(none.unwrap_err().to_string().contains("per_tray: found 0"));
    }
}
