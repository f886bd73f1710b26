//! `graspd device list`: what a cell is made of, and which kinds there are.

use std::io::Write as _;

use clap::Args;
use serde_json::json;

use super::Which;
use crate::devices::{ARMS, CAMERAS, EMULATOR, HANDS, sections};

/// Lists the devices of a cell, and the kinds that a cell may name.
#[derive(Debug, Clone, Args)]
pub(super) struct ListArgs {
    #[command(flatten)]
    which: Which,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &ListArgs) -> anyhow::Result<()> {
    let config = args.which.read()?;
    let sections = sections(&config).into_iter().filter(|s| args.which.wants(s.name));
    let kinds = [("camera", CAMERAS), ("arm", ARMS), ("hand", HANDS)];
    let mut out = std::io::stdout().lock();
    if args.json {
        let devices: Vec<_> = sections
            .map(|s| json!({ "device": s.name, "kind": s.kind, "address": s.address, "armed": s.armed }))
            .collect();
        let names = |(device, kinds): (&str, &[(&str, &str)])| {
            (device.to_owned(), kinds.iter().map(|(name, _)| *name).collect::<Vec<_>>().into())
        };
        let kinds: serde_json::Map<String, serde_json::Value> = kinds.map(names).into_iter().collect();
        writeln!(out, "{:#}", json!({ "devices": devices, "kinds": kinds }))?;
        return Ok(());
    }
    writeln!(out, "{:<8} {:<12} {:<32} motion", "device", "kind", "address")?;
    for s in sections {
        let address = match (s.is_mock(), s.address) {
            (true, _) => "in the simulated world",
            (false, EMULATOR) => "emulated in this process",
            (false, address) => address,
        };
        let motion = match (s.is_mock(), s.armed) {
            (_, None) | (true, _) => "-",
            (false, Some(true)) => "armed",
            (false, Some(false)) => "not armed",
        };
        writeln!(out, "{:<8} {:<12} {address:<32} {motion}", s.name, s.kind)?;
    }
    for (device, kinds) in kinds.into_iter().filter(|(device, _)| args.which.wants(device)) {
        writeln!(out, "\n{device}.kind may be")?;
        for (name, what) in kinds {
            writeln!(out, "  {name:<12} {what}")?;
        }
    }
    Ok(())
}
