//! Locks, threads and cores of the pool: the system's; with the feature `shuttle` those of a scheduler that runs
//! one thread at a time and chooses at random which, so that tests see many orders of the same events.

#[cfg(not(feature = "shuttle"))]
pub(super) use std::sync::{Condvar, Mutex, MutexGuard};
#[cfg(not(feature = "shuttle"))]
pub(super) use std::thread;

#[cfg(feature = "shuttle")]
pub(super) use shuttle::sync::{Condvar, Mutex, MutexGuard};
#[cfg(feature = "shuttle")]
pub(super) use shuttle::thread;

/// Why threads do not start.
#[cfg(not(feature = "shuttle"))]
pub(super) type CoresError = rayon::ThreadPoolBuildError;
#[cfg(feature = "shuttle")]
pub(super) type CoresError = std::convert::Infallible;

/// The cores of a slot: parallel iterators of its jobs run on them.
#[cfg(not(feature = "shuttle"))]
pub(super) struct Cores(rayon::ThreadPool);

#[cfg(not(feature = "shuttle"))]
impl Cores {
    /// Starts the threads of slot number `slot`, which are so much nicer than the one that calls this.
    ///
    /// # Errors
    /// What the system said.
    pub(super) fn start(slot: usize, threads: usize, nice: u8) -> Result<Self, CoresError> {
        let builder = rayon::ThreadPoolBuilder::new().num_threads(threads.max(1));
        let builder = builder.start_handler(move |_| {
            be_nicer(nice);
            if nice > 0 {
                crate::give_way::begin();
            }
        });
        builder.thread_name(move |i| format!("plan-{slot}-{i}")).build().map(Self)
    }

    /// Runs a job on them.
    pub(super) fn run<R: Send>(&self, job: impl FnOnce() -> R + Send) -> R {
        self.0.install(job)
    }
}

/// Lowers the claim of this thread to a core, where others want it too. What the system refuses stays as it was.
#[cfg(all(not(feature = "shuttle"), target_os = "linux"))]
fn be_nicer(by: u8) {
    // On Linux each thread has a niceness of its own, and nobody is that of the calling one.
    use rustix::process::{getpriority_process, setpriority_process};
    let own = getpriority_process(None).unwrap_or(0);
    if let Err(error) = setpriority_process(None, (own + i32::from(by)).min(19)) {
        tracing::warn!(%error, "planning threads are not nicer than others");
    }
}

#[cfg(all(not(feature = "shuttle"), not(target_os = "linux")))]
fn be_nicer(_by: u8) {}

/// Under `shuttle` a job runs in its slot's own thread: others are not that scheduler's.
#[cfg(feature = "shuttle")]
pub(super) struct Cores;

#[cfg(feature = "shuttle")]
impl Cores {
    pub(super) fn start(_slot: usize, _threads: usize, _nice: u8) -> Result<Self, CoresError> {
        Ok(Self)
    }

    pub(super) fn run<R: Send>(&self, job: impl FnOnce() -> R + Send) -> R {
        job()
    }
}
