//! `graspd device latency`: how long the ways between a cell and its devices take, idle and with every core busy.
//!
//! Devices are those of the file. An emulated arm and hand are also moved: from a command to motion, and how often the
//! fingers' loop goes round. Real ones are only asked.

use std::io::Write as _;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use clap::Args;
use graspd_adapters_core::{Hand as _, Limits};
use graspd_adapters_emulators::ur::UrEmulator;
use graspd_adapters_ur::UrArm;
use graspd_cell::config::CellConfig;
use serde::Serialize;

use super::Which;
use crate::devices::arm::WiredArm;
use crate::devices::hand::{AnyHand, WiredHand};
use crate::devices::{self, sections};

const PATIENCE: Duration = Duration::from_secs(20);

/// Measures how long the ways between a cell and its devices take, idle and with busy cores. Moves emulated devices only.
#[derive(Debug, Clone, Args)]
pub(super) struct LatencyArgs {
    #[command(flatten)]
    which: Which,
    /// Looks at each way
    #[arg(long, value_name = "N", default_value_t = 500, value_parser = clap::value_parser!(u32).range(10..=100_000))]
    looks: u32,
    /// Threads that keep cores busy in the second half; left out: as many as there are cores
    #[arg(long, value_name = "THREADS")]
    load: Option<usize>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// One line of the table.
#[derive(Debug, Serialize)]
struct Row {
    way: &'static str,
    load: usize,
    looks: usize,
    p50_ms: f64,
    p99_ms: f64,
    most_ms: f64,
    rate_hz: Option<f64>,
}

impl Row {
    fn of(way: &'static str, mut times: Vec<Duration>, is_rate: bool) -> Option<Self> {
        times.sort();
        let last = times.len().checked_sub(1)?;
        let at = |share: f64| 1e3 * times[(last as f64 * share).round() as usize].as_secs_f64();
        let sum: f64 = times.iter().map(Duration::as_secs_f64).sum();
        let rate_hz = is_rate.then(|| times.len() as f64 / sum);
        let (p50_ms, p99_ms, most_ms) = (at(0.5), at(0.99), at(1.0));
        Some(Self { way, load: 0, looks: times.len(), p50_ms, p99_ms, most_ms, rate_hz })
    }
}

/// Threads that do nothing but keep cores busy, until this is dropped.
struct Load(Arc<AtomicBool>, Vec<std::thread::JoinHandle<()>>);

impl Load {
    fn new(threads: usize) -> Self {
        let ends = Arc::new(AtomicBool::new(false));
        let spin = || {
            let ends = ends.clone();
            std::thread::spawn(move || {
                let mut x = 1_u64;
                while !ends.load(Ordering::Relaxed) {
                    for _ in 0..10_000 {
                        x = std::hint::black_box(x.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1));
                    }
                }
            })
        };
        let threads = (0..threads).map(|_| spin()).collect();
        Self(ends, threads)
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
        for thread in self.1.drain(..) {
            // A thread that counts does not panic.
            let _ended = thread.join();
        }
    }
}

pub(super) async fn run(args: &LatencyArgs) -> anyhow::Result<()> {
    let mut config = args.which.read()?;
    let [camera, arm, hand] =
        sections(&config).map(|s| (args.which.wants(s.name), s.is_mock(), s.is_emulated()));
    // Emulated devices harm nobody; real ones are not moved.
    (config.arm.armed, config.hand.armed) = (arm.2, hand.2);
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let mut rows = Vec::new();
    for load in [0, args.load.unwrap_or(cores)] {
        let busy = Load::new(load);
        let mut found = Vec::new();
        if arm.0 && !arm.1 {
            let wired = devices::arm::connect(&config, None).await?;
            arm_rows(&wired, args.looks, &mut found).await?;
        }
        if hand.0 && !hand.1 {
            hand_rows(&devices::hand::connect(&config, None)?, args.looks, &mut found).await?;
        }
        if camera.0 && camera.1 {
            frame_rows(&config, args.looks, &mut found).await?;
        }
        drop(busy);
        rows.extend(found.into_iter().flatten().map(|row| Row { load, ..row }));
    }
    let mut out = std::io::stdout().lock();
    if args.json {
        writeln!(out, "{}", serde_json::to_string_pretty(&rows)?)?;
        return Ok(());
    }
    let width = rows.iter().map(|row| row.way.len()).max().unwrap_or(0);
    writeln!(
        out,
        "{:<width$} {:>9} {:>9} {:>9} {:>9} {:>8}",
        "way", "load", "p50 ms", "p99 ms", "most ms", "rate"
    )?;
    for row in &rows {
        let load = if row.load == 0 { "idle".to_owned() } else { format!("{} busy", row.load) };
        let rate = row.rate_hz.map_or_else(String::new, |hz| format!("{hz:.0} Hz"));
        let Row { way, p50_ms, p99_ms, most_ms, .. } = row;
        writeln!(out, "{way:<width$} {load:>9} {p50_ms:>9.2} {p99_ms:>9.2} {most_ms:>9.2} {rate:>8}")?;
    }
    Ok(())
}

async fn arm_rows(wired: &WiredArm, looks: u32, rows: &mut Vec<Option<Row>>) -> anyhow::Result<()> {
    let (mut gaps, mut last, mut stamp) = (Vec::new(), Instant::now(), 0.0);
    while gaps.len() < looks as usize + 1 {
        let now = wired.arm.robot_state(PATIENCE).await?.timestamp_s;
        if now != stamp {
            stamp = now;
            gaps.push(last.elapsed());
            last = Instant::now();
        }
        tokio::time::sleep(Duration::from_micros(100)).await;
    }
    rows.push(Row::of("arm: from one state to the next (RTDE)", gaps.split_off(1), true));
    let version = graspd_adapters_ur::Dashboard::new(
        wired.arm.config().host.clone(),
        wired.arm.config().ports.dashboard,
        PATIENCE,
    );
    let mut asked = Vec::new();
    for _ in 0..looks.min(100) {
        let began = Instant::now();
        version.robot_mode().await?;
        asked.push(began.elapsed());
    }
    rows.push(Row::of("arm: question to the dashboard, connection included", asked, false));
    if let Some(emulator) = &wired.emulator {
        rows.push(command_to_motion(&wired.arm, emulator, looks.min(60)).await?);
    }
    Ok(())
}

/// From the call to the first step in which the controller's targets move.
async fn command_to_motion(arm: &UrArm, emulator: &UrEmulator, looks: u32) -> anyhow::Result<Option<Row>> {
    let limits = Limits { speed_m_s: 0.25, acceleration_m_s2: 1.0 };
    let home = arm.robot_state(PATIENCE).await?.joints;
    // Uploads the control script.
    arm.move_joints(&home, limits, PATIENCE).await?;
    let mut starts = Vec::new();
    for look in 0..looks {
        let mut goal = home;
        goal[5] += if look % 2 == 0 { 0.2 } else { 0.0 };
        let began = Instant::now();
        let moves = async {
            while emulator.snapshot().target_speeds.iter().all(|v| v.abs() < 1e-6) {
                tokio::time::sleep(Duration::from_micros(100)).await;
            }
            starts.push(began.elapsed());
        };
        let (moved, ()) = tokio::join!(arm.move_joints(&goal, limits, PATIENCE), moves);
        moved?;
    }
    Ok(Row::of("arm: from a command to motion", starts, false))
}

async fn hand_rows(wired: &WiredHand, looks: u32, rows: &mut Vec<Option<Row>>) -> anyhow::Result<()> {
    let hand = wired.hand.hand();
    if let (AnyHand::Leap(leap), Some(_)) = (&wired.hand, &wired.emulator) {
        // Motors that hold are read and told at the loop's rate; each state waits for the next reading.
        leap.clear_fault(PATIENCE).await?;
    }
    let mut asked = Vec::new();
    for _ in 0..looks {
        let began = Instant::now();
        hand.state(PATIENCE).await?;
        asked.push(began.elapsed());
    }
    let way = match (&wired.hand, &wired.emulator) {
        (AnyHand::Leap(_), Some(_)) => "hand: round of the loop, 16 motors read and told",
        (AnyHand::Leap(_), None) => "hand: state, all motors read",
        (AnyHand::Robotiq(_), _) => "hand: state of the gripper, there and back",
    };
    rows.push(Row::of(way, asked, true));
    Ok(())
}

/// From a frame in hand to the answer that it gets, without the time that planning takes: what the way costs.
#[cfg(feature = "sim")]
async fn frame_rows(config: &CellConfig, looks: u32, rows: &mut Vec<Option<Row>>) -> anyhow::Result<()> {
    use graspd_cell::config::CellConfig as Config;
    use graspd_cell::frame::Frame;
    use graspd_cell::plan::{GraspPlanner as _, Question, ReachingChoice};
    // The world of a cell of mock devices, whatever else the file names.
    let mut mock = Config { camera: config.camera.clone(), tray: config.tray.clone(), ..Config::default() };
    mock.camera.address.clear();
    let world = crate::commands::cell::world::devices(&mock).await?;
    let question = Question {
        hand: mock.hand.id.clone(),
        seed: 0,
        reaching: ReachingChoice::TopDown,
        max_tilt_rad: None,
        workspace: mock.tray.workspace(),
        region: None,
        keep_out: Vec::new(),
        estimator: String::new(),
        // As little as there is to plan: the way is what is measured.
        batch: 2,
        scheme: [1, 0],
        max_grasps: 1,
        min_score: 0.0,
        friction: 0.5,
        pregrasp_offset_m: 0.1,
    };
    let times = crate::commands::cell::with_planner(&mock, async |planner| {
        let mut times = Vec::new();
        for look in 0..looks.min(60) + 3 {
            let device = world.camera.capture(Duration::from_secs(10), PATIENCE).await?;
            let began = Instant::now();
            let pose = device.world_from_camera.unwrap_or_else(nalgebra::Isometry3::identity);
            let frame = Frame::of(&device, &pose)?;
            let answer = planner.plan(&frame, &question, PATIENCE).await?;
            let way = began.elapsed().saturating_sub(Duration::from_secs_f64(answer.plan_s.max(0.0)));
            // The first connect.
            if look >= 3 {
                times.push(way);
            }
        }
        Ok(times)
    })
    .await?;
    rows.push(Row::of("frame: to the planner and back, planning aside", times, false));
    Ok(())
}

/// Without a simulated world there is no camera to take frames from.
#[cfg(not(feature = "sim"))]
async fn frame_rows(_: &CellConfig, _: u32, _: &mut Vec<Option<Row>>) -> anyhow::Result<()> {
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_those_of_the_sorted_times() {
        let times = (1..=101).rev().map(Duration::from_millis).collect();
        let row = Row::of("way", times, true).unwrap();
        assert_eq!((row.p50_ms, row.p99_ms, row.most_ms), (51.0, 100.0, 101.0));
        assert!((row.rate_hz.unwrap() - 1000.0 / 51.0).abs() < 1e-9);
        assert!(Row::of("way", Vec::new(), false).is_none());
    }
}
