//! `graspd worker`: plans the jobs of fronts that share a broker with it.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context as _;
use clap::Args;
use graspd_engine_nats::{NatsHands, Node, Worker, WorkerConfig};
use graspd_server::jobs::JobEngine;
use graspd_server::pool::PoolConfig;
use graspd_server::{LocalEngine, ServerConfig, shutdown_signal};

use super::engine::EngineArgs;
use crate::estimators::EstimatorArgs;

/// Plans for every graspd serve with the same --engine until SIGINT or SIGTERM, then finishes what is running.
#[derive(Debug, Clone, Args)]
pub(crate) struct WorkerArgs {
    #[command(flatten)]
    engine: EngineArgs,
    /// Jobs that are planned at the same time
    #[arg(long, env = "GRASPD_SLOTS", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1024))]
    slots: u32,
    /// Threads that work on one job; all cores if left out
    #[arg(long, env = "GRASPD_THREADS", value_parser = clap::value_parser!(u32).range(1..=1024))]
    threads: Option<u32>,
    /// Folder of hands to offer besides the library: the same as the fronts'
    #[arg(long, env = "GRASPD_HANDS_DIR", value_name = "DIR")]
    hands_dir: Option<PathBuf>,
    #[command(flatten)]
    estimator: EstimatorArgs,
    /// Calibration of the score for this site, as graspd recalibrate writes it: the same for all workers
    #[arg(long, env = "GRASPD_CALIBRATION", value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Address of /metrics, /livez and /readyz
    #[arg(long, env = "GRASPD_METRICS_LISTEN", value_name = "ADDRESS:PORT")]
    metrics_listen: Option<SocketAddr>,
    /// OpenTelemetry collector that gets traces (OTLP over gRPC), for example http://127.0.0.1:4317
    #[arg(long, env = "GRASPD_OTLP", value_name = "URL")]
    otlp: Option<String>,
    /// Seconds that running jobs may take to finish at the end; then they are given back
    #[arg(long, env = "GRASPD_DRAIN_SECONDS", value_name = "SECONDS", default_value_t = 10.0)]
    drain_seconds: f64,
}

impl WorkerArgs {
    /// The settings of the engine of this process.
    fn config(&self) -> anyhow::Result<ServerConfig> {
        let slots = self.slots as usize;
        let default = ServerConfig::default();
        let threads = self.threads.map_or(default.pool.threads, |threads| threads as usize);
        let drain_grace = Duration::try_from_secs_f64(self.drain_seconds).map_err(|_| {
            let found = self.drain_seconds;
            anyhow::anyhow!("--drain-seconds: found {found}, expected a number of seconds, 0 or more")
        })?;
        let calibration = self
            .calibration
            .as_deref()
            .map(super::serve::calibration)
            .transpose()
            .context("--calibration")?;
        Ok(ServerConfig {
            // Servo streams stay at the fronts.
            pool: PoolConfig {
                slots,
                threads,
                servo_slots: 0,
                scene_room: default.pool.scene_room.max(slots),
                ..default.pool
            },
            hands_dir: self.hands_dir.clone(),
            estimators: self.estimator.all()?,
            calibration,
            metrics_listen: self.metrics_listen,
            otlp: self.otlp.clone(),
            drain_grace,
            ..default
        })
    }
}

/// Runs a worker.
///
/// # Errors
/// If the broker cannot be reached, or the engine does not start.
pub(crate) fn run(args: &WorkerArgs) -> anyhow::Result<()> {
    let config = args.config()?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    runtime.block_on(async {
        let broker = args.engine.connect(Node::Worker).await?;
        let broker = broker.context("--engine: found nothing, expected the address of a NATS broker")?;
        let engine = Arc::new(LocalEngine::start(&config).await?);
        let hands = NatsHands::new(&broker);
        hands.follow(engine.hands()).await.map_err(|e| anyhow::anyhow!("hands: {e}"))?;
        let slots = WorkerConfig { slots: args.slots as usize, drain_grace: config.drain_grace };
        let jobs = Arc::clone(&engine) as Arc<dyn JobEngine>;
        let worker = Worker::start(&broker, jobs, hands, slots)
            .await
            .map_err(|e| anyhow::anyhow!("the broker: {e}"))?;
        tracing::info!(slots = slots.slots, "working");
        let signalled = async {
            if let Err(error) = shutdown_signal().await {
                tracing::error!(%error, "cannot listen for signals; ending");
            }
        };
        engine.run_while(worker.run_until(signalled)).await;
        Ok(())
    })
}
