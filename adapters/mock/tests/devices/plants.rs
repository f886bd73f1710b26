//! The shared world as the body of emulated devices.
#![allow(clippy::unwrap_used, reason = "helpers of tests are not in test functions")]

use std::sync::Arc;
use std::time::{Duration, Instant};

use graspd_adapters_emulators::dynamixel::{MotorCommand, MotorState, Plant as _};
use graspd_adapters_emulators::robotiq::{AxisCommand, AxisState, Contact, Plant as _};
use graspd_adapters_emulators::ur::{Plant as _, PlantTarget, Six, UrModel};
use graspd_adapters_mock::plants::{GripperPlant, MotorPlant, WristMount, WristPlant};
use graspd_adapters_mock::{SharedWorld, SharedWorldSettings};
use graspd_hands::library;
use graspd_sim::object::Object;
use graspd_sim::world::{HandId, World, WorldSettings};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

/// Ten times as fast as the wall clock, where the machine can.
const SPEED: f64 = 10.0;
const HOME: Six = [0.0, -1.3, 1.3, -1.57, -1.57, 0.0];

/// A hand that points down, with something between its fingers where `object` says how wide.
async fn world(hand: &str, speed: f64, object: Option<f64>) -> (SharedWorld, HandId) {
    let hand = Arc::new(library::hand(hand).unwrap().clone());
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let tool = down * hand.tool_point.coords;
    let height_m = if object.is_some() { 0.03 } else { 0.3 };
    let at = Isometry3::from_parts((Vector3::new(0.0, 0.0, height_m) - tool).into(), down);
    let mut world = World::new(WorldSettings::default());
    if let Some(half) = object {
        let object = Object::cuboid("box", Vector3::new(half, half, 0.03)).unwrap();
        world.add(Arc::new(object), &Isometry3::translation(0.0, 0.0, 0.03));
    }
    let settings = SharedWorldSettings { speed, bins: Vec::new() };
    let shared = SharedWorld::new(world, settings).unwrap();
    let id = shared.add_hand(hand, at, None).await.unwrap();
    (shared, id)
}

/// Tells a gripper's motor until it stands.
async fn go(plant: &mut GripperPlant, target: f64) -> AxisState {
    let command = AxisCommand { target: Some(target), speed: 1.0, force: 0.3 };
    let mut states = [AxisState::default()];
    let until = Instant::now() + Duration::from_secs(20);
    plant.advance(Duration::ZERO, &[command], &mut states);
    assert!(states[0].moving, "what is told now is on its way now: {states:?}");
    while states[0].moving {
        assert!(Instant::now() < until, "it never stands: {states:?}");
        tokio::time::sleep(Duration::from_millis(5)).await;
        plant.advance(Duration::from_millis(5), &[command], &mut states);
    }
    states[0]
}

#[tokio::test(flavor = "multi_thread")]
async fn a_gripper_closes_on_what_lies_between_its_fingers() {
    let (shared, hand) = world("robotiq-2f85", SPEED, None).await;
    let mut plant = GripperPlant::two_finger(&shared, hand).await.unwrap();
    let closed = go(&mut plant, 255.0).await;
    assert!(closed.position > 227.0 && closed.contact.is_none(), "{closed:?}");
    let open = go(&mut plant, 0.0).await;
    assert!((open.position - 3.0).abs() < 2.0 && open.contact.is_none(), "{open:?}");

    let (shared, hand) = world("robotiq-2f85", SPEED, Some(0.02)).await;
    let mut plant = GripperPlant::two_finger(&shared, hand).await.unwrap();
    let held = go(&mut plant, 255.0).await;
    // 40 mm of 85 mm are left open.
    let expected = 230.0 - 227.0 * 40.0 / 85.0;
    assert!((held.position - expected).abs() < 8.0, "{held:?}, expected {expected}");
    assert_eq!(held.contact, Some(Contact::Closing));
    assert!(held.current > 5.0, "{held:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn motors_turn_the_joints_of_their_addresses() {
    let (shared, hand) = world("leap", SPEED, None).await;
    let names: Vec<String> = {
        let hand = library::hand("leap").unwrap();
        hand.actuation.coordinates.iter().map(|c| c.name.clone()).collect()
    };
    // Addresses in any order.
    let ids: Vec<u8> = (0..16).map(|i| 15 - i).collect();
    assert!(MotorPlant::new(&shared, hand, vec![1, 2], 350.0).await.is_err());
    let mut plant = MotorPlant::new(&shared, hand, ids.clone(), 350.0).await.unwrap();
    let thumb = names.iter().position(|n| n == "thumb_ip").unwrap();
    let goal = |id: u8| if id == ids[thumb] { 0.5 } else { 0.1 };
    let commands: Vec<MotorCommand> = (0..16)
        .map(|id| MotorCommand {
            id,
            torque: true,
            goal_rad: std::f64::consts::PI + goal(id),
            current_limit_ma: 300.0,
            speed_limit_rad_s: 3.0,
        })
        .collect();
    let mut states = [MotorState::default(); 16];
    let until = Instant::now() + Duration::from_secs(20);
    let off = |states: &[MotorState]| {
        let off = |(id, s): (u8, &MotorState)| (s.position_rad - std::f64::consts::PI - goal(id)).abs();
        (0..16).zip(states).map(off).fold(0.0, f64::max)
    };
    loop {
        plant.advance(Duration::from_millis(5), &commands, &mut states);
        if off(&states) < 0.05 {
            break;
        }
        assert!(Instant::now() < until, "{states:?}");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let actuators = shared.with(move |world| world.hand_state(hand).unwrap().actuators).await.unwrap();
    assert!((actuators[thumb] - 0.5).abs() < 0.06, "{actuators:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wrist_follows_its_controller_and_says_where_it_is_held() {
    let model = UrModel::Ur5e;
    let start = model.flange(&HOME);
    let hand = Arc::new(library::hand("robotiq-2f85").unwrap().clone());
    let settings = SharedWorldSettings { speed: 1.0, bins: Vec::new() };
    let shared = SharedWorld::new(World::new(WorldSettings::default()), settings).unwrap();
    let id = shared.add_hand(hand, start, None).await.unwrap();
    let identity = Isometry3::identity();
    let mount = WristMount { model, world_from_base: identity, flange_from_hand: identity, joints: HOME };
    let elsewhere = WristMount { joints: [0.5; 6], ..mount };
    let error = WristPlant::new(&shared, id, elsewhere).await.unwrap_err();
    assert_eq!(error.field, "joints");
    let mut plant = WristPlant::new(&shared, id, mount).await.unwrap();
    // Up by a decimetre in half a second, then wait: the controller counts its own steps.
    let mut state = None;
    let mut fastest: f64 = 0.0;
    let mut last = start.translation.vector;
    for step in 0..400 {
        let mut pose = start;
        pose.translation.vector.z += 0.1 * (f64::from(step) / 250.0).min(1.0);
        let q = model.joints(&pose, &HOME).unwrap();
        let target =
            PlantTarget { dt_s: 0.002, q, qd: [0.0; 6], base_from_flange: pose, base_from_tcp: pose };
        let now = plant.step(&target);
        let at = model.flange(&now.q).translation.vector;
        fastest = fastest.max((at - last).norm());
        last = at;
        state = Some(now);
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    let state = state.unwrap();
    assert!((last - start.translation.vector - Vector3::z() * 0.1).norm() < 2e-3, "{last}");
    assert!(state.protective_stop.is_none() && state.wrench.iter().all(|w| w.abs() < 5.0), "{state:?}");
    assert!(fastest < 0.05, "it jumps: {fastest} m");

    // Down into the table: it is pressed on from below, and does not get there.
    let mut pose = start;
    let mut most: f64 = 0.0;
    let mut stop = None;
    for step in 0..1500 {
        pose.translation.vector.z = (start.translation.vector.z + 0.1 - 0.0008 * f64::from(step)).max(0.0);
        let target =
            PlantTarget { dt_s: 0.002, q: HOME, qd: [0.0; 6], base_from_flange: pose, base_from_tcp: pose };
        let state = plant.step(&target);
        most = most.max(state.wrench[2]);
        stop = state.protective_stop;
        if stop.is_some() {
            break;
        }
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    assert!(most > 40.0 && stop.is_some_and(|why| why.contains("held")), "{most} N");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_world_on_demand_is_no_body() {
    let (shared, hand) = world("robotiq-2f85", 0.0, None).await;
    let error = GripperPlant::two_finger(&shared, hand).await.unwrap_err();
    assert!(error.to_string().contains("a speed above 0"), "{error}");
    let (shared, hand) = world("leap", SPEED, None).await;
    let error = GripperPlant::three_finger(&shared, hand).await.unwrap_err();
    assert!(error.to_string().contains("expected finger_middle"), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn each_motor_presses_with_the_current_of_its_own_register() {
    let (shared, hand) = world("leap", SPEED, None).await;
    let names: Vec<String> = {
        let hand = library::hand("leap").unwrap();
        hand.actuation.coordinates.iter().map(|c| c.name.clone()).collect()
    };
    // A block between the fingers that is too heavy for them.
    let block = Object { mass_kg: 50.0, ..Object::cuboid("block", Vector3::new(0.03, 0.03, 0.16)).unwrap() };
    let centre = Isometry3::translation(0.0, 0.0, 0.16);
    shared.with(move |world| world.add(Arc::new(block), &centre)).await.unwrap();
    let mut plant = MotorPlant::new(&shared, hand, (0..16).collect(), 350.0).await.unwrap();
    let name = |id: u8| names[usize::from(id)].as_str();
    let commands: Vec<MotorCommand> = (0..16)
        .map(|id| MotorCommand {
            id,
            torque: name(id) != "ring_dip",
            goal_rad: std::f64::consts::PI + if name(id).contains("abduction") { 0.0 } else { 1.2 },
            current_limit_ma: if name(id).starts_with("index") { 40.0 } else { 300.0 },
            speed_limit_rad_s: 6.0,
        })
        .collect();
    let mut states = [MotorState::default(); 16];
    let (mut most, until) = ([0.0_f64; 16], Instant::now() + Duration::from_millis(800));
    while Instant::now() < until {
        plant.advance(Duration::from_millis(5), &commands, &mut states);
        most.iter_mut().zip(&states).for_each(|(most, now)| *most = most.max(now.current_ma.abs()));
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    // Damping counts as well: a little more than the limit shows while speeds change.
    for (id, most) in (0..16).zip(most) {
        let limit = if name(id).starts_with("index") { 40.0 } else { 300.0 };
        assert!(most <= 1.3 * limit, "{}: {most} mA of {limit}", name(id));
        assert!(most == 0.0 || name(id) != "ring_dip", "{most} mA without torque");
    }
    let of = |finger: &str| {
        let own = (0..16u8).filter(|id| name(*id).starts_with(finger));
        own.map(|id| most[usize::from(id)]).fold(0.0, f64::max)
    };
    assert!(of("index") > 20.0, "the index finger does not press: {names:?} {most:?}");
    assert!(of("middle") > 100.0, "the middle finger does not press: {names:?} {most:?}");
}
