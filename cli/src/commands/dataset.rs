//! `graspd dataset`: labelled views to train contact estimators on.

mod generate;
mod look;
mod stats;

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use anyhow::Context as _;
use clap::{Args, Subcommand};
use graspd_training::dataset::read::Shard;

/// Makes, draws and checks data to train contact estimators on.
#[derive(Debug, Clone, Args)]
pub(crate) struct DatasetArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Clone, Subcommand)]
enum What {
    Generate(generate::GenerateArgs),
    Look(look::LookArgs),
    Stats(stats::StatsArgs),
}

/// Runs the command.
///
/// # Errors
/// For files that cannot be read or written, settings of no use, and datasets that are not sane.
pub(crate) fn run(args: &DatasetArgs) -> anyhow::Result<()> {
    match &args.what {
        What::Generate(args) => generate::run(args),
        What::Look(args) => look::run(args),
        What::Stats(args) => stats::run(args),
    }
}

/// Opens a shard for reading.
fn open(path: &Path) -> anyhow::Result<Shard<BufReader<File>>> {
    let at = || path.display().to_string();
    let file = File::open(path).with_context(at)?;
    Shard::open(BufReader::new(file)).with_context(at)
}
