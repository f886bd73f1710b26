//! A servo stream's life: the newest frame waits, one is worked on, answers wait for their reader.

mod newest;
mod stream;

pub(crate) use stream::{ServoStream, Streams};
