//! The thread that owns the world: it runs jobs between steps, and steps as its pace says.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, TryRecvError};
use std::time::{Duration, Instant};

use graspd_sim::world::World;

use crate::bins::{self, Bin, Delivered};
use crate::clock::Clock;

/// Something that takes time in the world, such as a motion: looked at after each step until it is done.
pub(crate) trait Process: Send {
    /// Looks at the world after a step, tells it what follows; true when all is done.
    fn after_step(&mut self, world: &mut World) -> bool;

    /// False for one that goes on while others let time go by, and lets none go by itself.
    fn takes_time(&self) -> bool {
        true
    }
}

/// Looks at the world now and then while it moves; never moves it.
pub(crate) struct Watcher {
    /// Steps between two looks.
    pub(crate) every: u64,
    pub(crate) look: Box<dyn FnMut(&World) + Send>,
}

/// What is done between two steps, on the world's thread.
pub(crate) type Job = Box<dyn FnOnce(&mut Stage) + Send>;

/// Steps between two looks into the bins.
const BIN_STEPS: u64 = 20;
/// When the world is behind by more than this (wall clock), it gives up catching up.
const LAG: Duration = Duration::from_millis(100);

/// The world and what is going on in it.
pub(crate) struct Stage {
    pub(crate) world: World,
    pub(crate) delivered: Vec<Delivered>,
    processes: Vec<Box<dyn Process>>,
    watchers: Vec<Watcher>,
    bins: Vec<Bin>,
    steps: u64,
}

impl Stage {
    pub(crate) fn new(world: World, bins: Vec<Bin>) -> Self {
        Self { world, delivered: Vec::new(), processes: Vec::new(), watchers: Vec::new(), bins, steps: 0 }
    }

    /// Starts something that takes time; it is looked at after the next step for the first time.
    pub(crate) fn start(&mut self, process: impl Process + 'static) {
        self.processes.push(Box::new(process));
    }

    /// Lets somebody watch from now on.
    pub(crate) fn watch(&mut self, watcher: Watcher) {
        self.watchers.push(watcher);
    }

    fn step(&mut self, clock: &Clock) {
        self.world.step();
        // Before any process answers: who is answered reads the time of the answer.
        clock.set(self.world.time_s());
        self.steps += 1;
        if self.steps.is_multiple_of(BIN_STEPS) {
            self.delivered.extend(bins::absorb(&mut self.world, &self.bins));
        }
        for watcher in &mut self.watchers {
            if self.steps.is_multiple_of(watcher.every) {
                (watcher.look)(&self.world);
            }
        }
        let world = &mut self.world;
        self.processes.retain_mut(|process| !process.after_step(world));
    }
}

/// What moves the world's clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Pace {
    /// It moves only while a process that takes time runs, as fast as the machine can.
    OnDemand,
    /// It moves all the time, this many times as fast as the wall clock.
    Wall(f64),
}

/// The wall clock's side of a paced world: where it should be by now.
struct Pacer {
    since: Instant,
    at_s: f64,
}

/// Runs until every sender of jobs is gone.
pub(crate) fn run(mut stage: Stage, jobs: &Receiver<Job>, clock: &Arc<Clock>, pace: Pace) {
    let mut pacer = Pacer { since: Instant::now(), at_s: stage.world.time_s() };
    loop {
        loop {
            match jobs.try_recv() {
                Ok(job) => job(&mut stage),
                Err(TryRecvError::Empty) => break,
                Err(TryRecvError::Disconnected) => return,
            }
        }
        let next = if clock.stands() {
            // Time that passes during a pause is not caught up with.
            pacer = Pacer { since: Instant::now(), at_s: stage.world.time_s() };
            Next::Sleep
        } else {
            match pace {
                Pace::OnDemand if !stage.processes.iter().any(|p| p.takes_time()) => Next::Sleep,
                Pace::OnDemand => Next::Step,
                Pace::Wall(speed) => pacer.next(stage.world.time_s(), speed),
            }
        };
        let job = match next {
            Next::Step => {
                stage.step(clock);
                None
            }
            Next::Sleep => match jobs.recv() {
                Ok(job) => Some(job),
                Err(_) => return,
            },
            Next::SleepFor(time) => match jobs.recv_timeout(time) {
                Ok(job) => Some(job),
                Err(RecvTimeoutError::Timeout) => None,
                Err(RecvTimeoutError::Disconnected) => return,
            },
        };
        if let Some(job) = job {
            job(&mut stage);
        }
    }
}

/// What the thread does next.
enum Next {
    Step,
    Sleep,
    SleepFor(Duration),
}

impl Pacer {
    fn next(&mut self, now_s: f64, speed: f64) -> Next {
        let due = self.since + crate::clock::duration((now_s - self.at_s) / speed);
        let now = Instant::now();
        if due > now {
            return Next::SleepFor(due - now);
        }
        if now - due > LAG {
            *self = Self { since: now, at_s: now_s };
        }
        Next::Step
    }
}
