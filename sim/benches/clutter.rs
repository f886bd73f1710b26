//! CPU time of arranging clutter: 12 objects must settle in less than 2 s.
//!
//! `cargo bench -p graspd-sim --bench clutter`. One seed each sample, single-threaded.

use std::sync::atomic::{AtomicU64, Ordering};

use graspd_sim::clutter::{Arrangement, arrange, assortment, is_at_rest};
use graspd_sim::world::{Tray, WorldSettings};

fn main() {
    divan::main();
}

fn scene(bencher: divan::Bencher<'_, '_>, objects: usize, how: Arrangement) {
    let settings = WorldSettings { tray: Some(Tray::default()), ..WorldSettings::default() };
    let seed = AtomicU64::new(0);
    bencher
        .with_inputs(|| {
            let seed = seed.fetch_add(1, Ordering::Relaxed);
            (assortment(objects, seed), seed)
        })
        .bench_values(|(objects, seed)| {
            let world = arrange(&settings, &objects, how, seed);
            world.is_ok_and(|world| world.ids().len() == objects.len() && is_at_rest(&world))
        });
}

#[divan::bench(args = [5, 12, 16], sample_count = 30, sample_size = 1)]
fn pile(bencher: divan::Bencher<'_, '_>, objects: usize) {
    scene(bencher, objects, Arrangement::Pile);
}

#[divan::bench(args = [5, 12], sample_count = 30, sample_size = 1)]
fn packed(bencher: divan::Bencher<'_, '_>, objects: usize) {
    scene(bencher, objects, Arrangement::Packed);
}

#[divan::bench(sample_count = 100)]
fn draw_twelve_objects(bencher: divan::Bencher<'_, '_>) {
    let seed = AtomicU64::new(0);
    bencher.bench(|| assortment(12, seed.fetch_add(1, Ordering::Relaxed)));
}
