//! What `graspd eval ap` and `graspd eval thresholds` have in common: scenes, views, the parallel jaw, and the conditions
//! that are printed above their tables.

use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use graspd_planner::estimator::ContactEstimator;
use graspd_planner::options::{Scheme, VolumeKind};
use graspd_training::evaluate::ap::ApSettings;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use crate::commands::args::{parse_scheme, parse_volume};
use crate::commands::plan::write_file;
use crate::estimators::EstimatorArgs;
use crate::hand_source;

/// How average precision is measured.
#[derive(Debug, Clone, Args)]
pub(super) struct PrecisionArgs {
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
    #[arg(long, conflicts_with_all = ["estimator", "model"])]
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

impl PrecisionArgs {
    /// The estimator that finds the contacts.
    pub(super) fn estimator(&self) -> anyhow::Result<Arc<dyn ContactEstimator>> {
        self.estimator.chosen()
    }

    /// As the evaluation wants it, with `T_fc` and `T_fe`.
    pub(super) fn settings(&self, thresholds: [f64; 2]) -> anyhow::Result<ApSettings> {
        Ok(ApSettings {
            hand: Arc::new(hand_source::resolve(&self.hand)?),
            scenes: self.scenes as usize,
            objects: [self.least as usize, self.most as usize],
            views: self.views as usize,
            volumes: self.volume.map_or_else(|| vec![VolumeKind::Tsdf, VolumeKind::Occupancy], |v| vec![v]),
            batch: self.batch as usize,
            scheme: self.scheme,
            seed: self.seed,
            workers: super::jobs(self.jobs),
            labels: self.labels,
            thresholds,
        })
    }

    /// What is measured and how, for the lines above a table; `more` about thresholds.
    pub(super) fn conditions(&self, command: &str, estimator: &str, more: &str) -> Vec<String> {
        vec![
            format!(
                "graspd {}, `graspd eval {command}` with seed {}: {}, {} scenes of {} to {} procedural objects, \
                 poured, {} views each, Azure Kinect with noise, calibrated pose",
                env!("CARGO_PKG_VERSION"),
                self.seed,
                self.hand,
                self.scenes,
                self.least,
                self.most,
                self.views
            ),
            format!(
                "contact estimator {}, {more}{} candidates, [{}, {}] iterations",
                if self.labels { "none: labels of the exact scene" } else { estimator },
                self.batch,
                self.scheme.iterations,
                self.scheme.with_penetration
            ),
            "best 50 grasps after non-maximum suppression (3 cm, 30°), at most 10 on one object, judged against the \
             exact scene: collision of the opened jaw with points 8 mm apart, fewer than 10 points between the jaws, \
             Nguyen's antipodal test; missing grasps count as failures"
                .to_owned(),
            "AP (0.2–1.0) is the mean over five friction coefficients, as Supplementary Note 3 defines it; AP \
             (0.2–1.2) over six, as the benchmark's code computes it. The scenes are not those of the benchmark: the \
             numbers compare planners with each other here, not with published ones"
                .to_owned(),
        ]
    }

    /// Writes what was asked for.
    ///
    /// # Errors
    /// For files that cannot be written.
    pub(super) fn write(&self, report: &impl Serialize, markdown: &str) -> anyhow::Result<()> {
        if let Some(path) = &self.json {
            write_file(path, serde_json::to_string_pretty(report)?.as_bytes())?;
        }
        if let Some(path) = &self.markdown {
            write_file(path, markdown.as_bytes())?;
        }
        Ok(())
    }
}

/// A bar that counts plans.
pub(super) fn bar() -> ProgressBar {
    let bar = ProgressBar::new(0);
    if let Ok(style) = ProgressStyle::with_template("{pos}/{len} plans {bar:30} {elapsed}") {
        bar.set_style(style);
    }
    bar
}

/// Moves a bar.
pub(super) fn show(bar: &ProgressBar, done: usize, all: usize) {
    bar.set_length(all as u64);
    bar.set_position(done as u64);
}
