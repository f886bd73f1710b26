//! `graspd eval servo`: the dynamic grasp servo against static grasping in dense clutter (Supplementary Note 7, Task 2).

mod kept;

use std::io::Write as _;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use clap::{Args, ValueEnum};
use graspd_planner::estimator::ContactEstimator;
use graspd_planner::servo::Mode;
use graspd_training::evaluate::Class;
use graspd_training::evaluate::servo::{
    Group, Nudge, Pair, ServoAttempt, ServoObserver, ServoReport, ServoSettings, ServoTray, clear_with_servo,
    pairs_with_servo,
};
use indicatif::{ProgressBar, ProgressStyle};

use self::kept::Kept;
use crate::commands::plan::write_file;
use crate::estimators::EstimatorArgs;

/// Which modes are measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Which {
    /// Every frame refines the grasp
    Dynamic,
    /// The first frame decides
    Static,
    /// Both, on the same trays
    Both,
}

/// A group of objects.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Objects {
    /// Balls, superquadrics, building blocks
    Toys,
    /// Capsules, frusta, cylinders
    Vegetables,
    /// Angles, tees, hammers, nuts, pegs
    Adversarial,
    /// Boxes, bottles, cans, cups
    Household,
}

impl Objects {
    fn group(self) -> Group {
        match self {
            Self::Toys => Group::Toys,
            Self::Vegetables => Group::Vegetables,
            Self::Adversarial => Group::Adversarial,
            Self::Household => Group::Household,
        }
    }
}

/// Clears trays of 12 to 16 objects with a depth camera in the palm (Supplementary Note 7, Task 2): each frame of the
/// approach refines the grasp, against one that is planned on the first frame alone. Prints success rate, clearing
/// rate and FGM (successful grasps over grasped objects) with their 95 % intervals, and their differences. Same seed,
/// same attempts, whatever --jobs.
#[derive(Debug, Clone, Args)]
pub(crate) struct ServoArgs {
    /// Hands by id (see `graspd hands list`) or folder, separated by commas
    #[arg(long, value_delimiter = ',', default_value = "robotiq-3f,leap")]
    hands: Vec<String>,
    /// Groups of objects, separated by commas
    #[arg(long, value_enum, value_delimiter = ',', default_value = "toys,vegetables,adversarial,household")]
    groups: Vec<Objects>,
    /// Trays of each group
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    runs: u32,
    /// Dynamic, static, or both
    #[arg(long, value_enum, default_value = "both")]
    mode: Which,
    /// Second test: five objects in a tray, of which the one at the grasp is shoved by so many metres on the way
    #[arg(long, value_name = "METRES", num_args = 0..=1, default_missing_value = "0.025", value_parser = metres)]
    nudge: Option<f64>,
    /// So many attempts of both modes in each tray, each pair from the same place, instead of clearing it
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100))]
    pairs: Option<u32>,
    /// Frames per second of the palm camera
    #[arg(long, default_value_t = 15.0, value_parser = metres)]
    fps: f64,
    /// Failed attempts at one object after which it is given up, and approaches without a grip after which a tray is
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    give_up: u32,
    /// Same seed: same objects, trays, noise and plans
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    estimator: EstimatorArgs,
    /// Trays at the same time; as many as there are cores if left out
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1024))]
    jobs: Option<u32>,
    /// Keep every tray that is done in this file, and do not do those again that are in it: a run that was stopped goes
    /// on. Only with the program that began it: what has changed in it since is not noticed
    #[arg(long, value_name = "FILE", conflicts_with = "pairs")]
    resume: Option<PathBuf>,
    /// Write everything: every attempt of every tray
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Write the tables as Markdown
    #[arg(long, value_name = "FILE")]
    markdown: Option<PathBuf>,
}

fn metres(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("found {text:?}, expected a number"))?;
    if value.is_finite() && value > 0.0 {
        Ok(value)
    } else {
        Err(format!("found {value}, expected more than 0"))
    }
}

impl ServoArgs {
    /// What a tray depends on, but for its hand, group, run and mode, in words: trays of other settings are not these.
    fn trays_of(&self, estimator: &str) -> String {
        format!(
            "graspd {}, seed {}, nudge {:?} m, {} frames/s, give up after {}, estimator {estimator}",
            env!("CARGO_PKG_VERSION"),
            self.seed,
            self.nudge,
            self.fps,
            self.give_up
        )
    }
}

/// Runs the command.
///
/// # Errors
/// For unknown hands, files that cannot be written, and settings of no use.
pub(crate) fn run(args: &ServoArgs) -> anyhow::Result<()> {
    let estimator: Arc<dyn ContactEstimator> = args.estimator.chosen()?;
    let jobs = super::jobs(args.jobs);
    let settings = ServoSettings {
        groups: args.groups.iter().map(|g| g.group()).collect(),
        runs: args.runs as usize,
        modes: match args.mode {
            Which::Dynamic => vec![Mode::Dynamic],
            Which::Static => vec![Mode::Static],
            Which::Both => vec![Mode::Static, Mode::Dynamic],
        },
        nudge: args.nudge.map(|distance_m| Nudge { distance_m, ..Nudge::default() }),
        frames_per_s: args.fps,
        give_up: args.give_up as usize,
        seed: args.seed,
        workers: jobs,
        ..ServoSettings::new(super::hands(&args.hands)?)
    };
    let trays = settings.hands.len() * settings.groups.len() * settings.runs;
    let begin = std::time::Instant::now();
    let (trays, pairs) = match args.pairs {
        Some(attempts) => {
            let watcher = Watcher::new((trays * attempts as usize) as u64);
            let pairs = pairs_with_servo(&settings, attempts as usize, &estimator, &watcher)?;
            watcher.bar.finish_and_clear();
            (Vec::new(), pairs)
        }
        None => {
            let kept = args.resume.as_ref().map(|path| Kept::open(path, &args.trays_of(estimator.name())));
            let kept = kept.transpose()?;
            let done = kept.as_ref().map_or_else(Vec::new, |kept| kept.done.clone());
            let watcher = Watcher { kept, ..Watcher::new((trays * settings.modes.len()) as u64) };
            watcher.bar.inc(done.len() as u64);
            let trays = clear_with_servo(&settings, &estimator, &watcher, &done)?;
            watcher.bar.finish_and_clear();
            watcher.kept.map_or(Ok(()), |kept| kept.check())?;
            (trays, Vec::new())
        }
    };
    let objects = match settings.nudge {
        Some(n) => format!(
            "{} objects a tray; the one at the grasp is shoved by {:.0} mm at a stand-off of {:.0} mm",
            n.objects,
            1e3 * n.distance_m,
            1e3 * n.at_standoff_m
        ),
        None => "12 to 16 objects a tray".to_owned(),
    };
    let (servo, tray) = (&settings.servo, &settings.tray);
    let conditions = vec![
        format!(
            "graspd {}, `graspd eval servo` with seed {}: {} trays of each group, hand and mode, {objects}, poured \
             into {:.0} x {:.0} mm",
            env!("CARGO_PKG_VERSION"),
            args.seed,
            args.runs,
            1e3 * tray.width_m,
            1e3 * tray.length_m
        ),
        format!(
            "Pico Flexx in the palm with noise, calibrated, {} frames a second; what a frame says is obeyed one frame \
             later; contact estimator {}",
            args.fps,
            estimator.name()
        ),
        format!(
            "dynamic: first plan of {} candidates and {} iterations, then {} iterations of the one candidate a frame, \
             stand-off from {:.0} to {:.0} mm; static: 96 candidates and 128 iterations on the first frame, same way",
            servo.plan.batch,
            servo.plan.scheme.iterations,
            servo.iterations,
            1e3 * servo.standoff.start_m,
            1e3 * servo.standoff.end_m
        ),
        format!(
            "success: something was lifted by 15 cm, held and shaken, and not lost; {}",
            match args.pairs {
                Some(attempts) => format!(
                    "{attempts} pairs a tray, each from the same place; an approach without a grip counts as a failure of its pair"
                ),
                None => format!(
                    "an object is given up after {n} failed trials, a tray after {n} approaches in a row without a grip",
                    n = args.give_up
                ),
            }
        ),
        format!("{jobs} trays at a time, each on one thread, {:.0} s in all", begin.elapsed().as_secs_f64()),
    ];
    let report = match args.pairs {
        Some(_) => ServoReport::of_pairs(conditions, pairs),
        None => ServoReport::new(conditions, trays),
    };
    if let Some(path) = &args.json {
        write_file(path, serde_json::to_string(&report)?.as_bytes())?;
    }
    if let Some(path) = &args.markdown {
        write_file(path, report.markdown().as_bytes())?;
    }
    write!(std::io::stdout().lock(), "{}", report.text())?;
    Ok(())
}

/// Shows progress on standard error.
struct Watcher {
    bar: ProgressBar,
    /// Where trays are kept that are done.
    kept: Option<Kept>,
    /// Trials, successes.
    counts: Mutex<(usize, usize)>,
}

impl Watcher {
    fn new(trays: u64) -> Self {
        let bar = ProgressBar::new(trays);
        if let Ok(style) = ProgressStyle::with_template("{pos}/{len} trays {bar:30} {elapsed} {msg}") {
            bar.set_style(style);
        }
        Self { bar, kept: None, counts: Mutex::default() }
    }
}

impl Watcher {
    /// One line, and one more that is done.
    fn tell(&self, line: &str) {
        if self.bar.is_hidden() {
            // Nobody watches a bar: a line in a log.
            writeln!(std::io::stderr(), "{line}").ok();
        } else {
            self.bar.println(line);
        }
        self.bar.inc(1);
    }
}

impl ServoObserver for Watcher {
    fn attempt(&self, attempt: &ServoAttempt) {
        let mut counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        counts.0 += usize::from(attempt.class != Class::NoGrasp);
        counts.1 += usize::from(attempt.class == Class::Success);
        let rate = 100.0 * counts.1 as f64 / counts.0.max(1) as f64;
        self.bar.set_message(format!("{} trials, {rate:.0}% successful", counts.0));
    }

    fn pair(&self, pair: &Pair) {
        let told = |a: &ServoAttempt| a.nothing.clone().unwrap_or_else(|| a.class.title().to_owned());
        let (hand, group) = (&pair.hand, pair.group.name());
        self.tell(&format!(
            "{hand} {group} run {} pair {}: static {}, dynamic {}",
            pair.run,
            pair.number,
            told(&pair.fixed),
            told(&pair.dynamic)
        ));
    }

    fn tray(&self, tray: &ServoTray) {
        if let Some(kept) = &self.kept {
            kept.add(tray);
        }
        let end = tray.end();
        let line = format!(
            "{} {} run {} {}: {} of {} cleared, {} trials, {} successful",
            tray.hand,
            tray.group.name(),
            tray.run,
            if tray.is_dynamic { "dynamic" } else { "static" },
            end.cleared,
            end.objects,
            end.trials,
            end.successes
        );
        self.tell(&line);
    }
}
