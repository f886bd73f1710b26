//! `graspd device check`: what is wrong with the devices of a cell, and what to do about it. Nothing moves.

use std::io::Write as _;
use std::time::Duration;

use clap::Args;
use graspd_adapters_core::check::Finding;
use graspd_adapters_ur::diagnose;
use graspd_cell::config::CellConfig;
use serde_json::json;

use super::Which;
use crate::devices::{self, Section, sections};

/// Says what is wrong with the devices of a cell and what to do about it; moves nothing. Ends with 1 when something is.
#[derive(Debug, Clone, Args)]
pub(super) struct CheckArgs {
    #[command(flatten)]
    which: Which,
    /// Seconds to wait for a device
    #[arg(long, value_name = "SECONDS", default_value_t = 10.0, value_parser = crate::commands::device::check::seconds)]
    timeout: f64,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// A number of seconds above 0, at most an hour.
pub(super) fn seconds(text: &str) -> Result<f64, String> {
    let value = text.parse::<f64>().ok().filter(|v| *v > 0.0 && *v <= 3600.0);
    value.ok_or_else(|| format!("found {text}, expected seconds above 0, at most 3600"))
}

pub(super) async fn run(args: &CheckArgs) -> anyhow::Result<()> {
    let config = args.which.read()?;
    let timeout = Duration::from_secs_f64(args.timeout);
    let mut found: Vec<(&str, Finding)> = Vec::new();
    for section in sections(&config).iter().filter(|s| args.which.wants(s.name)) {
        found.extend(look(&config, section, timeout).await.into_iter().map(|f| (section.name, f)));
    }
    let mut out = std::io::stdout().lock();
    if args.json {
        let findings: Vec<_> = found
            .iter()
            .map(|(device, f)| {
                json!({ "device": device, "subject": f.subject, "ok": f.ok, "found": f.found, "advice": f.advice })
            })
            .collect();
        writeln!(out, "{:#}", json!({ "findings": findings }))?;
    } else {
        for (device, finding) in &found {
            let mark = if finding.ok { "ok " } else { "BAD" };
            writeln!(out, "{mark}  {device:<7} {:<24} {}", finding.subject, finding.found)?;
            if !finding.advice.is_empty() {
                writeln!(out, "             to do: {}", finding.advice)?;
            }
        }
    }
    out.flush()?;
    let wrong = found.iter().filter(|(_, f)| !f.ok).count();
    anyhow::ensure!(wrong == 0, "{wrong} of {} findings need something to be done", found.len());
    Ok(())
}

/// Looks at one device.
async fn look(config: &CellConfig, section: &Section<'_>, timeout: Duration) -> Vec<Finding> {
    if section.is_mock() {
        return vec![Finding::good("device", "of the simulated world: nothing to look at")];
    }
    let settings = |error: anyhow::Error| {
        vec![Finding::bad("settings", format!("{error:#}"), "change the cell's file as it says")]
    };
    let late = |error: &dyn std::fmt::Display| {
        vec![Finding::bad("device", error.to_string(), "see that it has power and that its cable is plugged")]
    };
    if section.name == "camera" {
        return match devices::camera::connect(config).await {
            Ok(camera) => camera.check(timeout).await,
            Err(error) => settings(error),
        };
    }
    if section.name == "arm" {
        let wired = match devices::arm::connect(config, None).await {
            Ok(wired) => wired,
            Err(error) => return settings(error),
        };
        // Another look at the same controller takes the registers for taken, unless this client lets go of them.
        let mut ur = wired.arm.config().clone();
        drop(wired.arm);
        tokio::time::sleep(Duration::from_millis(50)).await;
        // Its steps are bounded by this.
        ur.connect_timeout_s = ur.connect_timeout_s.min(timeout.as_secs_f64());
        return diagnose(&ur).await;
    }
    match devices::hand::connect(config, None) {
        Err(error) => settings(error),
        Ok(wired) => match wired.hand.check(timeout).await {
            Ok(findings) => findings,
            Err(error) => late(&error),
        },
    }
}
