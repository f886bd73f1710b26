//! How long a servo takes for a frame of a 224 x 172 palm camera above ten objects, by stages, and how many blocks of
//! memory it asks for. The rig stands still above its target, so that every frame is tracked.
//!
//! `cargo bench -p graspd-planner --bench servo`, for two threads `RAYON_NUM_THREADS=2` before it.

#[allow(dead_code)] // tests use the rest
#[path = "../tests/clutter/mod.rs"]
mod clutter;
#[allow(dead_code)] // tests use the rest
#[path = "../tests/palm/mod.rs"]
mod palm;

use std::alloc::{GlobalAlloc, Layout, System};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use clutter::ten_objects;
use graspd_planner::budget::{Budget, Stop};
use graspd_planner::servo::{ServoOptions, State};
use palm::Rig;

/// Frames of each measurement.
const FRAMES: usize = 300;

/// Counts what is asked of the system's allocator.
struct Counting;

static BLOCKS: AtomicU64 = AtomicU64::new(0);
static BYTES: AtomicU64 = AtomicU64::new(0);

// SAFETY: every call goes on to the system's allocator unchanged.
#[allow(unsafe_code)]
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        BLOCKS.fetch_add(1, Ordering::Relaxed);
        BYTES.fetch_add(layout.size() as u64, Ordering::Relaxed);
        // SAFETY: as the caller promised.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as the caller promised.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// A clock without an end.
struct Clock(Instant);

impl Budget for Clock {
    fn elapsed(&self) -> Duration {
        self.0.elapsed()
    }

    fn stop(&self) -> Option<Stop> {
        None
    }
}

/// Time that this process has had on any core so far, milliseconds; 0 where the system does not tell.
fn cpu_ms() -> f64 {
    let Ok(tasks) = std::fs::read_dir("/proc/self/task") else { return 0.0 };
    let told = tasks.flatten().filter_map(|t| std::fs::read_to_string(t.path().join("schedstat")).ok());
    told.filter_map(|s| s.split(' ').next()?.parse::<f64>().ok()).sum::<f64>() / 1e6
}

fn quantile(sorted: &[f64], q: f64) -> f64 {
    sorted.get(((sorted.len().max(1) - 1) as f64 * q).round() as usize).copied().unwrap_or(0.0)
}

fn main() {
    println!("{} threads", rayon::current_num_threads());
    for id in ["robotiq-2f85", "robotiq-3f", "leap"] {
        let mut rig = Rig::new(id, ten_objects(), ServoOptions::default());
        // To the start of the approach, as a robot would go.
        for _ in 0..20 {
            if rig.step().is_err() {
                println!("{id}: no frame to begin with");
            }
        }
        let frame = rig.frame();
        let (mut stages, mut whole) = (BTreeMap::<&str, Vec<f64>>::new(), Vec::new());
        let (mut tracked, mut blocks, mut bytes, mut cpu) = (0, 0, 0, 0.0);
        for k in 0..FRAMES as u64 {
            let mut next = frame.clone();
            next.sequence += k;
            next.captured += palm::FRAME * k as u32;
            let before = (BLOCKS.load(Ordering::Relaxed), BYTES.load(Ordering::Relaxed));
            let cpu_before = cpu_ms();
            let clock = Clock(Instant::now());
            let Ok(answer) = rig.servo.step(next, &clock) else { continue };
            whole.push(clock.elapsed().as_secs_f64() * 1e3);
            cpu += cpu_ms() - cpu_before;
            blocks += BLOCKS.load(Ordering::Relaxed) - before.0;
            bytes += BYTES.load(Ordering::Relaxed) - before.1;
            tracked += usize::from(answer.state == State::Tracking);
            for (name, took) in &answer.stages {
                stages.entry(name).or_default().push(took.as_secs_f64() * 1e3);
            }
        }
        whole.sort_by(f64::total_cmp);
        let mean = whole.iter().sum::<f64>() / whole.len().max(1) as f64;
        println!(
            "{id:<14} frame -> answer: median {:.2} ms, p99 {:.2} ms, mean {mean:.2} ms = {:.0} Hz; {:.2} ms of CPU time; {tracked} of {FRAMES} \
             tracked; {} blocks, {:.2} MB a frame",
            quantile(&whole, 0.5),
            quantile(&whole, 0.99),
            1e3 / mean,
            cpu / FRAMES as f64,
            blocks / FRAMES as u64,
            bytes as f64 / FRAMES as f64 / 1e6,
        );
        for name in ["frame", "fuse", "window", "refine", "judge"] {
            let Some(times) = stages.get_mut(name) else { continue };
            times.sort_by(f64::total_cmp);
            println!(
                "  {name:<8} median {:.3} ms, p99 {:.3} ms",
                quantile(times, 0.5),
                quantile(times, 0.99)
            );
        }
    }
}
