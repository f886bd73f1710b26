//! A serial line with a device at its end: a pseudo-terminal, served by a thread of its own.

mod pty;

use std::time::{Duration, Instant};

pub use pty::SerialLine;

/// Bytes that a device sends.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reply {
    /// The bytes.
    pub bytes: Vec<u8>,
    /// When the last of them is on the line, counted from when the request was there.
    pub after: Duration,
}

/// A device at the end of a serial line.
pub trait LineDevice: Send + 'static {
    /// Takes bytes that came, in any pieces, and says what it sends back.
    fn receive(&mut self, bytes: &[u8], now: Instant) -> Vec<Reply>;

    /// Nothing came for some milliseconds: protocols that frame by silence forget what is not whole.
    fn silence(&mut self) {}
}
