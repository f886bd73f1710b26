//! A slot: a thread that takes one job after the other, and what slots and callers share.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use super::SceneRoom;
use super::queue::{State, refuse_dead, take_dead, take_next};

/// What the slots and the callers of a pool share.
pub(super) struct Shared {
    pub(super) state: Mutex<State>,
    pub(super) wake: Condvar,
}

impl Shared {
    pub(super) fn lock(&self) -> MutexGuard<'_, State> {
        // Jobs run outside the lock, so a poisoned lock still holds a consistent state.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The life of a slot: take the most urgent job, run it, until the pool is closed.
pub(super) fn run_slot(shared: &Arc<Shared>, rayon: &rayon::ThreadPool, room_limit: usize) {
    let mut state = shared.lock();
    loop {
        let mut dead = Vec::new();
        take_dead(&mut state, &mut dead);
        if !dead.is_empty() {
            drop(state);
            dead.into_iter().for_each(refuse_dead);
            state = shared.lock();
            continue;
        }
        if let Some((job, room)) = take_next(&mut state, room_limit) {
            state.running += 1;
            if !state.waiting.is_empty() {
                shared.wake.notify_one();
            }
            drop(state);
            let began = Instant::now();
            (job.run)(rayon, SceneRoom::new(Arc::clone(shared), room));
            let took = began.elapsed().as_secs_f64();
            state = shared.lock();
            state.running -= 1;
            state.mean_run_s += 0.2 * (took - state.mean_run_s);
        } else if state.closed {
            return;
        } else {
            state = shared.wake.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }
}
