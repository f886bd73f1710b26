//! The highest rate at which an objective holds: doubling until it does not, then halving the gap.

use std::str::FromStr;
use std::time::Duration;

use super::report::Report;

/// Calls a second of the first try.
const FIRST_RATE: f64 = 2.0;
/// The gap between a rate that held and one that did not, as a share.
const CLOSE_ENOUGH: f64 = 0.08;
/// Share of calls that must be answered.
const SUCCEED: f64 = 0.99;

/// A quantile of latency and what it must not exceed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Objective {
    /// 0 to 1.
    pub(super) quantile: f64,
    pub(super) limit: Duration,
}

impl FromStr for Objective {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = || {
            let (quantile, limit) = text.split_once('=')?;
            let quantile: f64 = quantile.trim().strip_prefix('p')?.parse().ok()?;
            let limit: u64 = limit.trim().strip_suffix("ms")?.parse().ok()?;
            let sane = (1.0..100.0).contains(&quantile) && limit > 0;
            sane.then(|| Self { quantile: quantile / 100.0, limit: Duration::from_millis(limit) })
        };
        parsed().ok_or_else(|| "expected for example p99=250ms".to_owned())
    }
}

impl Objective {
    fn holds(&self, report: &Report) -> bool {
        report.answered_share() >= SUCCEED && report.latency(self.quantile) <= self.limit
    }
}

/// The report of the highest rate that held.
pub(super) async fn find_max(
    objective: Objective,
    mut measure: impl AsyncFnMut(f64) -> anyhow::Result<Report>,
) -> anyhow::Result<Report> {
    let (mut good, mut bad, mut rate) = (None, None, FIRST_RATE);
    loop {
        let report = measure(rate).await?;
        let held = objective.holds(&report);
        tracing::warn!(
            rate,
            held,
            answered = report.answered_share(),
            latency_ms = report.latency(objective.quantile).as_secs_f64() * 1e3,
            "tried"
        );
        if held {
            good = Some((rate, report));
        } else {
            bad = Some(rate);
        }
        match (&good, bad) {
            (None, Some(bad)) if bad < 0.05 => {
                anyhow::bail!("--find-max: the objective does not hold at {bad} calls a second either");
            }
            (None, Some(bad)) => rate = bad / 2.0,
            (Some((good, _)), None) => rate = good * 2.0,
            (Some((good, _)), Some(bad)) if bad - good > CLOSE_ENOUGH * good => rate = (good + bad) / 2.0,
            (Some(_), Some(_)) => break,
            (None, None) => {}
        }
    }
    good.map(|(_, report)| report).ok_or_else(|| anyhow::anyhow!("--find-max: no rate held"))
}
