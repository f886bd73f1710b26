//! Flags of the broker that connects fronts and workers.

use std::path::PathBuf;

use anyhow::Context as _;
use clap::Args;
use graspd_engine_nats::{Broker, BrokerTls, NatsConfig, Node};

/// Where jobs go through.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Several machines")]
pub(crate) struct EngineArgs {
    /// NATS broker that connects fronts and workers, nats:// or tls://; put passwords into the variable
    #[arg(long, env = "GRASPD_ENGINE", value_name = "URL", hide_env_values = true)]
    engine: Option<String>,
    /// Installations that share a broker are told apart by this
    #[arg(long, env = "GRASPD_ENGINE_NAME", value_name = "NAME", default_value = "graspd")]
    engine_name: String,
    /// Jobs that may wait or run in the whole installation; more are refused at once
    #[arg(long, env = "GRASPD_ENGINE_QUEUE", value_name = "JOBS", default_value_t = 64,
        value_parser = clap::value_parser!(u32).range(1..=100_000))]
    engine_queue: u32,
    /// Allow a broker on another machine without encryption
    #[arg(long, env = "GRASPD_INSECURE_ENGINE")]
    insecure_engine: bool,
    /// Roots of the broker's certificate besides those of the system, PEM
    #[arg(long, env = "GRASPD_ENGINE_ROOTS", value_name = "FILE")]
    engine_roots: Option<PathBuf>,
    /// This process's certificate for the broker, PEM
    #[arg(long, env = "GRASPD_ENGINE_CERTIFICATE", value_name = "FILE", requires = "engine_key")]
    engine_certificate: Option<PathBuf>,
    /// Its key, PEM
    #[arg(long, env = "GRASPD_ENGINE_KEY", value_name = "FILE", requires = "engine_certificate")]
    engine_key: Option<PathBuf>,
}

impl EngineArgs {
    /// The broker's settings, if one is named.
    pub(crate) fn config(&self) -> Option<NatsConfig> {
        let url = self.engine.clone()?;
        let certificate = self.engine_certificate.clone().zip(self.engine_key.clone());
        Some(NatsConfig {
            name: self.engine_name.clone(),
            queue: self.engine_queue as usize,
            insecure: self.insecure_engine,
            tls: BrokerTls { roots: self.engine_roots.clone(), certificate },
            ..NatsConfig::new(url)
        })
    }

    /// The broker, if one is named.
    ///
    /// # Errors
    /// When it cannot be reached or is not set up for this.
    pub(crate) async fn connect(&self, kind: Node) -> anyhow::Result<Option<Broker>> {
        match self.config() {
            None => Ok(None),
            Some(config) => Ok(Some(Broker::connect(&config, kind).await.context("--engine")?)),
        }
    }
}
