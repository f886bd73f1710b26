//! A server in this process on a free port.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use graspd_client::{Client, ClientConfig, RetryPolicy};
use graspd_planner::estimator::Geometric;
use graspd_server::pool::PoolConfig;
use graspd_server::{Estimators, LoadProbe, ServeError, Server, ServerConfig};
use tokio::sync::oneshot;
use tokio::task::JoinHandle;

use crate::estimators::{Panics, Stalls};

/// A running server; it ends with its test's runtime, or by [`TestServer::stop`].
#[derive(Debug)]
pub struct TestServer {
    /// Where it listens.
    pub addr: SocketAddr,
    /// What its planning pool is doing.
    pub load: LoadProbe,
    /// Where its metrics are.
    pub metrics: Option<SocketAddr>,
    /// Where its live view is.
    pub live: Option<SocketAddr>,
    stop: oneshot::Sender<()>,
    ended: JoinHandle<Result<(), ServeError>>,
}

impl TestServer {
    /// The configuration of test servers: a free port, two slots, a queue of four, and the estimators that
    /// misbehave beside the default one.
    pub fn config() -> ServerConfig {
        ServerConfig {
            listen: SocketAddr::from(([127, 0, 0, 1], 0)),
            pool: PoolConfig {
                threads: 2,
                slots: 2,
                servo_slots: 1,
                queue: 4,
                scene_room: 3,
                nice: 0,
                plain_fifo: false,
            },
            estimators: Estimators::new(Arc::new(Geometric), vec![Arc::new(Panics), Arc::new(Stalls)]),
            ..ServerConfig::default()
        }
    }

    /// Starts a server with the test configuration.
    pub async fn start() -> Self {
        Self::start_with(Self::config()).await
    }

    /// Starts a server.
    ///
    /// # Panics
    /// If it does not start.
    pub async fn start_with(config: ServerConfig) -> Self {
        let server = match Server::bind(config).await {
            Ok(server) => server,
            Err(error) => panic!("{error}"),
        };
        let (addr, load, metrics) = (server.local_addr(), server.load(), server.metrics_addr());
        let live = server.live_addr();
        let (stop, stopped) = oneshot::channel();
        let ended = tokio::spawn(server.serve_until(async {
            stopped.await.ok();
        }));
        Self { addr, load, metrics, live, stop, ended }
    }

    /// Address for clients.
    pub fn endpoint(&self) -> String {
        format!("http://{}", self.addr)
    }

    /// A client that never repeats, with a deadline long enough for a slow machine.
    ///
    /// # Panics
    /// If it does not connect.
    pub async fn client(&self) -> Client {
        let config = ClientConfig {
            call_timeout: Duration::from_secs(60),
            retry: RetryPolicy::NONE,
            ..ClientConfig::new(self.endpoint())
        };
        match Client::connect(config).await {
            Ok(client) => client,
            Err(error) => panic!("{error}"),
        }
    }

    /// Waits until nothing runs or waits in the planning pool; how long that took.
    ///
    /// # Panics
    /// If it takes more than `limit`.
    pub async fn idle_within(&self, limit: Duration) -> Duration {
        let began = std::time::Instant::now();
        while self.load.running() + self.load.waiting() > 0 {
            assert!(began.elapsed() < limit, "still busy after {limit:?}: {:?}", self.load);
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        began.elapsed()
    }

    /// Waits until a job runs.
    ///
    /// # Panics
    /// If none does within thirty seconds.
    pub async fn busy(&self) {
        let began = std::time::Instant::now();
        while self.load.running() == 0 {
            assert!(began.elapsed() < Duration::from_secs(30), "no job began");
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }

    /// Asks the server to end; what [`Server::serve_until`] returns comes from the handle.
    pub fn stop(self) -> JoinHandle<Result<(), ServeError>> {
        // Whoever waits for the handle sees it if the server has ended before.
        self.stop.send(()).ok();
        self.ended
    }
}
