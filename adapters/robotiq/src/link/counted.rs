//! A stream that counts what comes, so that a garbled answer can be told from silence, and that throws away what came
//! late before a request is sent: frames of RTU do not say which request they answer.

use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::task::{Context, Poll, ready};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

#[derive(Debug, Default)]
struct Shared {
    came: AtomicU64,
    request_next: AtomicBool,
}

/// Knows how many bytes came so far, and is told when a request follows; clones are handles to the same.
#[derive(Debug, Clone, Default)]
pub(super) struct Count(Arc<Shared>);

impl Count {
    pub(super) fn get(&self) -> u64 {
        self.0.came.load(Ordering::Relaxed)
    }

    /// What came before the bytes that are written next answers nothing.
    pub(super) fn request_follows(&self) {
        self.0.request_next.store(true, Ordering::Relaxed);
    }
}

/// A stream whose received bytes are counted.
#[derive(Debug)]
pub(super) struct Counted<T> {
    stream: T,
    count: Count,
}

impl<T> Counted<T> {
    pub(super) fn new(stream: T, count: Count) -> Self {
        Self { stream, count }
    }
}

impl<T: AsyncRead + Unpin> AsyncRead for Counted<T> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<std::io::Result<()>> {
        let before = buffer.filled().len();
        let read = ready!(Pin::new(&mut self.stream).poll_read(context, buffer));
        let came = buffer.filled().len() - before;
        self.count.0.came.fetch_add(u64::try_from(came).unwrap_or(u64::MAX), Ordering::Relaxed);
        Poll::Ready(read)
    }
}

impl<T: AsyncRead + AsyncWrite + Unpin> AsyncWrite for Counted<T> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<std::io::Result<usize>> {
        if self.count.0.request_next.swap(false, Ordering::Relaxed) {
            // A babbling line does not hold the request forever.
            for _ in 0..16 {
                let mut late = [0; 256];
                let mut buffer = ReadBuf::new(&mut late);
                match Pin::new(&mut self.stream).poll_read(context, &mut buffer) {
                    Poll::Ready(Ok(())) if !buffer.filled().is_empty() => {}
                    _ => break,
                }
            }
        }
        Pin::new(&mut self.stream).poll_write(context, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<std::io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<std::io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}
