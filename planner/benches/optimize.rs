//! Durations of the optimization: every hand, and how they grow with batch, iterations and focal contacts.

#[path = "../tests/clutter/mod.rs"]
mod clutter;

use std::sync::LazyLock;

use clutter::{look_at, ten_objects};
use divan::{Bencher, black_box};
use graspd_hands::library;
use graspd_planner::budget::Unlimited;
use graspd_planner::estimator::Geometric;
use graspd_planner::options::{PlanOptions, SceneOptions, Scheme};
use graspd_planner::plan::plan;
use graspd_planner::scene::{Scene, prepare};

fn main() {
    divan::main();
}

fn scene_with(focal_contact_threshold: f64) -> Scene {
    let options = SceneOptions { focal_contact_threshold, ..SceneOptions::default() };
    prepare(&[look_at(&ten_objects())], &options, &Geometric, &Unlimited)
        .expect("the synthetic frame is valid")
}

static SCENE: LazyLock<Scene> = LazyLock::new(|| scene_with(0.7));

fn run(bencher: Bencher, scene: &Scene, hand: &str, options: &PlanOptions) {
    let hand = library::hand(hand).expect("a library hand");
    bencher.bench(|| plan(black_box(scene), hand, options, &Unlimited, None));
}

#[divan::bench(args = library::ids())]
fn plan_200_40(bencher: Bencher, hand: &str) {
    run(bencher, &SCENE, hand, &PlanOptions::default());
}

#[divan::bench]
fn antipodal_500_by_100(bencher: Bencher) {
    let scheme = Scheme { iterations: 100, with_penetration: 0 };
    run(bencher, &SCENE, "antipodal", &PlanOptions { batch: 500, scheme, ..PlanOptions::default() });
}

#[divan::bench(args = [12, 24, 48, 96])]
fn batch(bencher: Bencher, batch: usize) {
    run(bencher, &SCENE, "robotiq-3f", &PlanOptions { batch, ..PlanOptions::default() });
}

#[divan::bench(args = [50, 100, 200, 400])]
fn iterations(bencher: Bencher, iterations: usize) {
    let scheme = Scheme { iterations, with_penetration: iterations / 5 };
    run(bencher, &SCENE, "robotiq-3f", &PlanOptions { scheme, ..PlanOptions::default() });
}

#[divan::bench(args = [0.3, 0.5, 0.7, 0.9])]
fn focal_contact_threshold(bencher: Bencher, threshold: f64) {
    run(bencher, &scene_with(threshold), "robotiq-3f", &PlanOptions::default());
}
