//! Room for a scene that is alive: taken when a job that reads one begins, given back when the scene is gone.

use std::sync::Arc;

use super::slot::Shared;

/// Room that a scene takes; dropping it gives the room back.
pub struct SceneRoom {
    shared: Arc<Shared>,
    taken: usize,
}

impl SceneRoom {
    /// Room that is accounted for already.
    pub(super) fn new(shared: Arc<Shared>, taken: usize) -> Self {
        Self { shared, taken }
    }
}

impl std::fmt::Debug for SceneRoom {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SceneRoom").field("taken", &self.taken).finish_non_exhaustive()
    }
}

impl Drop for SceneRoom {
    fn drop(&mut self) {
        if self.taken > 0 {
            self.shared.lock().room_taken -= self.taken;
            self.shared.wake.notify_all();
        }
    }
}
