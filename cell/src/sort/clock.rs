//! The clock on which arms move: the wall's, or a simulated world's.

use std::any::Any;
use std::fmt::Debug;
use std::time::Instant;

/// The clock of a cell's devices.
pub trait Clock: Send + Sync + Debug {
    /// Seconds since some moment before the run.
    fn now_s(&self) -> f64;

    /// Where time can stand still, it does until the answer is dropped: a simulated cell in which thinking takes no time. The
    /// real one has no such thing, as this default.
    fn still(&self) -> Option<Box<dyn Any + Send>> {
        None
    }
}

/// The clock on the wall.
#[derive(Debug)]
pub struct WallClock(Instant);

impl Default for WallClock {
    fn default() -> Self {
        Self(Instant::now())
    }
}

impl Clock for WallClock {
    fn now_s(&self) -> f64 {
        self.0.elapsed().as_secs_f64()
    }
}
