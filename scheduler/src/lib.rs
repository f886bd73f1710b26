//! Which job begins next, which waits, and which is refused: a pure state machine.
//!
//! No clock, no threads, no sockets: the owner says what time it is ([`Time`], a duration since an epoch of the
//! owner's choice), runs what [`Scheduler::take`] gives out, and reports each end. The rules, in this order:
//!
//! 1. **Bound.** At most [`Config::queue`] calls wait beyond the free slots. Where there is no place, the last in
//!    order goes if the newcomer is of a higher priority, or if its caller holds more places than the newcomer's
//!    by two or more; else the newcomer is refused.
//! 2. **Admission.** A call that cannot finish before its deadline behind what is before it is refused at once, and
//!    so is one that would make a waiting call of the same or a higher priority miss its own.
//! 3. **Order.** Higher priority first; then those whose caller, then those whose hand, has had no more than its
//!    fair share of time lately; then the earlier deadline; then the earlier arrival.
//! 4. **No starvation.** One in [`RELIEF`] jobs that begin is the one that has waited longest, if it has waited
//!    longer than [`Config::patience`].
//! 5. **Room for servo.** Ordinary jobs never take the last [`Config::servo_slots`] slots.
//! 6. **Expiry.** A waiting job leaves at its deadline ([`Scheduler::expire`]), not when its turn comes.

mod admission;
mod fairness;
mod scheduler;
mod types;

pub use scheduler::{RELIEF, Scheduler};
pub use types::{
    Admitted, Ask, Begun, Config, Estimate, Fit, Flow, JobId, Priority, Refusal, Refused, Shed, Time,
};

#[cfg(test)]
mod laws;
