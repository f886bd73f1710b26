//! A measurement of average precision: scenes, views, plans and verdicts put together.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use graspd_hands::Hand;
use graspd_planner::budget::Budget as _;
use graspd_planner::estimator::ContactEstimator;
use graspd_planner::options::{PlanOptions, SceneOptions, Scheme, VolumeKind, WorkspaceRequest};
use graspd_planner::{plan, scene};
use graspd_sim::clutter::assortment;
use nalgebra::Point3;

use super::exact::Exact;
use super::jaw::{JawGrasp, Verdict};
use super::planned::jaw_grasp;
use super::report::{ApReport, ViewFigures, VolumeResult};
use crate::dataset::contacts::contacts;
use crate::dataset::oracle::Oracle;
use crate::dataset::recipe::Recipe;
use crate::evaluate::EvaluationError;
use crate::evaluate::clock::Stopwatch;
use crate::evaluate::seeds::derive;
use crate::evaluate::station::Station;
use crate::evaluate::workers::in_turn;

/// What is measured, and how.
#[derive(Debug, Clone)]
pub struct ApSettings {
    /// The parallel jaw; Supplementary Note 3 uses `antipodal`.
    pub hand: Arc<Hand>,
    /// Scenes of clutter.
    pub scenes: usize,
    /// Objects in each, at least and at most.
    pub objects: [usize; 2],
    /// Views of each scene, from around and above.
    pub views: usize,
    /// Kinds of volume.
    pub volumes: Vec<VolumeKind>,
    /// Candidates (Supplementary Note 3: 500).
    pub batch: usize,
    /// Iterations (Supplementary Note 3: 200).
    pub scheme: Scheme,
    /// Same seed, same numbers.
    pub seed: u64,
    /// Views at the same time, each on one thread.
    pub workers: usize,
    /// Plan from the contact dataset's labels of the exact scene instead of an estimator's contacts: what a network that
    /// had learnt all of them would reach.
    pub labels: bool,
    /// `T_fc` and `T_fe` (Supplementary Note 3: 0.7 and 0.95).
    pub thresholds: [f64; 2],
}

/// One view with one kind of volume.
struct View {
    job: usize,
    verdicts: Vec<Verdict>,
    planning_ms: f64,
    figures: ViewFigures,
}

/// Measures AP. The numbers do not depend on the number of workers. `seen` is told after each view how many of
/// how many are done; it is called from several threads.
///
/// # Errors
/// [`EvaluationError`] for settings of no use, and for what the planner refuses.
pub fn average(
    settings: &ApSettings,
    estimator: &dyn ContactEstimator,
    conditions: Vec<String>,
    seen: &(dyn Fn(usize, usize) + Sync),
) -> Result<ApReport, EvaluationError> {
    validate(settings)?;
    let per_scene = settings.views * settings.volumes.len();
    let done = AtomicUsize::new(0);
    let scenes = in_turn(settings.scenes, settings.workers, |index| {
        let told = || seen(done.fetch_add(1, Ordering::Relaxed) + 1, settings.scenes * per_scene);
        look_around(settings, estimator, index, &told)
    })?;
    let mut views: Vec<View> = scenes.into_iter().flatten().collect();
    views.sort_by_key(|v| v.job);
    let volumes = settings
        .volumes
        .iter()
        .enumerate()
        .map(|(i, &kind)| {
            let of_kind: Vec<&View> = views.iter().filter(|v| v.job % settings.volumes.len() == i).collect();
            let times: Vec<f64> = of_kind.iter().map(|v| v.planning_ms).collect();
            let verdicts: Vec<Vec<Verdict>> = of_kind.iter().map(|v| v.verdicts.clone()).collect();
            let figures: Vec<ViewFigures> = of_kind.iter().map(|v| v.figures).collect();
            VolumeResult::of(kind, &verdicts, &times, &figures)
        })
        .collect();
    Ok(ApReport { conditions, volumes })
}

fn validate(settings: &ApSettings) -> Result<(), EvaluationError> {
    let refuse = |field, found: String, expected: &str| {
        Err(EvaluationError::Setting { field, found, expected: expected.into() })
    };
    if settings.hand.actuation.actuator_count() != 1 || settings.hand.pads.len() != 2 {
        let found = format!("{} with {} pads", settings.hand.id, settings.hand.pads.len());
        return refuse("hand", found, "a parallel jaw with one actuator and two pads");
    }
    for (field, count) in [
        ("scenes", settings.scenes),
        ("views", settings.views),
        ("volumes", settings.volumes.len()),
        ("objects", settings.objects[0]),
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

/// One scene, from all views, with all kinds of volume.
fn look_around(
    settings: &ApSettings,
    estimator: &dyn ContactEstimator,
    index: usize,
    told: &dyn Fn(),
) -> Result<Vec<View>, EvaluationError> {
    let seed = derive(settings.seed, &[0, index as u64]);
    let [least, most] = settings.objects;
    let count = least + (derive(seed, &[0]) % (most - least + 1) as u64) as usize;
    let objects = assortment(count, derive(seed, &[1]));
    let table = Station::table(&Point3::new(0.0, 0.0, 0.75));
    let world = table.poured(&objects, derive(seed, &[2]))?;
    let exact = Exact::of(&world);
    let known = settings.labels.then(|| contacts(&world, &Recipe::default(), derive(seed, &[5])));
    let mut views = Vec::new();
    for view in 0..settings.views {
        let station = Station::table(&eye(settings.views, view));
        let frame = station.frame(&world, derive(seed, &[3, view as u64]));
        for (i, &kind) in settings.volumes.iter().enumerate() {
            let watch = Stopwatch::start();
            let [focal_contact_threshold, focal_centroid_threshold] = settings.thresholds;
            let scene_options = SceneOptions {
                focal_contact_threshold,
                focal_centroid_threshold,
                ..station.scene_options(kind)
            };
            let oracle = match (&known, scene_options.workspace) {
                (Some(contacts), WorkspaceRequest::Placed { world_from_volume, .. }) => {
                    Some(Oracle { contacts, world_from_volume })
                }
                _ => None,
            };
            let estimator = oracle.as_ref().map_or(estimator, |o| o as &dyn ContactEstimator);
            let scene = scene::prepare(std::slice::from_ref(&frame), &scene_options, estimator, &watch)?;
            let options = PlanOptions {
                batch: settings.batch,
                scheme: settings.scheme,
                seed: derive(seed, &[4, view as u64]),
                max_grasps: settings.batch,
                ..PlanOptions::default()
            };
            let plan = plan::plan(&scene, &settings.hand, &options, &watch, None);
            let planning_ms = watch.elapsed().as_secs_f64() * 1e3;
            let grasps: Vec<JawGrasp> =
                plan.grasps.iter().filter_map(|g| jaw_grasp(&settings.hand, g)).collect();
            let job = (index * settings.views + view) * settings.volumes.len() + i;
            let figures = ViewFigures::of(&plan.stats);
            views.push(View { job, verdicts: exact.judge(&grasps), planning_ms, figures });
            told();
        }
    }
    Ok(views)
}

/// Where a camera stands: from 25° to 65° from the vertical, all around, 0.7 m away, the views of a scene
/// evenly spread.
fn eye(views: usize, view: usize) -> Point3<f64> {
    let share = (view as f64 + 0.5) / views as f64;
    let polar = (25.0 + 40.0 * share).to_radians();
    // The golden angle.
    let azimuth = view as f64 * 2.399_963_229_728_653;
    let (sin, cos) = (polar.sin(), polar.cos());
    Point3::new(0.7 * sin * azimuth.cos(), 0.7 * sin * azimuth.sin(), 0.7 * cos)
}

#[cfg(test)]
mod tests {
    use graspd_hands::library;
    use graspd_planner::estimator::Geometric;

    use super::*;

    #[test]
    fn a_small_measurement_adds_up_and_repeats_itself() {
        let settings = ApSettings {
            hand: Arc::new(library::hand("antipodal").unwrap().clone()),
            scenes: 1,
            objects: [3, 3],
            views: 1,
            volumes: vec![VolumeKind::Tsdf, VolumeKind::Occupancy],
            batch: 48,
            scheme: Scheme::QUICK,
            seed: 3,
            workers: 2,
            labels: false,
            thresholds: [0.7, 0.95],
        };
        let told = AtomicUsize::new(0);
        let seen = |done, all| {
            assert!(done <= all && all == 2);
            told.fetch_add(1, Ordering::Relaxed);
        };
        let report = average(&settings, &Geometric, vec!["condition".into()], &seen).unwrap();
        assert_eq!(told.load(Ordering::Relaxed), 2);
        assert_eq!(
            report.volumes.iter().map(|v| v.volume.as_str()).collect::<Vec<_>>(),
            ["tsdf", "occupancy"]
        );
        assert!(report.volumes[0].grasps >= 1.0, "{report:?}");
        for volume in &report.volumes {
            let p = &volume.precision;
            // More friction holds no less.
            assert!(p.by_friction.windows(2).all(|w| w[0].1 <= w[1].1), "{p:?}");
            assert!(p.by_friction.iter().all(|(_, ap)| (0.0..=100.0).contains(ap)));
            let scored = if volume.grasps > 0.0 { 1.0 } else { 0.0 };
            assert!((volume.shares.iter().sum::<f64>() - scored).abs() < 1e-9, "{:?}", volume.shares);
        }
        let untimed =
            |report: ApReport| report.volumes.into_iter().map(|v| (v.precision, v.shares, v.grasps));
        let known = ApSettings { labels: true, volumes: vec![VolumeKind::Tsdf], ..settings.clone() };
        let known = average(&known, &Geometric, Vec::new(), &|_, _| {}).unwrap();
        assert!(known.volumes[0].grasps >= 1.0 && known.volumes[0].precision.ap > 0.0, "{known:?}");
        assert_ne!(known.volumes[0].precision, report.volumes[0].precision);
        let again =
            average(&ApSettings { workers: 1, ..settings }, &Geometric, Vec::new(), &|_, _| {}).unwrap();
        assert!(untimed(report).eq(untimed(again)));
    }

    #[test]
    fn settings_of_no_use_are_named() {
        let settings = ApSettings {
            hand: Arc::new(library::hand("leap").unwrap().clone()),
            scenes: 1,
            objects: [3, 3],
            views: 1,
            volumes: vec![VolumeKind::Tsdf],
            batch: 16,
            scheme: Scheme::QUICK,
            seed: 3,
            workers: 1,
            labels: false,
            thresholds: [0.7, 0.95],
        };
        let refused = |settings: &ApSettings| {
            average(settings, &Geometric, Vec::new(), &|_, _| {}).unwrap_err().to_string()
        };
        assert!(refused(&settings).starts_with("hand: found leap with "));
        let jaw = Arc::new(library::hand("antipodal").unwrap().clone());
        assert!(
            refused(&ApSettings { hand: jaw, objects: [4, 3], ..settings })
                .starts_with("objects: found 4 to 3")
        );
    }

    #[test]
    fn eyes_are_above_and_apart() {
        let eyes: Vec<_> = (0..6).map(|view| eye(6, view)).collect();
        for (i, a) in eyes.iter().enumerate() {
            assert!(a.z > 0.25 && (a.coords.norm() - 0.7).abs() < 1e-9);
            assert!(eyes[..i].iter().all(|b| (a - b).norm() > 0.2));
        }
    }
}
