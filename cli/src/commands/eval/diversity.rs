//! `graspd eval diversity`: what grasps touch objects with, against grasps from exactly known geometry.

use std::io::Write as _;
use std::path::PathBuf;

use clap::Args;
use graspd_planner::options::{Scheme, VolumeKind};
use graspd_training::evaluate::diversity::{
    DiversityReport, DiversitySettings, directions_svg, diversity, reach_svg,
};
use indicatif::{ProgressBar, ProgressStyle};

use crate::commands::args::{parse_scheme, parse_volume};
use crate::commands::plan::write_file;
use crate::estimators::EstimatorArgs;

/// Plans for hands of several fingers in simulated clutter, once with contacts found in a depth frame and once with
/// contacts made from the exact objects, and compares what the best grasps touch: share of the pads' area, pads,
/// fingers; where the touching pads are and where they point (Supplementary Note 6). Same seed, same numbers.
#[derive(Debug, Clone, Args)]
pub(crate) struct DiversityArgs {
    /// Hands by id (see `graspd hands list`) or folder, separated by commas
    #[arg(long, value_delimiter = ',', default_value = "barrett,leap")]
    hands: Vec<String>,
    /// Scenes of clutter (the paper: 30)
    #[arg(long, default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    scenes: u32,
    /// Objects in a scene: at least and at most
    #[arg(long, default_value = "8,12", value_name = "LEAST,MOST", value_delimiter = ',')]
    objects: Vec<u32>,
    /// Plans of each scene, each with a seed of its own (the paper: 48)
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    repeats: u32,
    /// Best grasps of each plan
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=256))]
    best: u32,
    /// Same seed: same scenes, noise and plans
    #[arg(long, default_value_t = 1)]
    seed: u64,
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
    /// Scenes at the same time; as many as there are cores if left out
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1024))]
    jobs: Option<u32>,
    /// Write the figures as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Write the tables as Markdown
    #[arg(long, value_name = "FILE")]
    markdown: Option<PathBuf>,
    /// Draw where touching pads were, as SVG (Supplementary Fig. 3)
    #[arg(long, value_name = "FILE")]
    reach: Option<PathBuf>,
    /// Draw in which directions they pointed, as SVG (Supplementary Fig. 4)
    #[arg(long, value_name = "FILE")]
    directions: Option<PathBuf>,
}

/// Runs the command.
///
/// # Errors
/// For unknown hands, files that cannot be written, and settings of no use.
pub(crate) fn run(args: &DiversityArgs) -> anyhow::Result<()> {
    let estimator = args.estimator.chosen()?;
    let &[least, most] = &args.objects[..] else {
        anyhow::bail!("--objects: found {} numbers, expected LEAST,MOST", args.objects.len());
    };
    let settings = DiversitySettings {
        hands: super::hands(&args.hands)?,
        scenes: args.scenes as usize,
        objects: [least as usize, most as usize],
        repeats: args.repeats as usize,
        best: args.best as usize,
        batch: args.batch as usize,
        scheme: args.scheme,
        volume: args.volume,
        seed: args.seed,
        workers: super::jobs(args.jobs),
    };
    let bar = ProgressBar::new(settings.scenes as u64);
    if let Ok(style) = ProgressStyle::with_template("{pos}/{len} scenes {bar:30} {elapsed}") {
        bar.set_style(style);
    }
    let measured = diversity(&settings, &[&*estimator], &|done, _| bar.set_position(done as u64))?;
    bar.finish_and_clear();
    let conditions = vec![
        format!(
            "graspd {}, `graspd eval diversity` with seed {}: {} scenes of {least} to {most} poured objects, {} plans of \
             each, the best {} grasps of each plan",
            env!("CARGO_PKG_VERSION"),
            args.seed,
            args.scenes,
            args.repeats,
            args.best
        ),
        format!(
            "{} volume of one noisy Azure Kinect frame, {} candidates, [{}, {}] iterations",
            if args.volume == VolumeKind::Tsdf { "TSDF" } else { "occupancy" },
            args.batch,
            args.scheme.iterations,
            args.scheme.with_penetration
        ),
        "a pad touches where it is within 5 mm of an object, by the exact objects; ± is 1.96 standard errors over scenes"
            .to_owned(),
        "reached: cells of 1 cm³, of each pad for itself, without the 5 % farthest; directions: share of the sphere within \
         10° of a touch, mean of the fingers"
            .to_owned(),
        "same places, same directions: share of the simulated geometry's touches that the source has in another scene too \
         (within 1 cm, 15°, hand frame); its own row is the most that can be expected"
            .to_owned(),
    ];
    let report = DiversityReport::new(conditions, &measured);
    let files = [
        (&args.json, serde_json::to_string_pretty(&report)?),
        (&args.markdown, report.markdown()),
        (&args.reach, reach_svg(&measured)),
        (&args.directions, directions_svg(&measured)),
    ];
    for (path, text) in files {
        if let Some(path) = path {
            write_file(path, text.as_bytes())?;
        }
    }
    write!(std::io::stdout().lock(), "{}", report.text())?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        args: DiversityArgs,
    }

    #[test]
    fn both_numbers_of_objects_are_one_word() {
        let read = |line: &[&str]| Line::try_parse_from(line).unwrap().args;
        assert_eq!(read(&["diversity"]).objects, [8, 12]);
        assert_eq!(read(&["diversity", "--objects", "3,4"]).objects, [3, 4]);
        let wrong = run(&read(&["diversity", "--objects", "3"])).unwrap_err();
        assert_eq!(wrong.to_string(), "--objects: found 1 numbers, expected LEAST,MOST");
    }
}
