//! What a scheduler is asked and what it answers.

use std::time::Duration;

/// A moment, as time since an epoch of the owner's choice.
pub type Time = Duration;

/// How urgent a call is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub enum Priority {
    /// Work that may wait: evaluation, recording.
    Low,
    /// The default.
    #[default]
    Normal,
    /// A robot stands still until it is answered.
    High,
    /// A correction of a motion under way: has slots of its own.
    Servo,
}

impl Priority {
    /// All, the least urgent first.
    pub const ALL: [Self; 4] = [Self::Low, Self::Normal, Self::High, Self::Servo];

    /// Name in lower case, for logs and metrics.
    pub fn name(self) -> &'static str {
        match self {
            Self::Low => "low",
            Self::Normal => "normal",
            Self::High => "high",
            Self::Servo => "servo",
        }
    }
}

/// A caller or a hand, by a number that the owner gives it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Flow(pub u64);

/// A job, unique in its scheduler.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct JobId(pub(crate) u64);

/// How long a job is expected to run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Estimate {
    /// The least that gives an answer worth having; what must fit before the deadline.
    pub least: Duration,
    /// What it will take of its slot; what others wait for.
    pub expected: Duration,
}

/// A job as its caller asks for it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ask {
    /// How urgent it is.
    pub priority: Priority,
    /// Who asks.
    pub caller: Flow,
    /// For which hand.
    pub hand: Flow,
    /// When the call arrived; what continues a call keeps its call's place.
    pub arrived: Time,
    /// When work must have ended, if ever.
    pub deadline: Option<Time>,
    /// How long it is expected to run.
    pub estimate: Estimate,
}

/// Size of a scheduler.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Config {
    /// Jobs of any priority that run at the same time.
    pub slots: usize,
    /// Slots beyond these that only servo jobs take.
    pub servo_slots: usize,
    /// Calls that may wait beyond free slots.
    pub queue: usize,
    /// A job without a deadline is ordered as if it had this much time, and one that has waited so long is relieved.
    pub patience: Duration,
    /// For comparison: jobs begin in the order of their arrival, and nothing is refused but by a full queue.
    pub plain_fifo: bool,
}

/// Whether a waiting job can begin now.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fit {
    /// It can.
    Now,
    /// It waits for something else than a slot.
    NotYet,
}

/// A job that was queued.
#[derive(Debug, PartialEq, Eq)]
pub struct Admitted<T> {
    /// Its name.
    pub id: JobId,
    /// Jobs before it.
    pub position: usize,
    /// A job that had to go for it; it has ended with that.
    pub shed: Option<Shed<T>>,
}

/// A waiting job that lost its place to a more urgent one.
#[derive(Debug, PartialEq, Eq)]
pub struct Shed<T> {
    /// Its name.
    pub id: JobId,
    /// What the owner gave with it.
    pub payload: T,
    /// When to try again.
    pub retry_after: Duration,
}

/// Why a job was not queued.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    /// There is no place.
    Full {
        /// Calls that wait.
        waiting: usize,
    },
    /// It could not finish before its deadline.
    CannotFinish {
        /// How long it would take, from now.
        needs: Duration,
        /// How long it has, from now.
        left: Duration,
    },
    /// It would make a waiting call of the same or a higher priority miss its deadline.
    InTheWay,
}

/// A job that was not queued; it has ended with that.
#[derive(Debug, PartialEq, Eq)]
pub struct Refused<T> {
    /// Why.
    pub why: Refusal,
    /// When to try again.
    pub retry_after: Duration,
    /// What the owner gave with it.
    pub payload: T,
}

/// A job that begins.
#[derive(Debug, PartialEq, Eq)]
pub struct Begun<T> {
    /// Its name, for [`Scheduler::end`](crate::Scheduler::end).
    pub id: JobId,
    /// What the owner gave with it.
    pub payload: T,
    /// What was asked.
    pub ask: Ask,
    /// It begins because it has waited longest, not because it is first in order.
    pub relieved: bool,
}
