//! Scenes, views, plans and verdicts put together.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use graspd_hands::Hand;
use graspd_planner::budget::Budget as _;
use graspd_planner::estimator::ContactEstimator;
use graspd_planner::grasp::Grasp;
use graspd_planner::options::{PlanOptions, Scheme, VolumeKind};
use graspd_planner::{plan, scene};
use graspd_sim::clutter::assortment;
use graspd_sim::object::Object;
use graspd_sim::world::World;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::jaw::{DEPTH_M, JawGrasp, MAX_WIDTH_M, Target, Verdict, judge};
use super::precision::{Precision, select, suppress};
use super::surface::{sample, table_points};
use crate::evaluate::EvaluationError;
use crate::evaluate::clock::Stopwatch;
use crate::evaluate::seeds::derive;
use crate::evaluate::station::Station;
use crate::evaluate::statistics::{mean, quantile};
use crate::evaluate::table::Table;

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
}

/// What one kind of volume gave.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VolumeResult {
    /// `tsdf` or `occupancy`.
    pub volume: String,
    /// AP.
    pub precision: Precision,
    /// Grasps that were scored, mean over views.
    pub grasps: f64,
    /// Scored grasps that collide, are empty, have no force closure at any friction, and that hold at some;
    /// shares of the scored.
    pub shares: [f64; 4],
    /// From the frame to the grasps, on one thread, median, milliseconds.
    pub planning_median_ms: f64,
}

/// All kinds of volumes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ApReport {
    /// What was measured, one condition a line.
    pub conditions: Vec<String>,
    /// One entry for each kind of volume.
    pub volumes: Vec<VolumeResult>,
}

/// One view with one kind of volume.
struct View {
    job: usize,
    verdicts: Vec<Verdict>,
    planning_ms: f64,
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
    let next = AtomicUsize::new(0);
    let views: Mutex<Vec<View>> = Mutex::default();
    let failed: Mutex<Option<EvaluationError>> = Mutex::new(None);
    let work = || -> Result<(), EvaluationError> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            if index >= settings.scenes {
                return Ok(());
            }
            let told = || seen(done.fetch_add(1, Ordering::Relaxed) + 1, settings.scenes * per_scene);
            let of_scene = pool.install(|| look_around(settings, estimator, index, &told))?;
            views.lock().unwrap_or_else(PoisonError::into_inner).extend(of_scene);
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..settings.workers.min(settings.scenes) {
            scope.spawn(|| {
                if let Err(error) = work() {
                    next.store(settings.scenes, Ordering::Relaxed);
                    failed.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
                }
            });
        }
    });
    if let Some(error) = failed.into_inner().unwrap_or_else(PoisonError::into_inner) {
        return Err(error);
    }
    let mut views = views.into_inner().unwrap_or_else(PoisonError::into_inner);
    views.sort_by_key(|v| v.job);
    let volumes = settings
        .volumes
        .iter()
        .enumerate()
        .map(|(i, &kind)| {
            let of_kind: Vec<&View> = views.iter().filter(|v| v.job % settings.volumes.len() == i).collect();
            result(kind, &of_kind)
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

fn result(kind: VolumeKind, views: &[&View]) -> VolumeResult {
    let verdicts: Vec<Vec<Verdict>> = views.iter().map(|v| v.verdicts.clone()).collect();
    let all: Vec<Verdict> = verdicts.concat();
    let share =
        |is: fn(&Verdict) -> bool| all.iter().filter(|v| is(v)).count() as f64 / all.len().max(1) as f64;
    let times: Vec<f64> = views.iter().map(|v| v.planning_ms).collect();
    let counts: Vec<f64> = verdicts.iter().map(|v| v.len() as f64).collect();
    VolumeResult {
        volume: name(kind).to_owned(),
        precision: Precision::of(&verdicts),
        grasps: mean(&counts).unwrap_or(0.0),
        shares: [
            share(|v| matches!(v, Verdict::Collision)),
            share(|v| matches!(v, Verdict::Empty)),
            share(|v| matches!(v, Verdict::NoClosure)),
            share(|v| matches!(v, Verdict::Holds { .. })),
        ],
        planning_median_ms: quantile(&times, 0.5).unwrap_or(0.0),
    }
}

fn name(kind: VolumeKind) -> &'static str {
    match kind {
        VolumeKind::Tsdf => "tsdf",
        VolumeKind::Occupancy => "occupancy",
    }
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
    let mut views = Vec::new();
    for view in 0..settings.views {
        let station = Station::table(&eye(settings.views, view));
        let frame = station.frame(&world, derive(seed, &[3, view as u64]));
        for (i, &kind) in settings.volumes.iter().enumerate() {
            let watch = Stopwatch::start();
            let scene = scene::prepare(
                std::slice::from_ref(&frame),
                &station.scene_options(kind),
                estimator,
                &watch,
            )?;
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
            views.push(View { job, verdicts: exact.judge(&grasps), planning_ms });
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

/// A planned grasp as the benchmark's gripper: the jaws open as far as on the approach.
fn jaw_grasp(hand: &Hand, grasp: &Grasp) -> Option<JawGrasp> {
    let coordinate = hand.actuation.coordinates.first()?;
    let opening = hand.opening?;
    // The opening is linear in the actuator of a parallel jaw.
    let open = *grasp.actuators.open.first()?;
    let share = (open - coordinate.open) / (coordinate.closed - coordinate.open);
    let width_m = (opening.max_m + share * (opening.min_m - opening.max_m)).clamp(0.0, MAX_WIDTH_M);
    let count = grasp.contacts.len().max(1) as f64;
    let expected = grasp.contacts.iter().map(|c| c.point.coords).sum::<Vector3<f64>>() / count;
    Some(JawGrasp {
        world_from_jaw: grasp.world_from_hand * jaw_frame(hand),
        width_m,
        expected: Point3::from(expected),
        score: grasp.score,
    })
}

/// Takes the benchmark's gripper frame (z along the approach, y along the closing direction, fingers from −2 to
/// 6 cm) to the hand frame, from the pads of the open hand: their tips are the fingers' tips.
fn jaw_frame(hand: &Hand) -> Isometry3<f64> {
    let poses = hand.tree.body_poses(&hand.actuation.joints(&hand.actuation.open()));
    let links = hand.tree.link_poses(&poses);
    let pads: Vec<[Point3<f64>; 4]> =
        hand.pads.iter().map(|pad| pad.corners().map(|c| links[pad.link] * c)).collect();
    let center = |corners: &[Point3<f64>; 4]| corners.iter().map(|c| c.coords).sum::<Vector3<f64>>() / 4.0;
    let z = hand.approach.into_inner();
    let apart = center(&pads[1]) - center(&pads[0]);
    let y = (apart - z * z.dot(&apart)).normalize();
    let rotation = nalgebra::Rotation3::from_basis_unchecked(&[y.cross(&z), y, z]);
    let middle = 0.5 * (center(&pads[0]) + center(&pads[1]));
    let tip = pads.iter().flatten().map(|c| z.dot(&c.coords)).fold(f64::NEG_INFINITY, f64::max);
    let origin = middle + z * (tip - DEPTH_M - z.dot(&middle));
    Isometry3::from_parts(Translation3::from(origin), UnitQuaternion::from_rotation_matrix(&rotation))
}

/// An object that really lies on the table.
struct Lying {
    object: Arc<Object>,
    world_from_object: Isometry3<f64>,
    /// Points of its surface, world frame.
    points: Vec<Point3<f64>>,
}

/// What really lies on the table.
struct Exact {
    objects: Vec<Lying>,
    /// Points of all objects and of the table, world frame.
    points: Vec<Point3<f64>>,
}

impl Exact {
    fn of(world: &World) -> Self {
        let objects: Vec<Lying> = world
            .ids()
            .into_iter()
            .filter_map(|id| {
                let (object, world_from_object) = (Arc::clone(world.object(id)?), world.pose(id)?);
                let points = sample(&object.mesh).iter().map(|p| world_from_object * p).collect();
                Some(Lying { object, world_from_object, points })
            })
            .collect();
        let points = objects.iter().flat_map(|o| o.points.iter().copied()).chain(table_points()).collect();
        Self { objects, points }
    }

    /// The object nearest to the middle of the jaws; none in an empty scene.
    ///
    /// The benchmark takes the gripper's origin, which lies 1 to 4 cm behind its tips; here it lies 6 cm behind
    /// them, nearer to a neighbour than to what is between the jaws.
    fn nearest(&self, grasp: &JawGrasp) -> Option<usize> {
        let middle = grasp.world_from_jaw * Point3::new(0.0, 0.0, 0.5 * DEPTH_M);
        let distance = |points: &[Point3<f64>]| {
            points.iter().map(|p| (p - middle).norm_squared()).fold(f64::INFINITY, f64::min)
        };
        let distances = self.objects.iter().map(|o| distance(&o.points));
        distances.enumerate().min_by(|a, b| a.1.total_cmp(&b.1)).map(|(i, _)| i)
    }

    /// Verdicts of the grasps that are scored, best first.
    fn judge(&self, grasps: &[JawGrasp]) -> Vec<Verdict> {
        let poses: Vec<Isometry3<f64>> = grasps.iter().map(|g| g.world_from_jaw).collect();
        let kept: Vec<&JawGrasp> = suppress(&poses).into_iter().map(|i| &grasps[i]).collect();
        let nearest: Vec<usize> = kept.iter().filter_map(|g| self.nearest(g)).collect();
        select(&nearest)
            .into_iter()
            .map(|i| {
                let Lying { object, world_from_object, .. } = &self.objects[nearest[i]];
                let target = Target { mesh: &object.mesh, world_from_mesh: *world_from_object };
                judge(kept[i], &self.points, &target)
            })
            .collect()
    }
}

impl ApReport {
    /// For people at a terminal.
    pub fn text(&self) -> String {
        self.render(Table::text, "")
    }

    /// For the documentation.
    pub fn markdown(&self) -> String {
        self.render(Table::markdown, "- ")
    }

    fn render(&self, table: fn(&Table) -> String, bullet: &str) -> String {
        let mut out: String = self.conditions.iter().map(|c| format!("{bullet}{c}\n")).collect();
        let frictions = self.volumes.first().map_or_else(Vec::new, |v| v.precision.by_friction.clone());
        let header = ["volume".to_owned()]
            .into_iter()
            .chain(frictions.iter().map(|(mu, _)| format!("AP_{mu:.1}")))
            .chain(["AP (0.2–1.0)", "AP (0.2–1.2)"].map(str::to_owned));
        let mut precision = Table::new(header);
        let mut why = Table::new([
            "volume",
            "grasps scored",
            "collision",
            "empty",
            "no closure",
            "holds at some µ",
            "planning median ms",
        ]);
        for v in &self.volumes {
            let values = v.precision.by_friction.iter().map(|(_, ap)| format!("{ap:.2}"));
            let averages = [v.precision.ap, v.precision.ap_six].map(|ap| format!("{ap:.2}"));
            precision.row(std::iter::once(v.volume.clone()).chain(values).chain(averages));
            let shares = v.shares.map(|s| format!("{:.1}%", 100.0 * s));
            let row = [v.volume.clone(), format!("{:.1}", v.grasps)];
            let time = [format!("{:.0}", v.planning_median_ms)];
            why.row(row.into_iter().chain(shares).chain(time));
        }
        out += &format!("\n{}\n{}", table(&precision), table(&why));
        out
    }
}

#[cfg(test)]
mod tests {
    use graspd_hands::library;

    use super::*;

    #[test]
    fn the_antipodal_hand_is_the_benchmarks_gripper() {
        let frame = jaw_frame(library::hand("antipodal").unwrap());
        // Its origin is the hand's, z forward, y along the closing direction, up to its sign.
        assert!(frame.translation.vector.norm() < 1e-3, "{frame}");
        assert!((frame.rotation * Vector3::z() - Vector3::z()).norm() < 1e-3);
        assert!((frame.rotation * Vector3::y()).y.abs() > 0.999);
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
