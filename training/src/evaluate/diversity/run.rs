//! A measurement of diversity: scenes, sources of contacts, plans, and what the best grasps touch.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use graspd_hands::Hand;
use graspd_planner::estimator::ContactEstimator;
use graspd_planner::options::{PlanOptions, Scheme, VolumeKind, WorkspaceRequest};
use graspd_planner::{plan, scene};
use graspd_sim::clutter::assortment;
use nalgebra::Point3;

use super::geometry::SimulatedGeometry;
use super::pattern::Pattern;
use crate::evaluate::EvaluationError;
use crate::evaluate::clock::Stopwatch;
use crate::evaluate::seeds::derive;
use crate::evaluate::station::Station;
use crate::evaluate::workers::in_turn;

/// Name of the baseline.
pub const GEOMETRY: &str = "simulated geometry";

/// What is measured, and how.
#[derive(Debug, Clone)]
pub struct DiversitySettings {
    /// The hands; Supplementary Note 6: Barrett Hand and LEAP Hand.
    pub hands: Vec<Arc<Hand>>,
    /// Scenes of clutter (Note 6: 30).
    pub scenes: usize,
    /// Objects in each, at least and at most.
    pub objects: [usize; 2],
    /// Plans of each scene, each with a seed of its own (Note 6: 48).
    pub repeats: usize,
    /// Best grasps of each plan (Note 6: 3).
    pub best: usize,
    /// Candidates (Note 6: 48).
    pub batch: usize,
    /// Iterations (Note 6: 200).
    pub scheme: Scheme,
    /// What the volume stores.
    pub volume: VolumeKind,
    /// Same seed, same numbers.
    pub seed: u64,
    /// Scenes at the same time, each on one thread.
    pub workers: usize,
}

/// A hand's grasps by the source of their contacts, in the order of the sources.
#[derive(Debug, Clone, PartialEq)]
pub struct HandPatterns {
    /// The hand.
    pub hand: Arc<Hand>,
    /// Name of the source, and what its grasps touch: simulated geometry first.
    pub sources: Vec<(String, Vec<Pattern>)>,
}

/// Plans in every scene with every source's contacts, and looks at what the best grasps touch. Does not depend on the
/// number of workers. `seen` is told after each scene how many of how many are done.
///
/// # Errors
/// [`EvaluationError`] for settings of no use, and for what the planner or the world refuses.
pub fn diversity(
    settings: &DiversitySettings,
    estimators: &[&dyn ContactEstimator],
    seen: &(dyn Fn(usize, usize) + Sync),
) -> Result<Vec<HandPatterns>, EvaluationError> {
    validate(settings)?;
    let done = AtomicUsize::new(0);
    let scenes = in_turn(settings.scenes, settings.workers, |index| {
        let patterns = of_scene(settings, estimators, index)?;
        seen(done.fetch_add(1, Ordering::Relaxed) + 1, settings.scenes);
        Ok(patterns)
    })?;
    let names = std::iter::once(GEOMETRY.to_owned()).chain(estimators.iter().map(|e| e.name().to_owned()));
    let names: Vec<String> = names.collect();
    let of_hand = |(at, hand): (usize, &Arc<Hand>)| HandPatterns {
        hand: Arc::clone(hand),
        sources: (names.iter().enumerate())
            .map(|(source, name)| {
                let all = scenes.iter().flat_map(|scene| scene[source][at].iter().cloned());
                (name.clone(), all.collect())
            })
            .collect(),
    };
    Ok(settings.hands.iter().enumerate().map(of_hand).collect())
}

fn validate(settings: &DiversitySettings) -> Result<(), EvaluationError> {
    let refuse = |field, found: String, expected: &str| {
        Err(EvaluationError::Setting { field, found, expected: expected.into() })
    };
    for (field, count) in [
        ("hands", settings.hands.len()),
        ("scenes", settings.scenes),
        ("objects", settings.objects[0]),
        ("repeats", settings.repeats),
        ("best", settings.best),
        ("batch", settings.batch),
        ("workers", settings.workers),
    ] {
        if count == 0 {
            return refuse(field, "0".into(), "at least 1");
        }
    }
    let [least, most] = settings.objects;
    if least > most {
        return refuse("objects", format!("{least} to {most}"), "the smaller number first");
    }
    Ok(())
}

/// The patterns of one scene: for each source, for each hand.
fn of_scene(
    settings: &DiversitySettings,
    estimators: &[&dyn ContactEstimator],
    index: usize,
) -> Result<Vec<Vec<Vec<Pattern>>>, EvaluationError> {
    let seed = derive(settings.seed, &[0, index as u64]);
    let [least, most] = settings.objects;
    let count = least + (derive(seed, &[0]) % (most - least + 1) as u64) as usize;
    let station = Station::table(&Point3::new(0.0, -0.2, 0.75));
    let world = station.poured(&assortment(count, derive(seed, &[1])), derive(seed, &[2]))?;
    let frame = station.frame(&world, derive(seed, &[3]));
    let options = station.scene_options(settings.volume);
    let WorkspaceRequest::Placed { world_from_volume, .. } = options.workspace else {
        return Err(EvaluationError::Setting {
            field: "workspace",
            found: "one that is looked for".into(),
            expected: "a placed one".into(),
        });
    };
    let known = SimulatedGeometry::new(&world, world_from_volume);
    let sources = std::iter::once(&known as &dyn ContactEstimator).chain(estimators.iter().copied());
    sources
        .map(|estimator| {
            let watch = Stopwatch::start();
            let scene = scene::prepare(std::slice::from_ref(&frame), &options, estimator, &watch)?;
            let of_hand = |hand: &Arc<Hand>| {
                let plans = (0..settings.repeats).map(|repeat| {
                    let search = PlanOptions {
                        batch: settings.batch,
                        scheme: settings.scheme,
                        seed: derive(seed, &[4, repeat as u64]),
                        max_grasps: settings.best,
                        ..PlanOptions::default()
                    };
                    plan::plan(&scene, hand, &search, &watch, None)
                });
                plans
                    .flat_map(|plan| plan.grasps)
                    .map(|grasp| Pattern::of(index, known.scene(), hand, &grasp))
                    .collect()
            };
            Ok(settings.hands.iter().map(of_hand).collect())
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use graspd_hands::library;
    use graspd_planner::estimator::Geometric;

    use super::super::report::DiversityReport;
    use super::*;

    fn settings(workers: usize) -> DiversitySettings {
        DiversitySettings {
            hands: vec![Arc::new(library::hand("barrett").unwrap().clone())],
            scenes: 2,
            objects: [3, 4],
            repeats: 2,
            best: 3,
            batch: 32,
            scheme: Scheme::QUICK,
            volume: VolumeKind::Tsdf,
            seed: 5,
            workers,
        }
    }

    #[test]
    fn a_small_measurement_repeats_itself_and_is_told_truly() {
        let measured = diversity(&settings(2), &[&Geometric], &|_, _| {}).unwrap();
        assert_eq!(measured, diversity(&settings(1), &[&Geometric], &|_, _| {}).unwrap());
        let sources = &measured[0].sources;
        assert_eq!(sources.iter().map(|s| s.0.as_str()).collect::<Vec<_>>(), [GEOMETRY, "geometric"]);
        for (name, patterns) in sources {
            assert!(!patterns.is_empty() && patterns.len() <= 2 * 2 * 3, "{name} {}", patterns.len());
            for pattern in patterns {
                assert!((0.0..=1.0).contains(&pattern.area) && pattern.fingers() <= 3, "{name} {pattern:?}");
            }
            // Planned grasps do touch something.
            let touching = patterns.iter().filter(|p| p.touches.len() >= 2).count();
            assert!(2 * touching > patterns.len(), "{name} {patterns:?}");
        }
        let report = DiversityReport::new(vec!["here".into()], &measured);
        let text = report.text();
        for words in ["Barrett", "contacted area", "engaged pads", GEOMETRY, "geometric"] {
            assert!(text.contains(words), "{words}\n{text}");
        }
    }

    #[test]
    fn settings_of_no_use_are_named() {
        let refused = |settings| diversity(&settings, &[], &|_, _| {}).unwrap_err().to_string();
        assert!(refused(DiversitySettings { repeats: 0, ..settings(1) }).starts_with("repeats: found 0"));
        assert!(
            refused(DiversitySettings { objects: [5, 4], ..settings(1) }).starts_with("objects: found 5")
        );
    }
}
