//! The queue in front of the slots: jobs by the deadline of their call, and which of them may begin.

use std::collections::BTreeMap;
use std::time::Instant;

use graspd_planner::budget::{Budget as _, Stop};

use super::{PoolError, SceneRoom};
use crate::deadline::CallBudget;

/// Gets the room that the job asked for.
pub(super) type Run = Box<dyn FnOnce(&rayon::ThreadPool, SceneRoom) + Send>;
pub(super) type Refuse = Box<dyn FnOnce(PoolError) + Send>;

pub(super) struct Job {
    pub(super) budget: CallBudget,
    pub(super) kind: Kind,
    /// Runs the job and answers its ticket.
    pub(super) run: Run,
    /// Answers its ticket without running it. Shares the ticket with `run`; only one of both is called.
    pub(super) refuse: Refuse,
}

/// What a job is to its call.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// The first job of a call, and the room that its scene needs; 0 if it reads none.
    First { room: usize },
    /// Continues a call that was admitted.
    Continuation,
}

/// Place of a job in the queue: when its call is due, when it arrived, and when the job was queued.
pub(super) type Place = (Instant, Instant, u64);

#[derive(Default)]
pub(super) struct State {
    pub(super) waiting: BTreeMap<Place, Job>,
    pub(super) queued: u64,
    pub(super) running: usize,
    /// Room that scenes take.
    pub(super) room_taken: usize,
    /// Moving average of the time that a job runs, seconds.
    pub(super) mean_run_s: f64,
    pub(super) closed: bool,
}

/// Takes every job out of the queue that need not run any more.
pub(super) fn take_dead(state: &mut State, dead: &mut Vec<Job>) {
    let keys: Vec<_> =
        state.waiting.iter().filter(|(_, job)| job.budget.stop().is_some()).map(|(k, _)| *k).collect();
    dead.extend(keys.iter().filter_map(|key| state.waiting.remove(key)));
}

pub(super) fn refuse_dead(job: Job) {
    let error = match job.budget.stop() {
        Some(Stop::Cancelled) => PoolError::Cancelled,
        _ => PoolError::Expired,
    };
    (job.refuse)(error);
}

/// Calls of which no job has begun.
pub(super) fn calls_waiting(state: &State) -> usize {
    state.waiting.values().filter(|job| job.kind != Kind::Continuation).count()
}

/// Takes the most urgent job that can begin, and the room for its scene. Where one has to wait for room, no
/// other scene may overtake it (a large one would wait for ever), but jobs that read none may.
pub(super) fn take_next(state: &mut State, room_limit: usize) -> Option<(Job, usize)> {
    let mut room_left = room_limit.saturating_sub(state.room_taken);
    let place = state.waiting.iter().find_map(|(place, job)| match job.kind {
        Kind::First { room } if room > room_left => {
            room_left = 0;
            None
        }
        _ => Some(*place),
    })?;
    let job = state.waiting.remove(&place)?;
    let room = match job.kind {
        Kind::First { room } => room,
        Kind::Continuation => 0,
    };
    state.room_taken += room;
    Some((job, room))
}
