//! Wherever the budget ends, work ends there: nothing half done is taken for an answer.

mod clutter;

use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use clutter::{look_at, ten_objects};
use graspd_hands::library;
use graspd_planner::budget::{Budget, Stop};
use graspd_planner::estimator::Geometric;
use graspd_planner::grid::Grid;
use graspd_planner::options::{PlanOptions, SceneOptions, Scheme};
use graspd_planner::plan;
use graspd_planner::scene::{SceneError, prepare};

/// Ends at its `last` look, and counts them.
struct Looks {
    last: usize,
    done: AtomicUsize,
}

impl Looks {
    fn until(last: usize) -> Self {
        Self { last, done: AtomicUsize::new(0) }
    }

    fn count(&self) -> usize {
        self.done.load(Ordering::Relaxed)
    }
}

impl Budget for Looks {
    fn elapsed(&self) -> Duration {
        Duration::ZERO
    }

    fn stop(&self) -> Option<Stop> {
        (self.done.fetch_add(1, Ordering::Relaxed) >= self.last).then_some(Stop::Cancelled)
    }
}

/// Looks that reading the scene took, and all together; `None` where the search ended before its end.
fn run(looks: &Looks) -> Option<(usize, usize)> {
    let frame = look_at(&ten_objects());
    let options = SceneOptions { grid: Grid { resolution: 40, size_m: 0.4 }, ..SceneOptions::default() };
    let scene = match prepare(&[frame], &options, &Geometric, looks) {
        Ok(scene) => scene,
        Err(SceneError::Stopped(Stop::Cancelled)) => return None,
        Err(other) => panic!("{other}"),
    };
    let reading = looks.count();
    let hand = library::hand("leap").expect("the LEAP Hand is in the library");
    let scheme = Scheme { iterations: 20, with_penetration: 10 };
    let options = PlanOptions { batch: 6, scheme, ..PlanOptions::default() };
    let plan = plan::plan(&scene, hand, &options, looks, None);
    if plan.stats.stopped == Some(Stop::Cancelled) {
        return None;
    }
    Some((reading, looks.count()))
}

#[test]
fn work_that_nobody_waits_for_ends_wherever_it_is() {
    // One thread makes the same looks in every run.
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    one.install(|| {
        let (reading, all) = run(&Looks::until(usize::MAX)).expect("nothing ends it");
        // Fields are looked through in rows and slabs, iterations and closings step by step.
        let (least_reading, least_search) = (40 * 40 + 4 * 40, 6 * 20 + 6 * 20);
        assert!(reading > least_reading && all - reading > least_search, "{reading} and {all} looks");
        for k in 0..24 {
            let last = all * k / 24;
            let looks = Looks::until(last);
            assert!(run(&looks).is_none(), "it went on after look {last} of {all}");
            // What is left after it is skipped: a look for each row of voxels at most, and for each candidate.
            let more = looks.count() - last;
            assert!(more < 8 * least_reading, "{more} looks after look {last} of {all}");
        }
    });
}
