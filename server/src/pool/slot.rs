//! A slot: a thread that takes one job after the other, and what slots and callers share.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

use graspd_planner::budget::{Budget as _, Stop};
use graspd_scheduler::{Fit, JobId, Scheduler, Time};

use super::sync::{Condvar, Cores, Mutex, MutexGuard};
use super::{Gate, Look, PoolError, Priority, SceneRoom, Turn};
use crate::deadline::CallBudget;

/// Runs a job and gives back what tells its caller, to be called when the slot is free again.
pub(super) type Run = Box<dyn FnOnce(&Cores, Turn) -> Box<dyn FnOnce() + Send> + Send>;
pub(super) type Refuse = Box<dyn FnOnce(PoolError) + Send>;

/// A job as the scheduler keeps it.
pub(super) struct Job {
    pub(super) budget: CallBudget,
    pub(super) gate: Option<Arc<dyn Gate>>,
    /// Runs the job and answers its ticket.
    pub(super) run: Run,
    /// Answers its ticket without running it. Shares the ticket with `run`; only one of both is called.
    pub(super) refuse: Refuse,
}

impl Job {
    pub(super) fn refuse_dead(self) {
        let error = match self.budget.stop() {
            Some(Stop::Cancelled) => PoolError::Cancelled,
            _ => PoolError::Expired,
        };
        (self.refuse)(error);
    }
}

pub(super) struct State {
    pub(super) scheduler: Scheduler<Job>,
    /// Room that scenes take.
    pub(super) room_taken: usize,
    /// Budgets of the jobs that run.
    pub(super) running: Vec<(JobId, CallBudget)>,
    pub(super) closed: bool,
}

impl State {
    /// Takes every job out of the queue that need not run any more.
    pub(super) fn take_dead(&mut self, now: Time) -> Vec<Job> {
        let mut dead: Vec<Job> = self.scheduler.expire(now).into_iter().map(|(_, job)| job).collect();
        let cancelled: Vec<JobId> = (self.scheduler.waiting_payloads())
            .filter(|(_, job)| job.budget.is_cancelled())
            .map(|(id, _)| id)
            .collect();
        dead.extend(cancelled.into_iter().filter_map(|id| self.scheduler.withdraw(id)));
        dead
    }

    /// Tells the scheduler which running jobs have nobody any more who waits for them: they end in a moment, and no
    /// newcomer is refused for what they would have taken.
    pub(super) fn forget_cancelled(&mut self) {
        for (id, budget) in &self.running {
            if budget.is_cancelled() {
                self.scheduler.stops(*id);
            }
        }
    }

    /// Takes the first job that can begin, and the room for its scene. Where one has to wait for room, no
    /// other scene may overtake it (a large one would wait for ever), but jobs that read none may.
    fn take_next(&mut self, now: Time, room_limit: usize) -> Option<Taken> {
        let mut room_left = room_limit.saturating_sub(self.room_taken);
        let mut room = 0;
        let begun = self.scheduler.take(now, |job| {
            room = 0;
            match job.gate.as_ref().map_or(Look::Open, |gate| gate.look()) {
                Look::Open => Fit::Now,
                Look::Shut => Fit::NotYet,
                Look::Needs(needed) if needed.min(room_limit) > room_left => {
                    room_left = 0;
                    Fit::NotYet
                }
                Look::Needs(needed) => {
                    room = needed.min(room_limit);
                    if let Some(gate) = &job.gate {
                        gate.begin();
                    }
                    Fit::Now
                }
            }
        })?;
        self.room_taken += room;
        self.running.push((begun.id, begun.payload.budget.clone()));
        Some(Taken { id: begun.id, job: begun.payload, room, priority: begun.ask.priority })
    }
}

/// A job that begins.
struct Taken {
    id: JobId,
    job: Job,
    /// Room that its scene takes.
    room: usize,
    priority: Priority,
}

/// A servo is at work for so long after its last frame.
const SERVO_LASTS: Duration = Duration::from_secs(1);
/// Plans are so much nicer still while a servo is at work.
const YIELDING: u8 = 10;

/// The threads of one slot, by how nice they are. The frame of a servo needs the cores now, for some milliseconds: its threads
/// are as nice as the process. A plan beside it can do without them for so long: jobs that begin while a servo is at work
/// are nicer than the settings say. A thread that was made nicer cannot be made less so without privileges, hence sets
/// of threads; all but the ordinary one are started when they are needed first.
pub(super) struct SlotCores {
    ordinary: Cores,
    urgent: Option<Cores>,
    yielding: Option<Cores>,
    slot: usize,
    threads: usize,
    nice: u8,
}

impl SlotCores {
    /// Starts the ordinary threads of slot number `slot`.
    pub(super) fn start(slot: usize, threads: usize, nice: u8) -> Result<Self, super::sync::CoresError> {
        let ordinary = Cores::start(slot, threads, nice)?;
        Ok(Self { ordinary, urgent: None, yielding: None, slot, threads, nice })
    }

    /// The threads for a job of that priority, `beside_servo` if a servo is at work.
    fn of(&mut self, priority: Priority, beside_servo: bool) -> &Cores {
        // Where planning is to hold its share, nothing is nicer than anything.
        let (set, nice) = match priority {
            _ if self.nice == 0 => return &self.ordinary,
            Priority::Servo => (&mut self.urgent, 0),
            _ if beside_servo => (&mut self.yielding, self.nice.saturating_add(YIELDING)),
            _ => return &self.ordinary,
        };
        if set.is_none() {
            match Cores::start(self.slot, self.threads, nice) {
                Ok(cores) => *set = Some(cores),
                Err(error) => tracing::warn!(%error, "servo frames and plans share their threads"),
            }
        }
        set.as_ref().unwrap_or(&self.ordinary)
    }
}

/// What the slots and the callers of a pool share.
pub(super) struct Shared {
    pub(super) epoch: Instant,
    pub(super) state: Mutex<State>,
    pub(super) wake: Condvar,
    /// When the newest servo job began.
    pub(super) servo_at: Mutex<Option<Instant>>,
    /// The longest that a job has run on after it was cancelled, microseconds.
    pub(super) slowest_release_us: AtomicU64,
    /// Jobs that ran when they were cancelled, by how long they ran on: up to each bound, and longer.
    pub(super) releases: [AtomicU64; RELEASE_BOUNDS_US.len() + 1],
}

/// Bounds of how long jobs run on after they were cancelled, microseconds.
pub(super) const RELEASE_BOUNDS_US: [u64; 5] = [1_000, 2_500, 5_000, 10_000, 50_000];

impl Shared {
    pub(super) fn lock(&self) -> MutexGuard<'_, State> {
        // Jobs run outside the lock, so a poisoned lock still holds a consistent state.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn now(&self) -> Time {
        self.epoch.elapsed()
    }

    /// A moment as the scheduler counts it.
    pub(super) fn time(&self, at: Instant) -> Time {
        at.saturating_duration_since(self.epoch)
    }

    /// Takes a job out of the queue whose caller is gone.
    pub(super) fn withdraw(&self, id: JobId) {
        let job = self.lock().scheduler.withdraw(id);
        if job.is_some() {
            // It may have been in the way of others.
            self.wake.notify_all();
        }
    }
}

/// The life of a slot: take the first job, run it, until the pool is closed.
pub(super) fn run_slot(shared: &Arc<Shared>, mut cores: SlotCores, room_limit: usize) {
    let mut state = shared.lock();
    loop {
        let now = shared.now();
        let dead = state.take_dead(now);
        if !dead.is_empty() {
            drop(state);
            dead.into_iter().for_each(Job::refuse_dead);
            state = shared.lock();
            continue;
        }
        if let Some(Taken { id, job, room, priority }) = state.take_next(now, room_limit) {
            drop(state);
            // What a job holds may need the lock when it is let go: nothing of it is left when the lock is taken again.
            let Job { budget, run, gate, refuse } = job;
            drop((gate, refuse));
            let turn = Turn::new(Arc::clone(shared), id, SceneRoom::new(Arc::clone(shared), room));
            if priority == Priority::Servo {
                *shared.servo_at.lock().unwrap_or_else(PoisonError::into_inner) = Some(Instant::now());
            }
            let servo_at = *shared.servo_at.lock().unwrap_or_else(PoisonError::into_inner);
            let beside_servo = servo_at.is_some_and(|at| at.elapsed() < SERVO_LASTS);
            let tell = run(cores.of(priority, beside_servo), turn);
            if let Some(since) = budget.cancelled_for() {
                let us = u64::try_from(since.as_micros()).unwrap_or(u64::MAX);
                shared.slowest_release_us.fetch_max(us, Ordering::Relaxed);
                let bucket = RELEASE_BOUNDS_US.iter().position(|bound| us <= *bound);
                if let Some(count) = shared.releases.get(bucket.unwrap_or(RELEASE_BOUNDS_US.len())) {
                    count.fetch_add(1, Ordering::Relaxed);
                }
            }
            state = shared.lock();
            state.scheduler.end(shared.now(), id);
            state.running.retain(|(running, _)| *running != id);
            drop(state);
            shared.wake.notify_all();
            tell();
            state = shared.lock();
        } else if state.closed {
            return;
        } else {
            state = shared.wake.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }
}
