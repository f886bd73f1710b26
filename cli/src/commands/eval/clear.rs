//! `graspd eval clear`: trays cleared by every hand, in the layout of Supplementary Table 4.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use anyhow::Context as _;
use clap::{Args, ValueEnum};
use graspd_planner::options::{PlanOptions, Scheme, VolumeKind};
use graspd_sim::execute::ExecuteSettings;
use graspd_training::evaluate::{
    Attempt, Class, ClearSettings, FailedTrial, Observer, Report, Run, Setup, Station, clear,
};
use indicatif::{ProgressBar, ProgressStyle};

use super::objects;
use crate::commands::args::{parse_scheme, parse_volume};
use crate::commands::plan::write_file;
use crate::estimators::EstimatorArgs;

/// Which rows of the table are measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Which {
    /// One object in the tray
    Single,
    /// A poured tray
    Clutter,
    /// Both
    Both,
}

/// Clears simulated trays with every hand (Supplementary Note 7, Task 1) and prints success rates with their 95
/// % intervals, attempts per object, planning times and why grasps failed. Same seed, same attempts, whatever
/// --jobs.
#[derive(Debug, Clone, Args)]
pub(crate) struct ClearArgs {
    /// Hands by id (see `graspd hands list`) or folder, separated by commas
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "finray-2f,robotiq-2f85,robotiq-3f,model-o,finray-4f,brunel,leap,barrett"
    )]
    hands: Vec<String>,
    /// Objects, the same for every hand, each grasped once alone and once in clutter
    #[arg(long, default_value_t = 25, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    items: u32,
    /// Objects in a tray of clutter
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=32))]
    per_tray: u32,
    /// Single objects, clutter, or both
    #[arg(long, value_enum, default_value = "both")]
    scenes: Which,
    /// Same seed: same objects, trays, noise and plans
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Failed attempts after which an object is given up, and plans without a grasp after which a tray is
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    give_up: u32,
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
    /// Write everything: every attempt of every tray
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Write the tables as Markdown
    #[arg(long, value_name = "FILE")]
    markdown: Option<PathBuf>,
    /// Write one file for every failed attempt, for `graspd eval look`
    #[arg(long, value_name = "DIR")]
    failures: Option<PathBuf>,
}

/// Runs the command.
///
/// # Errors
/// For unknown hands, files that cannot be read or written, and settings of no use.
pub(crate) fn run(args: &ClearArgs) -> anyhow::Result<()> {
    let hands = super::hands(&args.hands)?;
    let estimator = args.estimator.chosen()?;
    let (objects, about_objects) = args.objects.objects(args.items as usize, args.seed)?;
    let jobs = super::jobs(args.jobs);
    let settings = ClearSettings {
        hands,
        objects,
        per_tray: args.per_tray as usize,
        setups: match args.scenes {
            Which::Single => vec![Setup::Single],
            Which::Clutter => vec![Setup::Clutter],
            Which::Both => vec![Setup::Single, Setup::Clutter],
        },
        give_up: args.give_up as usize,
        seed: args.seed,
        volume: args.volume,
        search: PlanOptions { batch: args.batch as usize, scheme: args.scheme, ..PlanOptions::default() },
        execute: ExecuteSettings::default(),
        workers: jobs,
    };
    if let Some(folder) = &args.failures {
        std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot be made", folder.display()))?;
    }
    let trays: usize = settings
        .setups
        .iter()
        .map(|s| match s {
            Setup::Single => settings.objects.len(),
            Setup::Clutter => settings.objects.len().div_ceil(settings.per_tray),
        })
        .sum();
    let watcher = Watcher::new((trays * settings.hands.len()) as u64, args.failures.as_deref());
    let begin = std::time::Instant::now();
    let runs = clear(&settings, &Station::tray(), &*estimator, &watcher)?;
    watcher.end()?;
    let conditions = vec![
        format!(
            "graspd {}, `graspd eval clear` with seed {}: {about_objects}",
            env!("CARGO_PKG_VERSION"),
            args.seed
        ),
        format!(
            "contact estimator {}, {} volume, {} candidates, [{}, {}] iterations; Azure Kinect with noise, calibrated \
             pose",
            estimator.name(),
            if args.volume == VolumeKind::Tsdf { "TSDF" } else { "occupancy" },
            args.batch,
            args.scheme.iterations,
            args.scheme.with_penetration
        ),
        format!(
            "trials are executed grasps, as the supplement counts them; a plan without a grasp is made again from a \
             new frame with twice the candidates; an object is given up, and counts as not cleared, after {give_up} \
             failed trials, a tray after {give_up} plans in a row without a grasp",
            give_up = args.give_up
        ),
        "success: at least one object was lifted by 15 cm, held and shaken, and not lost; objects outside the \
         tray are put back"
            .to_owned(),
        format!("{jobs} trays at a time, each on one thread, {:.0} s in all", begin.elapsed().as_secs_f64()),
    ];
    let report = Report::new(conditions, runs);
    if let Some(path) = &args.json {
        write_file(path, serde_json::to_string(&report)?.as_bytes())?;
    }
    if let Some(path) = &args.markdown {
        write_file(path, report.markdown().as_bytes())?;
    }
    write!(std::io::stdout().lock(), "{}", report.text())?;
    Ok(())
}

/// Attempts so far, told apart as in the table: a plan without a grasp is no trial.
#[derive(Debug, Clone, Copy, Default)]
struct Counts {
    trials: usize,
    successes: usize,
    empty_plans: usize,
}

impl Counts {
    fn add(&mut self, class: Class) {
        match class {
            Class::NoGrasp => self.empty_plans += 1,
            _ => self.trials += 1,
        }
        self.successes += usize::from(class == Class::Success);
    }

    fn text(self) -> String {
        let Self { trials, successes, empty_plans } = self;
        let rate = 100.0 * successes as f64 / trials.max(1) as f64;
        format!("{trials} trials, {rate:.0}% successful, {empty_plans} plans without a grasp")
    }
}

/// Shows progress on standard error, and writes failed trials as they happen.
struct Watcher<'a> {
    bar: ProgressBar,
    folder: Option<&'a Path>,
    counts: Mutex<Counts>,
    trouble: Mutex<Option<anyhow::Error>>,
}

impl<'a> Watcher<'a> {
    fn new(trays: u64, folder: Option<&'a Path>) -> Self {
        let bar = ProgressBar::new(trays);
        if let Ok(style) = ProgressStyle::with_template("{pos}/{len} trays {bar:30} {elapsed} {msg}") {
            bar.set_style(style);
        }
        Self { bar, folder, counts: Mutex::default(), trouble: Mutex::default() }
    }

    fn write(&self, folder: &Path, trial: &FailedTrial) -> anyhow::Result<()> {
        write_file(&folder.join(format!("{}.json", trial.name())), trial.to_json()?.as_bytes())
    }

    /// Ends the progress.
    ///
    /// # Errors
    /// The first failed trial that could not be written.
    fn end(self) -> anyhow::Result<()> {
        self.bar.finish_and_clear();
        self.trouble.into_inner().unwrap_or_else(PoisonError::into_inner).map_or(Ok(()), Err)
    }
}

impl Observer for Watcher<'_> {
    fn attempt(&self, attempt: &Attempt) {
        let mut counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        counts.add(attempt.class);
        self.bar.set_message(counts.text());
    }

    fn failed(&self, trial: &FailedTrial) {
        if let Some(folder) = self.folder
            && let Err(error) = self.write(folder, trial)
        {
            self.trouble.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
        }
    }

    fn run(&self, _: &Run) {
        self.bar.inc(1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn progress_counts_as_the_table_does() {
        let mut counts = Counts::default();
        assert_eq!(counts.text(), "0 trials, 0% successful, 0 plans without a grasp");
        for class in [Class::Success, Class::NoGrasp, Class::LostLifting, Class::NoGrasp] {
            counts.add(class);
        }
        assert_eq!(counts.text(), "2 trials, 50% successful, 2 plans without a grasp");
    }
}
