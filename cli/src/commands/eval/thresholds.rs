//! `graspd eval thresholds`: the thresholds of the refinement by grid search, as Supplementary Table 1 lays them out.

use std::io::Write as _;

use clap::Args;
use graspd_training::evaluate::ap::{FOCAL_CENTROID, FOCAL_CONTACT, thresholds};

use super::precision::{PrecisionArgs, bar, show};
use crate::commands::args::parse_share;

/// Measures the average precision of the parallel jaw for every pair of T_fc and T_fe, with N_fc, N_fe/N_ee and the
/// optimization's time for 100 iterations (Supplementary Table 1). Same seed, same scenes, for every pair.
#[derive(Debug, Clone, Args)]
pub(crate) struct ThresholdsArgs {
    #[command(flatten)]
    precision: PrecisionArgs,
    /// T_fc, separated by commas
    #[arg(long, value_delimiter = ',', default_values_t = FOCAL_CONTACT, value_name = "SHARES", value_parser = parse_share)]
    t_fc: Vec<f64>,
    /// T_fe, separated by commas
    #[arg(long, value_delimiter = ',', default_values_t = FOCAL_CENTROID, value_name = "SHARES", value_parser = parse_share)]
    t_fe: Vec<f64>,
}

/// Runs the command.
///
/// # Errors
/// For a hand that is no parallel jaw, files that cannot be written, and settings of no use.
pub(crate) fn run(args: &ThresholdsArgs) -> anyhow::Result<()> {
    let estimator = args.precision.estimator()?;
    let settings = args.precision.settings([0.0, 0.0])?;
    let conditions = args.precision.conditions("thresholds", estimator.name(), "");
    let bar = bar();
    let seen = |done, all| show(&bar, done, all);
    let report = thresholds(&settings, &args.t_fc, &args.t_fe, &*estimator, conditions, &seen)?;
    bar.finish_and_clear();
    args.precision.write(&report, &report.markdown())?;
    write!(std::io::stdout().lock(), "{}", report.text())?;
    Ok(())
}
