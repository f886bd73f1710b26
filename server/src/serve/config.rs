//! How a server is set up.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use graspd_live::LiveConfig;

use crate::calibration::Calibration;
use crate::estimators::Estimators;
use crate::jobs::JobEngine;
use crate::page::Page;
use crate::pool::PoolConfig;
use crate::recorder::RecordConfig;
use crate::registry::HandStore;
use crate::security::{Access, Limits, Tls};

/// How a server is set up.
#[derive(Debug, Clone)]
pub struct ServerConfig {
    /// Address to listen on; port 0 takes a free one. Default `127.0.0.1:50051`.
    pub listen: SocketAddr,
    /// Allows an address that other machines can reach, without encryption. Default false.
    pub insecure_listen: bool,
    /// Largest message that is taken, bytes. Default 16 MiB.
    pub max_message_bytes: usize,
    /// Certificates. Default none: connections are not encrypted.
    pub tls: Option<Tls>,
    /// Who may call. Default: whoever can connect.
    pub access: Access,
    /// How much there may be of everything.
    pub limits: Limits,
    /// Address of `/metrics`, `/livez` and `/readyz`, over HTTP without encryption. Default none.
    pub metrics_listen: Option<SocketAddr>,
    /// The page for browsers, at `/` of `listen`. Default none.
    pub page: Option<Page>,
    /// The planning pool. Default: by the number of cores.
    pub pool: PoolConfig,
    /// A folder of hands to offer besides the library. Default none.
    pub hands_dir: Option<PathBuf>,
    /// The contact estimators. Default: the geometric rule.
    pub estimators: Estimators,
    /// Address of an OpenTelemetry collector (OTLP over gRPC), for example `http://127.0.0.1:4317`. Default none.
    pub otlp: Option<String>,
    /// What is recorded. Default: nothing.
    pub record: Option<RecordConfig>,
    /// The live view for Foxglove and its like. Default: none.
    pub live: Option<LiveConfig>,
    /// What scores become on their way out. Default: they stay as the planner makes them.
    pub calibration: Option<Calibration>,
    /// Who plans. Default: this process.
    pub engine: Option<Arc<dyn JobEngine>>,
    /// Where hands that are created are kept, for other servers and workers too. Default: in this process.
    pub hand_store: Option<Arc<dyn HandStore>>,
    /// How long running calls may take to finish once the server is asked to end. Default 10 s.
    pub drain_grace: Duration,
}

impl Default for ServerConfig {
    fn default() -> Self {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 50051)),
            insecure_listen: false,
            max_message_bytes: 16 << 20,
            tls: None,
            access: Access::default(),
            limits: Limits::default(),
            metrics_listen: None,
            page: None,
            pool: PoolConfig::for_cores(cores),
            hands_dir: None,
            estimators: Estimators::default(),
            otlp: None,
            record: None,
            live: None,
            calibration: None,
            engine: None,
            hand_store: None,
            drain_grace: Duration::from_secs(10),
        }
    }
}

impl ServerConfig {
    /// True if callers must say who they are.
    pub(super) fn access_required(&self) -> bool {
        let certificates = self.tls.as_ref().is_some_and(|tls| tls.client_roots.is_some());
        !self.access.tokens.is_empty() || certificates
    }
}
