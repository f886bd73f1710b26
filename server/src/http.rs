//! The HTTP side for those who watch over servers: `/metrics`, `/livez`, `/readyz`. No calls, no secrets.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use hyper::body::Incoming;
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::net::TcpListener;
use tokio::sync::Semaphore;
use tonic::body::Body;

use crate::engine::Engine;

/// Connections at the same time.
const CONNECTIONS: usize = 32;
/// Time for the headers of a request, and for a connection as a whole.
const PATIENCE: (Duration, Duration) = (Duration::from_secs(5), Duration::from_secs(60));

/// Answers until the task is aborted.
pub(crate) async fn serve(listener: TcpListener, engine: Arc<Engine>) {
    let places = Arc::new(Semaphore::new(CONNECTIONS));
    loop {
        let Ok(place) = Arc::clone(&places).acquire_owned().await else { return };
        let Ok((stream, _)) = listener.accept().await else {
            tokio::time::sleep(Duration::from_millis(50)).await;
            continue;
        };
        let engine = Arc::clone(&engine);
        tokio::spawn(async move {
            let service = service_fn(move |request: Request<Incoming>| {
                let response = answer(&request, &engine);
                async move { Ok::<_, Infallible>(response) }
            });
            let connection = hyper::server::conn::http1::Builder::new()
                .timer(TokioTimer::new())
                .header_read_timeout(PATIENCE.0)
                .serve_connection(TokioIo::new(stream), service);
            // However it ends, the next one is another connection.
            tokio::time::timeout(PATIENCE.1, connection).await.ok();
            drop(place);
        });
    }
}

/// The content type of [`metrics`].
pub(crate) const METRICS_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// Everything that is counted and timed, in the OpenMetrics format.
pub(crate) fn metrics(engine: &Engine) -> String {
    if let Some(presence) = engine.presence() {
        engine.metrics.elsewhere(&presence, engine.outgoing.waiting_by_priority());
    }
    let live = engine.live.as_ref().map(graspd_live::Live::counts);
    engine.metrics.encode(&engine.pool, engine.scenes.read_count(), engine.health.is_ready(), live)
}

fn answer(request: &Request<Incoming>, engine: &Engine) -> Response<Body> {
    let ready = engine.health.is_ready();
    let (status, kind, text) = match (request.method(), request.uri().path()) {
        (&Method::GET, "/metrics") => (StatusCode::OK, METRICS_TYPE, metrics(engine)),
        (&Method::GET, "/livez") => (StatusCode::OK, "text/plain", "alive\n".to_owned()),
        (&Method::GET, "/readyz") if ready => (StatusCode::OK, "text/plain", "ready\n".to_owned()),
        (&Method::GET, "/readyz") => {
            (StatusCode::SERVICE_UNAVAILABLE, "text/plain", format!("{}\n", engine.health.why_not()))
        }
        (&Method::GET, _) => {
            let text = "there are /metrics, /livez and /readyz\n".to_owned();
            (StatusCode::NOT_FOUND, "text/plain", text)
        }
        _ => (StatusCode::METHOD_NOT_ALLOWED, "text/plain", "only GET\n".to_owned()),
    };
    let mut response = Response::new(one_piece(text.into()));
    *response.status_mut() = status;
    response.headers_mut().insert("content-type", hyper::header::HeaderValue::from_static(kind));
    response
}

/// A body of one piece.
pub(crate) fn one_piece(bytes: bytes::Bytes) -> Body {
    Body::new(OneFrame(Some(bytes)))
}

struct OneFrame(Option<bytes::Bytes>);

impl http_body::Body for OneFrame {
    type Data = bytes::Bytes;
    type Error = tonic::Status;

    fn poll_frame(
        mut self: std::pin::Pin<&mut Self>,
        _: &mut std::task::Context<'_>,
    ) -> std::task::Poll<Option<Result<http_body::Frame<bytes::Bytes>, tonic::Status>>> {
        std::task::Poll::Ready(self.0.take().map(|bytes| Ok(http_body::Frame::data(bytes))))
    }

    fn is_end_stream(&self) -> bool {
        self.0.is_none()
    }

    fn size_hint(&self) -> http_body::SizeHint {
        http_body::SizeHint::with_exact(self.0.as_ref().map_or(0, |bytes| bytes.len() as u64))
    }
}
