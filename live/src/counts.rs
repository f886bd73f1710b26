//! What is counted, for metrics.

use std::sync::atomic::{AtomicU64, Ordering};

/// What has happened since the start, and how many viewers there are.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Viewers that are connected.
    pub clients: u64,
    /// Pictures that were drawn for somebody.
    pub drawn: u64,
    /// Pictures that a newer one has replaced before they were drawn.
    pub superseded: u64,
    /// Messages that were sent.
    pub sent: u64,
    /// Messages that a newer one has replaced before a slow viewer took them.
    pub dropped: u64,
    /// Connections that were refused: another site, another name, too many, another protocol.
    pub refused: u64,
    /// Viewers that were put out because they read nothing, or sent what is no protocol.
    pub put_out: u64,
}

/// The same while it changes.
#[derive(Debug, Default)]
pub(crate) struct Counters {
    pub(crate) clients: AtomicU64,
    pub(crate) drawn: AtomicU64,
    pub(crate) superseded: AtomicU64,
    pub(crate) sent: AtomicU64,
    pub(crate) dropped: AtomicU64,
    pub(crate) refused: AtomicU64,
    pub(crate) put_out: AtomicU64,
}

impl Counters {
    pub(crate) fn read(&self) -> Counts {
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        Counts {
            clients: read(&self.clients),
            drawn: read(&self.drawn),
            superseded: read(&self.superseded),
            sent: read(&self.sent),
            dropped: read(&self.dropped),
            refused: read(&self.refused),
            put_out: read(&self.put_out),
        }
    }
}

/// Adds to a counter.
pub(crate) fn add(counter: &AtomicU64, count: usize) {
    counter.fetch_add(count as u64, Ordering::Relaxed);
}
