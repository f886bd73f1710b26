//! `graspd cell run sort.toml`: several arms sort one tray; `--rounds` measures it.

mod envelope;
mod progress;
mod rounds;
mod shape;
#[cfg(test)]
mod tests;
mod truth;
mod world;

use std::io::Write as _;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::Context as _;
use graspd_cell::plan::GraspPlanner;
use graspd_cell::sort::config::SortConfig;
use graspd_cell::sort::report::SortReport;
use graspd_cell::sort::{SortCell, sort};
use nalgebra::Point3;
use serde_json::json;

use super::pictures::{self, Viewpoint};
use super::{RunArgs, interrupted, with_planner};
use progress::Progress;

/// Runs a file with several arms.
///
/// # Errors
/// For a configuration that is not in order, a planner that is not there, a tray that is not empty at the end.
pub(super) fn run(args: &RunArgs, text: &str, name: &str) -> anyhow::Result<()> {
    let config = configured(args, text).with_context(|| name.to_owned())?;
    // Devices have threads of their own: heartbeats and watchdogs do not wait while a plan is made.
    let for_devices = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .thread_name("devices")
        .enable_all()
        .build()?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let first = config.cell(&config.arms[0]);
    runtime.block_on(with_planner(&first, async |planner| {
        let planner: Arc<dyn GraspPlanner> = Arc::new(planner);
        if let Some(count) = args.rounds {
            return rounds::run(args, &config, &planner, &for_devices, count).await;
        }
        let stop = Arc::new(AtomicBool::new(false));
        let once = one_run(&config, &planner, &for_devices, &stop, (false, args.pictures.as_ref()));
        let report = tokio::select! {
            report = once => report?,
            () = interrupted(&stop) => anyhow::bail!("interrupted at once: the arms stand where they were"),
        };
        print(args, &config, &report)?;
        anyhow::ensure!(report.end.is_clear(), "the tray is not sorted: {}", report.end);
        let met = report.truth.as_ref().map_or(0, |t| t.collisions.len());
        anyhow::ensure!(met == 0, "arms met {met} times");
        Ok(())
    }))
}

/// One tray.
async fn one_run(
    config: &SortConfig,
    planner: &Arc<dyn GraspPlanner>,
    for_devices: &tokio::runtime::Runtime,
    stop: &Arc<AtomicBool>,
    (quiet, pictures): (bool, Option<&PathBuf>),
) -> anyhow::Result<SortReport> {
    let making = {
        let config = config.clone();
        for_devices.spawn(async move { world::devices(&config).await })
    };
    let devices = making.await??;
    if let Some(folder) = pictures {
        let from = Viewpoint {
            eye: Point3::new(0.75, -1.15, 1.0),
            target: Point3::new(0.0, 0.02, 0.12),
            focal_px: 620.0,
        };
        pictures::take(&devices.shared, folder, 1.0, from).await?;
    }
    let cell = SortCell {
        camera: devices.camera,
        arms: devices.arms,
        planner: planner.clone(),
        recognizer: Some(devices.recognizer),
        clock: Arc::new(world::WorldClock(devices.shared.clone())),
        witness: Some(devices.witness),
    };
    // The emulated devices live until the run has ended.
    let _trouble = devices.trouble;
    let mut progress = Progress::new(stop.clone(), quiet);
    let report = sort(&cell, config, &mut progress).await;
    progress.end();
    Ok(report?)
}

/// The file, then the flags.
fn configured(args: &RunArgs, text: &str) -> anyhow::Result<SortConfig> {
    let mut config = SortConfig::parse(text)?;
    anyhow::ensure!(
        args.hand.is_none(),
        "--hand: found a hand, expected none: each of several arms has its own"
    );
    if let Some(names) = &args.arms {
        let unknown = names.iter().find(|name| !config.arms.iter().any(|a| a.name == **name));
        if let Some(unknown) = unknown {
            let known: Vec<&str> = config.arms.iter().map(|a| a.name.as_str()).collect();
            anyhow::bail!("--arms: found {unknown:?}, expected some of {}", known.join(", "));
        }
        config.keep(names);
    }
    if let Some(folder) = &args.record {
        config.recording.folder = Some(folder.clone());
    }
    if let Some(url) = &args.server {
        config.planner.endpoint.clone_from(url);
        config.planner.embedded = false;
    }
    for arm in &mut config.arms {
        arm.arm.armed |= args.arm_motion;
        arm.hand.armed |= args.arm_motion;
    }
    config.run.trials = args.trials.unwrap_or(config.run.trials);
    config.run.seed = args.seed.unwrap_or(config.run.seed);
    let simulation = config.simulation.get_or_insert_default();
    if let Some(objects) = args.objects {
        simulation.insert("objects".to_owned(), i64::from(objects).into());
    }
    if let Some(seed) = args.scene_seed {
        let seed = i64::try_from(seed).context("--scene-seed: found a number beyond 2^63")?;
        simulation.insert("seed".to_owned(), seed.into());
    }
    config.check()?;
    Ok(config)
}

fn print(args: &RunArgs, config: &SortConfig, report: &SortReport) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    if args.json {
        writeln!(out, "{:#}", json!({ "report": report, "record": config.recording.folder }))?;
        return Ok(());
    }
    write!(out, "{report}")?;
    if let Some(folder) = &config.recording.folder {
        let (folder, arm) = (folder.display(), &config.arms[0].name);
        writeln!(out, "record          {folder}; graspd cell replay {folder}/{arm} --attempt N plans again")?;
    }
    Ok(())
}
