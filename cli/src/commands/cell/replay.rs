//! `graspd cell replay`: an attempt of a recorded run, planned again from its frame.

use std::io::Write as _;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::Context as _;
use clap::Args;
use graspd_cell::record::{Replay, read_attempts, read_run, replay};
use serde_json::json;

/// Plans attempts of a recorded run again and says whether the same grasp comes out. Ends with 1 when it does not.
#[derive(Debug, Clone, Args)]
pub(super) struct ReplayArgs {
    /// Folder of the run
    run: PathBuf,
    /// Which attempt, from 1; all that were planned if left out
    #[arg(long, value_name = "N")]
    attempt: Option<u32>,
    /// Plan with this server instead of one in this process
    #[arg(long, value_name = "URL")]
    server: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &ReplayArgs) -> anyhow::Result<()> {
    let mut config = read_run(&args.run)?.config;
    config.planner.embedded = args.server.is_none();
    if let Some(url) = &args.server {
        config.planner.endpoint.clone_from(url);
    }
    // The file may have been written by anybody.
    config.check().with_context(|| format!("{}", args.run.join("run.json").display()))?;
    let attempts: Vec<u32> = match args.attempt {
        Some(attempt) => vec![attempt],
        None => {
            let attempts = read_attempts(&args.run)?;
            if let Some(line) = attempts.cut_line {
                let note = "was cut off when the run was killed, and is left out";
                writeln!(std::io::stderr(), "attempts.jsonl: line {line} {note}").ok();
            }
            let planned = attempts.records.into_iter().filter(|a| a.answer.is_some());
            planned.map(|a| a.attempt).collect()
        }
    };
    let timeout = Duration::try_from_secs_f64(config.timeouts.plan_s)?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let different = runtime.block_on(super::with_planner(&config, async |planner| {
        let mut different = 0;
        for attempt in attempts {
            let again = replay(&planner, &args.run, attempt, timeout).await?;
            different += u32::from(!again.same);
            let mut out = std::io::stdout().lock();
            if args.json {
                writeln!(out, "{}", as_json(&again))?;
            } else {
                writeln!(out, "{}", line(&again))?;
            }
        }
        Ok(different)
    }))?;
    anyhow::ensure!(different == 0, "{different} attempts are planned otherwise now");
    Ok(())
}

fn line(again: &Replay) -> String {
    let recorded = &again.recorded;
    let what = match (&recorded.chosen, &again.answer.no_grasp) {
        (Some(chosen), _) => format!("grasp {} (score {:.3})", chosen.rank, chosen.grasp.score),
        (None, Some(why)) => format!("no grasp ({})", why.reason.name()),
        (None, None) => "no grasp then".to_owned(),
    };
    let verdict = match (again.same, again.apart) {
        (true, _) => "the same".to_owned(),
        (false, Some((metres, radians))) => {
            format!("another one, {:.1} mm and {:.1} degrees away", 1000.0 * metres, radians.to_degrees())
        }
        (false, None) => "another answer".to_owned(),
    };
    let changed = if again.hand_changed { "; the hand's description has changed since" } else { "" };
    format!("attempt {:3}  {what}: {verdict}{changed}", recorded.attempt)
}

fn as_json(again: &Replay) -> serde_json::Value {
    json!({
        "attempt": again.recorded.attempt,
        "same": again.same,
        "hand_changed": again.hand_changed,
        "apart_m": again.apart.map(|a| a.0),
        "apart_rad": again.apart.map(|a| a.1),
        "recorded": again.recorded.chosen,
        "now": again.recorded.chosen.as_ref().and_then(|c| again.answer.grasps.get(c.rank)),
    })
}
