//! The live view: what a server sees and answers, for viewers that speak the Foxglove WebSocket protocol (Foxglove,
//! Lichtblick).
//!
//! Whoever has something to show hands it to [`Live::show`] and goes on: that is a pointer in the place of the one
//! before. A task of its own, the hub, lets the newest [`Picture`] draw the topics that somebody has subscribed to, in
//! the messages and schemas of recordings, at most [`PICTURES_PER_SECOND`] times a second. A viewer that comes later gets
//! what was shown last. Each viewer has room for one message of a topic: a slow one misses some, and one that reads
//! nothing is put out.

mod client;
mod counts;
mod door;
mod hub;
mod news;
mod outbox;
mod protocol;
mod server;

pub use counts::Counts;
pub use hub::PICTURES_PER_SECOND;
pub use server::{Live, LiveConfig, LiveError};

use graspd_recording::Bundle;

/// Something that can be shown, as often as somebody new wants to see it.
pub trait Picture: Send + Sync + std::fmt::Debug {
    /// When it happened, nanoseconds since 1970.
    fn time_ns(&self) -> u64;

    /// Offers everything that there is to see to the bundle, and adds what it wants.
    fn draw(&self, bundle: &mut Bundle);
}

/// What is shown beside each other: the newest picture of each layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Layer {
    /// Plans.
    Plan,
    /// Servo streams.
    Servo,
}

impl Layer {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Plan, Self::Servo];

    pub(crate) fn index(self) -> usize {
        match self {
            Self::Plan => 0,
            Self::Servo => 1,
        }
    }
}

#[cfg(test)]
mod tests;
