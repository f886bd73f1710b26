//! What a job waits for besides a slot.

/// Stands between a waiting job and its beginning. Asked under the pool's lock: answers at once.
pub trait Gate: Send + Sync {
    /// Whether the job can begin.
    fn look(&self) -> Look;

    /// The job begins, after a [`Look::Needs`].
    fn begin(&self) {}
}

/// What a gate says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Look {
    /// Begin.
    Open,
    /// Wait until somebody else has done something.
    Shut,
    /// Begin where there is so much room for a scene.
    Needs(usize),
}
