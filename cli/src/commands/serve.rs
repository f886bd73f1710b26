//! `graspd serve`: the gRPC service.

mod file;

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::Context as _;
use clap::Args;
use graspd_server::{Server, ServerConfig, shutdown_signal};

use crate::estimators::EstimatorArgs;

/// Serves grasps over gRPC until SIGINT or SIGTERM, then finishes what is running.
#[derive(Debug, Clone, Args)]
pub(crate) struct ServeArgs {
    /// Settings as TOML; see docs/operations.md. Flags come before it
    #[arg(long, env = "GRASPD_CONFIG", value_name = "TOML")]
    config: Option<PathBuf>,
    /// Address to listen on; port 0 takes a free one [default: 127.0.0.1:50051]
    #[arg(long, env = "GRASPD_LISTEN", value_name = "ADDRESS:PORT")]
    listen: Option<SocketAddr>,
    /// Allow an address that other machines can reach, without encryption
    #[arg(long, env = "GRASPD_INSECURE_LISTEN")]
    insecure_listen: bool,
    /// Address of /metrics, /livez and /readyz
    #[arg(long, env = "GRASPD_METRICS_LISTEN", value_name = "ADDRESS:PORT")]
    metrics_listen: Option<SocketAddr>,
    /// Largest message that is taken, MiB [default: 16]
    #[arg(long, env = "GRASPD_MAX_MESSAGE_MIB", value_parser = clap::value_parser!(u32).range(1..=1024))]
    max_message_mib: Option<u32>,
    /// Threads that work on one request; all cores if left out
    #[arg(long, env = "GRASPD_THREADS", value_parser = clap::value_parser!(u32).range(1..=1024))]
    threads: Option<u32>,
    /// Requests that are planned at the same time
    #[arg(long, env = "GRASPD_SLOTS", value_parser = clap::value_parser!(u32).range(1..=1024))]
    slots: Option<u32>,
    /// Further requests that are planned at the same time, for servo calls alone
    #[arg(long, env = "GRASPD_SERVO_SLOTS", value_parser = clap::value_parser!(u32).range(0..=1024))]
    servo_slots: Option<u32>,
    /// Requests that may wait; more are refused at once
    #[arg(long, env = "GRASPD_QUEUE", value_parser = clap::value_parser!(u32).range(0..=100_000))]
    queue: Option<u32>,
    /// For comparison: plan in the order of arrival, and refuse nothing but by a full queue
    #[arg(long)]
    plain_fifo: bool,
    /// Folder of hands to offer besides the library, one folder for each hand
    #[arg(long, env = "GRASPD_HANDS_DIR", value_name = "DIR")]
    hands_dir: Option<PathBuf>,
    #[command(flatten)]
    estimator: EstimatorArgs,
    /// Seconds that running requests may take to finish at the end [default: 10]
    #[arg(long, env = "GRASPD_DRAIN_SECONDS", value_name = "SECONDS")]
    drain_seconds: Option<f64>,
}

impl ServeArgs {
    /// The file's settings, and over them those of flags and environment.
    pub(crate) fn config(&self) -> anyhow::Result<ServerConfig> {
        let mut config = match &self.config {
            None => ServerConfig::default(),
            Some(path) => {
                let text = std::fs::read_to_string(path)
                    .with_context(|| format!("--config: {} cannot be read", path.display()))?;
                file::parse(&text).with_context(|| path.display().to_string())?
            }
        };
        let pool = &mut config.pool;
        let set = |slot: &mut usize, value: Option<u32>| {
            if let Some(value) = value {
                *slot = value as usize;
            }
        };
        set(&mut pool.threads, self.threads);
        set(&mut pool.slots, self.slots);
        set(&mut pool.queue, self.queue);
        set(&mut pool.servo_slots, self.servo_slots);
        pool.plain_fifo |= self.plain_fifo;
        if let Some(seconds) = self.drain_seconds {
            config.drain_grace = Duration::try_from_secs_f64(seconds).map_err(|_| {
                anyhow::anyhow!("--drain-seconds: found {seconds}, expected a number of seconds, 0 or more")
            })?;
        }
        if let Some(mib) = self.max_message_mib {
            config.max_message_bytes = mib as usize * 1024 * 1024;
        }
        config.listen = self.listen.unwrap_or(config.listen);
        config.insecure_listen |= self.insecure_listen;
        config.metrics_listen = self.metrics_listen.or(config.metrics_listen);
        config.hands_dir = self.hands_dir.clone().or(config.hands_dir);
        config.estimators = self.estimator.all()?;
        Ok(config)
    }
}

/// Runs the service.
///
/// # Errors
/// If the address cannot be had, or the folder of hands cannot be read.
pub(crate) fn run(args: &ServeArgs) -> anyhow::Result<()> {
    let config = args.config()?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    runtime.block_on(async {
        let server = Server::bind(config).await?;
        let ended = async {
            if let Err(error) = shutdown_signal().await {
                tracing::error!(%error, "cannot listen for signals; ending");
            }
        };
        Ok(server.serve_until(ended).await?)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Only {
        #[command(flatten)]
        serve: ServeArgs,
    }

    #[test]
    fn flags_reach_the_configuration() {
        let flags =
            "--listen 127.0.0.1:0 --threads 3 --slots 2 --queue 7 --max-message-mib 4 --drain-seconds 0.5";
        let only = Only::parse_from(std::iter::once("serve").chain(flags.split(' ')));
        let config = only.serve.config().unwrap();
        assert_eq!((config.pool.threads, config.pool.slots, config.pool.queue), (3, 2, 7));
        assert_eq!(config.max_message_bytes, 4 << 20);
        assert_eq!(config.drain_grace, Duration::from_millis(500));
        let negative = Only::parse_from(["serve", "--drain-seconds=-1"]).serve.config().unwrap_err();
        assert!(negative.to_string().starts_with("--drain-seconds: found -1"));
        let missing = Only::parse_from(["serve", "--config", "/nowhere.toml"]).serve.config().unwrap_err();
        assert!(missing.to_string().starts_with("--config: /nowhere.toml cannot be read"));
    }
}
