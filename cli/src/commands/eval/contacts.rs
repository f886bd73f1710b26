//! `graspd eval contacts`: how well networks find the labelled contacts of views, as Supplementary Note 2 measures it.

mod picture;

use std::fs::File;
use std::io::{BufReader, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::Context as _;
use clap::Args;
use graspd_inference::Network;
use graspd_training::dataset::read::Shard;
use graspd_training::evaluate::contact_picture::{found, labelled};
use graspd_training::evaluate::contacts::{ContactMetrics, ContactReport, ContactRow, answer};
use indicatif::ProgressBar;

use crate::commands::plan::write_file;
use crate::estimators;

/// Lets networks read labelled views and prints E_Pc, E_Pe and E_Angle (Supplementary Note 2) for each. Views come
/// from `graspd dataset generate`, best with `--families held-out`: shapes that were never trained on.
#[derive(Debug, Clone, Args)]
pub(crate) struct ContactsArgs {
    /// Folder of shards of `graspd dataset generate`
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// Network exported by graspd_train, several times for several; the one that graspd ships if left out
    #[arg(long, value_name = "ONNX")]
    model: Vec<PathBuf>,
    /// At most so many views, spread evenly over the folder
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    views: Option<u32>,
    /// Views at the same time; as many as there are cores if left out
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1024))]
    jobs: Option<u32>,
    /// Draw some views, as labelled and as each network finds them: an SVG file
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// How many views are drawn, spread evenly
    #[arg(long, value_name = "N", default_value_t = 4, requires = "picture", value_parser = clap::value_parser!(u32).range(1..=32))]
    pictured: u32,
    /// Write everything
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Write the table as Markdown
    #[arg(long, value_name = "FILE")]
    markdown: Option<PathBuf>,
}

/// Runs the command.
///
/// # Errors
/// For models and shards that cannot be read, views of another resolution than a network, and files that cannot be
/// written.
pub(crate) fn run(args: &ContactsArgs) -> anyhow::Result<()> {
    let networks = networks(&args.model)?;
    let shards = shards(&args.data)?;
    let mut views: Vec<(usize, usize)> = Vec::new();
    let mut told = Vec::new();
    for (s, path) in shards.iter().enumerate() {
        let shard = open(path)?;
        let h = shard.header();
        told.push(format!(
            "{}: {} views of scenes of seed {}, {}, families {:?}",
            path.file_name().unwrap_or_default().display(),
            shard.len(),
            h.seed,
            h.sensor,
            h.families
        ));
        views.extend((0..shard.len()).map(|record| (s, record)));
    }
    anyhow::ensure!(!views.is_empty(), "--data {}: found no view, expected some", args.data.display());
    let wanted = args.views.map_or(views.len(), |v| (v as usize).min(views.len()));
    let views: Vec<(usize, usize)> = (0..wanted).map(|i| views[i * views.len() / wanted]).collect();

    let bar = ProgressBar::new((views.len() * networks.len()) as u64);
    let mut rows = Vec::new();
    for (name, network) in &networks {
        let sums = measure(network, &shards, &views, super::jobs(args.jobs), &bar)
            .with_context(|| format!("network {name}"))?;
        rows.push(ContactRow::new(name, network, sums.scores()));
    }
    bar.finish_and_clear();
    if let Some(path) = &args.picture {
        let columns = columns(&networks, &rows, &shards, &views, args.pictured as usize)?;
        write_file(path, picture::svg(&columns)?.as_bytes())?;
    }
    let mut conditions =
        vec![format!("graspd {}, `graspd eval contacts`, {wanted} views", env!("CARGO_PKG_VERSION"))];
    conditions.append(&mut told);
    let report = ContactReport { conditions, rows };
    if let Some(path) = &args.json {
        write_file(path, serde_json::to_string_pretty(&report)?.as_bytes())?;
    }
    if let Some(path) = &args.markdown {
        write_file(path, report.markdown().as_bytes())?;
    }
    write!(std::io::stdout().lock(), "{}", report.text())?;
    Ok(())
}

/// Networks by name.
fn networks(files: &[PathBuf]) -> anyhow::Result<Vec<(String, Network)>> {
    if files.is_empty() {
        return Ok(vec![("shipped".to_owned(), Network::from_bytes(graspd_models::TSDF_QUATERNION)?)]);
    }
    let named = |path: &PathBuf| {
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        Ok((name, estimators::network(path)?))
    };
    files.iter().map(named).collect()
}

/// The shards of a folder, by name.
fn shards(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let read = std::fs::read_dir(folder).with_context(|| format!("--data {}", folder.display()))?;
    let mut found = Vec::new();
    for entry in read {
        let path = entry.with_context(|| format!("--data {}", folder.display()))?.path();
        if path.extension().is_some_and(|e| e == "gcd") {
            found.push(path);
        }
    }
    anyhow::ensure!(
        !found.is_empty(),
        "--data {}: found no *.gcd, expected shards of `graspd dataset generate`",
        folder.display()
    );
    found.sort();
    Ok(found)
}

fn open(path: &Path) -> anyhow::Result<Shard<BufReader<File>>> {
    let file = File::open(path).with_context(|| path.display().to_string())?;
    Shard::open(BufReader::new(file)).with_context(|| path.display().to_string())
}

/// The columns of the picture: labels, and every network's answers.
fn columns(
    networks: &[(String, Network)],
    rows: &[ContactRow],
    shards: &[PathBuf],
    views: &[(usize, usize)],
    wanted: usize,
) -> anyhow::Result<Vec<picture::Column>> {
    let count = wanted.min(views.len());
    let mut drawn = Vec::new();
    for i in 0..count {
        // From the middle of each part: the first view of a folder is no better than others.
        let (shard, record) = views[(2 * i + 1) * views.len() / (2 * count)];
        let path = &shards[shard];
        drawn.push(open(path)?.read(record).with_context(|| format!("{}, view {record}", path.display()))?);
    }
    let mut columns = vec![picture::Column {
        title: "labels".to_owned(),
        what: "contacts, centroids".to_owned(),
        figures: "(E_Pc, E_Pe, E_Angle)".to_owned(),
        cells: drawn.iter().map(labelled).collect(),
    }];
    for ((name, network), row) in networks.iter().zip(rows) {
        let cell = |view| answer(network, view).map(|answer| found(view, &answer));
        let cells = drawn.iter().map(cell).collect::<Result<_, _>>();
        columns.push(picture::Column::of(row, cells.with_context(|| format!("network {name}"))?));
    }
    Ok(columns)
}

/// Sums over views, which workers share out among themselves.
fn measure(
    network: &Network,
    shards: &[PathBuf],
    views: &[(usize, usize)],
    workers: usize,
    bar: &ProgressBar,
) -> anyhow::Result<ContactMetrics> {
    let next = AtomicUsize::new(0);
    // Sums are put together in the order of the views: the same figures however many workers there are.
    let done: Mutex<Vec<(usize, ContactMetrics)>> = Mutex::new(Vec::new());
    let work = || -> anyhow::Result<()> {
        let mut opened = None;
        loop {
            let at = next.fetch_add(1, Ordering::Relaxed);
            let Some(&(shard, record)) = views.get(at) else { return Ok(()) };
            if opened.as_ref().is_none_or(|(s, _)| *s != shard) {
                opened = Some((shard, open(&shards[shard])?));
            }
            let Some((_, reader)) = &mut opened else { continue };
            let path = &shards[shard];
            let view = reader.read(record).with_context(|| format!("{}, view {record}", path.display()))?;
            let mut metrics = ContactMetrics::default();
            metrics.add(network, &view).with_context(|| format!("{}, view {record}", path.display()))?;
            done.lock().unwrap_or_else(std::sync::PoisonError::into_inner).push((at, metrics));
            bar.inc(1);
        }
    };
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..workers.max(1)).map(|_| scope.spawn(work)).collect();
        threads
            .into_iter()
            .try_for_each(|t| t.join().map_err(|_| anyhow::anyhow!("a worker stopped unexpectedly"))?)
    })?;
    let mut done = done.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    done.sort_by_key(|(at, _)| *at);
    Ok(done.iter().fold(ContactMetrics::default(), |sum, (_, one)| sum.and(one)))
}
