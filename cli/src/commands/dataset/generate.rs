//! `graspd dataset generate`: scenes, views and labels into a shard, from where an interrupted run stopped.

use std::fs::{File, OpenOptions};
use std::io::{BufReader, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use graspd_training::dataset::families::{Split, Stock};
use graspd_training::dataset::generate::{GenerateSettings, Generator};
use graspd_training::dataset::read::Shard;
use graspd_training::dataset::recipe::Recipe;
use graspd_training::dataset::shard::Header;
use indicatif::{ProgressBar, ProgressStyle};

use crate::commands::eval;

/// Draws cluttered scenes, samples antipodal grasps on their objects, and writes noisy views from all around with a
/// label at every voxel that a finger may touch. Runs again from where it was interrupted; same seed, same bytes.
#[derive(Debug, Clone, Args)]
pub(crate) struct GenerateArgs {
    /// Folder for the shard's file; made where it is missing
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Scenes of all shards together
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    scenes: u32,
    /// Views of each scene
    #[arg(long, default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=4096))]
    views: u32,
    /// Same seed: same data
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Make every n-th scene from number i on only: one machine's part of n
    #[arg(long, default_value = "0/1", value_name = "I/N", value_parser = parse_shard)]
    shard: [u32; 2],
    /// Scenes at the same time; as many as there are cores if left out
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1024))]
    jobs: Option<u32>,
    /// Depth camera: azure-kinect, pico-flexx, ideal
    #[arg(long, default_value = "azure-kinect", value_name = "NAME")]
    sensor: String,
    /// Objects to learn from, those held out for tests, or all: train, held-out, all
    #[arg(long, default_value = "train", value_name = "SPLIT", value_parser = parse_split)]
    families: Split,
    /// Take the meshes (OBJ, STL; closed, z up) of this folder instead of procedural families; every fourth by name is
    /// held out
    #[arg(long, value_name = "DIR")]
    meshes: Option<PathBuf>,
    /// Metres in a unit of the meshes: 0.001 for millimetres
    #[arg(long, default_value_t = 1.0, value_name = "FACTOR", requires = "meshes")]
    mesh_scale: f64,
    /// Every number of the generation as JSON; what it leaves out has its default
    #[arg(long, value_name = "FILE")]
    recipe: Option<PathBuf>,
    /// Commit of the source that makes the data, for the header
    #[arg(long, value_name = "HASH", env = "GRASPD_COMMIT")]
    commit: Option<String>,
}

fn parse_shard(text: &str) -> Result<[u32; 2], String> {
    let wrong = || format!("found {text:?}, expected i/n with i from 0 to n - 1");
    let (i, n) = text.split_once('/').ok_or_else(wrong)?;
    let number = |part: &str| part.trim().parse::<u32>().map_err(|_| wrong());
    let [i, n] = [number(i)?, number(n)?];
    if i < n { Ok([i, n]) } else { Err(wrong()) }
}

fn parse_split(text: &str) -> Result<Split, String> {
    let found = Split::NAMES.iter().find(|(name, _)| *name == text);
    found
        .map(|(_, split)| *split)
        .ok_or_else(|| format!("found {text:?}, expected {}", Split::NAMES.map(|(name, _)| name).join(", ")))
}

/// Runs the command.
///
/// # Errors
/// For settings of no use, meshes that cannot be read, a shard that cannot be written, and one that is there but was made
/// otherwise or is damaged.
pub(crate) fn run(args: &GenerateArgs) -> anyhow::Result<()> {
    let stock = match &args.meshes {
        None => Stock::families(args.families),
        Some(folder) => Stock::meshes(&eval::meshes(folder, args.mesh_scale, usize::MAX)?, args.families),
    };
    let recipe = match &args.recipe {
        None => Recipe::for_sensor(&args.sensor),
        Some(path) => {
            let at = || path.display().to_string();
            let text = std::fs::read_to_string(path).with_context(at)?;
            Recipe::from_json(&text, &args.sensor).with_context(at)?
        }
    };
    let generator = Generator::new(GenerateSettings {
        stock,
        families: args.families,
        sensor: args.sensor.clone(),
        recipe,
        scenes: args.scenes,
        views: args.views,
        shard: args.shard,
        seed: args.seed,
        program: format!("graspd {}", env!("CARGO_PKG_VERSION")),
        commit: args.commit.clone(),
    })?;
    std::fs::create_dir_all(&args.out).with_context(|| args.out.display().to_string())?;
    let path = args.out.join(generator.header().file_name());
    let at = || path.display().to_string();
    let (mut file, done) = begin(&path, generator.header()).with_context(at)?;
    let all = generator.header().records();
    if done > 0 && done < all {
        writeln!(std::io::stderr(), "{}: goes on behind {done} of {all} views", path.display()).ok();
    }
    let bar = ProgressBar::new(all as u64);
    if let Ok(style) =
        ProgressStyle::with_template("{pos}/{len} views {bar:30} {elapsed}, {per_sec}, {eta} left")
    {
        bar.set_style(style);
    }
    bar.set_position(done as u64);
    bar.reset_eta();
    let result = generator.generate(
        done,
        eval::jobs(args.jobs),
        |record| file.write_all(record),
        |done, _| bar.set_position(done as u64),
    );
    bar.finish_and_clear();
    result.with_context(at)?;
    file.sync_all().with_context(at)?;
    writeln!(
        std::io::stdout().lock(),
        "{}: {all} views of {} scenes, {:.1} MB",
        path.display(),
        generator.header().scenes_here().count(),
        file.metadata().with_context(at)?.len() as f64 / 1e6
    )?;
    Ok(())
}

/// The shard's file, open behind its last whole record, and how many there are.
fn begin(path: &Path, header: &Header) -> anyhow::Result<(File, usize)> {
    let bytes = header.to_bytes();
    let mut file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path)?;
    // A run that was interrupted within its first bytes leaves a part of the same header.
    let there = file.metadata()?.len();
    if there < bytes.len() as u64 {
        let mut start = Vec::new();
        std::io::Read::read_to_end(&mut file, &mut start)?;
        anyhow::ensure!(
            bytes.starts_with(&start),
            "found another file here, expected a shard of this dataset"
        );
        file.set_len(0)?;
        file.rewind()?;
        file.write_all(&bytes)?;
        return Ok((file, 0));
    }
    let mut shard = Shard::open(BufReader::new(file.try_clone()?))?;
    if let Some(field) = difference(shard.header(), header)? {
        anyhow::bail!(
            "found a shard that was made with {field}; expected the same settings (or another --out)"
        );
    }
    let (done, end) = shard.progress()?;
    anyhow::ensure!(done <= header.records(), "found {done} records, expected at most {}", header.records());
    file.set_len(end)?;
    file.seek(SeekFrom::Start(end))?;
    Ok((file, done))
}

/// The first field that a shard was made with otherwise. Another commit or version is another maker.
fn difference(found: &Header, expected: &Header) -> anyhow::Result<Option<String>> {
    let [found, expected] = [serde_json::to_value(found)?, serde_json::to_value(expected)?];
    let Some(fields) = expected.as_object() else { return Ok(None) };
    let other = fields.iter().find(|(name, value)| found.get(name) != Some(value));
    Ok(other.map(|(name, _)| format!("{name} {}", found.get(name).unwrap_or(&serde_json::Value::Null))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_and_splits_are_parsed() {
        assert_eq!(parse_shard("3/16"), Ok([3, 16]));
        for wrong in ["", "3", "16/16", "-1/2", "a/b", "0/0"] {
            assert!(parse_shard(wrong).is_err(), "{wrong}");
        }
        assert_eq!(parse_split("held-out"), Ok(Split::HeldOut));
        assert!(parse_split("test").unwrap_err().contains("train, held-out, all"));
    }

    #[test]
    fn a_shard_goes_on_only_with_the_settings_it_was_begun_with() {
        let folder = std::env::temp_dir().join(format!("graspd-shard-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("shard.gcd");
        let header = |seed| {
            let settings = GenerateSettings {
                stock: Stock::families(Split::All),
                families: Split::All,
                sensor: "ideal".into(),
                recipe: Recipe::default(),
                scenes: 2,
                views: 2,
                shard: [0, 1],
                seed,
                program: "test".into(),
                commit: None,
            };
            Generator::new(settings).unwrap().header().clone()
        };
        let (_, done) = begin(&path, &header(1)).unwrap();
        assert_eq!(done, 0);
        // Cut off within the header, and whole, it goes on.
        std::fs::write(&path, &header(1).to_bytes()[..40]).unwrap();
        assert_eq!(begin(&path, &header(1)).unwrap().1, 0);
        assert_eq!(std::fs::read(&path).unwrap(), header(1).to_bytes());
        assert_eq!(begin(&path, &header(1)).unwrap().1, 0);
        let error = begin(&path, &header(2)).unwrap_err().to_string();
        assert!(error.contains("made with seed 1"), "{error}");
        std::fs::write(&path, b"my thesis").unwrap();
        assert!(begin(&path, &header(1)).is_err());
        assert_eq!(std::fs::read(&path).unwrap(), b"my thesis");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
