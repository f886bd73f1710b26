//! Frames of an Azure Kinect on one core: twelve finely meshed objects in a tray, and whole scenes for a dataset.
//!
//! `cargo bench -p graspd-sim --bench render`. A frame with noise must take less than 15 ms; generating, settling the
//! scenes included, must give at least 10 frames a second.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use divan::Bencher;
use divan::counter::ItemsCount;
use graspd_sim::camera::look_at;
use graspd_sim::clutter::{Arrangement, arrange, assortment};
use graspd_sim::mesh::Mesh;
use graspd_sim::object::{Object, Surface};
use graspd_sim::render::{Renderer, capture, picture};
use graspd_sim::sensor::{DepthCamera, Sensor};
use graspd_sim::world::{Tray, World, WorldSettings};
use nalgebra::{Isometry3, Point3, Vector3};

fn main() {
    divan::main();
}

/// A sphere of about 2000 triangles.
fn ball(radius: f64) -> Mesh {
    let (rings, sides) = (32, 32);
    let mut mesh = Mesh::default();
    for ring in 0..=rings {
        let tilt = PI * f64::from(ring) / f64::from(rings);
        for side in 0..sides {
            let turn = TAU * f64::from(side) / f64::from(sides);
            let (sin, cos) = tilt.sin_cos();
            mesh.vertices.push(Point3::new(sin * turn.cos(), sin * turn.sin(), cos) * radius);
        }
    }
    for ring in 0..rings {
        for side in 0..sides {
            let next = (side + 1) % sides;
            let [a, b] = [ring, ring + 1].map(|r| (r * sides) as u32);
            let (side, next) = (side as u32, next as u32);
            mesh.triangles.push([a + side, b + side, b + next]);
            mesh.triangles.push([a + side, b + next, a + next]);
        }
    }
    mesh
}

fn tray() -> World {
    let mut world = World::new(WorldSettings { tray: Some(Tray::default()), ..Default::default() });
    for i in 0..12 {
        let mesh = ball(0.03 + 0.002 * f64::from(i));
        let object = Object {
            name: "ball".into(),
            parts: vec![Mesh::cuboid(Vector3::repeat(0.02)).vertices],
            mesh: mesh.into(),
            mass_kg: 0.2,
            friction: 0.5,
            surface: Surface { albedo: 0.5, specular: 0.1 },
            source: graspd_sim::object::Source::Mesh,
        };
        let (x, y) = (0.1 * f64::from(i % 4) - 0.15, 0.1 * f64::from(i / 4) - 0.1);
        world.add(Arc::new(object), &Isometry3::translation(x, y, 0.04));
    }
    world
}

fn above() -> Isometry3<f64> {
    look_at(&Point3::new(0.25, 0.0, 0.7), &Point3::origin(), &Vector3::z())
}

#[divan::bench]
fn rendering(bencher: Bencher<'_, '_>) {
    let (world, lens, mut renderer) = (tray(), Sensor::azure_kinect().lens, Renderer::new());
    bencher.bench_local(|| renderer.capture(&world, &lens, &above()).depth_m[0]);
}

#[divan::bench]
fn noise(bencher: Bencher<'_, '_>) {
    let sensor = Sensor::azure_kinect();
    let view = capture(&tray(), &sensor.lens, &above());
    bencher.bench_local(|| sensor.observe(&view, 1));
}

/// What has to be below 15 ms: rendering and noise, as one takes frame after frame.
#[divan::bench]
fn frame(bencher: Bencher<'_, '_>) {
    let (world, mut camera) = (tray(), DepthCamera::new(Sensor::azure_kinect()));
    bencher.bench_local(|| camera.take(&world, &above(), 1).image.depth_m[0]);
}

/// The same for one who takes a single frame.
#[divan::bench]
fn frame_in_fresh_memory(bencher: Bencher<'_, '_>) {
    let (world, sensor) = (tray(), Sensor::azure_kinect());
    bencher.bench_local(|| sensor.observe(&capture(&world, &sensor.lens, &above()), 1));
}

/// Views of a generated scene.
const VIEWS: u32 = 64;

/// Whole generation, in frames: draw twelve objects, pour them into a tray, let them settle, and take 64 frames with
/// noise from all around.
#[divan::bench(sample_count = 12, sample_size = 1)]
fn generating(bencher: Bencher<'_, '_>) {
    let settings = WorldSettings { tray: Some(Tray::default()), ..WorldSettings::default() };
    let mut camera = DepthCamera::new(Sensor::azure_kinect());
    let mut seed = 0;
    bencher.counter(ItemsCount::new(VIEWS)).bench_local(|| {
        seed += 1;
        let world = arrange(&settings, &assortment(12, seed), Arrangement::Pile, seed)
            .expect("a tray has room for twelve");
        (0..VIEWS).map(|i| camera.take(&world, &around(i), seed).image.depth_m[0]).sum::<f32>()
    });
}

/// Half a metre to a metre away, in a spiral from the side to the top.
fn around(view: u32) -> Isometry3<f64> {
    let share = f64::from(view) / f64::from(VIEWS);
    let (turn, tilt) = (TAU * 10.0 * share, PI / 3.0 * (1.0 - share));
    let away = 0.5 + 0.5 * f64::from(view % 5) / 4.0;
    let towards = Vector3::new(tilt.sin() * turn.cos(), tilt.sin() * turn.sin(), tilt.cos());
    look_at(&Point3::from(away * towards), &Point3::new(0.0, 0.0, 0.02), &Vector3::z())
}

#[divan::bench(sample_count = 5)]
fn picture_for_people(bencher: Bencher<'_, '_>) {
    let (world, lens) = (tray(), Sensor::azure_kinect().lens);
    bencher.bench_local(|| picture(&world, &lens, &above()));
}
