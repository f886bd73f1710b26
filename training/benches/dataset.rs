//! Labelled views of an Azure Kinect on one core: whole generation, and its parts.
//!
//! `cargo bench -p graspd-training --bench dataset`. Generating, scenes and labels included, must give at least 3
//! views a second.

use divan::Bencher;
use divan::counter::ItemsCount;
use graspd_sim::sensor::DepthCamera;
use graspd_sim::sensor::Sensor;
use graspd_training::dataset::clutter::clutter;
use graspd_training::dataset::contacts::contacts;
use graspd_training::dataset::families::{Split, Stock};
use graspd_training::dataset::generate::{GenerateSettings, Generator};
use graspd_training::dataset::recipe::Recipe;
use graspd_training::dataset::shard::record;

fn main() {
    divan::main();
}

/// Views of a scene.
const VIEWS: u32 = 64;

fn generator() -> Generator {
    let settings = GenerateSettings {
        stock: Stock::families(Split::Train),
        families: Split::Train,
        sensor: "azure-kinect".into(),
        recipe: Recipe::default(),
        scenes: 1000,
        views: VIEWS,
        shard: [0, 1],
        seed: 1,
        program: "bench".into(),
        commit: None,
    };
    Generator::new(settings).expect("the defaults are of use")
}

/// Whole scenes with 64 views each, on one thread.
#[divan::bench(sample_count = 8, sample_size = 1)]
fn generating(bencher: Bencher<'_, '_>) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    let (generator, mut number) = (generator(), 0);
    bencher.counter(ItemsCount::new(VIEWS)).bench_local(|| {
        number += 1;
        pool.install(|| {
            let scene = generator.scene(number).expect("a scene");
            let mut camera = DepthCamera::new(scene.0.sensor.clone());
            let view = |v| record(&generator.view(number, &scene, &mut camera, v).expect("a view")).len();
            (0..VIEWS).map(view).sum::<usize>()
        })
    });
}

/// Drawing and settling a scene.
#[divan::bench(sample_count = 8, sample_size = 1)]
fn settling(bencher: Bencher<'_, '_>) {
    let (recipe, stock, mut number) = (Recipe::default(), Stock::families(Split::Train), 0);
    bencher.bench_local(|| {
        number += 1;
        clutter(&recipe, &stock, &Sensor::azure_kinect(), 1, number).expect("a scene")
    });
}

/// Grasps and contacts of a scene.
#[divan::bench(sample_count = 8, sample_size = 1)]
fn labelling(bencher: Bencher<'_, '_>) {
    let (generator, mut number) = (generator(), 0);
    bencher
        .with_inputs(|| {
            number += 1;
            generator.scene(number).expect("a scene").0
        })
        .bench_local_values(|scene| contacts(&scene.world, &Recipe::default(), scene.seed).grasps);
}

/// One view: depth frame, volume, labels.
#[divan::bench(sample_count = 64, sample_size = 1)]
fn viewing(bencher: Bencher<'_, '_>) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    let generator = generator();
    let scene = generator.scene(3).expect("a scene");
    let mut camera = DepthCamera::new(scene.0.sensor.clone());
    let mut view = 0;
    bencher.bench_local(|| {
        view = (view + 1) % VIEWS;
        pool.install(|| generator.view(3, &scene, &mut camera, view).expect("a view").contacts.len())
    });
}

/// Packing a view into a record.
#[divan::bench]
fn packing(bencher: Bencher<'_, '_>) {
    let generator = generator();
    let scene = generator.scene(3).expect("a scene");
    let mut camera = DepthCamera::new(scene.0.sensor.clone());
    let sample = generator.view(3, &scene, &mut camera, 5).expect("a view");
    bencher.bench_local(|| record(&sample).len());
}
