//! What every call passes first: who calls and whether they may, quotas, its clock, the answer to an expired
//! deadline, refusal while draining, a log line, and our own words where the transport would use its own.

use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll};
use std::time::Duration;

use tonic::body::Body;
use tonic::codegen::Service;
use tonic::codegen::http::{Request, Response};
use tonic::{Code, Status};
use tonic_types::StatusExt as _;
use tower::Layer;
use tracing::Instrument as _;

use crate::convert::shortened;
use crate::deadline::CallClock;
use crate::error::ServiceError;
use crate::metrics::Metrics;
use crate::security::{
    Access, Credentials, Ending, GuardedBody, Identity, PeerInfo, Quotas, ReceivedBody, Role, Use,
};
use crate::status;
use crate::trace::Tracer;

/// Our own services start with this.
const OWN_PATHS: &str = "/graspd.";
/// Whoever watches over servers needs no token.
const HEALTH_PATHS: &str = "/grpc.health.v1.Health/";
/// The method whose requests are a stream without an end of their own.
const SERVO: &str = "/graspd.v1.ServoService/ServoGrasp";
/// The method that counts as an upload.
const UPLOAD: &str = "/graspd.v1.HandService/CreateHand";

/// What every call is checked against.
#[derive(Debug)]
pub(crate) struct Gatekeeper {
    /// Set while the server drains.
    pub(crate) draining: Arc<AtomicBool>,
    pub(crate) access: Access,
    /// Callers must say who they are.
    pub(crate) access_required: bool,
    pub(crate) quotas: Arc<Quotas>,
    /// Time for a request to arrive.
    pub(crate) receive: Duration,
    pub(crate) metrics: Arc<Metrics>,
    pub(crate) tracer: Tracer,
}

/// A call in the metrics and in its trace, from its headers to the end of its answer.
struct Counted {
    metrics: Arc<Metrics>,
    tracer: Tracer,
    path: String,
    clock: CallClock,
    /// Nothing said yet means that the caller is gone.
    code: Code,
    /// Its caller's quota is held as long.
    used_quota: Option<Arc<Use>>,
}

impl Counted {
    fn begin(gatekeeper: &Gatekeeper, path: &str, clock: CallClock) -> Self {
        gatekeeper.metrics.begin();
        let (metrics, tracer) = (Arc::clone(&gatekeeper.metrics), gatekeeper.tracer.clone());
        Self { metrics, tracer, path: path.to_owned(), clock, code: Code::Cancelled, used_quota: None }
    }

    /// What the headers of the answer say, where they say something.
    fn answered(&mut self, response: &Response<Body>) {
        let Some(status) = Status::from_header_map(response.headers()) else { return };
        self.code = status.code();
        if let (Code::ResourceExhausted, Some(info)) = (status.code(), status.get_details_error_info()) {
            let reasons =
                ["QUEUE_FULL", "CANNOT_FINISH", "SHED", "QUOTA", "MESSAGE_TOO_LARGE", "TOO_MANY_HANDS"];
            let known = reasons.into_iter().find(|reason| *reason == info.reason);
            self.metrics.refuse(known.unwrap_or("other"));
        }
    }
}

impl Ending for Counted {
    fn ends_with(&mut self, code: Code) {
        self.code = code;
    }
}

impl Drop for Counted {
    fn drop(&mut self) {
        self.metrics.end(&self.path, self.code, self.clock.elapsed());
        self.tracer.call(&self.clock.trace, &self.path, self.clock.arrived, self.code);
    }
}

impl Gatekeeper {
    /// Who calls, if they said so where they have to.
    pub(crate) fn identify(&self, request: &Request<Body>) -> Result<Identity, ServiceError> {
        let peer = request.extensions().get::<PeerInfo>();
        let credentials = Credentials {
            peer: peer.map(|p| p.addr),
            certificate: peer.and_then(|p| p.certificate),
            authorization: request.headers().get("authorization").map(|value| value.as_bytes()),
        };
        self.access.identify(&credentials, self.access_required)
    }

    /// Who calls, if they may call this method, and their part of their quotas.
    fn admit(&self, request: &Request<Body>, path: &str) -> Result<(Identity, Use), ServiceError> {
        let identity = self.identify(request)?;
        let needs = Role::of_method(path);
        if identity.role < needs {
            return Err(ServiceError::Forbidden {
                what: shortened(path),
                needs: needs.name(),
                caller: identity.caller.name.to_string(),
                has: identity.role.name(),
            });
        }
        let used = self.quotas.call(&identity.caller.name, path == UPLOAD)?;
        Ok((identity, used))
    }
}

/// Makes [`CallService`]s.
#[derive(Debug, Clone)]
pub(crate) struct CallLayer(pub(crate) Arc<Gatekeeper>);

impl<S> Layer<S> for CallLayer {
    type Service = CallService<S>;

    fn layer(&self, inner: S) -> Self::Service {
        CallService { inner, gatekeeper: Arc::clone(&self.0) }
    }
}

/// A service behind the layer.
#[derive(Debug, Clone)]
pub(crate) struct CallService<S> {
    inner: S,
    gatekeeper: Arc<Gatekeeper>,
}

type BoxFuture<T> = Pin<Box<dyn Future<Output = T> + Send>>;

impl<S> Service<Request<Body>> for CallService<S>
where
    S: Service<Request<Body>, Response = Response<Body>>,
    S::Future: Send + 'static,
    S::Error: Send + 'static,
{
    type Response = Response<Body>;
    type Error = S::Error;
    type Future = BoxFuture<Result<Response<Body>, S::Error>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.inner.poll_ready(context)
    }

    fn call(&mut self, mut request: Request<Body>) -> Self::Future {
        let path = request.uri().path().to_owned();
        if path.starts_with(HEALTH_PATHS) {
            let answer = self.inner.call(request);
            return Box::pin(async move { Ok(in_our_words(answer.await?, &path)) });
        }
        let clock = CallClock::start(request.headers());
        let span = tracing::info_span!(
            "call",
            method = %path,
            trace_id = %clock.trace.id_text(),
            request_id = tracing::field::Empty
        );
        let mut counted = Counted::begin(&self.gatekeeper, &path, clock);
        let mut refuse = |error: ServiceError| -> Self::Future {
            let refused = Status::from(error).into_http();
            span.in_scope(|| log(&refused, &clock));
            counted.answered(&refused);
            Box::pin(async move { Ok(refused) })
        };
        let (identity, used) = match self.gatekeeper.admit(&request, &path) {
            Ok(admitted) => admitted,
            Err(error) => return refuse(error),
        };
        if path.starts_with(OWN_PATHS) && self.gatekeeper.draining.load(Ordering::Relaxed) {
            return refuse(ServiceError::Draining);
        }
        let used = Arc::new(used);
        counted.used_quota = Some(Arc::clone(&used));
        let receive = self.gatekeeper.receive;
        request.extensions_mut().insert(clock);
        request.extensions_mut().insert(identity.caller);
        let request = request.map(|body| {
            let received = if path == SERVO { ReceivedBody::stream } else { ReceivedBody::new };
            Body::new(received(body, used, receive))
        });
        let answer = self.inner.call(request);
        Box::pin(
            async move {
                let response = match clock.answer_deadline() {
                    None => answer.await?,
                    Some(deadline) => match tokio::time::timeout_at(deadline.into(), answer).await {
                        Ok(response) => response?,
                        Err(_) => {
                            let stage = "with nothing to answer";
                            Status::from(ServiceError::Deadline { elapsed: clock.elapsed(), stage })
                                .into_http()
                        }
                    },
                };
                let response = in_our_words(response, &path);
                log(&response, &clock);
                counted.answered(&response);
                // A stream holds its caller's quota until its end.
                Ok(response.map(|inner| Body::new(GuardedBody { inner, guard: counted })))
            }
            .instrument(span),
        )
    }
}

/// Replaces what tonic itself refuses (too large, not protobuf, no such method) by an error with details.
fn in_our_words(response: Response<Body>, path: &str) -> Response<Body> {
    let status = Status::from_header_map(response.headers());
    let error = status.and_then(|s| status::from_transport(&s).or_else(|| status::unknown_method(&s, path)));
    error.map_or(response, |error| Status::from(error).into_http())
}

/// One line for each call. A stream has no code yet when its answer begins.
fn log(response: &Response<Body>, clock: &CallClock) {
    let elapsed_ms = clock.elapsed().as_secs_f64() * 1e3;
    match Status::from_header_map(response.headers()) {
        Some(status) if status.code() != Code::Ok => {
            tracing::info!(code = ?status.code(), elapsed_ms, message = status.message(), "call refused");
        }
        _ => tracing::info!(elapsed_ms, "call answered"),
    }
}
