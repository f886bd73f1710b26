//! `graspd cell`: a robot cell clears a tray; recorded attempts are planned again.

mod pictures;
mod progress;
mod replay;
#[cfg(test)]
mod servo_tests;
mod simulation;
mod sorting;
mod truth;
pub(super) mod world;

use std::future::Future;
use std::io::Write as _;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context as _;
use clap::{Args, Subcommand};
use graspd_cell::config::CellConfig;
use graspd_cell::plan::PlannerClient;
use graspd_cell::report::Report;
use graspd_cell::sort::config::SortConfig;
use graspd_cell::{Cell, clear_tray};
use graspd_server::{Server, ServerConfig};
use serde_json::json;

use progress::Progress;

/// A robot cell clears a tray; recorded attempts are planned again.
#[derive(Debug, Clone, Args)]
pub(crate) struct CellArgs {
    #[command(subcommand)]
    command: CellCommand,
}

#[derive(Debug, Clone, Subcommand)]
enum CellCommand {
    Run(Box<RunArgs>),
    Replay(replay::ReplayArgs),
}

/// Clears a tray, or sorts one with several arms. Ends with 0 when the tray is empty, with 1 for every other end, which is told.
#[derive(Debug, Clone, Args)]
struct RunArgs {
    /// Configuration; every value has a default
    config: Option<PathBuf>,
    /// Hand by its id (see `graspd hands list`)
    #[arg(long, value_name = "ID")]
    hand: Option<String>,
    /// Keep the run in this folder
    #[arg(long, value_name = "DIR")]
    record: Option<PathBuf>,
    /// Plan with this server instead of one in this process, for example http://127.0.0.1:50051
    #[arg(long, value_name = "URL")]
    server: Option<String>,
    /// Grasp trials at most
    #[arg(long, value_name = "N")]
    trials: Option<u32>,
    /// Seed of the first plan
    #[arg(long)]
    seed: Option<u64>,
    /// Number of simulated objects
    #[arg(long, value_name = "N")]
    objects: Option<u32>,
    /// Seed of the simulated scene
    #[arg(long, value_name = "SEED")]
    scene_seed: Option<u64>,
    /// Several arms: sort so many trays, each with the next seed, and print what is counted
    #[arg(long, value_name = "N")]
    rounds: Option<u32>,
    /// Several arms: only these, by their names
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    arms: Option<Vec<String>>,
    /// Several arms, or a servo: pictures of the simulated world into this folder, one for each second of its clock, or
    /// for each fifth of one
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    /// Allow motion of all devices, whatever the file says
    #[arg(long)]
    arm_motion: bool,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Simulated seconds between pictures of a servo.
const PICTURE_EVERY_S: f64 = 0.2;

/// Runs the command.
///
/// # Errors
/// For a configuration that is not in order, a planner that is not there, and a tray that is not empty at the end.
pub(crate) fn run(args: &CellArgs) -> anyhow::Result<()> {
    match &args.command {
        CellCommand::Run(args) => run_cell(args),
        CellCommand::Replay(args) => replay::run(args),
    }
}

impl RunArgs {
    /// The file, then the environment, then the flags.
    fn config(&self) -> anyhow::Result<CellConfig> {
        let mut config = crate::devices::read(self.config.as_deref())?;
        if let Some(hand) = &self.hand {
            config.hand.id.clone_from(hand);
        }
        if let Some(folder) = &self.record {
            config.recording.folder = Some(folder.clone());
        }
        if let Some(url) = &self.server {
            config.planner.endpoint.clone_from(url);
            config.planner.embedded = false;
        }
        config.arm.armed |= self.arm_motion;
        config.hand.armed |= self.arm_motion;
        config.run.trials = self.trials.unwrap_or(config.run.trials);
        config.run.seed = self.seed.unwrap_or(config.run.seed);
        let simulation = config.simulation.get_or_insert_default();
        if let Some(objects) = self.objects {
            simulation.insert("objects".to_owned(), i64::from(objects).into());
        }
        if let Some(seed) = self.scene_seed {
            let seed = i64::try_from(seed).context("--scene-seed: found a number beyond 2^63")?;
            simulation.insert("seed".to_owned(), seed.into());
        }
        world::place_palm_camera(&mut config)?;
        config.check()?;
        Ok(config)
    }
}

fn run_cell(args: &RunArgs) -> anyhow::Result<()> {
    if let Some(path) = &args.config
        && let Ok(text) = std::fs::read_to_string(path)
        && SortConfig::is_one(&text)
    {
        return sorting::run(args, &text, &path.display().to_string());
    }
    let config = args.config()?;
    for (flag, given) in [
        ("--rounds", args.rounds.is_some()),
        ("--arms", args.arms.is_some()),
        ("--pictures", args.pictures.is_some() && config.servo.is_none()),
    ] {
        anyhow::ensure!(
            !given,
            "{flag}: found it, expected a file with several arms: [[arms]], as in examples/sort.toml"
        );
    }
    // Devices have threads of their own: heartbeats and watchdogs do not wait while a frame is packed or a plan is made.
    let for_devices = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .thread_name("devices")
        .enable_all()
        .build()?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let report = runtime.block_on(async {
        let making = {
            let config = config.clone();
            for_devices.spawn(async move { world::devices(&config).await })
        };
        // The emulated devices live until the run has ended.
        let world::Devices { camera, arm, hand, witness, shared, trouble: _trouble } = making.await??;
        if let (Some(folder), Some(shared)) = (&args.pictures, &shared) {
            pictures::take(shared, folder, PICTURE_EVERY_S, world::VIEWPOINT).await?;
        }
        with_planner(&config, async |planner| {
            let stop = Arc::new(AtomicBool::new(false));
            let mut progress = Progress::new(&config, Arc::clone(&stop));
            let cell = Cell { camera, arm, hand, planner: Arc::new(planner), witness };
            let report = tokio::select! {
                report = clear_tray(&cell, &config, &mut progress) => report?,
                () = interrupted(&stop) => anyhow::bail!("interrupted at once: the arm stands where it was"),
            };
            progress.end();
            Ok(report)
        })
        .await
    })?;
    print(args, &config, &report)?;
    anyhow::ensure!(report.end.is_clear(), "the tray is not cleared: {}", report.end);
    Ok(())
}

/// The first interrupt asks the run to end after its attempt; ready at the second.
async fn interrupted(stop: &AtomicBool) {
    for last in [false, true] {
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
        stop.store(true, Ordering::Relaxed);
        if !last {
            writeln!(std::io::stderr(), "ending after this attempt; interrupt again to stop at once").ok();
        }
    }
}

/// Does something with the configured planner: a server elsewhere, or one in this process on a free port.
pub(super) async fn with_planner<T, F>(
    config: &CellConfig,
    work: impl FnOnce(PlannerClient) -> F,
) -> anyhow::Result<T>
where
    F: Future<Output = anyhow::Result<T>>,
{
    if !config.planner.embedded {
        return work(PlannerClient::new(&config.planner.endpoint)).await;
    }
    let listen = ([127, 0, 0, 1], 0).into();
    let server = Server::bind(ServerConfig { listen, ..ServerConfig::default() }).await?;
    let url = format!("http://{}", server.local_addr());
    let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
    let serving = tokio::spawn(server.serve_until(async {
        stopped.await.ok();
    }));
    let done = work(PlannerClient::new(&url)).await;
    // That it has ended already is told by the handle.
    stop.send(()).ok();
    serving.await??;
    done
}

fn print(args: &RunArgs, config: &CellConfig, report: &Report) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    if args.json {
        let summary = json!({
            "report": report,
            "success_rate": report.tally.rate(),
            "record": config.recording.folder,
        });
        writeln!(out, "{summary:#}")?;
        return Ok(());
    }
    write!(out, "{report}")?;
    if let Some(folder) = &config.recording.folder {
        let folder = folder.display();
        writeln!(out, "record          {folder}; graspd cell replay {folder} --attempt N plans again")?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Only {
        #[command(flatten)]
        run: RunArgs,
    }

    fn config(flags: &str) -> anyhow::Result<CellConfig> {
        let words = std::iter::once("run").chain(flags.split_whitespace());
        Only::try_parse_from(words)?.run.config()
    }

    #[test]
    fn flags_stand_above_the_file() {
        let found = config("--hand barrett --trials 3 --seed 9 --objects 12 --server http://h:1").unwrap();
        assert_eq!((found.hand.id.as_str(), found.run.trials, found.run.seed), ("barrett", 3, 9));
        assert_eq!((found.planner.embedded, found.planner.endpoint.as_str()), (false, "http://h:1"));
        assert_eq!(found.simulation.unwrap()["objects"].as_integer(), Some(12));
        assert!(config("--trials 0").unwrap_err().to_string().starts_with("run.trials: found 0"));
        let missing = config("none.toml").unwrap_err().to_string();
        assert_eq!(missing, "none.toml: cannot be read");
    }
}
