//! The place where the newest picture of each layer waits: what comes later takes it.

use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::Notify;

use crate::counts::{Counters, add};
use crate::{Layer, Picture};

/// The newest of each layer, where it has not been taken.
pub(crate) type Waiting = [Option<Arc<dyn Picture>>; Layer::ALL.len()];

/// Pictures on their way to the hub.
#[derive(Debug, Default)]
pub(crate) struct News {
    waiting: Mutex<Waiting>,
    changed: Notify,
}

impl News {
    /// Something newer has come. Never waits.
    pub(crate) fn put(&self, layer: Layer, picture: Arc<dyn Picture>, counters: &Counters) {
        let before = {
            let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
            waiting[layer.index()].replace(picture)
        };
        // Freed outside the lock: a picture can be large.
        if before.is_some() {
            add(&counters.superseded, 1);
        }
        self.changed.notify_one();
    }

    /// What waits, when anything does.
    pub(crate) async fn take(&self) -> Waiting {
        loop {
            let waiting = self.take_now();
            if waiting.iter().any(Option::is_some) {
                return waiting;
            }
            // A notice that came in between is kept for this.
            self.changed.notified().await;
        }
    }

    /// What waits, if anything does.
    pub(crate) fn take_now(&self) -> Waiting {
        std::mem::take(&mut *self.waiting.lock().unwrap_or_else(PoisonError::into_inner))
    }
}
