//! `graspd eval ap`: average precision of the parallel jaw, as Supplementary Note 3 measures it.

use std::io::Write as _;
use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use graspd_planner::options::{Scheme, VolumeKind};
use graspd_training::evaluate::ap::{ApSettings, average};
use indicatif::{ProgressBar, ProgressStyle};

use crate::commands::args::{parse_scheme, parse_volume};
use crate::commands::plan::write_file;
use crate::estimators::EstimatorArgs;
use crate::hand_source;

/// Plans for the parallel jaw in simulated clutter from several views, and judges the best 50 grasps of each
/// against the exact scene: collision, emptiness, analytic force closure (Supplementary Note 3). Same seed,
/// same numbers.
#[derive(Debug, Clone, Args)]
pub(crate) struct ApArgs {
    /// The parallel jaw, by id or folder
    #[arg(long, default_value = "antipodal")]
    hand: String,
    /// Scenes of poured clutter
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    scenes: u32,
    /// Views of each scene
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=1000))]
    views: u32,
    /// Objects in a scene, at least
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=32))]
    least: u32,
    /// Objects in a scene, at most
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=32))]
    most: u32,
    /// What the volume stores: tsdf or occupancy; both if left out
    #[arg(long, value_parser = parse_volume)]
    volume: Option<VolumeKind>,
    /// Candidates that are optimized together (N_batch)
    #[arg(long, default_value_t = 500, value_parser = clap::value_parser!(u32).range(1..=4096))]
    batch: u32,
    /// Iterations, and how many of the last ones avoid penetration
    #[arg(long, default_value = "200,40", value_name = "ALL,LAST", value_parser = parse_scheme)]
    scheme: Scheme,
    /// Same seed: same scenes, noise and plans
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    estimator: EstimatorArgs,
    /// Plan from the contact dataset's labels of the exact scene instead: what a network that had learnt all of them
    /// would reach
    #[arg(long, conflicts_with = "estimator")]
    labels: bool,
    /// Scenes at the same time; as many as there are cores if left out
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1024))]
    jobs: Option<u32>,
    /// Write everything
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Write the tables as Markdown
    #[arg(long, value_name = "FILE")]
    markdown: Option<PathBuf>,
}

/// Runs the command.
///
/// # Errors
/// For a hand that is no parallel jaw, files that cannot be written, and settings of no use.
pub(crate) fn run(args: &ApArgs) -> anyhow::Result<()> {
    let estimator = args.estimator.chosen()?;
    let settings = ApSettings {
        hand: Arc::new(hand_source::resolve(&args.hand)?),
        scenes: args.scenes as usize,
        objects: [args.least as usize, args.most as usize],
        views: args.views as usize,
        volumes: args.volume.map_or_else(|| vec![VolumeKind::Tsdf, VolumeKind::Occupancy], |v| vec![v]),
        batch: args.batch as usize,
        scheme: args.scheme,
        seed: args.seed,
        workers: super::jobs(args.jobs),
        labels: args.labels,
    };
    let conditions = vec![
        format!(
            "graspd {}, `graspd eval ap` with seed {}: {}, {} scenes of {} to {} procedural objects, poured, {} views \
             each, Azure Kinect with noise, calibrated pose",
            env!("CARGO_PKG_VERSION"),
            args.seed,
            args.hand,
            args.scenes,
            args.least,
            args.most,
            args.views
        ),
        format!(
            "contact estimator {}, {} candidates, [{}, {}] iterations",
            if args.labels { "none: labels of the exact scene" } else { estimator.name() },
            args.batch,
            args.scheme.iterations,
            args.scheme.with_penetration
        ),
        "best 50 grasps after non-maximum suppression (3 cm, 30°), at most 10 on one object, judged against the exact \
         scene: collision of the opened jaw with points 8 mm apart, fewer than 10 points between the jaws, Nguyen's \
         antipodal test; missing grasps count as failures"
            .to_owned(),
        "AP (0.2–1.0) is the mean over five friction coefficients, as Supplementary Note 3 defines it; AP (0.2–1.2) \
         over six, as the benchmark's code computes it. The scenes are not those of the benchmark: the numbers \
         compare planners with each other here, not with published ones"
            .to_owned(),
    ];
    let bar = ProgressBar::new(0);
    if let Ok(style) = ProgressStyle::with_template("{pos}/{len} plans {bar:30} {elapsed}") {
        bar.set_style(style);
    }
    let report = average(&settings, &*estimator, conditions, &|done, all| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
    })?;
    bar.finish_and_clear();
    if let Some(path) = &args.json {
        write_file(path, serde_json::to_string_pretty(&report)?.as_bytes())?;
    }
    if let Some(path) = &args.markdown {
        write_file(path, report.markdown().as_bytes())?;
    }
    write!(std::io::stdout().lock(), "{}", report.text())?;
    Ok(())
}
