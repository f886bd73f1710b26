//! `graspd serve`: the gRPC service.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use graspd_server::{Server, ServerConfig, shutdown_signal};

use crate::estimators::EstimatorArgs;

/// Serves grasps over gRPC until SIGINT or SIGTERM, then finishes what is running.
#[derive(Debug, Clone, Args)]
pub(crate) struct ServeArgs {
    /// Address to listen on; port 0 takes a free one
    #[arg(long, default_value = "127.0.0.1:50051", env = "GRASPD_LISTEN", value_name = "ADDRESS:PORT")]
    listen: SocketAddr,
    /// Allow an address that other machines can reach, without encryption
    #[arg(long, env = "GRASPD_INSECURE_LISTEN")]
    insecure_listen: bool,
    /// Largest message that is taken, MiB
    #[arg(
        long,
        default_value_t = 16,
        env = "GRASPD_MAX_MESSAGE_MIB",
        value_parser = clap::value_parser!(u32).range(1..=1024)
    )]
    max_message_mib: u32,
    /// Threads that work on one request; all cores if left out
    #[arg(long, env = "GRASPD_THREADS", value_parser = clap::value_parser!(u32).range(1..=1024))]
    threads: Option<u32>,
    /// Requests that are planned at the same time
    #[arg(long, env = "GRASPD_SLOTS", value_parser = clap::value_parser!(u32).range(1..=1024))]
    slots: Option<u32>,
    /// Requests that may wait; more are refused at once
    #[arg(long, env = "GRASPD_QUEUE", value_parser = clap::value_parser!(u32).range(0..=100_000))]
    queue: Option<u32>,
    /// Folder of hands to offer besides the library, one folder for each hand
    #[arg(long, env = "GRASPD_HANDS_DIR", value_name = "DIR")]
    hands_dir: Option<PathBuf>,
    #[command(flatten)]
    estimator: EstimatorArgs,
    /// Seconds that running requests may take to finish at the end
    #[arg(long, default_value_t = 10.0, env = "GRASPD_DRAIN_SECONDS", value_name = "SECONDS")]
    drain_seconds: f64,
}

impl ServeArgs {
    fn config(&self) -> anyhow::Result<ServerConfig> {
        let mut pool = ServerConfig::default().pool;
        let set = |slot: &mut usize, value: Option<u32>| {
            if let Some(value) = value {
                *slot = value as usize;
            }
        };
        set(&mut pool.threads, self.threads);
        set(&mut pool.slots, self.slots);
        set(&mut pool.queue, self.queue);
        let drain_grace = Duration::try_from_secs_f64(self.drain_seconds).map_err(|_| {
            anyhow::anyhow!(
                "--drain-seconds: found {}, expected a number of seconds, 0 or more",
                self.drain_seconds
            )
        })?;
        Ok(ServerConfig {
            listen: self.listen,
            insecure_listen: self.insecure_listen,
            max_message_bytes: self.max_message_mib as usize * 1024 * 1024,
            pool,
            hands_dir: self.hands_dir.clone(),
            estimators: self.estimator.all()?,
            drain_grace,
        })
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
    }
}
