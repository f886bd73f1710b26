//! One frame of an Azure Kinect on one core: twelve finely meshed objects in a tray.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use divan::Bencher;
use graspd_sim::camera::look_at;
use graspd_sim::mesh::Mesh;
use graspd_sim::object::{Object, Surface};
use graspd_sim::render::{capture, picture};
use graspd_sim::sensor::Sensor;
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
    let (world, sensor) = (tray(), Sensor::azure_kinect());
    bencher.bench_local(|| capture(&world, &sensor.lens, &above()));
}

#[divan::bench]
fn noise(bencher: Bencher<'_, '_>) {
    let sensor = Sensor::azure_kinect();
    let view = capture(&tray(), &sensor.lens, &above());
    bencher.bench_local(|| sensor.observe(&view, 1));
}

#[divan::bench]
fn frame(bencher: Bencher<'_, '_>) {
    let (world, sensor) = (tray(), Sensor::azure_kinect());
    bencher.bench_local(|| sensor.observe(&capture(&world, &sensor.lens, &above()), 1));
}

#[divan::bench(sample_count = 5)]
fn picture_for_people(bencher: Bencher<'_, '_>) {
    let (world, lens) = (tray(), Sensor::azure_kinect().lens);
    bencher.bench_local(|| picture(&world, &lens, &above()));
}
