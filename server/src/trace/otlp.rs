//! Spans to an OpenTelemetry collector: OTLP 1 over gRPC (opentelemetry-proto, `collector/trace/v1`), as far as spans
//! of this server need it.

use std::time::Duration;

use prost::Message;
use tokio::sync::mpsc::Receiver;
use tonic::client::Grpc;
use tonic::codegen::http::uri::PathAndQuery;
use tonic::transport::{Channel, Endpoint};
use tonic_prost::ProstCodec;

use super::{Span, Value};

/// Spans in one message.
const BATCH: usize = 512;
/// Spans wait so long for others at most.
const LINGER: Duration = Duration::from_millis(500);
/// A collector that does not answer for so long has not taken them.
const PATIENCE: Duration = Duration::from_secs(5);
const PATH: &str = "/opentelemetry.proto.collector.trace.v1.TraceService/Export";

/// Why there is no collector.
#[derive(Debug, thiserror::Error)]
#[error(
    "collector of traces: found {found:?}, expected an address such as http://127.0.0.1:4317 (without TLS)"
)]
pub struct WrongCollector {
    /// As given.
    pub found: String,
}

/// Sends spans.
pub(super) struct Exporter {
    client: Grpc<Channel>,
}

impl Exporter {
    pub(super) fn new(collector: &str) -> Result<Self, WrongCollector> {
        let wrong = || WrongCollector { found: collector.to_owned() };
        if !collector.starts_with("http://") {
            return Err(wrong());
        }
        let endpoint = Endpoint::from_shared(collector.to_owned()).map_err(|_| wrong())?;
        let channel = endpoint.connect_timeout(PATIENCE).timeout(PATIENCE).connect_lazy();
        Ok(Self { client: Grpc::new(channel) })
    }

    /// Sends until the other end is dropped, and then the rest.
    pub(super) async fn run(mut self, mut spans: Receiver<Span>) {
        let mut lost = 0u64;
        let mut batch = Vec::with_capacity(BATCH);
        loop {
            let came = spans.recv_many(&mut batch, BATCH).await;
            if came == 0 {
                return;
            }
            // A few more may come soon.
            let until = tokio::time::Instant::now() + LINGER;
            while batch.len() < BATCH {
                match tokio::time::timeout_at(until, spans.recv()).await {
                    Ok(Some(span)) => batch.push(span),
                    Ok(None) | Err(_) => break,
                }
            }
            let count = batch.len() as u64;
            match self.send(std::mem::take(&mut batch)).await {
                Ok(()) if lost > 0 => {
                    tracing::info!(lost, "the collector of traces is there again");
                    lost = 0;
                }
                Ok(()) => {}
                Err(status) => {
                    // Once, not for every batch.
                    if lost == 0 {
                        tracing::warn!(code = ?status.code(), "the collector of traces does not take spans");
                    }
                    lost += count;
                }
            }
        }
    }

    async fn send(&mut self, spans: Vec<Span>) -> Result<(), tonic::Status> {
        let ready = self.client.ready().await;
        ready.map_err(|error| tonic::Status::unavailable(error.to_string()))?;
        let codec = ProstCodec::<ExportRequest, ExportResponse>::default();
        let request = tonic::Request::new(request(spans));
        self.client.unary(request, PathAndQuery::from_static(PATH), codec).await.map(drop)
    }
}

fn request(spans: Vec<Span>) -> ExportRequest {
    let text = |key: &str, value: &str| KeyValue {
        key: key.to_owned(),
        value: Some(AnyValue { value: Some(any_value::Value::Text(value.to_owned())) }),
    };
    let version = env!("CARGO_PKG_VERSION");
    ExportRequest {
        resource_spans: vec![ResourceSpans {
            resource: Some(Resource {
                attributes: vec![text("service.name", "graspd"), text("service.version", version)],
            }),
            scope_spans: vec![ScopeSpans {
                scope: Some(Scope { name: "graspd".to_owned(), version: version.to_owned() }),
                spans: spans.into_iter().map(message).collect(),
            }],
        }],
    }
}

fn message(span: Span) -> WireSpan {
    const INTERNAL: i32 = 1;
    const SERVER: i32 = 2;
    const ERROR: i32 = 2;
    let attribute = |(key, value): (&str, Value)| KeyValue {
        key: key.to_owned(),
        value: Some(AnyValue {
            value: Some(match value {
                Value::Text(text) => any_value::Value::Text(text),
                Value::Number(n) => any_value::Value::Number(i64::try_from(n).unwrap_or(i64::MAX)),
            }),
        }),
    };
    WireSpan {
        trace_id: span.trace_id.to_vec(),
        span_id: span.span_id.to_vec(),
        parent_span_id: span.parent.map_or_else(Vec::new, |parent| parent.to_vec()),
        name: span.name,
        kind: if span.is_call { SERVER } else { INTERNAL },
        begin_ns: span.begin_ns,
        end_ns: span.end_ns,
        attributes: span.attributes.into_iter().map(attribute).collect(),
        status: span.error.map(|message| SpanStatus { message, code: ERROR }),
    }
}

#[derive(Clone, PartialEq, Message)]
struct ExportRequest {
    #[prost(message, repeated, tag = "1")]
    resource_spans: Vec<ResourceSpans>,
}

#[derive(Clone, PartialEq, Message)]
struct ExportResponse {}

#[derive(Clone, PartialEq, Message)]
struct ResourceSpans {
    #[prost(message, optional, tag = "1")]
    resource: Option<Resource>,
    #[prost(message, repeated, tag = "2")]
    scope_spans: Vec<ScopeSpans>,
}

#[derive(Clone, PartialEq, Message)]
struct Resource {
    #[prost(message, repeated, tag = "1")]
    attributes: Vec<KeyValue>,
}

#[derive(Clone, PartialEq, Message)]
struct ScopeSpans {
    #[prost(message, optional, tag = "1")]
    scope: Option<Scope>,
    #[prost(message, repeated, tag = "2")]
    spans: Vec<WireSpan>,
}

#[derive(Clone, PartialEq, Message)]
struct Scope {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(string, tag = "2")]
    version: String,
}

#[derive(Clone, PartialEq, Message)]
struct WireSpan {
    #[prost(bytes = "vec", tag = "1")]
    trace_id: Vec<u8>,
    #[prost(bytes = "vec", tag = "2")]
    span_id: Vec<u8>,
    #[prost(bytes = "vec", tag = "4")]
    parent_span_id: Vec<u8>,
    #[prost(string, tag = "5")]
    name: String,
    #[prost(int32, tag = "6")]
    kind: i32,
    #[prost(fixed64, tag = "7")]
    begin_ns: u64,
    #[prost(fixed64, tag = "8")]
    end_ns: u64,
    #[prost(message, repeated, tag = "9")]
    attributes: Vec<KeyValue>,
    #[prost(message, optional, tag = "15")]
    status: Option<SpanStatus>,
}

#[derive(Clone, PartialEq, Message)]
struct SpanStatus {
    #[prost(string, tag = "2")]
    message: String,
    #[prost(int32, tag = "3")]
    code: i32,
}

#[derive(Clone, PartialEq, Message)]
struct KeyValue {
    #[prost(string, tag = "1")]
    key: String,
    #[prost(message, optional, tag = "2")]
    value: Option<AnyValue>,
}

#[derive(Clone, PartialEq, Message)]
struct AnyValue {
    #[prost(oneof = "any_value::Value", tags = "1, 3")]
    value: Option<any_value::Value>,
}

mod any_value {
    #[derive(Clone, PartialEq, prost::Oneof)]
    pub(super) enum Value {
        #[prost(string, tag = "1")]
        Text(String),
        #[prost(int64, tag = "3")]
        Number(i64),
    }
}
