//! `graspd recalibrate`: learns from the outcomes of a recording what a score is worth at this site.

use std::io::Write as _;
use std::path::PathBuf;
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::Context as _;
use clap::Args;
use graspd_server::calibration::{Fitted, Trial, fit};

use super::replay::{self, outcomes};
use crate::output::table::Table;

/// Ranges of scores in the table.
const RANGES: usize = 5;

/// Learns from reported outcomes what share of grasps of a score succeeds here, and writes it for graspd serve
/// --calibration. Says so where outcomes are too few or the score tells nothing.
#[derive(Debug, Clone, Args)]
pub(crate) struct RecalibrateArgs {
    /// A folder of a recording, or one of its files
    #[arg(value_name = "DIR|FILE")]
    path: PathBuf,
    /// File to write
    #[arg(short, long, value_name = "JSON")]
    out: PathBuf,
    /// Name that answers give of the calibration
    #[arg(long, default_value = "site")]
    name: String,
    /// Learn from the outcomes of this hand alone
    #[arg(long, value_name = "ID")]
    hand: Option<String>,
}

/// Runs the command.
///
/// # Errors
/// For files that are no recording, outcomes that are too few or say nothing, and a file that cannot be written.
pub(crate) fn run(args: &RecalibrateArgs) -> anyhow::Result<()> {
    let reported = outcomes::listed(&replay::read(&args.path)?);
    let of_hand = |r: &&outcomes::Reported| args.hand.as_ref().is_none_or(|hand| r.hand == *hand);
    let trial = |r: &outcomes::Reported| Some(Trial { score: r.uncalibrated_score, succeeded: r.succeeded? });
    let trials: Vec<Trial> = reported.iter().filter(of_hand).filter_map(trial).collect();
    let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
    let fitted = fit(&trials, &args.name, i64::try_from(now).unwrap_or(i64::MAX))
        .with_context(|| args.path.display().to_string())?;
    std::fs::write(&args.out, fitted.calibration.to_json())
        .with_context(|| format!("--out: {} cannot be written", args.out.display()))?;
    write!(std::io::stdout().lock(), "{}", said(&fitted, trials))?;
    Ok(())
}

fn said(fitted: &Fitted, mut trials: Vec<Trial>) -> String {
    let calibration = &fitted.calibration;
    let mut text = format!(
        "{}: learned from {} outcomes, {} of them successes\n\n",
        calibration.name, calibration.outcome_count, calibration.success_count
    );
    trials.sort_by(|a, b| a.score.total_cmp(&b.score));
    let mut table = Table::new(&["score", "outcomes", "succeeded", "calibrated"], 1);
    for range in trials.chunks(trials.len().div_ceil(RANGES).max(1)) {
        let n = range.len() as f64;
        let succeeded = range.iter().filter(|t| t.succeeded).count() as f64 / n;
        let calibrated = range.iter().map(|t| calibration.share(t.score)).sum::<f64>() / n;
        let (low, high) = (range.first().map_or(0.0, |t| t.score), range.last().map_or(0.0, |t| t.score));
        table.row(vec![
            format!("{low:.3} to {high:.3}"),
            range.len().to_string(),
            format!("{succeeded:.2}"),
            format!("{calibrated:.2}"),
        ]);
    }
    text.push_str(&table.to_string());
    text.push_str(&format!(
        "\nmean squared error of the share of success, of outcomes that were held out: {:.4} calibrated, {:.4} as the \
         score was, {:.4} for always saying the mean\n",
        fitted.brier, fitted.brier_uncalibrated, fitted.brier_of_mean
    ));
    if fitted.brier >= fitted.brier_of_mean {
        text.push_str(
            "the score tells little about success here: the calibration is no better than always saying the mean\n",
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_learned_is_told() {
        let trials: Vec<Trial> =
            (0..100).map(|i| Trial { score: f64::from(i) / 100.0, succeeded: (i * 37) % 100 < i }).collect();
        let text = said(&fit(&trials, "bench 3", 0).unwrap(), trials);
        assert!(text.starts_with("bench 3: learned from 100 outcomes"), "{text}");
        assert_eq!(text.lines().filter(|line| line.contains(" to ")).count(), RANGES, "{text}");
        assert!(!text.contains("tells little"), "{text}");
    }
}
