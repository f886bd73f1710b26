//! Many trays one after the other: throughput in simulated time, and whether arms meet.

use std::collections::BTreeMap;
use std::io::Write as _;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::Context as _;
use graspd_cell::plan::GraspPlanner;
use graspd_cell::sort::config::SortConfig;
use graspd_cell::sort::report::SortReport;
use graspd_cell::sort::shares::Shares;
use serde_json::json;

use super::super::RunArgs;
use super::one_run;

/// Everything counted.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize)]
struct Sum {
    trays: u32,
    sorted: u32,
    objects: usize,
    delivered: usize,
    misplaced: usize,
    in_tray: usize,
    in_hand: usize,
    lost: usize,
    collisions: usize,
    looks: u32,
    picks: u32,
    together: u32,
    simulated_s: f64,
    planning_s: f64,
    longest_assignment_s: f64,
    looks_past_arms: u32,
    /// Where the arms' time went, by their names.
    time: BTreeMap<String, Shares>,
    /// Simulated seconds with none, one, two, ... arms over the tray.
    over_tray_s: Vec<f64>,
}

impl Sum {
    fn add(&mut self, report: &SortReport) {
        self.trays += 1;
        self.sorted += u32::from(report.end.is_clear());
        self.looks += report.looks;
        self.picks += report.trials();
        self.together += report.together;
        self.looks_past_arms += report.looks_past_arms;
        for arm in &report.arms {
            let sum = self.time.entry(arm.arm.clone()).or_default();
            *sum = sum.plus(&arm.time);
        }
        self.over_tray_s.resize(report.over_tray_s.len().max(self.over_tray_s.len()), 0.0);
        for (sum, seconds) in self.over_tray_s.iter_mut().zip(&report.over_tray_s) {
            *sum += seconds;
        }
        self.planning_s += report.plan_s.iter().sum::<f64>();
        self.longest_assignment_s = report.assign_s.iter().copied().fold(self.longest_assignment_s, f64::max);
        let Some(truth) = &report.truth else { return };
        self.objects += truth.total();
        self.delivered += truth.delivered_count();
        self.misplaced += truth.misplaced.len();
        self.in_tray += truth.in_tray.len();
        self.in_hand += truth.in_hand.len();
        self.lost += truth.lost.len();
        self.collisions += truth.collisions.len();
        self.simulated_s += truth.time_s;
    }

    /// Objects in bins, a simulated minute.
    fn throughput(&self) -> f64 {
        60.0 * self.delivered as f64 / self.simulated_s.max(1e-9)
    }
}

/// Sorts `count` trays, the seed of scene and plans rising with each.
///
/// # Errors
/// When a tray cannot be made, and when arms met.
pub(super) async fn run(
    args: &RunArgs,
    config: &SortConfig,
    planner: &Arc<dyn GraspPlanner>,
    for_devices: &tokio::runtime::Runtime,
    count: u32,
) -> anyhow::Result<()> {
    let stop = Arc::new(AtomicBool::new(false));
    let first = match config.simulation.as_ref().and_then(|s| s.get("seed")) {
        Some(seed) => seed.as_integer().context("simulation.seed: expected a whole number")?,
        None => 1,
    };
    let mut sum = Sum::default();
    let mut met = Vec::new();
    for round in 0..count {
        let mut config = config.clone();
        let seed = first.wrapping_add(i64::from(round));
        config.simulation.get_or_insert_default().insert("seed".to_owned(), seed.into());
        config.run.seed = config.run.seed.wrapping_add(u64::from(round) * 1000);
        config.recording.folder = config.recording.folder.map(|f| f.join(format!("{seed:04}")));
        let report = one_run(&config, planner, for_devices, &stop, (true, None)).await?;
        sum.add(&report);
        let truth = report.truth.clone().unwrap_or_default();
        writeln!(
            std::io::stderr(),
            "tray {:>3} (seed {seed}): {} of {} delivered, {} lost, {} collisions, {:.1} s simulated; so far {:.2} a minute; {}",
            round + 1,
            truth.delivered_count(),
            truth.total(),
            truth.lost.len(),
            truth.collisions.len(),
            truth.time_s,
            sum.throughput(),
            report.end
        )?;
        met.extend(truth.collisions.into_iter().map(|c| json!({ "seed": seed, "collision": c })));
    }
    let arms: Vec<&str> = config.arms.iter().map(|a| a.name.as_str()).collect();
    let mut out = std::io::stdout().lock();
    if args.json {
        let all =
            json!({ "arms": arms, "sum": sum, "objects_a_minute": sum.throughput(), "collisions": met });
        writeln!(out, "{all:#}")?;
    } else {
        writeln!(out, "arms            {}", arms.join(", "))?;
        writeln!(out, "trays           {} ({} found empty at the end)", sum.trays, sum.sorted)?;
        writeln!(
            out,
            "objects         {} of {} delivered, {} in a wrong bin, {} left in trays, {} in hands, {} lost",
            sum.delivered, sum.objects, sum.misplaced, sum.in_tray, sum.in_hand, sum.lost
        )?;
        writeln!(
            out,
            "picks           {}, {} begun while another arm picked; {} looks",
            sum.picks, sum.together, sum.looks
        )?;
        for (arm, time) in &sum.time {
            writeln!(out, "{arm:<15} {time}")?;
        }
        let all = sum.over_tray_s.iter().sum::<f64>().max(1e-9);
        let over: Vec<String> = sum.over_tray_s.iter().map(|s| format!("{:.0} %", 100.0 * s / all)).collect();
        writeln!(out, "over the tray   none, one, ... arms: {} of the time", over.join(", "))?;
        writeln!(out, "collisions      {}", sum.collisions)?;
        writeln!(out, "simulated       {:.1} s, {:.2} objects a minute", sum.simulated_s, sum.throughput())?;
        writeln!(out, "planning        {:.1} s of the wall clock beside it", sum.planning_s)?;
        writeln!(out, "assignment      {:.2} ms at most", 1e3 * sum.longest_assignment_s)?;
    }
    anyhow::ensure!(sum.collisions == 0, "arms met {} times", sum.collisions);
    Ok(())
}
