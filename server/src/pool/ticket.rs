//! The two sides of a job: what its caller holds while it waits, and what the job itself gets when it begins.

use std::sync::Arc;
use std::time::Duration;

use graspd_scheduler::JobId;
use tokio::sync::oneshot;

use super::slot::Shared;
use super::{PoolError, SceneRoom};

/// A job in the queue or at work. Dropping it takes the job out of the queue; a job at work is stopped by its
/// budget.
pub struct Ticket<T> {
    /// Jobs before it when it was queued.
    pub position: usize,
    /// None for a job that was answered without being queued.
    id: Option<JobId>,
    shared: Arc<Shared>,
    receiver: oneshot::Receiver<Result<T, PoolError>>,
}

impl<T> Ticket<T> {
    pub(super) fn new(
        position: usize,
        id: Option<JobId>,
        shared: Arc<Shared>,
        receiver: oneshot::Receiver<Result<T, PoolError>>,
    ) -> Self {
        Self { position, id, shared, receiver }
    }

    /// Waits for the end of the job.
    ///
    /// # Errors
    /// [`PoolError`] when the job has no result.
    pub async fn wait(&mut self) -> Result<T, PoolError> {
        (&mut self.receiver).await.unwrap_or(Err(PoolError::Closed))
    }
}

impl<T> std::fmt::Debug for Ticket<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Ticket")
            .field("position", &self.position)
            .field("id", &self.id)
            .finish_non_exhaustive()
    }
}

impl<T> Drop for Ticket<T> {
    fn drop(&mut self) {
        if let Some(id) = self.id {
            self.shared.withdraw(id);
        }
    }
}

/// A job's turn in its slot.
pub struct Turn {
    /// How long it has waited.
    pub queued: Duration,
    room: Option<SceneRoom>,
    shared: Arc<Shared>,
    id: JobId,
}

impl Turn {
    pub(super) fn new(shared: Arc<Shared>, id: JobId, room: SceneRoom) -> Self {
        Self { queued: Duration::ZERO, room: Some(room), shared, id }
    }

    /// Room for the scene that the job reads: the scene is to keep it for as long as it lives. Once.
    pub fn take_room(&mut self) -> SceneRoom {
        self.room.take().unwrap_or_else(|| SceneRoom::new(Arc::clone(&self.shared), 0))
    }

    /// True if this job could go on for `more` without making a waiting call miss its deadline.
    pub fn has_time(&self, more: Duration) -> bool {
        self.shared.lock().scheduler.has_time(self.shared.now(), self.id, more)
    }

    /// Says how long this job will take in all.
    pub fn expect(&self, expected: Duration) {
        self.shared.lock().scheduler.expect(self.id, expected);
    }

    /// Has waiting jobs look at their gates again.
    pub fn wake_others(&self) {
        self.shared.wake.notify_all();
    }
}

impl std::fmt::Debug for Turn {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Turn").field("queued", &self.queued).field("id", &self.id).finish_non_exhaustive()
    }
}
