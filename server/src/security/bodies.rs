//! Bodies of requests that must arrive in time and within a quota, and bodies of answers that hold what a call holds.

use std::future::Future as _;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use bytes::Bytes;
use http_body::{Body as HttpBody, Frame, SizeHint};
use tokio::time::Sleep;
use tonic::body::Body;
use tonic::{Code, Status};

use super::Use;
use crate::error::ServiceError;

/// The body of a request.
pub(crate) struct ReceivedBody {
    inner: Body,
    used: Arc<Use>,
    limit: Duration,
    late: Pin<Box<Sleep>>,
    /// One of many messages that are let go one by one: its time begins anew with each piece, and what has arrived
    /// before is not held any more.
    is_stream: bool,
}

impl ReceivedBody {
    /// A body that must have arrived in that time.
    pub(crate) fn new(inner: Body, used: Arc<Use>, limit: Duration) -> Self {
        Self { inner, used, limit, late: Box::pin(tokio::time::sleep(limit)), is_stream: false }
    }

    /// The body of a stream of requests, in which something must arrive in that time, again and again. How much of it is
    /// held is for the service to limit.
    pub(crate) fn stream(inner: Body, used: Arc<Use>, limit: Duration) -> Self {
        Self { is_stream: true, ..Self::new(inner, used, limit) }
    }
}

impl HttpBody for ReceivedBody {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        match Pin::new(&mut self.inner).poll_frame(context) {
            Poll::Ready(Some(Ok(frame))) if self.is_stream => {
                let due = tokio::time::Instant::now() + self.limit;
                self.late.as_mut().reset(due);
                Poll::Ready(Some(Ok(frame)))
            }
            Poll::Ready(Some(Ok(frame))) => {
                if let Some(data) = frame.data_ref()
                    && let Err(over) = self.used.receive(data.len())
                {
                    return Poll::Ready(Some(Err(over.into())));
                }
                Poll::Ready(Some(Ok(frame)))
            }
            Poll::Pending if self.late.as_mut().poll(context).is_ready() => {
                let slow = ServiceError::SlowRequest { limit: self.limit };
                Poll::Ready(Some(Err(slow.into())))
            }
            other => other,
        }
    }

    fn is_end_stream(&self) -> bool {
        self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.inner.size_hint()
    }
}

/// What is to be known of the end of an answer.
pub(crate) trait Ending: Unpin {
    /// The trailers say so.
    fn ends_with(&mut self, code: Code);
}

/// The body of an answer; what it holds is let go when it has been sent or its caller is gone.
pub(crate) struct GuardedBody<G> {
    pub(crate) inner: Body,
    pub(crate) guard: G,
}

impl<G: Ending> HttpBody for GuardedBody<G> {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        let polled = Pin::new(&mut self.inner).poll_frame(context);
        if let Poll::Ready(Some(Ok(frame))) = &polled
            && let Some(status) = frame.trailers_ref().and_then(Status::from_header_map)
        {
            self.guard.ends_with(status.code());
        }
        polled
    }

    fn is_end_stream(&self) -> bool {
        self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.inner.size_hint()
    }
}
