//! `graspd eval calibration`: what a grasp's score says about its success, fitted and checked on executed grasps.

use std::io::Write as _;
use std::path::PathBuf;

use clap::Args;
use graspd_planner::options::{PlanOptions, Scheme, VolumeKind};
use graspd_sim::execute::ExecuteSettings;
use graspd_training::evaluate::calibration::{CalibrationReport, CalibrationSettings, Sample, collect, svg};
use indicatif::{ProgressBar, ProgressStyle};

use super::objects;
use crate::commands::args::{parse_scheme, parse_volume};
use crate::commands::plan::write_file;
use crate::estimators::EstimatorArgs;

/// Executes the ranked grasps of many plans, fits each hand's curve from the ranking's figure to the probability that
/// a grasp holds, and checks the curves on other trays with other objects. Prints the curves, how true stated
/// probabilities are (expected calibration error), and what `[confidence]` in a hand's `hand.toml` should say.
#[derive(Debug, Clone, Args)]
pub(crate) struct CalibrationArgs {
    /// Hands by id (see `graspd hands list`) or folder, separated by commas
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "antipodal,panda,finray-2f,robotiq-2f85,robotiq-3f,model-o,finray-4f,brunel,leap,allegro,barrett"
    )]
    hands: Vec<String>,
    /// Objects to fit on, each grasped once alone and once in clutter; as many others to check on
    #[arg(long, default_value_t = 40, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    items: u32,
    /// Objects in a tray of clutter
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=32))]
    per_tray: u32,
    /// Grasps of a plan that are executed, each in the tray as it was seen
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=256))]
    grasps: u32,
    /// Same seed: same objects, trays, noise and plans. Those to check on are of another seed that follows from it
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    objects: objects::ObjectArgs,
    #[command(flatten)]
    estimator: EstimatorArgs,
    /// What the volume stores: tsdf or occupancy
    #[arg(long, default_value = "tsdf", value_parser = parse_volume)]
    volume: VolumeKind,
    /// Candidates that are optimized together (N_batch)
    #[arg(long, default_value_t = 48, value_parser = clap::value_parser!(u32).range(1..=4096))]
    batch: u32,
    /// Iterations, and how many of the last ones avoid penetration
    #[arg(long, default_value = "200,40", value_name = "ALL,LAST", value_parser = parse_scheme)]
    scheme: Scheme,
    /// Trays at the same time; as many as there are cores if left out
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1024))]
    jobs: Option<u32>,
    /// Write everything: every executed grasp
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Write the tables as Markdown
    #[arg(long, value_name = "FILE")]
    markdown: Option<PathBuf>,
    /// Draw the reliability curve
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
}

/// What is written with `--json`.
#[derive(serde::Serialize)]
struct File<'a> {
    report: &'a CalibrationReport,
    fitted: &'a [Sample],
    checked: &'a [Sample],
}

/// From the seed of the fit to that of the check.
const TO_CHECK: u64 = 0x6368_6563_6b00;

/// Runs the command.
///
/// # Errors
/// For unknown hands, files that cannot be read or written, and settings of no use.
pub(crate) fn run(args: &CalibrationArgs) -> anyhow::Result<()> {
    let hands = super::hands(&args.hands)?;
    let estimator = args.estimator.chosen()?;
    let count = args.items as usize;
    let seeds = [args.seed, args.seed.wrapping_add(TO_CHECK)];
    let (to_fit, about) = args.objects.objects(count, seeds[0])?;
    let (to_check, _) = args.objects.objects(count, seeds[1])?;
    let settings = |seed, objects| CalibrationSettings {
        hands: hands.clone(),
        objects,
        per_tray: args.per_tray as usize,
        seed,
        volume: args.volume,
        search: PlanOptions {
            batch: args.batch as usize,
            scheme: args.scheme,
            max_grasps: args.grasps as usize,
            ..PlanOptions::default()
        },
        execute: ExecuteSettings::default(),
        workers: super::jobs(args.jobs),
    };
    let bar = ProgressBar::new(0);
    if let Ok(style) = ProgressStyle::with_template("{msg} {pos}/{len} trays {bar:30} {elapsed}") {
        bar.set_style(style);
    }
    let seen = |done: usize, all: usize| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
    };
    bar.set_message("fit");
    let fitted = collect(&settings(seeds[0], to_fit), &*estimator, &seen)?;
    bar.set_message("check");
    let checked = collect(&settings(seeds[1], to_check), &*estimator, &seen)?;
    bar.finish_and_clear();
    let conditions = vec![
        format!(
            "graspd {}, `graspd eval calibration` with seed {}: {about}; as many others to check on",
            env!("CARGO_PKG_VERSION"),
            args.seed
        ),
        format!(
            "contact estimator {}, {} volume, {} candidates, [{}, {}] iterations; Azure Kinect with noise; one object, \
             and {} poured, in the tray; up to {} grasps of each plan executed, each in the tray as it was seen",
            estimator.name(),
            if args.volume == VolumeKind::Tsdf { "TSDF" } else { "occupancy" },
            args.batch,
            args.scheme.iterations,
            args.scheme.with_penetration,
            args.per_tray,
            args.grasps
        ),
        "ECE: expected calibration error, bins of equal count (10 for all hands, 5 for one); by chance: what it would \
         be on average if every probability were true"
            .to_owned(),
    ];
    let report = CalibrationReport::new(conditions, &fitted, &checked);
    if let Some(path) = &args.json {
        let file = File { report: &report, fitted: &fitted, checked: &checked };
        write_file(path, serde_json::to_string(&file)?.as_bytes())?;
    }
    if let Some(path) = &args.markdown {
        write_file(path, report.markdown().as_bytes())?;
    }
    if let Some(path) = &args.svg {
        let curves = [("own curves", &report.together), ("one curve for all", &report.generic.reliability)];
        write_file(path, svg(&curves).as_bytes())?;
    }
    let mut out = std::io::stdout().lock();
    write!(out, "{}", report.text())?;
    writeln!(out, "\nFor the hands' hand.toml:")?;
    for hand in &hands {
        match report.toml(&hand.id) {
            Some(toml) => writeln!(out, "\n# {}\n{toml}", hand.id)?,
            None => writeln!(out, "\n# {}: too few executed grasps for a curve of its own", hand.id)?,
        }
    }
    Ok(())
}
