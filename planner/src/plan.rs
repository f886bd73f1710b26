//! Planning for one hand in a prepared scene: initialize, optimize, rank.

use graspd_hands::Hand;
use nalgebra::{Isometry3, Vector3};

use crate::budget::{Budget, Stop};
use crate::grasp::{EmptyReason, NoGrasp, ObjectiveTerms, Plan, PlanStats, RejectReason};
use crate::hand_model::HandModel;
use crate::init::Initializer;
use crate::objective::{Objective, Obstacles, Weights};
use crate::optimize::{Batch, Candidate, StepSizes};
use crate::options::{PlanOptions, Target};
use crate::orientation::Allowed;
use crate::rank::{self, Directions, Judge, Ranking};
use crate::refine::CenteredCentroid;
use crate::scene::{Observation, Scene};

/// Iterations between two looks for a better set, for callers who want to see them.
const LOOK_EVERY: usize = 20;
/// Candidates that such a look judges.
const LOOK_AT: usize = 48;
/// Spheres keep this far from keep-out boxes, metres: the covering of a hand leaves up to its tolerance of the
/// hand bare, and no part of the hand may be in a box.
const KEEP_OUT_MARGIN_M: f64 = 0.004;

/// Plans grasps of `hand` in `scene`.
///
/// `on_better`, if given, is called from the planning thread with every better set as it is found, before
/// the final plan is returned; looking for better sets on the way costs a ranking per round. Uses the
/// rayon pool that it is called in. Never fails: a plan without grasps says why. With the same scene, hand,
/// options and seed the answer is bit-identical on any number of threads, unless the budget ended it.
pub fn plan(
    scene: &Scene,
    hand: &Hand,
    options: &PlanOptions,
    budget: &dyn Budget,
    on_better: Option<&mut dyn FnMut(&Plan)>,
) -> Plan {
    search(scene, hand, options, (usize::MAX, 0), budget, on_better).0
}

/// [`plan`], and the optimized candidates behind the best so many (`kept`) grasps, for whoever wants to go on with them.
/// Only the `most` candidates with the lowest objectives are judged.
pub(crate) fn search(
    scene: &Scene,
    hand: &Hand,
    options: &PlanOptions,
    (most, kept): (usize, usize),
    budget: &dyn Budget,
    mut on_better: Option<&mut dyn FnMut(&Plan)>,
) -> (Plan, Vec<Candidate>) {
    let features = &scene.features;
    let mut stats = PlanStats {
        focal_contacts: features.focal_contacts.len(),
        focal_centroids: features.focal_centroid_count,
        centered_centroids: features.centroids.len(),
        stages: scene.stages.clone(),
        ..PlanStats::default()
    };
    if let Some(no_grasp) = nothing_to_grasp(scene) {
        return (Plan { stats, no_grasp: Some(no_grasp), ..Plan::default() }, Vec::new());
    }
    let centroids = wanted(scene, options);
    if centroids.is_empty() {
        let nearest_fix = target_fix(scene, options);
        let no_grasp = Some(NoGrasp { reason: EmptyReason::TargetNotFound, nearest_fix });
        return (Plan { stats, no_grasp, ..Plan::default() }, Vec::new());
    }

    let begin = budget.elapsed();
    let model = HandModel::new(hand);
    let world_from_volume = scene.workspace.world_from_volume;
    let objective = Objective {
        model: &model,
        cells: &features.cells,
        centroids: &centroids,
        obstacles: obstacles(scene, options, &world_from_volume),
        weights: Weights::default(),
    };
    let allowed = Allowed::new(&options.orientation, &options.reaching, &world_from_volume);
    let initializer = Initializer {
        model: &model,
        centroids: &centroids,
        options,
        world_from_volume,
        view: scene.view_direction,
    };
    let mut batch = Batch::new(&objective, &allowed, &initializer, StepSizes::default());
    let after_init = budget.elapsed();
    let directions = Directions::new();
    let judge = Judge { scene, objective: &objective, allowed: &allowed, options, directions: &directions };

    let (mut best_score, mut next_look) = (0.0, LOOK_EVERY);
    while !batch.is_finished() {
        if let Err(stop) = batch.round(budget) {
            stats.stopped = Some(stop);
            break;
        }
        let Some(report) = on_better.as_mut() else { continue };
        if batch.is_finished() || batch.iterations_done() < next_look {
            continue;
        }
        next_look = batch.iterations_done() + LOOK_EVERY;
        let ranking = rank::rank(&judge, &batch.candidates, LOOK_AT, budget);
        let score = ranking.grasps.first().map_or(0.0, |g| g.score);
        if score > best_score {
            best_score = score;
            let interim =
                PlanStats { candidates: options.batch, iterations: batch.iterations_done(), ..stats.clone() };
            report(&finish(ranking, interim, &batch, &judge));
        }
    }
    let after_optimization = budget.elapsed();
    if [stats.stopped, budget.stop()].contains(&Some(Stop::Cancelled)) {
        stats.stopped = Some(Stop::Cancelled);
        return (Plan { stats, no_grasp: Some(out_of_time()), ..Plan::default() }, Vec::new());
    }
    let ranking = rank::rank(&judge, &batch.candidates, most, budget);
    // A budget that ends when all is done has cost nothing: it stopped planning only if something was left out.
    if ranking.rejected.contains_key(&RejectReason::Unfinished) {
        stats.stopped = stats.stopped.or_else(|| budget.stop());
    }
    if batch.is_shortened() {
        stats.stopped = stats.stopped.or(Some(Stop::Deadline));
    }
    stats.candidates = batch.candidates.len();
    stats.iterations = batch.iterations_done();
    stats.stages.push(("initialize", after_init.saturating_sub(begin)));
    stats.stages.push(("optimize", after_optimization.saturating_sub(after_init)));
    stats.stages.push(("rank", budget.elapsed().saturating_sub(after_optimization)));
    let best = ranking.sources.iter().take(kept).map(|&i| batch.candidates[i].clone()).collect();
    (finish(ranking, stats, &batch, &judge), best)
}

/// A plan from a ranking.
fn finish(ranking: Ranking, mut stats: PlanStats, batch: &Batch<'_>, judge: &Judge<'_>) -> Plan {
    let no_grasp = ranking.grasps.is_empty().then(|| {
        if batch.iterations_done() == 0 {
            return out_of_time();
        }
        let scene = judge.scene;
        rank::all_rejected(
            &scene.features,
            judge.objective,
            judge.options,
            &ranking.rejected,
            &ranking.rejections,
        )
    });
    stats.rejected = ranking.rejected;
    let trace = traced(batch, ranking.sources.first().copied());
    Plan { grasps: ranking.grasps, stats, no_grasp, trace }
}

/// The trace of the candidate behind the best grasp, or of the lowest objective where there is no grasp.
fn traced(batch: &Batch<'_>, best: Option<usize>) -> Vec<ObjectiveTerms> {
    let lowest = || batch.candidates.iter().min_by(|a, b| a.terms.total.total_cmp(&b.terms.total));
    best.map(|i| &batch.candidates[i]).or_else(lowest).map_or_else(Vec::new, |c| c.trace.clone())
}

fn out_of_time() -> NoGrasp {
    let nearest_fix = "the budget ended within the first iterations; allow more time or a smaller batch";
    NoGrasp { reason: EmptyReason::OutOfTime, nearest_fix: nearest_fix.into() }
}

/// What a hand must not enter in a scene, keep-out boxes included.
pub(crate) fn obstacles<'a>(
    scene: &'a Scene,
    options: &PlanOptions,
    world_from_volume: &Isometry3<f64>,
) -> Obstacles<'a> {
    let volume_from_world = world_from_volume.inverse();
    Obstacles {
        grid: scene.features.grid,
        distance: &scene.features.scene_distance_m,
        objects: &scene.objects,
        table_m: scene.features.table_m,
        boxes: options
            .keep_out
            .iter()
            .map(|k| {
                let margin = Vector3::repeat(KEEP_OUT_MARGIN_M);
                (volume_from_world * k.world_from_box, k.half_extents_m + margin)
            })
            .collect(),
    }
}

/// Centred centroids that may be grasped, with their weights made to sum to 1 again.
fn wanted(scene: &Scene, options: &PlanOptions) -> Vec<CenteredCentroid> {
    let mut kept: Vec<CenteredCentroid> = scene
        .features
        .centroids
        .iter()
        .filter(|c| match &options.target {
            None => true,
            Some(Target::Label(label)) => c.label == Some(*label),
            Some(Target::Point { point, radius_m }) => {
                (scene.workspace.world_from_volume * c.position - point).norm() <= *radius_m
            }
        })
        .copied()
        .collect();
    let total: f64 = kept.iter().map(|c| c.weight).sum();
    if total > 0.0 {
        for c in &mut kept {
            c.weight /= total;
        }
    }
    kept
}

fn target_fix(scene: &Scene, options: &PlanOptions) -> String {
    let centroids = &scene.features.centroids;
    match &options.target {
        Some(Target::Label(label)) => {
            let seen: std::collections::BTreeSet<u8> = centroids.iter().filter_map(|c| c.label).collect();
            format!("label {label} has no centroid in the workspace; labels that have one: {seen:?}")
        }
        Some(Target::Point { point, radius_m }) => {
            let distance = centroids
                .iter()
                .map(|c| (scene.workspace.world_from_volume * c.position - point).norm())
                .fold(f64::INFINITY, f64::min);
            format!(
                "no centroid within {radius_m:.3} m of the target point; the nearest is {distance:.3} m away"
            )
        }
        None => "no centroid".into(),
    }
}

/// The reason when the scene itself has nothing to grasp.
fn nothing_to_grasp(scene: &Scene) -> Option<NoGrasp> {
    let features = &scene.features;
    let (reason, nearest_fix) = match scene.observation {
        Observation::NothingSeen => (
            EmptyReason::NothingSeen,
            "no depth fell into the workspace; check the camera's pose and the workspace",
        ),
        Observation::EmptyTable => (EmptyReason::EmptyTable, "nothing stands on the table in the workspace"),
        Observation::Objects { .. } if features.focal_contacts.is_empty() => (
            EmptyReason::NoContacts,
            "objects were seen but no contact is certain enough; look from nearer or from another side",
        ),
        Observation::Objects { .. } if features.centroids.is_empty() => {
            (EmptyReason::NoCentroid, "no cluster of centroids; lower the focal centroid threshold")
        }
        Observation::Objects { .. } => return None,
    };
    Some(NoGrasp { reason, nearest_fix: nearest_fix.into() })
}
