//! What every call passes first: its clock, the answer to an expired deadline, refusal while draining, a
//! log line, and our own words where the transport would use its own.

use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll};

use tonic::Status;
use tonic::body::Body;
use tonic::codegen::Service;
use tonic::codegen::http::{Request, Response};
use tonic::transport::server::TcpConnectInfo;
use tower::Layer;
use tracing::Instrument as _;

use crate::caller::Caller;
use crate::deadline::CallClock;
use crate::error::ServiceError;
use crate::status;

/// Our own services start with this; health and reflection are left alone.
const OWN_PATHS: &str = "/graspd.";

/// Makes [`CallService`]s.
#[derive(Debug, Clone)]
pub(crate) struct CallLayer {
    /// Set while the server drains.
    pub(crate) draining: Arc<AtomicBool>,
}

impl<S> Layer<S> for CallLayer {
    type Service = CallService<S>;

    fn layer(&self, inner: S) -> Self::Service {
        CallService { inner, draining: Arc::clone(&self.draining) }
    }
}

/// A service behind the layer.
#[derive(Debug, Clone)]
pub(crate) struct CallService<S> {
    inner: S,
    draining: Arc<AtomicBool>,
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
        if !path.starts_with(OWN_PATHS) {
            let answer = self.inner.call(request);
            return Box::pin(async move { Ok(in_our_words(answer.await?, &path)) });
        }
        if self.draining.load(Ordering::Relaxed) {
            let refused = Status::from(ServiceError::Draining).into_http();
            return Box::pin(async move { Ok(refused) });
        }
        let clock = CallClock::start(request.headers());
        let span = tracing::info_span!("call", method = %path);
        request.extensions_mut().insert(clock);
        let peer = request.extensions().get::<TcpConnectInfo>().and_then(TcpConnectInfo::remote_addr);
        request.extensions_mut().insert(Caller::anonymous(peer));
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
                Ok(response)
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
        Some(status) if status.code() != tonic::Code::Ok => {
            tracing::info!(code = ?status.code(), elapsed_ms, message = status.message(), "call refused");
        }
        _ => tracing::info!(elapsed_ms, "call answered"),
    }
}
