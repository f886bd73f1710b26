//! What executing one grasp costs: approach, close, lift, hold, shake. `cargo bench -p graspd-sim --bench execute`.

#![allow(missing_docs, clippy::unwrap_used)]

use std::f64::consts::PI;
use std::sync::Arc;

use graspd_hands::{CoordinateKind, library};
use graspd_sim::execute::{ExecuteSettings, GraspCommand, execute};
use graspd_sim::mesh::Mesh;
use graspd_sim::object::{Object, Surface};
use graspd_sim::world::{World, WorldSettings};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

fn main() {
    divan::main();
}

/// A box of 14 × 5 × 8 cm (4 × 4 × 8 cm for grippers that are narrower), 300 g, gripped from above.
#[divan::bench(
    args = ["leap", "robotiq-3f", "barrett", "brunel", "model-o", "robotiq-2f85"],
    sample_count = 5,
    sample_size = 1
)]
fn one_grasp(bencher: divan::Bencher<'_, '_>, id: &str) {
    let hand = Arc::new(library::hand(id).unwrap().clone());
    let half = match id {
        "leap" | "robotiq-3f" | "barrett" => Vector3::new(0.07, 0.025, 0.04),
        _ => Vector3::new(0.02, 0.02, 0.04),
    };
    let mesh = Mesh::cuboid(half);
    let object = Arc::new(Object {
        name: "box".into(),
        parts: vec![mesh.vertices.clone()],
        mesh: mesh.into(),
        mass_kg: 0.3,
        friction: 0.5,
        surface: Surface::default(),
        source: graspd_sim::object::Source::Mesh,
    });
    let down = UnitQuaternion::rotation_between(&hand.approach, &-Vector3::z())
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI));
    let at = Vector3::new(0.0, 0.0, 0.055) - down * hand.tool_point.coords;
    let world_from_hand = Isometry3::from_parts(at.into(), down);
    let posture = |share: f64| -> Vec<f64> {
        let driven = hand.actuation.coordinates.iter().filter(|c| c.kind == CoordinateKind::Actuator);
        driven.map(|c| c.open + share * (c.closed - c.open)).collect()
    };
    let grasp = GraspCommand {
        world_from_pregrasp: Isometry3::translation(0.0, 0.0, 0.06) * world_from_hand,
        world_from_hand,
        open: posture(0.0),
        contact: posture(0.6),
        squeezed: posture(0.8),
    };
    bencher
        .with_inputs(|| {
            let mut world = World::new(WorldSettings::default());
            world.add(object.clone(), &Isometry3::translation(0.0, 0.0, half.z));
            let placed = world.add_hand(hand.clone(), &grasp.world_from_pregrasp, &hand.actuation.open());
            (world, placed)
        })
        .bench_values(|(mut world, placed)| {
            let trial = execute(&mut world, placed, &grasp, &ExecuteSettings::default(), &mut |_, _| {});
            assert_eq!(trial.failure, None, "{id}: what is measured is a whole execution");
            trial
        });
}
