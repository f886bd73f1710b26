//! The planning pool: where CPU work runs, so that no thread of the network runtime ever plans.
//!
//! A few slots each run one job at a time on a rayon pool of their own. (In one shared rayon pool a waiting
//! job could steal a whole other job and finish after its own deadline.) Which job begins, waits or is refused is
//! the [scheduler's](graspd_scheduler) decision; the pool is its clock and its threads. A job whose caller is gone
//! leaves the queue at once, one whose deadline passes at that moment. A job that panics answers
//! [`PoolError::Panicked`]; the slot goes on.
//!
//! Scenes are what takes memory, and they outlive the job that reads them. So a job that reads a scene waits
//! until there is [room](SceneRoom) for it, and jobs that continue a call keep the call's place in the queue:
//! what has a scene is finished before another scene is read.

mod gate;
mod room;
mod slot;
mod sync;
mod ticket;

pub use gate::{Gate, Look};
pub use graspd_scheduler::{Estimate, Flow, Priority};
pub use room::SceneRoom;
pub use ticket::{Ticket, Turn};

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

use graspd_planner::budget::Budget as _;
use graspd_scheduler::{Ask, Config, Refusal, Refused, Scheduler};
use tokio::sync::oneshot;

use crate::deadline::CallBudget;
use slot::{Job, Refuse, Run, Shared, SlotCores, State, run_slot};
use sync::{Condvar, Mutex, thread};

/// A job without a deadline is ordered as if it had this much time.
pub(crate) const PATIENCE: Duration = Duration::from_secs(10);

/// Size of a pool.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PoolConfig {
    /// Threads of each slot's rayon pool.
    pub threads: usize,
    /// Jobs that run at the same time.
    pub slots: usize,
    /// Slots beyond these that only servo jobs take.
    pub servo_slots: usize,
    /// Calls that may wait.
    pub queue: usize,
    /// Room for scenes that are alive at the same time; a scene of the default size takes 1, and one that
    /// takes more than there is has all of it for itself.
    pub scene_room: usize,
    /// How much nicer planning threads are than the process, 0 to 19 (Linux): who waits for a core while they plan is a
    /// thread that answers, refuses or cancels a call, and it needs the core for less than a millisecond. With 1 and
    /// more, servo jobs run on threads that are no nicer than the process, and jobs that begin beside a servo on threads that
    /// are nicer by 10 more.
    pub nice: u8,
    /// For comparison: order of arrival, nothing refused but by a full queue.
    pub plain_fifo: bool,
}

/// Planning threads are so much nicer than the process where nothing else is said: they get a third of what others get that
/// want the same core.
const NICE: u8 = 5;

impl PoolConfig {
    /// The default for a machine with that many cores: all cores for each job, and up to four jobs at a
    /// time, because the stages of a job do not all use every core. One slot more for servo work.
    pub fn for_cores(cores: usize) -> Self {
        let threads = cores.max(1);
        Self {
            threads,
            slots: threads.min(4),
            servo_slots: 1,
            queue: 16,
            scene_room: 3,
            nice: NICE,
            plain_fifo: false,
        }
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
    /// It would not be done before its deadline, or others would not be for it.
    #[error("needs {needs:?} and has {left:?}")]
    CannotFinish {
        /// How long it would take from now, what is before it included.
        needs: Duration,
        /// How long it has.
        left: Duration,
        /// When it could.
        retry_after: Duration,
    },
    /// It lost its place to a more urgent job.
    #[error("lost its place to a more urgent job")]
    Shed {
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

/// What the scheduler wants to know of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Order {
    /// How urgent it is.
    pub priority: Priority,
    /// Who asks.
    pub caller: Flow,
    /// For which hand.
    pub hand: Flow,
    /// How long it will take.
    pub estimate: Estimate,
}

impl Order {
    /// A short job for no hand.
    pub fn brief(caller: Flow) -> Self {
        Self { priority: Priority::Normal, caller, hand: Flow(0), estimate: Estimate::default() }
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
    /// Starts the threads of a pool. Fewer than one thread or slot are taken as one; a queue of 0 takes a job only
    /// when a slot is free.
    ///
    /// # Errors
    /// [`PoolError::Threads`] when the system refuses a thread.
    pub fn start(config: PoolConfig) -> Result<Self, PoolError> {
        let scheduler = Scheduler::new(Config {
            slots: config.slots,
            servo_slots: config.servo_slots,
            queue: config.queue,
            patience: PATIENCE,
            plain_fifo: config.plain_fifo,
        });
        let shared = Arc::new(Shared {
            epoch: Instant::now(),
            state: Mutex::new(State { scheduler, room_taken: 0, running: Vec::new(), closed: false }),
            wake: Condvar::new(),
            servo_at: Mutex::new(None),
            slowest_release_us: Default::default(),
            releases: Default::default(),
        });
        let pool = Self { shared: Arc::clone(&shared), config };
        for slot in 0..config.slots.max(1) + config.servo_slots {
            let cores = SlotCores::start(slot, config.threads, config.nice)
                .map_err(|e| PoolError::Threads(e.to_string()))?;
            let shared = Arc::clone(&shared);
            let room_limit = config.scene_room.max(1);
            thread::Builder::new()
                .name(format!("plan-{slot}"))
                .spawn(move || run_slot(&shared, cores, room_limit))
                .map_err(|e| PoolError::Threads(e.to_string()))?;
        }
        Ok(pool)
    }

    /// Queues a job; parallel iterators inside it use its slot's threads. With a gate it begins when the gate lets
    /// it, and gets the room that the gate asks for.
    ///
    /// # Errors
    /// [`PoolError::Full`], [`PoolError::CannotFinish`], [`PoolError::Closed`].
    pub fn submit<T, F>(
        &self,
        budget: &CallBudget,
        order: &Order,
        gate: Option<Arc<dyn Gate>>,
        job: F,
    ) -> Result<Ticket<T>, PoolError>
    where
        T: Send + 'static,
        F: FnOnce(Turn) -> T + Send + 'static,
    {
        self.enqueue(budget, order, gate, false, job)
    }

    /// Queues a job that continues a call that was admitted: it may wait even where a new one may not, and
    /// has the place in the queue that its call had. How many there are is limited by the room for scenes.
    ///
    /// # Errors
    /// [`PoolError::Closed`] when the pool has ended.
    pub fn submit_continuation<T, F>(
        &self,
        budget: &CallBudget,
        order: &Order,
        job: F,
    ) -> Result<Ticket<T>, PoolError>
    where
        T: Send + 'static,
        F: FnOnce(Turn) -> T + Send + 'static,
    {
        self.enqueue(budget, order, None, true, job)
    }

    /// Jobs that wait.
    pub fn waiting(&self) -> usize {
        self.shared.lock().scheduler.waiting()
    }

    /// Jobs that wait, by priority.
    pub fn waiting_by_priority(&self) -> [usize; 4] {
        let state = self.shared.lock();
        Priority::ALL.map(|p| state.scheduler.waiting_asks().filter(|ask| ask.priority == p).count())
    }

    /// Jobs that run.
    pub fn running(&self) -> usize {
        self.shared.lock().scheduler.running()
    }

    /// Room that the scenes take that are alive.
    pub fn scene_room_taken(&self) -> usize {
        self.shared.lock().room_taken
    }

    /// The longest that a job has run on after it was cancelled.
    pub fn slowest_release(&self) -> Duration {
        Duration::from_micros(self.shared.slowest_release_us.load(std::sync::atomic::Ordering::Relaxed))
    }

    /// Jobs that ran when they were cancelled, by the milliseconds that they ran on at most.
    pub fn releases(&self) -> Vec<(&'static str, u64)> {
        let names = ["1", "2.5", "5", "10", "50", "more"];
        let counts = self.shared.releases.iter().map(|n| n.load(std::sync::atomic::Ordering::Relaxed));
        names.into_iter().zip(counts).collect()
    }

    /// How the pool is set up.
    pub fn config(&self) -> &PoolConfig {
        &self.config
    }

    /// Answers and removes every waiting job that was cancelled or whose deadline has passed.
    pub fn drop_dead(&self) {
        let dead = self.shared.lock().take_dead(self.shared.now());
        // A job that waited for room may have been in the way of others.
        self.shared.wake.notify_all();
        dead.into_iter().for_each(Job::refuse_dead);
    }

    /// Refuses every waiting job and every new one; running jobs end by themselves.
    pub fn close(&self) {
        let refused = {
            let mut state = self.shared.lock();
            state.closed = true;
            state.scheduler.clear()
        };
        self.shared.wake.notify_all();
        for (_, job) in refused {
            (job.refuse)(PoolError::Closed);
        }
    }

    fn enqueue<T, F>(
        &self,
        budget: &CallBudget,
        order: &Order,
        gate: Option<Arc<dyn Gate>>,
        continues: bool,
        job: F,
    ) -> Result<Ticket<T>, PoolError>
    where
        T: Send + 'static,
        F: FnOnce(Turn) -> T + Send + 'static,
    {
        let queued_at = Instant::now();
        let (sender, receiver) = oneshot::channel();
        let (run, refuse) = both_ends(sender, queued_at, job);
        let shared = &self.shared;
        if budget.stop().is_some() {
            let dead = Job { budget: budget.clone(), gate, run, refuse };
            dead.refuse_dead();
            return Ok(Ticket::new(0, None, Arc::clone(shared), receiver));
        }
        let ask = Ask {
            priority: order.priority,
            caller: order.caller,
            hand: order.hand,
            arrived: shared.time(budget.start()),
            deadline: budget.deadline().map(|d| shared.time(d)),
            estimate: order.estimate,
        };
        let payload = Job { budget: budget.clone(), gate, run, refuse };
        let mut state = shared.lock();
        if state.closed {
            return Err(PoolError::Closed);
        }
        let now = shared.now();
        // Dead jobs hold no places.
        let dead = state.take_dead(now);
        state.forget_cancelled();
        let done = if continues {
            Ok((state.scheduler.continue_call(now, ask, payload), 0, None))
        } else {
            match state.scheduler.admit(now, ask, payload) {
                Ok(admitted) => Ok((admitted.id, admitted.position, admitted.shed)),
                Err(refused) => Err(refused),
            }
        };
        // Jobs are dropped outside the lock: what they hold may need it.
        drop(state);
        shared.wake.notify_all();
        dead.into_iter().for_each(Job::refuse_dead);
        match done {
            Ok((id, position, shed)) => {
                if let Some(shed) = shed {
                    (shed.payload.refuse)(PoolError::Shed { retry_after: shed.retry_after });
                }
                Ok(Ticket::new(position, Some(id), Arc::clone(shared), receiver))
            }
            Err(Refused { why, retry_after, .. }) => {
                Err(PoolError::of_refusal(why, retry_after, self.config.queue, order))
            }
        }
    }
}

impl PoolError {
    /// What the scheduler's refusal means to a caller, where so many may wait.
    pub(crate) fn of_refusal(why: Refusal, retry_after: Duration, limit: usize, order: &Order) -> Self {
        match why {
            Refusal::Full { waiting } => Self::Full { waiting, limit, retry_after },
            Refusal::CannotFinish { needs, left } => Self::CannotFinish { needs, left, retry_after },
            Refusal::InTheWay => {
                let needs = order.estimate.least;
                Self::CannotFinish { needs, left: Duration::ZERO, retry_after }
            }
        }
    }
}

/// The two ways in which a job ends: it runs, or it is refused. Only one of both is called.
fn both_ends<T, F>(sender: oneshot::Sender<Result<T, PoolError>>, queued_at: Instant, job: F) -> (Run, Refuse)
where
    T: Send + 'static,
    F: FnOnce(Turn) -> T + Send + 'static,
{
    let sender = Arc::new(Mutex::new(Some(sender)));
    let answer = move |result: Result<T, PoolError>| {
        if let Some(sender) = sender.lock().unwrap_or_else(PoisonError::into_inner).take() {
            // The caller may be gone; then nobody needs the result.
            sender.send(result).ok();
        }
    };
    let refuse: Refuse = {
        let answer = answer.clone();
        Box::new(move |error| answer(Err(error)))
    };
    let run: Run = Box::new(move |cores, mut turn| {
        turn.queued = queued_at.elapsed();
        let result = catch_unwind(AssertUnwindSafe(|| cores.run(|| job(turn))));
        let result = result.map_err(|panic| {
            let said = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
            let said = said.or_else(|| panic.downcast_ref::<String>().cloned());
            tracing::error!(panic = said.unwrap_or_default(), "planning job panicked");
            PoolError::Panicked
        });
        Box::new(move || answer(result))
    });
    (run, refuse)
}

impl Drop for Pool {
    fn drop(&mut self) {
        self.close();
    }
}

#[cfg(test)]
mod schedules;
#[cfg(test)]
mod tests;
