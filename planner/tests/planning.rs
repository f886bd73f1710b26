//! Planning from a frame to ranked grasps: what every caller relies on, on a synthetic clutter.

mod clutter;

use std::collections::BTreeSet;
use std::f64::consts::PI;
use std::sync::LazyLock;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use clutter::{look_at, ten_objects};
use graspd_hands::library;
use graspd_planner::budget::{Budget, Stop, Unlimited};
use graspd_planner::estimator::Geometric;
use graspd_planner::grasp::{EmptyReason, Plan, RejectReason};
use graspd_planner::options::{
    KeepOut, OrientationLimits, PlanOptions, Reaching, SceneOptions, Scheme, Target, VolumeKind,
};
use graspd_planner::plan::plan;
use graspd_planner::scene::{Scene, prepare};
use nalgebra::{Isometry3, Point3, Unit, Vector3};

fn scene_of(objects: &[clutter::Object]) -> Scene {
    prepare(&[look_at(objects)], &SceneOptions::default(), &Geometric, &Unlimited).expect("a valid frame")
}

static CLUTTER: LazyLock<Scene> = LazyLock::new(|| scene_of(&ten_objects()));

static LARGE: LazyLock<Scene> =
    LazyLock::new(|| scene_of(&[([-0.09, 0.0], 0.045, true), ([0.09, 0.03], 0.04, false)]));

fn quick() -> PlanOptions {
    PlanOptions { scheme: Scheme::BALANCED, ..PlanOptions::default() }
}

fn plan_with(hand: &str, options: &PlanOptions) -> Plan {
    plan(&CLUTTER, library::hand(hand).expect("a library hand"), options, &Unlimited, None)
}

#[test]
fn every_library_hand_gets_grasps_that_add_up() {
    for &id in library::ids() {
        let hand = library::hand(id).expect("a library hand");
        let options = PlanOptions::default();
        // A Barrett Hand spans 0.26 m: it gets objects of its size.
        let scene = if id == "barrett" { &*LARGE } else { &*CLUTTER };
        let result = plan(scene, hand, &options, &Unlimited, None);
        assert!(!result.grasps.is_empty(), "{id}: {:?} {:?}", result.no_grasp, result.stats.rejected);
        assert!(result.no_grasp.is_none());
        let rejected: usize = result.stats.rejected.values().sum();
        assert_eq!(rejected + result.grasps.len(), options.batch, "{id}: every candidate is accounted for");
        let mut last = f64::INFINITY;
        for grasp in &result.grasps {
            assert!((0.0..=1.0).contains(&grasp.score) && grasp.score <= last, "{id}: sorted scores in 0..1");
            last = grasp.score;
            assert!(grasp.epsilon > 0.0);
            let fingers: BTreeSet<usize> = grasp.contacts.iter().map(|c| c.finger).collect();
            assert!(fingers.len() >= 2, "{id}: at least two fingers touch");
            for posture in [&grasp.joints.open, &grasp.joints.contact, &grasp.joints.squeezed] {
                for (q, joint) in posture.iter().zip(&hand.tree.joints) {
                    assert!(
                        *q >= joint.lower - 1e-9 && *q <= joint.upper + 1e-9,
                        "{id}: {} at {q}",
                        joint.name
                    );
                }
            }
            assert_eq!(grasp.actuators.contact.len(), hand.actuation.actuator_count());
            let back =
                grasp.world_from_hand.translation.vector - grasp.world_from_pregrasp.translation.vector;
            let approach = grasp.world_from_hand.rotation * hand.approach.into_inner();
            assert!(
                (back - approach * options.pregrasp_offset_m).norm() < 1e-9,
                "{id}: pre-grasp is straight back"
            );
        }
    }
}

#[test]
fn contacts_lie_on_objects_and_not_on_the_table() {
    for id in ["robotiq-2f85", "robotiq-3f", "leap"] {
        for contact in plan_with(id, &PlanOptions::default()).grasps.iter().flat_map(|g| g.contacts.clone()) {
            assert!(contact.point.z > 0.003, "{id}: contact at {:?}", contact.point);
            let nearest = ten_objects()
                .iter()
                .map(|([x, y], r, _)| (contact.point.xy() - nalgebra::Point2::new(*x, *y)).norm() - r)
                .fold(f64::INFINITY, f64::min);
            assert!(nearest < 0.02, "{id}: a contact {nearest:.3} m beside every object");
        }
    }
}

#[test]
fn one_seed_gives_one_answer_on_any_number_of_threads() {
    let options = PlanOptions { seed: 42, ..quick() };
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| plan_with("robotiq-3f", &options))
    };
    let one = on(1);
    for threads in [2, 3, 7] {
        let many = on(threads);
        assert_eq!(one.grasps, many.grasps, "{threads} threads");
        assert_eq!(one.stats.rejected, many.stats.rejected);
    }
    let other = plan_with("robotiq-3f", &PlanOptions { seed: 43, ..quick() });
    assert_ne!(one.grasps, other.grasps, "another seed, another answer");
}

/// Stops after being asked a number of times.
struct Asked {
    left: AtomicUsize,
    stop: Stop,
}

impl Budget for Asked {
    fn elapsed(&self) -> Duration {
        Duration::ZERO
    }

    fn stop(&self) -> Option<Stop> {
        let left = self.left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |n| n.checked_sub(1));
        left.is_err().then_some(self.stop)
    }
}

#[test]
fn a_deadline_returns_the_best_so_far_and_a_cancellation_stops_within_an_iteration() {
    let hand = library::hand("robotiq-2f85").expect("a library hand");
    let options = PlanOptions::default();
    let iterations_of_half = options.batch * options.scheme.iterations / 2;
    let budget = Asked { left: AtomicUsize::new(iterations_of_half), stop: Stop::Deadline };
    let half = plan(&CLUTTER, hand, &options, &budget, None);
    assert_eq!(half.stats.stopped, Some(Stop::Deadline));
    assert!(half.stats.iterations < options.scheme.iterations);
    assert!(!half.grasps.is_empty(), "half the iterations give grasps too: {:?}", half.stats.rejected);

    let budget = Asked { left: AtomicUsize::new(100), stop: Stop::Cancelled };
    let cancelled = plan(&CLUTTER, hand, &options, &budget, None);
    assert_eq!(cancelled.stats.stopped, Some(Stop::Cancelled));
    assert!(cancelled.grasps.is_empty());

    let budget = Asked { left: AtomicUsize::new(0), stop: Stop::Deadline };
    let none = plan(&CLUTTER, hand, &options, &budget, None);
    assert_eq!(none.no_grasp.map(|n| n.reason), Some(EmptyReason::OutOfTime));
    assert_eq!(none.stats.rejected.get(&RejectReason::Unfinished), Some(&options.batch));
}

/// A clock that every look moves on, until its limit; it says how long that is, or does not.
struct Ticking {
    looks: AtomicUsize,
    limit: usize,
    tells: bool,
}

impl Ticking {
    fn until(limit: usize, tells: bool) -> Self {
        Self { looks: AtomicUsize::new(0), limit, tells }
    }

    fn at(&self, looks: usize) -> Duration {
        Duration::from_micros(looks as u64)
    }
}

impl Budget for Ticking {
    fn elapsed(&self) -> Duration {
        self.at(self.looks.load(Ordering::Relaxed))
    }

    fn stop(&self) -> Option<Stop> {
        (self.looks.fetch_add(1, Ordering::Relaxed) >= self.limit).then_some(Stop::Deadline)
    }

    fn remaining(&self) -> Option<Duration> {
        self.tells.then(|| self.at(self.limit.saturating_sub(self.looks.load(Ordering::Relaxed))))
    }
}

#[test]
fn a_search_that_will_not_end_in_time_still_keeps_its_hand_out_of_things() {
    let hand = library::hand("leap").expect("a library hand");
    let scheme = Scheme { iterations: 2000, with_penetration: 500 };
    let options = PlanOptions { scheme, ..PlanOptions::default() };
    // Time for so many iterations of every candidate, of 2000.
    for iterations in [100, 200, 700, 1400] {
        let [known, unknown] = [true, false].map(|tells| {
            let clock = Ticking::until(options.batch * iterations, tells);
            let plan = plan(&CLUTTER, hand, &options, &clock, None);
            assert_eq!(plan.stats.stopped, Some(Stop::Deadline));
            assert!(plan.stats.iterations <= iterations, "{} of {iterations}", plan.stats.iterations);
            plan
        });
        let [with_clock, without] = [&known, &unknown].map(|plan| {
            let collisions =
                [RejectReason::CollisionScene, RejectReason::CollisionTable, RejectReason::CollisionSelf];
            collisions.iter().filter_map(|reason| plan.stats.rejected.get(reason)).sum::<usize>()
        });
        assert!(without > 4 && with_clock * 4 < without, "{iterations}: {with_clock} and {without} collide");
        assert!(known.grasps.len() > unknown.grasps.len(), "{iterations}: {:?}", known.stats.rejected);
    }
    // With time enough nothing is left out, and nothing differs from a search without a clock.
    let options = quick();
    let free = plan(&CLUTTER, hand, &options, &Unlimited, None);
    let clock = Ticking::until(100 * options.batch * options.scheme.iterations, true);
    let in_time = plan(&CLUTTER, hand, &options, &clock, None);
    assert_eq!(in_time.stats.stopped, None);
    assert_eq!(free.grasps, in_time.grasps);
}

#[test]
fn better_sets_arrive_before_the_end_and_never_get_worse() {
    let hand = library::hand("robotiq-2f85").expect("a library hand");
    let mut scores = Vec::new();
    let mut report = |p: &Plan| scores.push(p.grasps[0].score);
    let last = plan(&CLUTTER, hand, &PlanOptions::default(), &Unlimited, Some(&mut report));
    assert!(!scores.is_empty());
    assert!(scores.windows(2).all(|w| w[0] < w[1]), "{scores:?}");
    let without = plan(&CLUTTER, hand, &PlanOptions::default(), &Unlimited, None);
    assert_eq!(last.grasps, without.grasps, "watching does not change the answer");
}

#[test]
fn limits_on_orientation_hold_for_every_grasp() {
    let down = CLUTTER.workspace.world_from_volume * -Vector3::z();
    for (cone, roll) in [(0.0, None), (0.2, None), (0.3, Some((0.2, 0.6)))] {
        let orientation = OrientationLimits { cone_rad: cone, roll_rad: roll };
        for id in ["robotiq-2f85", "model-o"] {
            let hand = library::hand(id).expect("a library hand");
            let result = plan_with(id, &PlanOptions { orientation, ..PlanOptions::default() });
            assert!(!result.grasps.is_empty(), "{id} {cone} {roll:?}: {:?}", result.stats.rejected);
            for grasp in &result.grasps {
                let approach = grasp.world_from_hand.rotation * hand.approach.into_inner();
                assert!(approach.angle(&down) <= cone + 1e-6, "{id}: {}", approach.angle(&down));
                let Some((low, high)) = roll else { continue };
                let lateral = grasp.world_from_hand.rotation * Vector3::x();
                let flat = (lateral - down * lateral.dot(&down)).normalize();
                let zero = (Vector3::x() - down * down.x).normalize();
                let angle = zero.cross(&flat).dot(&down).atan2(zero.dot(&flat));
                assert!((low - 1e-6..=high + 1e-6).contains(&angle), "{id}: roll {angle}");
            }
        }
    }
}

#[test]
fn the_reaching_direction_is_followed() {
    let along = Unit::new_normalize(Vector3::new(0.0, 1.0, -1.0));
    let options = PlanOptions {
        reaching: Reaching::Direction(along),
        orientation: OrientationLimits { cone_rad: PI / 8.0, roll_rad: None },
        ..PlanOptions::default()
    };
    let hand = library::hand("finray-2f").expect("a library hand");
    let result = plan_with("finray-2f", &options);
    assert!(!result.grasps.is_empty(), "{:?}", result.stats.rejected);
    for grasp in result.grasps {
        let approach = grasp.world_from_hand.rotation * hand.approach.into_inner();
        assert!(approach.angle(&along) <= PI / 8.0 + 1e-6);
    }
}

/// The outermost points of a collision shape, in its own frame.
fn corners(shape: &graspd_hands::Shape) -> Vec<Point3<f64>> {
    use graspd_hands::Shape;
    let all_signs = |x: f64, y: f64, z: f64| -> Vec<Point3<f64>> {
        (0..8)
            .map(|k| [1, 2, 4].map(|bit| if k & bit == 0 { 1.0 } else { -1.0 }))
            .map(|[a, b, c]| Point3::new(a * x, b * y, c * z))
            .collect()
    };
    match shape {
        Shape::Box { half_extents: h } => all_signs(h.x, h.y, h.z),
        Shape::Cylinder { radius, half_length } => (0..32)
            .map(|k| f64::from(k / 2) * PI / 8.0)
            .zip([1.0, -1.0].into_iter().cycle())
            .map(|(a, end)| Point3::new(radius * a.cos(), radius * a.sin(), end * half_length))
            .collect(),
        Shape::Sphere { radius } => all_signs(*radius, 0.0, 0.0)
            .into_iter()
            .chain(all_signs(0.0, *radius, 0.0))
            .chain(all_signs(0.0, 0.0, *radius))
            .collect(),
        Shape::Mesh { vertices, .. } => vertices.clone(),
    }
}

#[test]
fn keep_out_boxes_stay_empty() {
    let half = Vector3::new(0.3, 0.3, 0.3);
    let keep_out = KeepOut { world_from_box: Isometry3::translation(0.3, 0.0, 0.0), half_extents_m: half };
    let hand = library::hand("robotiq-2f85").expect("a library hand");
    let result =
        plan_with("robotiq-2f85", &PlanOptions { keep_out: vec![keep_out], ..PlanOptions::default() });
    assert!(!result.grasps.is_empty(), "{:?}", result.stats.rejected);
    for grasp in &result.grasps {
        let bodies = hand.tree.body_poses(&grasp.joints.contact);
        for sphere in &hand.spheres {
            let center = grasp.world_from_hand * bodies[sphere.body] * sphere.center;
            assert!(center.x + sphere.radius <= 1e-6, "a part of the hand at x = {}", center.x);
        }
        // The spheres leave some millimetres of the hand bare: the hand itself stays out as well.
        let links = hand.tree.link_poses(&bodies);
        for shape in &hand.collision {
            let pose = grasp.world_from_hand * links[shape.link] * shape.link_from_shape;
            let corner =
                corners(&shape.shape).into_iter().map(|p| (pose * p).x).fold(f64::NEG_INFINITY, f64::max);
            assert!(corner <= 1e-3, "a corner of the hand at x = {corner}");
        }
    }
}

#[test]
fn a_target_point_is_what_is_grasped() {
    let ([x, y], r, _) = ten_objects()[5];
    let point = Point3::new(x, y, r);
    let options =
        PlanOptions { target: Some(Target::Point { point, radius_m: 0.04 }), ..PlanOptions::default() };
    let result = plan_with("robotiq-2f85", &options);
    assert!(!result.grasps.is_empty(), "{:?} {:?}", result.no_grasp, result.stats.rejected);
    for grasp in result.grasps {
        assert!((grasp.centroid - point).norm() < 0.045);
    }
    let nowhere = Some(Target::Point { point: Point3::new(0.5, 0.5, 0.5), radius_m: 0.02 });
    let none = plan_with("robotiq-2f85", &PlanOptions { target: nowhere, ..PlanOptions::default() });
    assert_eq!(none.no_grasp.map(|n| n.reason), Some(EmptyReason::TargetNotFound));
}

#[test]
fn a_labelled_target_is_what_every_contact_touches() {
    // Close enough that hands which aim at one object could end on its neighbour.
    let objects: Vec<clutter::Object> = (0..12)
        .map(|k| ([0.055 * f64::from(k % 4) - 0.08, 0.06 * f64::from(k / 4) - 0.06], 0.018, false))
        .collect();
    let mut frame = look_at(&objects);
    let camera = frame.world_from_camera.expect("the synthetic camera has a pose");
    let lens = frame.intrinsics;
    let label_of = |i: usize, depth: f64| {
        let u = ((i % 640) as f64 - lens.cx_px) / lens.fx_px;
        let v = ((i / 640) as f64 - lens.cy_px) / lens.fy_px;
        let p = camera * Point3::new(u * depth, v * depth, depth);
        let near = |([x, y], r, _): &clutter::Object| {
            p.z > 0.002 && (p.x - x).abs() < r + 0.002 && (p.y - y).abs() < r + 0.002
        };
        objects.iter().position(near).map_or(0, |k| k as u8 + 1)
    };
    let labels = frame.image.depth_m.iter().enumerate().map(|(i, d)| label_of(i, f64::from(*d))).collect();
    frame.labels = Some(labels);
    let scene = prepare(&[frame], &SceneOptions::default(), &Geometric, &Unlimited).expect("a valid frame");
    let (mut found, mut others) = (0, 0);
    for id in ["robotiq-2f85", "robotiq-3f", "leap", "finray-4f"] {
        let hand = library::hand(id).expect("a library hand");
        for label in 1..=12u8 {
            let options = PlanOptions { target: Some(Target::Label(label)), ..quick() };
            let result = plan(&scene, hand, &options, &Unlimited, None);
            others += result.stats.rejected.get(&RejectReason::NotTarget).copied().unwrap_or(0);
            let ([x, y], r, _) = objects[usize::from(label) - 1];
            for grasp in &result.grasps {
                assert_eq!(grasp.label, Some(label));
                let touching = grasp
                    .contacts
                    .iter()
                    .filter(|c| (c.point.x - x).abs() < r + 0.012 && (c.point.y - y).abs() < r + 0.012);
                assert!(touching.count() > 0, "{id}: no contact is on object {label}");
                found += 1;
            }
        }
    }
    assert!(found > 20, "{found} grasps of targets");
    assert!(others > 0, "some candidates end on a neighbour and are counted");
}

#[test]
fn ranking_keeps_to_the_budget_too() {
    let hand = library::hand("robotiq-2f85").expect("a library hand");
    let options =
        PlanOptions { batch: 400, scheme: Scheme { iterations: 10, with_penetration: 10 }, ..quick() };
    // Enough for all iterations, not for looking at every candidate.
    let budget = Asked { left: AtomicUsize::new(400 * 10 + 60), stop: Stop::Deadline };
    let result = plan(&CLUTTER, hand, &options, &budget, None);
    let unfinished = result.stats.rejected.get(&RejectReason::Unfinished).copied().unwrap_or(0);
    assert!(unfinished > 250, "{unfinished} candidates were left out: {:?}", result.stats.rejected);
    assert_eq!(result.stats.stopped, Some(Stop::Deadline));
}

#[test]
fn a_budget_that_ends_when_all_is_done_has_stopped_nothing() {
    let hand = library::hand("robotiq-2f85").expect("a library hand");
    let options =
        PlanOptions { batch: 12, scheme: Scheme { iterations: 60, with_penetration: 60 }, ..quick() };
    // One look per iteration and none left for the ranking: twelve candidates are judged all the same.
    let budget = Asked { left: AtomicUsize::new(12 * 60), stop: Stop::Deadline };
    let result = plan(&CLUTTER, hand, &options, &budget, None);
    assert_eq!(result.stats.iterations, 60);
    assert_eq!(result.stats.stopped, None, "{:?}", result.stats.rejected);
    let all = plan(&CLUTTER, hand, &options, &Unlimited, None);
    assert_eq!(result.grasps, all.grasps);
}

#[test]
fn limits_with_a_free_direction_are_about_straight_down() {
    let down = CLUTTER.workspace.world_from_volume * -Vector3::z();
    let orientation = OrientationLimits { cone_rad: 0.5, roll_rad: None };
    let options = PlanOptions { reaching: Reaching::Free, orientation, batch: 96, ..PlanOptions::default() };
    let hand = library::hand("finray-2f").expect("a library hand");
    let result = plan_with("finray-2f", &options);
    assert!(!result.grasps.is_empty(), "{:?}", result.stats.rejected);
    for grasp in &result.grasps {
        let approach = grasp.world_from_hand.rotation * hand.approach.into_inner();
        assert!(approach.angle(&down) <= 0.5 + 1e-6);
    }
}

#[test]
fn an_occupancy_volume_takes_shadows_as_solid() {
    let frame = [look_at(&ten_objects())];
    let of = |volume| {
        let options = SceneOptions { volume, ..SceneOptions::default() };
        prepare(&frame, &options, &Geometric, &Unlimited).expect("a valid frame")
    };
    let solid = |scene: &Scene| scene.features.scene_distance_m.iter().filter(|d| **d < 0.0).count();
    let (tsdf, occupancy) = (of(VolumeKind::Tsdf), of(VolumeKind::Occupancy));
    assert!(solid(&occupancy) > solid(&tsdf) + 1000, "{} {}", solid(&occupancy), solid(&tsdf));
}

#[test]
fn an_empty_table_is_an_answer() {
    let scene = scene_of(&[]);
    let hand = library::hand("leap").expect("a library hand");
    let result = plan(&scene, hand, &quick(), &Unlimited, None);
    assert!(result.grasps.is_empty());
    assert_eq!(result.no_grasp.map(|n| n.reason), Some(EmptyReason::EmptyTable));
}

#[test]
fn an_object_wider_than_the_hand_opens_is_named_with_its_figures() {
    let scene = scene_of(&[([0.0, 0.0], 0.075, false)]);
    let hand = library::hand("robotiq-2f85").expect("a library hand");
    let result = plan(&scene, hand, &quick(), &Unlimited, None);
    assert!(result.grasps.is_empty(), "{:?}", result.grasps.first().map(|g| g.jaw_width_m));
    let no_grasp = result.no_grasp.expect("a reason");
    assert_eq!(no_grasp.reason, EmptyReason::HandTooSmall, "{}", no_grasp.nearest_fix);
    assert!(
        no_grasp.nearest_fix.starts_with("widest opening 0.085 m, narrowest contact pair 0.1"),
        "{}",
        no_grasp.nearest_fix
    );
}

#[test]
fn odd_options_do_not_panic() {
    let hand = library::hand("robotiq-2f85").expect("a library hand");
    let options = [
        PlanOptions { batch: 0, ..quick() },
        PlanOptions { scheme: Scheme { iterations: 0, with_penetration: 0 }, ..quick() },
        PlanOptions { scheme: Scheme { iterations: 5, with_penetration: 50 }, ..quick() },
        PlanOptions { max_grasps: 0, ..quick() },
        PlanOptions { pregrasp_offset_m: 0.0, ..quick() },
        PlanOptions { opening_fraction: 0.0, friction: 0.0, ..quick() },
    ];
    for o in options {
        let result = plan(&CLUTTER, hand, &o, &Unlimited, None);
        assert_eq!(result.grasps.is_empty(), result.no_grasp.is_some(), "{o:?}");
    }
}

#[test]
fn a_trace_has_one_entry_per_iteration_and_goes_down() {
    let options =
        PlanOptions { trace: true, scheme: Scheme { iterations: 120, with_penetration: 0 }, ..quick() };
    let trace = plan_with("leap", &options).trace;
    assert_eq!(trace.len(), 120);
    assert!(trace[119].total < trace[0].total);
}
