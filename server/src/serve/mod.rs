//! The server as a whole: what it listens on, what it offers, and how it ends.

mod config;
mod error;

use std::future::Future;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use graspd_proto::v1::hand_service_server::HandServiceServer;
use graspd_proto::v1::info_service_server::InfoServiceServer;
use graspd_proto::v1::planner_service_server::PlannerServiceServer;
use graspd_proto::v1::servo_service_server::ServoServiceServer;
use tokio::net::TcpListener;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tonic_health::pb::health_server::HealthServer;
use tonic_health::server::HealthService;

pub use self::config::ServerConfig;
pub use self::error::ServeError;
use crate::engine::Engine;
use crate::local::start_engine;
use crate::page::{PageLayer, Site};
use crate::recorder::Recorder;
use crate::registry::HandSync;
use crate::security::{Acceptor, Quotas, accept};
use crate::service::{CallLayer, Gatekeeper, HandApi, InfoApi, PlannerApi, ServoApi};

/// HTTP/2 window of a stream: a whole depth frame, so that it is not throttled by round trips.
const STREAM_WINDOW_BYTES: u32 = 8 << 20;
/// HTTP/2 window of a connection.
const CONNECTION_WINDOW_BYTES: u32 = 32 << 20;
/// Concurrent calls on one connection.
const STREAMS_PER_CONNECTION: u32 = 64;
/// A silent connection is asked this often whether anybody is there.
const KEEPALIVE_INTERVAL: Duration = Duration::from_secs(30);
/// A connection that does not answer for so long is closed, and its calls are cancelled.
const KEEPALIVE_TIMEOUT: Duration = Duration::from_secs(20);
/// After the grace period, running calls have this long to notice that they were cancelled.
const ABORT_GRACE: Duration = Duration::from_millis(500);
/// The recording has this long to write what was answered.
const RECORD_GRACE: Duration = Duration::from_secs(10);

/// A server that is bound and not yet serving.
#[derive(Debug)]
pub struct Server {
    listener: TcpListener,
    local_addr: SocketAddr,
    engine: Arc<Engine>,
    acceptor: Option<Acceptor>,
    /// Metrics and readiness.
    http: Option<TcpListener>,
    config: ServerConfig,
}

/// What the planning pool is doing right now.
#[derive(Debug, Clone)]
pub struct LoadProbe {
    engine: Arc<Engine>,
}

impl LoadProbe {
    /// Jobs that run.
    pub fn running(&self) -> usize {
        self.engine.pool.running()
    }

    /// Jobs that wait.
    pub fn waiting(&self) -> usize {
        self.engine.pool.waiting()
    }

    /// The longest that a job has run on after its call was dropped.
    pub fn slowest_release(&self) -> Duration {
        self.engine.pool.slowest_release()
    }

    /// Scenes that were read, each for one call or for several that brought the same frames.
    pub fn scenes_read(&self) -> u64 {
        self.engine.scenes.read_count()
    }
}

impl Server {
    /// Loads the hands, starts the planning threads and binds the address.
    ///
    /// # Errors
    /// [`ServeError`] when the address is refused or taken, or the folder of hands is not in order.
    pub async fn bind(config: ServerConfig) -> Result<Self, ServeError> {
        let addr = config.listen;
        config.access.check()?;
        if !addr.ip().is_loopback() && !config.insecure_listen {
            if config.tls.is_none() {
                return Err(ServeError::NotLoopback { addr });
            }
            if !config.access_required() {
                return Err(ServeError::Anybody { addr });
            }
        }
        let acceptor = config.tls.clone().map(Acceptor::new).transpose()?;
        let engine = start_engine(&config).await?;
        let fault = |source| ServeError::Bind { addr, source };
        let listener = TcpListener::bind(addr).await.map_err(fault)?;
        let local_addr = listener.local_addr().map_err(fault)?;
        let http = match config.metrics_listen {
            None => None,
            Some(addr) => {
                Some(TcpListener::bind(addr).await.map_err(|source| ServeError::Bind { addr, source })?)
            }
        };
        Ok(Self { listener, local_addr, engine, acceptor, http, config })
    }

    /// The address that the server listens on, with its real port.
    pub fn local_addr(&self) -> SocketAddr {
        self.local_addr
    }

    /// The address of metrics and readiness, if there is one, with its real port.
    pub fn metrics_addr(&self) -> Option<SocketAddr> {
        self.http.as_ref().and_then(|listener| listener.local_addr().ok())
    }

    /// The address of the live view, if there is one, with its real port.
    pub fn live_addr(&self) -> Option<SocketAddr> {
        self.engine.live.as_ref().map(graspd_live::Live::local_addr)
    }

    /// What a store of hands tells of hands that come and go.
    pub fn hands(&self) -> HandSync {
        HandSync::new(Arc::clone(&self.engine))
    }

    /// A view of the planning pool that outlives the server's own handle.
    pub fn load(&self) -> LoadProbe {
        LoadProbe { engine: Arc::clone(&self.engine) }
    }

    /// Serves until `shutdown` is ready, then drains: health says NOT_SERVING, new calls are refused with
    /// UNAVAILABLE, running calls have the grace period to finish.
    ///
    /// # Errors
    /// [`ServeError`] when the transport fails.
    pub async fn serve_until(self, shutdown: impl Future<Output = ()> + Send) -> Result<(), ServeError> {
        let engine = Arc::clone(&self.engine);
        let ended = self.serve(shutdown).await;
        engine.tracer.close().await;
        if let Some(live) = &engine.live {
            live.close().await;
        }
        // What was answered is written before the process ends.
        let written = tokio::task::spawn_blocking(move || engine.recorder.as_ref().map(Recorder::close));
        if tokio::time::timeout(RECORD_GRACE, written).await.is_err() {
            tracing::error!("the recording is not written to its end");
        }
        ended
    }

    async fn serve(self, shutdown: impl Future<Output = ()> + Send) -> Result<(), ServeError> {
        let Self { listener, local_addr, engine, acceptor, http, config } = self;
        let draining = Arc::clone(engine.health.draining());
        let planner = PlannerServiceServer::new(PlannerApi { engine: Arc::clone(&engine) })
            .max_decoding_message_size(config.max_message_bytes);
        let hands = HandServiceServer::new(HandApi { engine: Arc::clone(&engine) })
            .max_decoding_message_size(config.max_message_bytes);
        let servo = ServoServiceServer::new(ServoApi::new(Arc::clone(&engine), &config.limits))
            .max_decoding_message_size(config.max_message_bytes);
        let info = InfoServiceServer::new(InfoApi {
            engine: Arc::clone(&engine),
            max_message_bytes: config.max_message_bytes,
        });
        engine.health.tell(engine.registry.ids()).await;
        let health_service =
            HealthServer::new(HealthService::from_health_reporter(engine.health.reporter().clone()));
        let watching_elsewhere = Arc::clone(&engine);
        let _elsewhere =
            AbortOnDrop(Some(tokio::spawn(async move { watching_elsewhere.watch_elsewhere().await })));
        let cold = (!engine.health.is_warm()).then(|| Arc::clone(&engine));
        let warming = cold.map(|engine| tokio::spawn(async move { engine.warm_up_in_the_end().await }));
        let _warming = AbortOnDrop(warming);
        let described = || {
            tonic_reflection::server::Builder::configure()
                .register_encoded_file_descriptor_set(graspd_proto::FILE_DESCRIPTOR_SET)
                .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
        };
        let gatekeeper = Arc::new(Gatekeeper {
            draining: Arc::clone(&draining),
            access: config.access.clone(),
            access_required: config.access_required(),
            quotas: Arc::new(Quotas::new(config.limits)),
            receive: config.limits.receive,
            metrics: Arc::clone(&engine.metrics),
            tracer: engine.tracer.clone(),
        });
        let site = config.page.map(|page| Site {
            page,
            engine: Arc::clone(&engine),
            gatekeeper: Arc::clone(&gatekeeper),
            is_encrypted: acceptor.is_some(),
            header_bytes: config.limits.header_bytes,
        });
        let has_page = site.is_some();
        let watched = http.map(|listener| tokio::spawn(crate::http::serve(listener, Arc::clone(&engine))));
        let _watched = AbortOnDrop(watched);
        let router = tonic::transport::Server::builder()
            .initial_stream_window_size(STREAM_WINDOW_BYTES)
            .initial_connection_window_size(CONNECTION_WINDOW_BYTES)
            .max_concurrent_streams(STREAMS_PER_CONNECTION)
            .http2_keepalive_interval(Some(KEEPALIVE_INTERVAL))
            .http2_keepalive_timeout(Some(KEEPALIVE_TIMEOUT))
            .http2_max_header_list_size(Some(config.limits.header_bytes))
            .http2_max_pending_accept_reset_streams(Some(STREAMS_PER_CONNECTION as usize))
            // Browsers speak HTTP/1 where there is no TLS.
            .accept_http1(has_page)
            .layer(PageLayer(site.map(Arc::new)))
            .layer(CallLayer(gatekeeper))
            .add_service(health_service)
            .add_service(described().build_v1()?)
            // What tools of yesterday ask for.
            .add_service(described().build_v1alpha()?)
            .add_service(planner)
            .add_service(servo)
            .add_service(hands)
            .add_service(info);
        let is_encrypted = acceptor.is_some();
        let watching = acceptor.clone().map(|acceptor| tokio::spawn(acceptor.watch()));
        let _watching = AbortOnDrop(watching);
        let incoming = accept(listener, acceptor, config.limits);
        let (stop, stopped) = oneshot::channel::<()>();
        let serving = router.serve_with_incoming_shutdown(incoming, async {
            stopped.await.ok();
        });
        tokio::pin!(serving);
        if has_page {
            let scheme = if is_encrypted { "https" } else { "http" };
            tracing::info!("the page is at {scheme}://{local_addr}/");
        }
        tracing::info!(%local_addr, hands = engine.registry.page(None, usize::MAX).0.len(), "serving");
        tokio::select! {
            ended = &mut serving => return Ok(ended?),
            () = shutdown => {}
        }
        tracing::info!(grace_s = config.drain_grace.as_secs_f64(), "draining");
        draining.store(true, Ordering::Relaxed);
        engine.health.tell(engine.registry.ids()).await;
        // The receiver lives in `serving`, which has not ended.
        stop.send(()).ok();
        if let Ok(ended) = tokio::time::timeout(config.drain_grace, &mut serving).await {
            tracing::info!("drained");
            return Ok(ended?);
        }
        tracing::warn!("calls are still running after the grace period and are cancelled");
        engine.aborted.store(true, Ordering::Relaxed);
        engine.pool.close();
        match tokio::time::timeout(ABORT_GRACE, &mut serving).await {
            Ok(ended) => Ok(ended?),
            Err(_) => Ok(()),
        }
    }
}

/// Ends a task with the server.
pub(crate) struct AbortOnDrop(pub(crate) Option<JoinHandle<()>>);

impl Drop for AbortOnDrop {
    fn drop(&mut self) {
        if let Some(task) = &self.0 {
            task.abort();
        }
    }
}

/// Ready when the process is asked to end: SIGTERM, or an interrupt from the keyboard.
///
/// # Errors
/// When the system refuses to report signals.
pub async fn shutdown_signal() -> io::Result<()> {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};

        let mut terminate = signal(SignalKind::terminate())?;
        tokio::select! {
            interrupted = tokio::signal::ctrl_c() => interrupted,
            _ = terminate.recv() => Ok(()),
        }
    }
    #[cfg(not(unix))]
    {
        tokio::signal::ctrl_c().await
    }
}
