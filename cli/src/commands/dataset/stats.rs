//! `graspd dataset stats`: what a dataset holds, and whether it is sane.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use graspd_training::dataset::stats::Stats;
use indicatif::ProgressBar;

use crate::commands::plan::write_file;

/// Counts labels, scores and directions in every shard of a folder, and fails where a bound of sanity does.
#[derive(Debug, Clone, Args)]
pub(crate) struct StatsArgs {
    /// Folder of shards, or one shard
    path: PathBuf,
    /// Look at every k-th record only
    #[arg(long, default_value_t = 1, value_name = "K", value_parser = clap::value_parser!(u32).range(1..))]
    every: u32,
    /// Write the counts
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// Runs the command.
///
/// # Errors
/// For files that are no shards or damaged, and with every bound that does not hold.
pub(crate) fn run(args: &StatsArgs) -> anyhow::Result<()> {
    let shards = shards(&args.path)?;
    let mut stats = Stats::default();
    let mut out = std::io::stdout().lock();
    let bar = ProgressBar::new(0);
    for path in &shards {
        let mut shard = super::open(path)?;
        bar.inc_length(shard.len() as u64);
        if shard.left_over() > 0 || shard.len() < shard.header().records() {
            let (found, all) = (shard.len(), shard.header().records());
            writeln!(out, "{}: unfinished, {found} of {all} views", path.display())?;
        }
        for record in 0..shard.len() {
            if record % args.every as usize == 0 {
                stats.add(&shard.read(record).with_context(|| path.display().to_string())?);
            }
            bar.inc(1);
        }
    }
    bar.finish_and_clear();
    if let Some(path) = &args.json {
        write_file(path, serde_json::to_string_pretty(&stats)?.as_bytes())?;
    }
    write!(out, "{}", stats.text())?;
    let complaints = stats.complaints();
    anyhow::ensure!(complaints.is_empty(), "the dataset is not sane: {}", complaints.join("; "));
    Ok(())
}

/// The shards of a folder in the order of their names, or the one file.
fn shards(path: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let at = || path.display().to_string();
    if !path.is_dir() {
        return Ok(vec![path.to_path_buf()]);
    }
    let entries = std::fs::read_dir(path).with_context(at)?;
    let mut all: Vec<PathBuf> =
        entries.map(|entry| Ok(entry?.path())).collect::<Result<_, std::io::Error>>().with_context(at)?;
    all.retain(|p| p.extension().is_some_and(|e| e == "gcd"));
    all.sort();
    anyhow::ensure!(!all.is_empty(), "{}: found no shard, expected files ending in .gcd", path.display());
    Ok(all)
}
