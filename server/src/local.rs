//! The engine of this process: what it is made of, and the same as an engine of jobs, for workers.

use std::future::Future;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use bytes::Bytes;
use graspd_live::Live;
use graspd_proto::v1;
use graspd_proto::v1::planner_service_server::PlannerService as _;
use prost::Message;
use tokio::net::TcpListener;
use tokio_stream::{Stream, StreamExt as _};
use tonic::{Request, Status};

use crate::caller::Caller;
use crate::deadline::CallClock;
use crate::engine::Engine;
use crate::error::ServiceError;
use crate::health::Health;
use crate::jobs::{Job, JobEngine, JobError, JobKind, Replies};
use crate::metrics::Metrics;
use crate::outgoing::Outgoing;
use crate::pool::Pool;
use crate::recorder::Recorder;
use crate::registry::{FolderError, HandSync, Registry};
use crate::scenes::Scenes;
use crate::serve::{AbortOnDrop, ServeError, ServerConfig};
use crate::service::PlannerApi;
use crate::trace::{TraceContext, Tracer};

/// What viewers call this server.
const LIVE_NAME: &str = concat!("graspd ", env!("CARGO_PKG_VERSION"));

/// Loads the hands and starts the planning threads.
pub(crate) async fn start_engine(config: &ServerConfig) -> Result<Arc<Engine>, ServeError> {
    // An address that is refused is refused before anything is read.
    let live = match &config.live {
        None => None,
        Some(live) => Some(Live::start(live.clone(), LIVE_NAME).await?),
    };
    let hands_dir = config.hands_dir.clone();
    let registry = tokio::task::spawn_blocking(move || -> Result<Registry, FolderError> {
        let registry = Registry::with_library();
        if let Some(path) = hands_dir {
            let count = registry.add_folder(&path)?;
            tracing::info!(path = %path.display(), count, "hands read from folder");
        }
        Ok(registry)
    })
    .await
    .map_err(|e| ServeError::Loading(e.to_string()))??;
    let metrics: Arc<Metrics> = Arc::default();
    let record = config.record.clone().map(|record| (record, Arc::clone(&metrics)));
    let recorder = tokio::task::spawn_blocking(move || {
        record.map(|(record, metrics)| Recorder::start(&record, metrics)).transpose()
    })
    .await
    .map_err(|e| ServeError::Loading(e.to_string()))??;
    let engine = Arc::new(Engine {
        pool: Pool::start(config.pool)?,
        registry,
        estimators: config.estimators.clone(),
        aborted: Arc::default(),
        overrun: Arc::default(),
        estimates: Arc::default(),
        metrics,
        scenes: Scenes::default(),
        answers: Arc::default(),
        recorder,
        live,
        calibration: config.calibration.clone().map(Arc::new),
        health: Health::default(),
        tracer: Tracer::start(config.otlp.as_deref())?,
        elsewhere: config.engine.clone(),
        outgoing: Outgoing::new(config.pool.queue, config.pool.plain_fifo),
        hand_store: config.hand_store.clone(),
    });
    if let Some(presence) = engine.presence() {
        engine.heed(&presence);
    }
    // Nobody is answered before planning has worked once; where it does not, that is told from the beginning.
    engine.warm_up().await;
    Ok(engine)
}

/// Plans jobs on this machine's cores, by the rules of the server: the same code answers a server's own calls.
#[derive(Debug)]
pub struct LocalEngine {
    planner: PlannerApi,
    /// Taken by whoever serves it.
    http: Mutex<Option<TcpListener>>,
}

impl LocalEngine {
    /// Loads the hands and starts the planning threads. Of the configuration, what is about listening for calls,
    /// callers and other engines does not count.
    ///
    /// # Errors
    /// [`ServeError`] when the folder of hands is not in order, the address of metrics is taken or there are no threads.
    pub async fn start(config: &ServerConfig) -> Result<Self, ServeError> {
        let config = ServerConfig { engine: None, hand_store: None, live: None, ..config.clone() };
        let engine = start_engine(&config).await?;
        let http = match config.metrics_listen {
            None => None,
            Some(addr) => {
                Some(TcpListener::bind(addr).await.map_err(|source| ServeError::Bind { addr, source })?)
            }
        };
        Ok(Self { planner: PlannerApi { engine }, http: Mutex::new(http) })
    }

    /// Serves `/metrics`, `/livez` and `/readyz` where the configuration named an address, for as long as `work` goes
    /// on; then it takes no more jobs. The jobs themselves come through [`JobEngine::submit`].
    pub async fn run_while(&self, work: impl Future<Output = ()>) {
        let engine = &self.planner.engine;
        let http = self.http.lock().unwrap_or_else(PoisonError::into_inner).take();
        let watched = http.map(|listener| tokio::spawn(crate::http::serve(listener, Arc::clone(engine))));
        let _watched = AbortOnDrop(watched);
        let cold = (!engine.health.is_warm()).then(|| Arc::clone(engine));
        let _warming =
            AbortOnDrop(cold.map(|engine| tokio::spawn(async move { engine.warm_up_in_the_end().await })));
        work.await;
        engine.health.draining().store(true, Ordering::Relaxed);
        engine.aborted.store(true, Ordering::Relaxed);
        engine.pool.close();
        engine.tracer.close().await;
    }

    /// What a store of hands tells of hands that come and go.
    pub fn hands(&self) -> HandSync {
        HandSync::new(Arc::clone(&self.planner.engine))
    }

    /// True once it has planned.
    pub fn is_ready(&self) -> bool {
        self.planner.engine.health.is_ready()
    }
}

/// A call as the service's layer would hand it on.
fn call<T: Message + Default>(job: &Job, clock: CallClock) -> Result<Request<T>, JobError> {
    let message = T::decode(job.request.clone()).map_err(|e| {
        JobError::Refused(Status::from(ServiceError::MalformedMessage { problem: e.to_string() }))
    })?;
    let mut request = Request::new(message);
    let trace = TraceContext::of_text(Some(job.traceparent.as_str()).filter(|text| !text.is_empty()));
    request.extensions_mut().insert(CallClock { trace, ..clock });
    request.extensions_mut().insert(Caller::named(&job.caller));
    Ok(request)
}

/// Encoded messages of a stream.
fn encoded<T: Message + 'static>(stream: impl Stream<Item = Result<T, Status>> + Send + 'static) -> Replies {
    Box::pin(stream.map(|item| item.map(|message| encode(&message)).map_err(JobError::Refused)))
}

fn encode(message: &impl Message) -> Bytes {
    message.encode_to_vec().into()
}

#[tonic::async_trait]
impl JobEngine for LocalEngine {
    async fn submit(&self, job: Job) -> Result<Replies, JobError> {
        let planner = &self.planner;
        let now = Instant::now();
        // Budgets count from where the call arrived, wherever that was.
        let arrived = now.checked_sub(job.age).unwrap_or(now);
        let clock = CallClock { arrived, timeout: job.timeout, trace: TraceContext::default() };
        let begin = async {
            Ok(match job.kind {
                JobKind::PlanGrasps => {
                    let answer = planner.plan_grasps(call::<v1::PlanGraspsRequest>(&job, clock)?).await;
                    let answer = answer.map_err(JobError::Refused)?.into_inner();
                    Box::pin(tokio_stream::once(Ok(encode(&answer)))) as Replies
                }
                JobKind::StreamGrasps => {
                    let answer = planner.stream_grasps(call::<v1::StreamGraspsRequest>(&job, clock)?).await;
                    encoded(answer.map_err(JobError::Refused)?.into_inner())
                }
                JobKind::PlanMultiHand => {
                    let answer =
                        planner.plan_multi_hand(call::<v1::PlanMultiHandRequest>(&job, clock)?).await;
                    encoded(answer.map_err(JobError::Refused)?.into_inner())
                }
            })
        };
        match clock.answer_deadline() {
            None => begin.await,
            // What the service's layer does for a call of its own; streams keep their time themselves.
            Some(deadline) => tokio::time::timeout_at(deadline.into(), begin).await.unwrap_or_else(|_| {
                let stage = "with nothing to answer";
                let late = ServiceError::Deadline { elapsed: clock.elapsed(), stage };
                Err(JobError::Refused(Status::from(late)))
            }),
        }
    }
}
