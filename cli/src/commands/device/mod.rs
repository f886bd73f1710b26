//! `graspd device`: the devices of a cell, what is wrong with them, what they do.

mod check;
mod latency;
mod list;
mod monitor;

use std::path::PathBuf;

use anyhow::Context as _;
use clap::{Args, Subcommand};
use graspd_cell::config::CellConfig;

use crate::devices;

/// Devices of a cell: which there are, what is wrong with them and what to do, what they report.
#[derive(Debug, Clone, Args)]
pub(crate) struct DeviceArgs {
    #[command(subcommand)]
    command: DeviceCommand,
}

#[derive(Debug, Clone, Subcommand)]
enum DeviceCommand {
    List(list::ListArgs),
    Check(check::CheckArgs),
    Monitor(monitor::MonitorArgs),
    Latency(latency::LatencyArgs),
}

/// Which devices of which cell.
#[derive(Debug, Clone, Args)]
struct Which {
    /// Configuration of the cell; the defaults are mock devices
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// camera, arm or hand; all if left out
    #[arg(value_parser = ["camera", "arm", "hand"])]
    name: Option<String>,
}

impl Which {
    /// The cell's file, with what every device of it needs in order.
    fn read(&self) -> anyhow::Result<CellConfig> {
        let config = devices::read(self.config.as_deref())?;
        devices::check_settings(&config)?;
        Ok(config)
    }

    fn wants(&self, name: &str) -> bool {
        self.name.as_deref().is_none_or(|wanted| wanted == name)
    }
}

/// Runs the command.
///
/// # Errors
/// For a configuration that is not in order; `check` also for everything that somebody must do something about.
pub(crate) fn run(args: &DeviceArgs) -> anyhow::Result<()> {
    let work = async {
        match &args.command {
            DeviceCommand::List(args) => list::run(args),
            DeviceCommand::Check(args) => check::run(args).await,
            DeviceCommand::Monitor(args) => monitor::run(args).await,
            DeviceCommand::Latency(args) => latency::run(args).await,
        }
    };
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build();
    runtime.context("no runtime")?.block_on(work)
}
