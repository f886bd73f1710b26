//! How long an assignment takes: 3 arms × 10 grasps (a cell) and 6 arms × 50 grasps, corridors with arms.

use divan::{Bencher, black_box};
use graspd_assign::*;
use nalgebra::{Isometry3, Point3};

fn main() {
    divan::main();
}

/// Random numbers from 0 to 1, the same in every run.
struct Dice(u64);

impl Dice {
    fn roll(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// Arms in a circle around a tray with objects, each with grasps of objects drawn at random.
fn arms(arms: usize, grasps: usize, objects: usize, seed: u64) -> Vec<Arm> {
    let mut dice = Dice(seed);
    let places: Vec<(f64, f64)> =
        (0..objects).map(|_| (0.36 * dice.roll() - 0.18, 0.36 * dice.roll() - 0.18)).collect();
    (0..arms)
        .map(|i| {
            let angle = std::f64::consts::TAU * i as f64 / arms as f64;
            let shoulder = Point3::new(0.55 * angle.cos(), 0.55 * angle.sin(), 0.3);
            let grasps = (0..grasps).map(|_| {
                let (x, y) = places[(dice.roll() * objects as f64) as usize % objects];
                let (x, y) = (x + 0.01 * dice.roll(), y + 0.01 * dice.roll());
                let at = |z| Isometry3::translation(x, y, z);
                Grasp {
                    world_from_pregrasp: at(0.3),
                    world_from_hand: at(0.2),
                    score: dice.roll(),
                    object: ObjectKey::At(Point3::new(x, y, 0.03)),
                    width_m: Some(0.09 * dice.roll()),
                    reach: Reach::Unknown,
                    barred: None,
                    corridor: None,
                }
            });
            let grasps = grasps.collect();
            Arm {
                opening_m: Some((0.0, 0.1)),
                region: ReachRegion::Shell { middle: shoulder, min_m: 0.1, max_m: 0.8 },
                body: Body { shoulder, hand_radius_m: 0.05, arm_radius_m: 0.04, ..Body::default() },
                ..Arm::new(&format!("arm {i}"), grasps)
            }
        })
        .collect()
}

fn run(bencher: Bencher<'_, '_>, arms: &[Arm]) {
    let problem = Problem { arms, ..Problem::default() };
    let found = assign(&problem, &Settings::default(), &mut || false);
    eprintln!(
        "value {:.2} of {:.2}, optimal {}, {} nodes",
        found.value, found.bound, found.optimal, found.nodes
    );
    bencher.bench_local(|| assign(black_box(&problem), &Settings::default(), &mut || false));
}

#[divan::bench(args = [1, 2, 3])]
fn three_arms_ten_grasps(bencher: Bencher<'_, '_>, seed: u64) {
    run(bencher, &arms(3, 10, 6, seed));
}

#[divan::bench(args = [1, 2, 3, 4])]
fn six_arms_fifty_grasps(bencher: Bencher<'_, '_>, seed: u64) {
    run(bencher, &arms(6, 50, 12, seed));
}

/// Slender arms and hands, more objects than arms: little is in conflict, much is to compare.
#[divan::bench(args = [1, 2, 3])]
fn six_slender_arms_fifty_grasps(bencher: Bencher<'_, '_>, seed: u64) {
    let mut arms = arms(6, 50, 20, seed);
    for arm in &mut arms {
        (arm.body.hand_radius_m, arm.body.arm_radius_m) = (0.02, 0.01);
    }
    run(bencher, &arms);
}
