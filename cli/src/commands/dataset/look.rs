//! `graspd dataset look`: a sample as a picture.

use std::io::Write as _;
use std::path::PathBuf;

use clap::Args;
use graspd_training::dataset::picture::picture;

use crate::commands::eval::png;
use crate::commands::plan::write_file;

/// Draws one view of a shard: its depth image; the volume from above with contacts by score (blue 0, red 1), by inward
/// direction (red x, green y, blue z), and centroids; the level and the upright slice with the most contacts, their
/// directions as needles.
#[derive(Debug, Clone, Args)]
pub(crate) struct LookArgs {
    /// The shard
    file: PathBuf,
    /// Number of the record, from 0
    index: usize,
    /// Where the picture goes
    #[arg(long, value_name = "PNG")]
    out: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// For a file that is no shard, a record that does not exist, and a picture that cannot be written.
pub(crate) fn run(args: &LookArgs) -> anyhow::Result<()> {
    let mut shard = super::open(&args.file)?;
    let sample = shard.read(args.index)?;
    write_file(&args.out, &png(&picture(&sample))?)?;
    writeln!(
        std::io::stdout().lock(),
        "scene {}, view {}: {} contacts ({} of them in the occupancy volume), {} centroids; {}",
        sample.scene,
        sample.view,
        sample.contacts.len(),
        sample.contacts_of_occupancy().count(),
        sample.centroids.len(),
        args.out.display()
    )?;
    Ok(())
}
