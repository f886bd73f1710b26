//! Hands in the world: they go where they are told, hold what they press, and press no harder than they may.

use std::f64::consts::PI;

use graspd_hands::library;
use nalgebra::UnitQuaternion;

use super::*;
use crate::world::WorldSettings;
use crate::world::samples::{ball, cuboid, cylinder};

fn library_hand(id: &str) -> Arc<Hand> {
    Arc::new(library::hand(id).unwrap().clone())
}

/// The wrist's pose that brings the tool point to a height above the origin, reaching down.
fn above(hand: &Hand, tool_z: f64) -> Isometry3<f64> {
    let down = UnitQuaternion::rotation_between(&hand.approach, &-Vector3::z())
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI));
    let at = Vector3::new(0.0, 0.0, tool_z) - down * hand.tool_point.coords;
    Isometry3::from_parts(at.into(), down)
}

fn run(world: &mut World, time_s: f64) {
    for _ in 0..(time_s / world.settings().dt_s).round() as usize {
        world.step();
    }
}

fn actuators(hand: &Hand, values: &[f64]) -> Vec<f64> {
    let all = hand.actuation.coordinates.iter().zip(values);
    all.filter(|(c, _)| c.kind == CoordinateKind::Actuator).map(|(_, v)| *v).collect()
}

fn close(world: &mut World, id: HandId, force: f64) -> bool {
    let hand = world.hand(id).unwrap().clone();
    let actuators = actuators(&hand, &hand.actuation.closed());
    world.command(id, Command::Close { actuators, force, speed: 1.0 })
}

/// Largest distance of a coupled joint from what its actuator's position makes it.
fn uncoupled(world: &World, id: HandId) -> f64 {
    let (hand, state) = (world.hand(id).unwrap(), world.hand_state(id).unwrap());
    let mut u = hand.actuation.open();
    let driven = u.iter_mut().zip(&hand.actuation.coordinates);
    let driven = driven.filter(|(_, c)| c.kind == CoordinateKind::Actuator);
    for ((value, _), now) in driven.zip(&state.actuators) {
        *value = *now;
    }
    let adaptive = |i: usize| hand.actuation.coordinates[i].kind == CoordinateKind::Adaptive;
    let rows = hand.actuation.rows.iter().zip(hand.actuation.joints(&u)).zip(&state.joints);
    rows.filter(|((row, _), _)| !row.terms.iter().any(|t| adaptive(t.0)))
        .map(|((_, q), now)| (q - now).abs())
        .fold(0.0, f64::max)
}

#[test]
fn every_hand_closes_on_nothing() {
    for id in library::ids() {
        let hand = library_hand(id);
        let mut world = World::new(WorldSettings::default());
        let at = above(&hand, 0.5);
        let placed = world.add_hand(hand.clone(), &at, &hand.actuation.open());
        let q = hand.actuation.joints(&hand.actuation.open());
        let links = hand.tree.link_poses(&hand.tree.body_poses(&q));
        for (found, expected) in world.hand_links(placed).unwrap().iter().zip(&links) {
            let expected = at * expected;
            assert!((found.translation.vector - expected.translation.vector).norm() < 1e-9, "{id}");
            assert!(found.rotation.angle_to(&expected.rotation) < 1e-6, "{id}");
        }
        assert!(close(&mut world, placed, 1.0));
        assert!(!world.hand_state(placed).unwrap().settled, "{id}: a new command has to be carried out");
        for _ in 0..600 {
            world.step();
            assert!(uncoupled(&world, placed) < 1e-3, "{id}");
        }
        let state = world.hand_state(placed).unwrap();
        assert!(state.settled, "{id}: {state:?}");
        let closed = hand.actuation.joints(&hand.actuation.closed());
        for (found, expected) in state.joints.iter().zip(&closed) {
            assert!((found - expected).abs() < 1e-3, "{id}: {:?}, not {closed:?}", state.joints);
        }
        assert!((state.world_from_hand.translation.vector - at.translation.vector).norm() < 1e-6, "{id}");
    }
}

#[test]
fn nothing_explodes_whatever_is_grasped() {
    let things = [
        Some((cuboid([0.03, 0.03, 0.03], 0.1, 0.5), 0.03)),
        Some((ball(0.03, 0.1), 0.03)),
        Some((cylinder(0.025, 0.05, 0.5), 0.05)),
        None,
    ];
    for id in library::ids() {
        let hand = library_hand(id);
        for thing in &things {
            let mut world = World::new(WorldSettings::default());
            let object =
                thing.as_ref().map(|(o, z)| world.add(o.clone(), &Isometry3::translation(0.0, 0.0, *z)));
            // With nothing to grasp, the fingers are led into the table.
            let at = above(&hand, if object.is_some() { 0.05 } else { 0.0 });
            let start = Isometry3::translation(0.0, 0.0, 0.1) * at;
            let placed = world.add_hand(hand.clone(), &start, &hand.actuation.open());
            world.command(placed, Command::Move { world_from_hand: at, speed_m_s: 0.2, turn_rad_s: 1.0 });
            for step in 0..500 {
                if step == 250 {
                    close(&mut world, placed, 1.0);
                }
                world.step();
                for &body in &world.hands[0].body.bodies {
                    let speed = world.physics.bodies[body].linvel().length();
                    assert!(speed < 5.0, "{id}: a finger at {speed} m/s");
                }
                if let Some(object) = object {
                    let speed = world.velocity(object).unwrap().0.norm();
                    assert!(speed < 5.0, "{id}: {} at {speed} m/s", world.object(object).unwrap().name);
                }
            }
            let found = world.hand_state(placed).unwrap().world_from_hand.translation.vector;
            assert!((found - at.translation.vector).norm() < 0.15, "{id}: wrist at {found}");
        }
    }
}

/// A 2F-85 around a box of 4 cm, closed with a share of its force.
fn gripped(force: f64) -> (World, HandId, ObjectId) {
    let hand = library_hand("robotiq-2f85");
    let mut world = World::new(WorldSettings::default());
    // Not in the middle: one finger comes first and brings the box along.
    let object = world.add(cuboid([0.02, 0.02, 0.04], 0.3, 0.5), &Isometry3::translation(0.003, 0.0, 0.04));
    let placed = world.add_hand(hand.clone(), &above(&hand, 0.05), &hand.actuation.open());
    close(&mut world, placed, force);
    run(&mut world, 0.8);
    (world, placed, object)
}

#[test]
fn a_gripper_presses_with_the_force_it_is_told() {
    for force in [0.02, 0.2, 1.0] {
        let (world, placed, object) = gripped(force);
        let state = world.hand_state(placed).unwrap();
        assert!(state.settled && uncoupled(&world, placed) < 1e-3);
        let allowed = force * world.full_efforts(placed).unwrap()[0];
        assert!((allowed - force * 235.0).abs() < 1e-9);
        assert!((state.efforts[0] - allowed).abs() < 0.2 * allowed, "{} of {allowed} N", state.efforts[0]);
        for link in [1, 2] {
            let contacts = world.hand_contacts(placed);
            let own = contacts.iter().filter(|c| c.link == link && c.touched == Touched::Object(object));
            let pressed: f64 = own.map(|c| c.force_n).sum();
            // The box stands on the table, whose friction may stand with either finger.
            let table = 0.5 * 0.3 * 9.81;
            assert!(
                (pressed - allowed).abs() < 0.2 * allowed + table,
                "link {link} presses {pressed} of {allowed} N"
            );
        }
    }
}

#[test]
fn what_is_held_follows_the_hand_without_slipping_or_gaining_energy() {
    let (mut world, placed, object) = gripped(0.2);
    let in_hand = |world: &World| {
        world.hand_state(placed).unwrap().world_from_hand.inverse() * world.pose(object).unwrap()
    };
    let before = in_hand(&world);
    let hand = world.hand(placed).unwrap().clone();
    let to = above(&hand, 0.25);
    world.command(placed, Command::Move { world_from_hand: to, speed_m_s: 0.3, turn_rad_s: 1.0 });
    run(&mut world, 1.5);
    assert!(world.hand_state(placed).unwrap().arrived);
    let slid = (in_hand(&world).translation.vector - before.translation.vector).norm();
    assert!(slid < 5e-4, "slid {slid} m");
    assert!((world.pose(object).unwrap().translation.z - 0.24).abs() < 2e-3);
    let energy = world.energy();
    for _ in 0..400 {
        world.step();
        assert!(world.energy() < energy + 1e-4, "held still: {energy} J, then {} J", world.energy());
    }
}

#[test]
fn a_hand_that_is_removed_leaves_nothing_behind_and_drops_what_it_held() {
    let (mut world, placed, object) = gripped(0.2);
    let hand = world.hand(placed).unwrap().clone();
    let to = above(&hand, 0.15);
    world.command(placed, Command::Move { world_from_hand: to, speed_m_s: 0.3, turn_rad_s: 1.0 });
    run(&mut world, 1.0);
    assert!(world.pose(object).unwrap().translation.z > 0.13);
    assert!(world.remove_hand(placed) && !world.remove_hand(placed));
    // The table and the box.
    assert_eq!((world.physics.bodies.len(), world.physics.colliders.len()), (2, 2));
    assert_eq!(world.physics.multibody_joints.iter().count(), 0);
    assert!(world.hand_ids().is_empty() && world.hand_state(placed).is_none());
    assert!(world.hand_links(placed).is_none() && world.hand_contacts(placed).is_empty());
    run(&mut world, 1.0);
    assert!(world.pose(object).unwrap().translation.z < 0.045);
}

#[test]
fn two_hands_work_side_by_side() {
    let mut world = World::new(WorldSettings::default());
    let mut work = Vec::new();
    for (id, x) in [("robotiq-2f85", -0.2), ("panda", 0.2)] {
        let hand = library_hand(id);
        let there = Isometry3::translation(x, 0.0, 0.0);
        let half = if id == "panda" { [0.07, 0.02, 0.04] } else { [0.02, 0.02, 0.04] };
        let object = world.add(cuboid(half, 0.2, 0.5), &Isometry3::translation(x, 0.0, 0.04));
        let placed = world.add_hand(hand.clone(), &(there * above(&hand, 0.05)), &hand.actuation.open());
        close(&mut world, placed, 0.5);
        work.push((hand, there, object, placed));
    }
    run(&mut world, 1.0);
    for (hand, there, _, placed) in &work {
        let to = there * above(hand, 0.15);
        world.command(*placed, Command::Move { world_from_hand: to, speed_m_s: 0.3, turn_rad_s: 1.0 });
    }
    run(&mut world, 1.0);
    for (hand, _, object, placed) in &work {
        assert!(world.pose(*object).unwrap().translation.z > 0.13, "{}", hand.id);
        let touched: Vec<Touched> = world.hand_contacts(*placed).iter().map(|c| c.touched).collect();
        assert!(!touched.is_empty() && touched.iter().all(|t| *t == Touched::Object(*object)), "{touched:?}");
    }
}

#[test]
fn an_adaptive_finger_wraps_when_its_first_phalanx_is_stopped() {
    let hand = library_hand("robotiq-3f");
    let mut world = World::new(WorldSettings::default());
    // A thick post deep between the fingers: it meets the first and second phalanges.
    let object = world.add(cylinder(0.05, 0.06, 2.0), &Isometry3::translation(0.0, 0.0, 0.06));
    let placed = world.add_hand(hand.clone(), &above(&hand, 0.06), &hand.actuation.open());
    let actuators = vec![0.0, 1.2, 1.2, 1.2];
    world.command(placed, Command::Close { actuators, force: 0.5, speed: 1.0 });
    run(&mut world, 2.0);
    let state = world.hand_state(placed).unwrap();
    let bent = |name: &str| state.joints[hand.tree.joint(name).unwrap()];
    assert!(bent("finger_middle_joint_2") > 0.05, "{:?}", state.joints);
    let links: std::collections::BTreeSet<usize> =
        world.hand_contacts(placed).iter().map(|c| c.link).collect();
    assert!(links.len() >= 3 && world.pose(object).is_some(), "touches with {links:?}");
}

#[test]
fn what_fingertips_hold_stays_where_they_hold_it() {
    let hand = library_hand("robotiq-3f");
    let mut world = World::new(WorldSettings::default());
    // A light round bar between two fingertips and one: each bends a phalanx back against its stop.
    let lying = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), PI / 2.0);
    let at = Isometry3::from_parts(Vector3::new(0.0, 0.0, 0.02).into(), lying);
    let object = world.add(cylinder(0.02, 0.045, 0.04), &at);
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
    let wrist = |z: f64| Isometry3::from_parts(Vector3::new(0.0, 0.0, z).into(), down);
    let placed = world.add_hand(hand.clone(), &wrist(0.1845), &hand.actuation.open());
    let actuators = vec![-0.178, 1.2, 1.2, 1.2];
    world.command(placed, Command::Close { actuators, force: 0.7, speed: 0.5 });
    run(&mut world, 2.0);
    let up = wrist(0.28);
    world.command(placed, Command::Move { world_from_hand: up, speed_m_s: 0.15, turn_rad_s: 1.0 });
    run(&mut world, 1.5);
    let in_hand = |world: &World| {
        world.hand_state(placed).unwrap().world_from_hand.inverse() * world.pose(object).unwrap()
    };
    let before = in_hand(&world);
    run(&mut world, 3.0);
    let slid = before.inverse() * in_hand(&world);
    let links: std::collections::BTreeSet<usize> =
        world.hand_contacts(placed).iter().map(|c| c.link).collect();
    let (way, turn) = (slid.translation.vector.norm(), slid.rotation.angle());
    assert!(way < 3e-3 && turn < 0.05, "slid {way} m and turned {turn} rad in 3 s");
    assert_eq!(links.len(), 3);
}

#[test]
fn the_arm_presses_on_the_table_with_its_force_and_no_more() {
    let hand = library_hand("panda");
    let mut world = World::new(WorldSettings::default());
    let placed = world.add_hand(hand.clone(), &above(&hand, 0.03), &hand.actuation.open());
    let to = above(&hand, -0.05);
    world.command(placed, Command::Move { world_from_hand: to, speed_m_s: 0.1, turn_rad_s: 1.0 });
    let mut mean = 0.0;
    for _ in 0..800 {
        world.step();
        let contacts = world.hand_contacts(placed);
        assert!(contacts.iter().all(|c| c.touched == Touched::Table && c.normal.z < -0.9));
        let pressed: f64 = contacts.iter().map(|c| c.force_n).sum();
        mean += (pressed - mean) * 0.02;
    }
    let state = world.hand_state(placed).unwrap();
    assert!(!state.arrived && state.world_from_hand.translation.z > above(&hand, -0.02).translation.z);
    let most = world.settings().hands.arm_force_n;
    assert!((0.9 * most..1.05 * most).contains(&mean), "presses with {mean} N");
    // What blocks one motion does not block the next: to stay, and back.
    let here = state.world_from_hand;
    world.command(placed, Command::Move { world_from_hand: here, speed_m_s: 0.1, turn_rad_s: 1.0 });
    run(&mut world, 0.3);
    let pressed: f64 = world.hand_contacts(placed).iter().map(|c| c.force_n).sum();
    assert!(pressed < 0.5 * mean, "told to stay it still presses with {pressed} N");
    let back = above(&hand, 0.03);
    world.command(placed, Command::Move { world_from_hand: back, speed_m_s: 0.1, turn_rad_s: 1.0 });
    run(&mut world, 1.5);
    assert!(world.hand_state(placed).unwrap().arrived);
}

#[test]
fn the_same_commands_give_the_same_poses_bit_for_bit() {
    let once = || {
        let hand = library_hand("leap");
        let mut world = World::new(WorldSettings::default());
        let object =
            world.add(cuboid([0.07, 0.025, 0.04], 0.3, 0.5), &Isometry3::translation(0.0, 0.0, 0.04));
        let placed = world.add_hand(hand.clone(), &above(&hand, 0.055), &hand.actuation.open());
        close(&mut world, placed, 0.7);
        run(&mut world, 0.6);
        (world.pose(object).unwrap(), world.hand_state(placed).unwrap(), world.hand_contacts(placed))
    };
    assert_eq!(once(), once());
}

#[test]
fn commands_that_make_no_sense_are_refused() {
    let hand = library_hand("leap");
    let mut world = World::new(WorldSettings::default());
    let at = above(&hand, 0.3);
    // Too few coordinates, and one that is not a number: the rest is open.
    let placed = world.add_hand(hand.clone(), &at, &[f64::NAN]);
    let open = actuators(&hand, &hand.actuation.open());
    for (actuators, force, speed) in
        [(vec![0.0; 3], 1.0, 1.0), (vec![f64::NAN; 16], 1.0, 1.0), (open.clone(), f64::INFINITY, 1.0)]
    {
        assert!(!world.command(placed, Command::Close { actuators, force, speed }));
    }
    let nowhere = Isometry3::translation(f64::NAN, 0.0, 0.0);
    assert!(
        !world.command(placed, Command::Move { world_from_hand: nowhere, speed_m_s: 0.1, turn_rad_s: 1.0 })
    );
    assert!(!world.command(HandId(99), Command::Close { actuators: open.clone(), force: 1.0, speed: 1.0 }));
    // Beyond the limits: as far as it goes.
    let actuators = vec![1e9; 16];
    assert!(world.command(placed, Command::Close { actuators, force: 7.0, speed: -1.0 }));
    run(&mut world, 0.3);
    let state = world.hand_state(placed).unwrap();
    assert!(state.joints.iter().zip(&hand.tree.joints).all(|(q, j)| *q < j.upper + 1e-2));
}

#[test]
fn a_hollow_mesh_is_decomposed_and_a_full_one_is_not() {
    // An L of two legs, 4 cm long and 1 cm thick, extruded by 2 cm.
    let outline = [(0.0, 0.0), (0.04, 0.0), (0.04, 0.01), (0.01, 0.01), (0.01, 0.04), (0.0, 0.04)];
    let vertices: Vec<Point3<f64>> =
        [0.0, 0.02].iter().flat_map(|&z| outline.map(|(x, y)| Point3::new(x, y, z))).collect();
    let mut triangles = vec![[0, 2, 1], [0, 3, 2], [0, 4, 3], [0, 5, 4]];
    triangles.extend([[6, 7, 8], [6, 8, 9], [6, 9, 10], [6, 10, 11]]);
    triangles.extend((0..6).flat_map(|i| {
        let next = (i + 1) % 6;
        [[i, next, next + 6], [i, next + 6, i + 6]]
    }));
    let parts = body::mesh(&vertices, &triangles);
    assert!(parts.len() > 1, "{} part", parts.len());
    let volume: f64 = parts.iter().map(|p| p.mass_properties(1.0).mass()).sum();
    assert!((volume - 14e-6).abs() < 3e-6, "{volume} m³ of 14e-6");
    let cube = crate::mesh::Mesh::cuboid(Vector3::repeat(0.01));
    assert_eq!(body::mesh(&cube.vertices, &cube.triangles).len(), 1);
    // Nothing solid can be made of a point.
    assert!(body::mesh(&[Point3::origin()], &[]).is_empty());
}

#[test]
fn joints_that_mix_coordinates_or_depend_on_none_are_servos() {
    let mut hand = library::hand("model-o").unwrap().clone();
    // A differential between fingers 2 and 3, and a spread that is fixed at 0.2 rad.
    let joint = |name: &str| hand.tree.joint(name).unwrap();
    let (finger, spread) = (joint("finger_3_joint"), joint("finger_3_base_joint"));
    hand.actuation.rows[finger].terms = vec![(2, 0.5), (3, 0.5)];
    hand.actuation.rows[spread].terms.clear();
    hand.actuation.rows[spread].offset = 0.2;
    let hand = Arc::new(hand);
    let mut world = World::new(WorldSettings::default());
    let placed = world.add_hand(hand.clone(), &above(&hand, 0.5), &hand.actuation.open());
    let actuators = vec![0.0, 0.0, 0.6, 0.2];
    assert!(world.command(placed, Command::Close { actuators, force: 1.0, speed: 1.0 }));
    run(&mut world, 1.5);
    let q = world.hand_state(placed).unwrap().joints;
    assert!((q[finger] - 0.4).abs() < 5e-3 && (q[spread] - 0.2).abs() < 5e-3, "{q:?}");
}

#[test]
fn each_motor_keeps_the_force_that_it_alone_may_use() {
    let hand = library_hand("barrett");
    let mut world = World::new(WorldSettings::default());
    // Too heavy to be pushed away by the stronger ones.
    world.add(cuboid([0.03, 0.03, 0.06], 50.0, 0.5), &Isometry3::translation(0.0, 0.0, 0.06));
    let placed = world.add_hand(hand.clone(), &above(&hand, 0.06), &hand.actuation.open());
    let full = world.full_efforts(placed).unwrap();
    assert!(!world.share_forces(placed, &[1.0]) && !world.share_forces(placed, &vec![f64::NAN; full.len()]));
    let shares: Vec<f64> = (0..full.len()).map(|i| if i % 2 == 0 { 0.2 } else { 1.0 }).collect();
    assert!(world.share_forces(placed, &shares));
    close(&mut world, placed, 0.5);
    let mut most = vec![0.0_f64; full.len()];
    for _ in 0..80 {
        run(&mut world, 0.02);
        let efforts = world.hand_state(placed).unwrap().efforts;
        most.iter_mut().zip(efforts).for_each(|(most, now)| *most = most.max(now.abs()));
    }
    for (i, most) in most.iter().enumerate() {
        assert!(*most <= 0.5 * shares[i] * full[i] * 1.3, "{i}: {most} of {full:?}, {shares:?}");
    }
    let pressing = (0..full.len()).filter(|i| most[*i] > 0.3 * full[*i]);
    assert!(pressing.count() > 0, "nothing presses: {most:?} of {full:?}");
}
