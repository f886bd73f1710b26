//! Known-good grasps lift, known-bad ones do not, and the reason is named.

use std::f64::consts::PI;
use std::sync::Arc;

use graspd_hands::{CoordinateKind, Hand, library};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use super::*;
use crate::object::Object;
use crate::world::samples::{ball, cuboid};
use crate::world::{Command, World, WorldSettings, WristForce};

/// A grasp from above, made by hand: the tool point goes to `tool`, fingers close half way and squeeze on.
fn from_above(hand: &Hand, tool: [f64; 3]) -> GraspCommand {
    let down = UnitQuaternion::rotation_between(&hand.approach, &-Vector3::z())
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI));
    let at = Isometry3::from_parts((Vector3::from(tool) - down * hand.tool_point.coords).into(), down);
    let posture = |share: f64| -> Vec<f64> {
        let driven = hand.actuation.coordinates.iter().filter(|c| c.kind == CoordinateKind::Actuator);
        driven.map(|c| c.open + share * (c.closed - c.open)).collect()
    };
    GraspCommand {
        world_from_pregrasp: Isometry3::translation(0.0, 0.0, 0.06) * at,
        world_from_hand: at,
        open: posture(0.0),
        contact: posture(0.6),
        squeezed: posture(0.8),
    }
}

fn attempt(
    id: &str,
    object: Option<(Arc<Object>, f64)>,
    tool: [f64; 3],
    settings: &ExecuteSettings,
) -> (Trial, World) {
    let hand = Arc::new(library::hand(id).unwrap().clone());
    let mut world = World::new(WorldSettings::default());
    if let Some((object, z)) = object {
        world.add(object, &Isometry3::translation(0.0, 0.0, z));
    }
    let grasp = from_above(&hand, tool);
    let placed = world.add_hand(hand.clone(), &grasp.world_from_pregrasp, &hand.actuation.open());
    let mut moments = Vec::new();
    let trial = execute(&mut world, placed, &grasp, settings, &mut |moment, _| moments.push(moment));
    assert_eq!(moments, [Moment::Before, Moment::Contact, Moment::After]);
    assert_eq!(trial.joints_closed.len(), hand.tree.joints.len());
    assert_eq!(trial.failure.is_none(), !trial.held.is_empty());
    (trial, world)
}

fn small_box() -> Option<(Arc<Object>, f64)> {
    Some((cuboid([0.02, 0.02, 0.04], 0.3, 0.5), 0.04))
}

#[test]
fn good_grasps_lift() {
    let bar = || Some((cuboid([0.07, 0.025, 0.04], 0.3, 0.5), 0.04));
    for (id, object) in [
        ("robotiq-2f85", small_box()),
        ("finray-4f", small_box()),
        ("robotiq-3f", bar()),
        ("barrett", bar()),
        ("leap", bar()),
    ] {
        let (trial, world) = attempt(id, object, [0.0, 0.0, 0.055], &ExecuteSettings::default());
        assert_eq!(trial.failure, None, "{id}: {trial:?}");
        assert_eq!(trial.held, world.ids(), "{id}");
        assert_eq!(trial.meant, Some(world.ids()[0]), "{id}");
        assert!(trial.slip_m < 0.03, "{id}: slid {} m", trial.slip_m);
        assert!(trial.duration_s > 3.0 && trial.duration_s < 10.0, "{id}: {} s", trial.duration_s);
    }
}

#[test]
fn bad_grasps_do_not_and_are_told_apart() {
    let normal = ExecuteSettings::default();
    let failure = |object, tool, settings| attempt("robotiq-2f85", object, tool, settings).0.failure;
    // Beside the box, and above it: nothing between the fingers.
    assert_eq!(failure(small_box(), [0.0, 0.08, 0.055], &normal), Some(Failure::UnstableContact));
    assert_eq!(failure(small_box(), [0.0, 0.0, 0.13], &normal), Some(Failure::UnstableContact));
    // A finger comes down on the box.
    assert_eq!(failure(small_box(), [0.05, 0.0, 0.055], &normal), Some(Failure::CollisionObject));
    // The fingers are led into the table, beside the box.
    assert_eq!(failure(small_box(), [0.0, 0.08, -0.03], &normal), Some(Failure::CollisionTable));
    // The edge of the pads squeezes a ball out.
    let ball = Some((ball(0.025, 0.2), 0.025));
    assert_eq!(failure(ball, [0.0, 0.031, 0.03], &normal), Some(Failure::LostClosing));
    // Smooth and heavy, gently held: the friction of pad and box is (0.9 + 0.1) / 2.
    let gentle = ExecuteSettings { grip_force: 0.02, ..normal.clone() };
    let heavy = || Some((cuboid([0.02, 0.02, 0.04], 1.0, 0.1), 0.04));
    assert_eq!(failure(heavy(), [0.0, 0.0, 0.055], &gentle), Some(Failure::LostLifting));
    assert_eq!(failure(heavy(), [0.0, 0.0, 0.055], &normal), None);
    // Held just well enough to be lifted.
    let wild = ExecuteSettings { grip_force: 0.06, shake_m: 0.03, shake_hz: 5.0, ..normal };
    assert_eq!(failure(heavy(), [0.0, 0.0, 0.055], &wild), Some(Failure::LostShaking));
}

#[test]
fn an_empty_table_and_an_absent_hand_are_no_success() {
    let (trial, mut world) = attempt("panda", None, [0.0, 0.0, 0.1], &ExecuteSettings::default());
    assert_eq!((trial.failure, trial.meant), (Some(Failure::UnstableContact), None));
    let placed = world.hand_ids()[0];
    let grasp = from_above(world.hand(placed).unwrap(), [0.0, 0.0, 0.1]);
    world.remove_hand(placed);
    let trial = execute(&mut world, placed, &grasp, &ExecuteSettings::default(), &mut |_, _| {});
    assert_eq!(trial.failure, Some(Failure::UnstableContact));
}

#[test]
fn another_object_that_comes_along_counts_as_picked() {
    let hand = Arc::new(library::hand("robotiq-2f85").unwrap().clone());
    let mut world = World::new(WorldSettings::default());
    let below = world.add(cuboid([0.03, 0.02, 0.02], 0.2, 0.5), &Isometry3::translation(0.0, 0.0, 0.02));
    let above = world.add(cuboid([0.01, 0.01, 0.01], 0.03, 0.5), &Isometry3::translation(0.0, 0.0, 0.05));
    let grasp = from_above(&hand, [0.0, 0.0, 0.025]);
    let placed = world.add_hand(hand.clone(), &grasp.world_from_pregrasp, &hand.actuation.open());
    let settings = ExecuteSettings { shake_m: 0.0, ..ExecuteSettings::default() };
    let trial = execute(&mut world, placed, &grasp, &settings, &mut |_, _| {});
    assert_eq!((trial.failure, trial.meant), (None, Some(below)), "{trial:?}");
    assert_eq!(trial.held, [below, above]);
}

#[test]
fn a_hand_set_down_in_an_object_has_hit_it() {
    let hand = Arc::new(library::hand("robotiq-2f85").unwrap().clone());
    // Beside the grasp stands a post that nobody lifts, where a finger is at the pre-grasp; further away it is in
    // nobody's way.
    let fails = |x: f64| {
        let mut world = World::new(WorldSettings::default());
        world.add(small_box().unwrap().0, &Isometry3::translation(0.0, 0.0, 0.04));
        world.add(cuboid([0.01, 0.03, 0.1], 30.0, 0.5), &Isometry3::translation(x, 0.0, 0.1));
        // Nothing but air is grasped: above the box.
        let grasp = from_above(&hand, [0.0, 0.0, 0.13]);
        let grasp = GraspCommand { world_from_pregrasp: grasp.world_from_hand, ..grasp };
        let placed = set_down(&mut world, &hand, &grasp);
        let overlaps = world.hand_overlaps(placed, 0.002);
        let trial = execute(&mut world, placed, &grasp, &ExecuteSettings::default(), &mut |_, _| {});
        (overlaps, trial.failure)
    };
    assert_eq!(fails(0.3), (Vec::new(), Some(Failure::UnstableContact)));
    let (overlaps, failure) = fails(0.05);
    assert_eq!((overlaps.len(), failure), (1, Some(Failure::CollisionObject)), "{overlaps:?}");
}

#[test]
fn what_an_arm_feels_is_the_sum_of_all_that_presses_on_the_hand() {
    let hand = Arc::new(library::hand("panda").unwrap().clone());
    let mut world = World::new(WorldSettings::default());
    // Held from both sides a hand feels the box's weight, not the force of its fingers.
    world.add(small_box().unwrap().0, &Isometry3::translation(0.0, 0.0, 0.04));
    let grasp = from_above(&hand, [0.0, 0.0, 0.055]);
    let placed = set_down(&mut world, &hand, &grasp);
    let settings = ExecuteSettings { shake_m: 0.0, ..ExecuteSettings::default() };
    let trial = execute(&mut world, placed, &grasp, &settings, &mut |_, _| {});
    assert_eq!(trial.failure, None, "{trial:?}");
    let mut felt = WristForce::new(WristForce::FILTER_S);
    let (mut net_n, mut pressed_n) = (0.0, 0.0);
    for _ in 0..80 {
        world.step();
        net_n = felt.feel(&world, placed);
        pressed_n = world.hand_contacts(placed).iter().map(|c| c.force_n).sum();
    }
    assert!(pressed_n > 40.0 && net_n < 0.2 * pressed_n, "{net_n} N of {pressed_n} N");
    assert!(!felt.is_mostly_fixed());
    // What it carries moves with it, and so does the point of the hand that is there.
    let at = nalgebra::Point3::from(world.pose(trial.held[0]).unwrap().translation.vector);
    let up = Isometry3::translation(0.0, 0.0, 0.1) * world.hand_state(placed).unwrap().world_from_hand;
    world.command(placed, Command::Move { world_from_hand: up, speed_m_s: 0.2, turn_rad_s: 1.0 });
    for _ in 0..100 {
        world.step();
    }
    let (hand_v, object_v) =
        (world.hand_velocity_at(placed, &at).unwrap(), world.velocity(trial.held[0]).unwrap().0);
    assert!((hand_v.z - 0.2).abs() < 0.01 && (hand_v - object_v).norm() < 0.02, "{hand_v} {object_v}");
}
