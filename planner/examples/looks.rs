//! How long planning goes on between two looks at its budget, and where: what a dropped call costs at most.
//!
//! Plans on one thread, twice: the first time looks are timed, the second time the longest stretches are found again by
//! their numbers (the same looks in the same order) and the place at each end is told.
//!
//! ```sh
//! cargo run -p graspd-planner --example looks -- leap
//! ```

#[path = "../tests/clutter/mod.rs"]
mod clutter;

use std::backtrace::Backtrace;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use clutter::{look_at, ten_objects};
use graspd_hands::library;
use graspd_planner::budget::{Budget, Stop};
use graspd_planner::estimator::Geometric;
use graspd_planner::options::{PlanOptions, SceneOptions};
use graspd_planner::{plan, scene};

/// Stretches that are shown.
const SHOWN: usize = 12;

/// Never stops; remembers when it was looked at, or from where.
struct Watch {
    began: Instant,
    looks: Mutex<Vec<Instant>>,
    /// Looks of which the place is wanted.
    wanted: Vec<usize>,
    places: Mutex<Vec<(usize, String)>>,
}

impl Watch {
    fn new(wanted: Vec<usize>) -> Self {
        Self { began: Instant::now(), looks: Mutex::default(), wanted, places: Mutex::default() }
    }
}

impl Budget for Watch {
    fn elapsed(&self) -> Duration {
        self.began.elapsed()
    }

    fn stop(&self) -> Option<Stop> {
        let mut looks = self.looks.lock().expect("one thread");
        if self.wanted.contains(&looks.len()) {
            let place = place(&Backtrace::force_capture().to_string());
            self.places.lock().expect("one thread").push((looks.len(), place));
        }
        looks.push(Instant::now());
        None
    }
}

/// The innermost lines of a backtrace that are the planner's.
fn place(backtrace: &str) -> String {
    let lines =
        backtrace.lines().map(str::trim).filter(|l| l.starts_with("at ") && l.contains("planner/src/"));
    let lines = lines.filter_map(|l| l.split("planner/src/").nth(1)).filter(|l| !l.starts_with("budget"));
    lines.take(2).collect::<Vec<_>>().join(" < ")
}

fn run(hand: &str, watch: &Watch) {
    let hand = library::hand(hand).expect("a hand of the library");
    let frame = look_at(&ten_objects());
    watch.stop();
    let scene = scene::prepare(&[frame], &SceneOptions::default(), &Geometric, watch).expect("a scene");
    let plan = plan::plan(&scene, hand, &PlanOptions { batch: 48, ..PlanOptions::default() }, watch, None);
    watch.stop();
    drop(plan);
}

fn main() {
    let hand = std::env::args().nth(1).unwrap_or_else(|| "leap".to_owned());
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    one.install(|| {
        let timed = Watch::new(Vec::new());
        run(&hand, &timed);
        let looks = timed.looks.into_inner().expect("one thread");
        let mut stretches: Vec<(Duration, usize)> =
            looks.windows(2).enumerate().map(|(i, pair)| (pair[1] - pair[0], i)).collect();
        stretches.sort_by(|a, b| b.cmp(a));
        stretches.truncate(SHOWN);
        let traced = Watch::new(stretches.iter().flat_map(|(_, i)| [*i, i + 1]).collect());
        run(&hand, &traced);
        let places = traced.places.into_inner().expect("one thread");
        let at = |look: usize| places.iter().find(|(i, _)| *i == look).map_or("?", |(_, place)| place);
        println!("{} looks; the longest stretches:", looks.len());
        for (took, i) in stretches {
            println!("{:7.2} ms  from {}  to {}", took.as_secs_f64() * 1e3, at(i), at(i + 1));
        }
    });
}
