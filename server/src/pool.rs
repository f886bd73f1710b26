//! The planning pool: where CPU work runs, so that no thread of the network runtime ever plans.
//!
//! A few slots each run one job at a time on a rayon pool of their own. (In one shared rayon pool a waiting
//! job could steal a whole other job and finish after its own deadline.) In front of the slots sits a short
//! queue, ordered by deadline: a long one would only make every answer late. A job whose caller is gone, or
//! whose deadline has passed, leaves the queue without running. A job that panics answers
//! [`PoolError::Panicked`]; the slot goes on.
//!
//! Scenes are what takes memory, and they outlive the job that reads them. So a job that reads a scene waits
//! until there is [room](SceneRoom) for it, and jobs that continue a call keep the call's place in the queue:
//! what has a scene is finished before another scene is read.

mod queue;
mod room;
mod slot;

pub use room::SceneRoom;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::oneshot;

use crate::deadline::CallBudget;
use queue::{Job, Kind, Refuse, Run, State, calls_waiting, refuse_dead, take_dead};
use slot::{Shared, run_slot};

/// A job without a deadline is queued as if it had this much time, so that it is not overtaken for ever.
const PATIENCE: Duration = Duration::from_secs(10);

/// Size of a pool.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PoolConfig {
    /// Threads of each slot's rayon pool.
    pub threads: usize,
    /// Jobs that run at the same time.
    pub slots: usize,
    /// Calls that may wait.
    pub queue: usize,
    /// Room for scenes that are alive at the same time; a scene of the default size takes 1, and one that
    /// takes more than there is has all of it for itself.
    pub scene_room: usize,
}

impl PoolConfig {
    /// The default for a machine with that many cores: all cores for each job, and up to four jobs at a
    /// time, because the stages of a job do not all use every core.
    pub fn for_cores(cores: usize) -> Self {
        let threads = cores.max(1);
        Self { threads, slots: threads.min(4), queue: 16, scene_room: 3 }
    }
}

/// Why a job has no result.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PoolError {
    /// The queue is full.
    #[error("{waiting} calls wait, at most {limit} may")]
    Full {
        /// Calls that wait.
        waiting: usize,
        /// At most so many.
        limit: usize,
        /// When a place is likely to be free.
        retry_after: Duration,
    },
    /// The deadline passed before the job began.
    #[error("the deadline passed in the queue")]
    Expired,
    /// The job was cancelled before it began.
    #[error("cancelled in the queue")]
    Cancelled,
    /// The job panicked.
    #[error("the job panicked")]
    Panicked,
    /// The pool has ended.
    #[error("the pool has ended")]
    Closed,
    /// The threads could not be started.
    #[error("cannot start planning threads: {0}")]
    Threads(String),
}

/// A job in the queue or at work.
#[derive(Debug)]
pub struct Ticket<T> {
    /// Jobs before it when it was queued.
    pub position: usize,
    receiver: oneshot::Receiver<Result<T, PoolError>>,
}

impl<T> Ticket<T> {
    /// Waits for the end of the job.
    ///
    /// # Errors
    /// [`PoolError`] when the job has no result.
    pub async fn wait(&mut self) -> Result<T, PoolError> {
        (&mut self.receiver).await.unwrap_or(Err(PoolError::Closed))
    }
}

/// The pool. Dropping it ends its threads after the jobs that they are at.
pub struct Pool {
    shared: Arc<Shared>,
    config: PoolConfig,
}

impl std::fmt::Debug for Pool {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Pool")
            .field("config", &self.config)
            .field("waiting", &self.waiting())
            .field("running", &self.running())
            .finish()
    }
}

impl Pool {
    /// Starts the threads of a pool. Numbers under 1 are taken as 1; a queue of 0 takes a job only when a
    /// slot is free.
    ///
    /// # Errors
    /// [`PoolError::Threads`] when the system refuses a thread.
    pub fn start(config: PoolConfig) -> Result<Self, PoolError> {
        let shared = Arc::new(Shared {
            state: Mutex::new(State { mean_run_s: 0.1, ..State::default() }),
            wake: Condvar::new(),
        });
        let pool = Self { shared: Arc::clone(&shared), config };
        for slot in 0..config.slots.max(1) {
            let rayon = rayon::ThreadPoolBuilder::new()
                .num_threads(config.threads.max(1))
                .thread_name(move |i| format!("plan-{slot}-{i}"))
                .build()
                .map_err(|e| PoolError::Threads(e.to_string()))?;
            let shared = Arc::clone(&shared);
            let room_limit = config.scene_room.max(1);
            std::thread::Builder::new()
                .name(format!("plan-{slot}"))
                .spawn(move || run_slot(&shared, &rayon, room_limit))
                .map_err(|e| PoolError::Threads(e.to_string()))?;
        }
        Ok(pool)
    }

    /// Queues a job, which is told how long it waited; parallel iterators inside it use its slot's threads.
    ///
    /// # Errors
    /// [`PoolError::Full`] when no more jobs may wait, [`PoolError::Closed`] when the pool has ended.
    pub fn submit<T, F>(&self, budget: &CallBudget, job: F) -> Result<Ticket<T>, PoolError>
    where
        T: Send + 'static,
        F: FnOnce(Duration) -> T + Send + 'static,
    {
        self.enqueue(budget, Kind::First { room: 0 }, |queued, _| job(queued))
    }

    /// Queues a job that reads a scene. It begins when there is room for the scene, and gets the room: the
    /// scene is to keep it for as long as it lives.
    ///
    /// # Errors
    /// As [`Pool::submit`].
    pub fn submit_scene<T, F>(&self, budget: &CallBudget, room: usize, job: F) -> Result<Ticket<T>, PoolError>
    where
        T: Send + 'static,
        F: FnOnce(Duration, SceneRoom) -> T + Send + 'static,
    {
        let room = room.min(self.config.scene_room.max(1));
        self.enqueue(budget, Kind::First { room }, job)
    }

    /// Queues a job that continues a call that was admitted: it may wait even where a new one may not, and
    /// has the place in the queue that its call had. How many there are is limited by the room for scenes.
    ///
    /// # Errors
    /// [`PoolError::Closed`] when the pool has ended.
    pub fn submit_continuation<T, F>(&self, budget: &CallBudget, job: F) -> Result<Ticket<T>, PoolError>
    where
        T: Send + 'static,
        F: FnOnce(Duration) -> T + Send + 'static,
    {
        self.enqueue(budget, Kind::Continuation, |queued, _| job(queued))
    }

    /// Jobs that wait.
    pub fn waiting(&self) -> usize {
        self.shared.lock().waiting.len()
    }

    /// Jobs that run.
    pub fn running(&self) -> usize {
        self.shared.lock().running
    }

    /// Room that the scenes take that are alive.
    pub fn scene_room_taken(&self) -> usize {
        self.shared.lock().room_taken
    }

    /// Answers and removes every waiting job that was cancelled or whose deadline has passed.
    pub fn drop_dead(&self) {
        let mut dead = Vec::new();
        take_dead(&mut self.shared.lock(), &mut dead);
        // A job that waited for room may have been in the way of others.
        self.shared.wake.notify_all();
        dead.into_iter().for_each(refuse_dead);
    }

    /// Refuses every waiting job and every new one; running jobs end by themselves.
    pub fn close(&self) {
        let refused = {
            let mut state = self.shared.lock();
            state.closed = true;
            std::mem::take(&mut state.waiting)
        };
        self.shared.wake.notify_all();
        for (_, job) in refused {
            (job.refuse)(PoolError::Closed);
        }
    }

    fn enqueue<T, F>(&self, budget: &CallBudget, kind: Kind, job: F) -> Result<Ticket<T>, PoolError>
    where
        T: Send + 'static,
        F: FnOnce(Duration, SceneRoom) -> T + Send + 'static,
    {
        let arrived = Instant::now();
        let (sender, receiver) = oneshot::channel();
        let sender = Arc::new(Mutex::new(Some(sender)));
        let answer = {
            let sender = Arc::clone(&sender);
            move |result: Result<T, PoolError>| {
                if let Some(sender) = sender.lock().unwrap_or_else(PoisonError::into_inner).take() {
                    // The caller may be gone; then nobody needs the result.
                    sender.send(result).ok();
                }
            }
        };
        let refuse: Refuse = {
            let answer = answer.clone();
            Box::new(move |error| answer(Err(error)))
        };
        let run: Run = Box::new(move |rayon, room| {
            let queued = arrived.elapsed();
            let result = catch_unwind(AssertUnwindSafe(|| rayon.install(|| job(queued, room))));
            answer(result.map_err(|panic| {
                let said = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
                let said = said.or_else(|| panic.downcast_ref::<String>().cloned());
                tracing::error!(panic = said.unwrap_or_default(), "planning job panicked");
                PoolError::Panicked
            }));
        });

        let mut dead = Vec::new();
        let mut state = self.shared.lock();
        if state.closed {
            return Err(PoolError::Closed);
        }
        let limited = kind != Kind::Continuation;
        let free_slots = self.config.slots.max(1).saturating_sub(state.running);
        if limited && calls_waiting(&state) >= self.config.queue + free_slots {
            take_dead(&mut state, &mut dead);
        }
        let waiting = calls_waiting(&state);
        let result = if limited && waiting >= self.config.queue + free_slots {
            let rounds = (state.waiting.len() + 1) as f64 / self.config.slots.max(1) as f64;
            let retry_after = Duration::from_secs_f64((state.mean_run_s * rounds).clamp(0.01, 30.0));
            Err(PoolError::Full { waiting, limit: self.config.queue, retry_after })
        } else {
            // The place is the call's, not the job's: what continues a call is not overtaken by newer calls.
            let due = budget.deadline().unwrap_or(budget.start() + PATIENCE);
            let place = (due, budget.start(), state.queued);
            state.queued += 1;
            let position = state.waiting.range(..place).count();
            state.waiting.insert(place, Job { budget: budget.clone(), kind, run, refuse });
            Ok(Ticket { position, receiver })
        };
        drop(state);
        self.shared.wake.notify_one();
        for job in dead {
            refuse_dead(job);
        }
        result
    }
}

impl Drop for Pool {
    fn drop(&mut self) {
        self.close();
    }
}

#[cfg(test)]
mod tests;
