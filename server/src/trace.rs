//! Traces: W3C trace context in, spans of each call and of its stages out to an OpenTelemetry collector.
//!
//! Spans are made from times that are measured anyway, and only where there is a collector. They go through a bounded
//! channel to one task that sends them; what does not fit is dropped and told in the log, no call waits for it.

mod context;
mod otlp;

pub(crate) use context::TraceContext;
pub(crate) use otlp::WrongCollector;

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::mpsc;
use tokio::task::JoinHandle;

/// Spans that wait to be sent.
const MOST_WAITING: usize = 4096;
/// Time for the last spans at the end.
const LAST: Duration = Duration::from_secs(2);

/// A finished span.
#[derive(Debug, Clone)]
pub(crate) struct Span {
    trace_id: [u8; 16],
    span_id: [u8; 8],
    parent: Option<[u8; 8]>,
    name: String,
    /// A call of somebody else, not a part of one.
    is_call: bool,
    begin_ns: u64,
    end_ns: u64,
    attributes: Vec<(&'static str, Value)>,
    /// What went wrong, if something did.
    error: Option<String>,
}

/// A value of an attribute.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Value {
    Text(String),
    Number(usize),
}

/// One piece of work with its stages, one after the other.
pub(crate) struct Stages<'a, I> {
    pub(crate) call: &'a TraceContext,
    pub(crate) name: &'static str,
    pub(crate) began: Instant,
    pub(crate) stages: I,
    pub(crate) attributes: Vec<(&'static str, Value)>,
}

/// Where spans go; nowhere, where there is no collector.
#[derive(Debug, Clone, Default)]
pub(crate) struct Tracer(Option<Arc<Sender>>);

#[derive(Debug)]
struct Sender {
    spans: Mutex<Option<mpsc::Sender<Span>>>,
    task: Mutex<Option<JoinHandle<()>>>,
    dropped: AtomicU64,
}

impl Tracer {
    /// Starts to send to a collector, if there is one. Needs a runtime.
    pub(crate) fn start(collector: Option<&str>) -> Result<Self, WrongCollector> {
        let Some(collector) = collector else { return Ok(Self(None)) };
        let exporter = otlp::Exporter::new(collector)?;
        let (sender, receiver) = mpsc::channel(MOST_WAITING);
        let task = tokio::spawn(exporter.run(receiver));
        Ok(Self(Some(Arc::new(Sender {
            spans: Mutex::new(Some(sender)),
            task: Mutex::new(Some(task)),
            dropped: AtomicU64::new(0),
        }))))
    }

    /// A call has ended.
    pub(crate) fn call(&self, context: &TraceContext, path: &str, began: Instant, code: tonic::Code) {
        if self.0.is_none() || !context.is_sampled {
            return;
        }
        // Names that callers make up are no names of spans.
        let name = crate::convert::shortened(path.trim_start_matches('/'));
        let method = name.rsplit('/').next().unwrap_or_default().to_owned();
        self.send(Span {
            trace_id: context.trace_id,
            span_id: context.span_id,
            parent: context.parent,
            name,
            is_call: true,
            begin_ns: unix_ns(began),
            end_ns: unix_ns(Instant::now()),
            attributes: vec![
                ("rpc.system", Value::Text("grpc".to_owned())),
                ("rpc.method", Value::Text(method)),
                ("rpc.grpc.status_code", Value::Number(usize::try_from(code as i32).unwrap_or(0))),
            ],
            error: (code != tonic::Code::Ok).then(|| code.description().to_owned()),
        });
    }

    /// A part of a call has ended.
    pub(crate) fn span(
        &self,
        call: &TraceContext,
        name: &'static str,
        (began, ended): (Instant, Instant),
        attributes: Vec<(&'static str, Value)>,
    ) -> Option<[u8; 8]> {
        if self.0.is_none() || !call.is_sampled {
            return None;
        }
        self.part(call, call.span_id, name, (unix_ns(began), unix_ns(ended)), attributes)
    }

    /// A part of a call has just ended, with its stages.
    pub(crate) fn stages<'s>(&self, work: Stages<'_, impl Iterator<Item = &'s (&'static str, Duration)>>) {
        let Stages { call, name, began, stages, attributes } = work;
        let Some(parent) = self.span(call, name, (began, Instant::now()), attributes) else { return };
        let mut at = unix_ns(began);
        for (stage, took) in stages {
            let end = at.saturating_add(u64::try_from(took.as_nanos()).unwrap_or(u64::MAX));
            self.part(call, parent, stage, (at, end), Vec::new());
            at = end;
        }
    }

    /// Sends what there is, and ends.
    pub(crate) async fn close(&self) {
        let Some(sender) = &self.0 else { return };
        drop(sender.spans.lock().unwrap_or_else(PoisonError::into_inner).take());
        let task = sender.task.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(task) = task
            && tokio::time::timeout(LAST, task).await.is_err()
        {
            tracing::warn!("the last spans were not taken by the collector");
        }
        match sender.dropped.load(Ordering::Relaxed) {
            0 => {}
            dropped => tracing::warn!(dropped, "spans were dropped: the collector was too slow"),
        }
    }

    fn part(
        &self,
        call: &TraceContext,
        parent: [u8; 8],
        name: &str,
        (begin_ns, end_ns): (u64, u64),
        attributes: Vec<(&'static str, Value)>,
    ) -> Option<[u8; 8]> {
        let span_id = crate::random::bytes();
        self.send(Span {
            trace_id: call.trace_id,
            span_id,
            parent: Some(parent),
            name: name.to_owned(),
            is_call: false,
            begin_ns,
            end_ns,
            attributes,
            error: None,
        });
        Some(span_id)
    }

    fn send(&self, span: Span) {
        let Some(sender) = &self.0 else { return };
        if let Some(spans) = &*sender.spans.lock().unwrap_or_else(PoisonError::into_inner)
            && spans.try_send(span).is_err()
        {
            sender.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// A moment as the wall clock tells it.
fn unix_ns(at: Instant) -> u64 {
    static BASE: OnceLock<(Instant, Duration)> = OnceLock::new();
    let (instant, since) = BASE.get_or_init(|| (Instant::now(), crate::recorder::unix_time()));
    let moment = match at.checked_duration_since(*instant) {
        Some(later) => *since + later,
        None => since.saturating_sub(instant.saturating_duration_since(at)),
    };
    u64::try_from(moment.as_nanos()).unwrap_or(u64::MAX)
}
