//! The place where the newest frame waits: what comes later takes it.

use std::sync::{Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;

/// How a sending side has ended.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum End<E> {
    /// It has said all.
    Finished,
    /// It has failed.
    Failed(E),
}

#[derive(Debug)]
struct State<T, E> {
    waiting: Option<T>,
    replaced: u64,
    end: Option<End<E>>,
}

/// Holds at most one thing, the newest.
#[derive(Debug)]
pub(super) struct Newest<T, E> {
    state: Mutex<State<T, E>>,
    changed: Notify,
}

impl<T, E: Clone> Newest<T, E> {
    pub(super) fn new() -> Self {
        Self { state: Mutex::new(State { waiting: None, replaced: 0, end: None }), changed: Notify::new() }
    }

    /// Something newer has come.
    pub(super) fn put(&self, newer: T) {
        let mut state = self.lock();
        state.replaced += u64::from(state.waiting.replace(newer).is_some());
        drop(state);
        self.changed.notify_one();
    }

    /// Nothing more comes.
    pub(super) fn end(&self, how: End<E>) {
        self.lock().end.get_or_insert(how);
        self.changed.notify_one();
    }

    /// The newest, when there is one; after the end what was left, then how it ended. An end in failure comes at once.
    pub(super) async fn take(&self) -> Result<T, End<E>> {
        loop {
            {
                let mut state = self.lock();
                if let Some(failed @ End::Failed(_)) = &state.end {
                    return Err(failed.clone());
                }
                if let Some(newest) = state.waiting.take() {
                    return Ok(newest);
                }
                if let Some(end) = &state.end {
                    return Err(end.clone());
                }
            }
            // A notice that came in between is kept for this.
            self.changed.notified().await;
        }
    }

    /// Things that were replaced before they were taken.
    pub(super) fn replaced(&self) -> u64 {
        self.lock().replaced
    }

    fn lock(&self) -> MutexGuard<'_, State<T, E>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn the_newest_wins_and_the_last_is_not_lost() {
        let newest: Newest<u32, &str> = Newest::new();
        for n in 0..5 {
            newest.put(n);
        }
        assert_eq!(newest.take().await, Ok(4));
        assert_eq!(newest.replaced(), 4);
        newest.put(5);
        newest.end(End::Finished);
        assert_eq!(newest.take().await, Ok(5));
        assert_eq!(newest.take().await, Err(End::Finished));
        newest.end(End::Failed("too late"));
        assert_eq!(newest.take().await, Err(End::Finished), "it ends once");
    }

    #[tokio::test]
    async fn whoever_waits_is_woken() {
        let newest: std::sync::Arc<Newest<u32, &str>> = std::sync::Arc::new(Newest::new());
        let reader = tokio::spawn({
            let newest = std::sync::Arc::clone(&newest);
            async move { (newest.take().await, newest.take().await) }
        });
        newest.put(1);
        tokio::task::yield_now().await;
        newest.end(End::Failed("broken"));
        let (first, second) = reader.await.unwrap();
        // On one thread the reader may see the failure before the frame.
        assert!(first == Ok(1) || first == Err(End::Failed("broken")), "{first:?}");
        assert_eq!(second, Err(End::Failed("broken")));
    }
}
