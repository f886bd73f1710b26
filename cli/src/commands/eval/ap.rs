//! `graspd eval ap`: average precision of the parallel jaw, as Supplementary Note 3 measures it.

use std::io::Write as _;

use clap::Args;
use graspd_training::evaluate::ap::average;

use super::precision::{PrecisionArgs, bar, show};
use crate::commands::args::parse_share;

/// Plans for the parallel jaw in simulated clutter from several views, and judges the best 50 grasps of each
/// against the exact scene: collision, emptiness, analytic force closure (Supplementary Note 3). Same seed,
/// same numbers.
#[derive(Debug, Clone, Args)]
pub(crate) struct ApArgs {
    #[command(flatten)]
    precision: PrecisionArgs,
    /// T_fc: focal contacts exceed this share of the largest certainty, 0 to 1
    #[arg(long, default_value_t = 0.7, value_name = "SHARE", value_parser = parse_share)]
    t_fc: f64,
    /// T_fe: focal centroids exceed this share of the largest centroid score, 0 to 1
    #[arg(long, default_value_t = 0.95, value_name = "SHARE", value_parser = parse_share)]
    t_fe: f64,
}

/// Runs the command.
///
/// # Errors
/// For a hand that is no parallel jaw, files that cannot be written, and settings of no use.
pub(crate) fn run(args: &ApArgs) -> anyhow::Result<()> {
    let estimator = args.precision.estimator()?;
    let settings = args.precision.settings([args.t_fc, args.t_fe])?;
    let more = format!("T_fc {}, T_fe {}, ", args.t_fc, args.t_fe);
    let conditions = args.precision.conditions("ap", estimator.name(), &more);
    let bar = bar();
    let report = average(&settings, &*estimator, conditions, &|done, all| show(&bar, done, all))?;
    bar.finish_and_clear();
    args.precision.write(&report, &report.markdown())?;
    write!(std::io::stdout().lock(), "{}", report.text())?;
    Ok(())
}
