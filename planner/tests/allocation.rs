//! The iteration loop asks the heap for nothing: counted, not promised.

mod clutter;

use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use clutter::{look_at, ten_objects};
use graspd_hands::library;
use graspd_planner::budget::{Budget, Stop, Unlimited};
use graspd_planner::estimator::Geometric;
use graspd_planner::options::{PlanOptions, SceneOptions, Scheme};
use graspd_planner::plan::plan;
use graspd_planner::scene::prepare;

#[global_allocator]
static ALLOCATOR: dhat::Alloc = dhat::Alloc;

/// Cancels after a number of iterations, so that nothing but iterations happens in between.
struct Iterations(AtomicUsize);

impl Budget for Iterations {
    fn elapsed(&self) -> Duration {
        Duration::ZERO
    }

    fn stop(&self) -> Option<Stop> {
        let left = self.0.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |n| n.checked_sub(1));
        left.is_err().then_some(Stop::Cancelled)
    }
}

#[test]
fn iterations_do_not_allocate() {
    let scene = prepare(&[look_at(&ten_objects())], &SceneOptions::default(), &Geometric, &Unlimited)
        .expect("a valid frame");
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool");
    let _profiler = dhat::Profiler::builder().testing().build();
    for id in ["robotiq-2f85", "robotiq-3f", "leap"] {
        let hand = library::hand(id).expect("a library hand");
        // With penetration from the first iteration: every objective is at work.
        let scheme = Scheme { iterations: 200, with_penetration: 200 };
        let options = PlanOptions { scheme, ..PlanOptions::default() };
        let blocks_of = |iterations: usize| {
            let before = dhat::HeapStats::get().total_blocks;
            let budget = Iterations(AtomicUsize::new(iterations));
            pool.install(|| plan(&scene, hand, &options, &budget, None));
            dhat::HeapStats::get().total_blocks - before
        };
        blocks_of(10);
        let (few, many) = (blocks_of(500), blocks_of(9_000));
        // Rounds over the whole batch may cost the thread pool a block each; iterations none.
        assert!(many <= few + 40, "{id}: {few} blocks for 500 iterations, {many} for 9000");
    }
}
