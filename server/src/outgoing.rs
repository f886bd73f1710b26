//! Calls that an engine elsewhere plans, before they go there: who is next, who is refused.
//!
//! A broker keeps jobs in the order of their priority and arrival and knows no callers. So a server hands on only as many
//! jobs as are likely to be begun soon; the rest waits here, by the rules that one machine's own queue has: a bound,
//! admission by estimate, order by priority, fair shares of callers and hands, and deadline.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use graspd_scheduler::{Admitted, Ask, Config, Fit, JobId, Priority, Refused, Scheduler, Time};
use tokio::sync::oneshot;

use crate::deadline::CallBudget;
use crate::pool::{Order, PATIENCE, PoolError};

/// While nobody knows how many jobs are planned at the same time, so many are handed on: what waits then waits in the
/// broker, whose own bound counts.
const UNKNOWN: usize = 1024;
/// One job more than are planned is handed on, so that whoever is ready with one finds the next.
const AHEAD: usize = 1;

/// The calls that wait for their turn, and those that have it.
#[derive(Debug)]
pub(crate) struct Outgoing(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    epoch: Instant,
    limit: usize,
    scheduler: Mutex<Scheduler<Waiter>>,
}

/// Told when its turn comes, or that it lost its place.
type Waiter = oneshot::Sender<Result<Pass, PoolError>>;

impl Outgoing {
    /// At most `limit` calls wait.
    pub(crate) fn new(limit: usize, plain_fifo: bool) -> Self {
        let config = Config { slots: UNKNOWN, servo_slots: 0, queue: limit, patience: PATIENCE, plain_fifo };
        let scheduler = Mutex::new(Scheduler::new(config));
        Self(Arc::new(Shared { epoch: Instant::now(), limit, scheduler }))
    }

    /// So many jobs are planned at the same time elsewhere; 0: nobody knows.
    pub(crate) fn set_slots(&self, slots: usize) {
        self.0.lock().set_slots(if slots == 0 { UNKNOWN } else { slots + AHEAD });
        self.0.dispatch();
    }

    /// Calls that wait, by priority.
    pub(crate) fn waiting_by_priority(&self) -> [usize; 4] {
        let scheduler = self.0.lock();
        Priority::ALL.map(|p| scheduler.waiting_asks().filter(|ask| ask.priority == p).count())
    }

    /// Takes a call in, or refuses it.
    ///
    /// # Errors
    /// As the planning pool's.
    pub(crate) fn admit(&self, budget: &CallBudget, order: &Order) -> Result<Waiting, PoolError> {
        let shared = &self.0;
        let (sender, receiver) = oneshot::channel();
        let ask = Ask {
            priority: order.priority,
            caller: order.caller,
            hand: order.hand,
            arrived: shared.time(budget.start()),
            deadline: budget.deadline().map(|d| shared.time(d)),
            estimate: order.estimate,
        };
        let now = shared.now();
        let (admitted, expired) = {
            let mut scheduler = shared.lock();
            // Who waits for them knows their deadline too; their places are free from now on.
            let expired = scheduler.expire(now);
            (scheduler.admit(now, ask, sender), expired)
        };
        for (_, waiter) in expired {
            waiter.send(Err(PoolError::Expired)).ok();
        }
        match admitted {
            Ok(Admitted { id, position, shed }) => {
                if let Some(shed) = shed {
                    let retry_after = shed.retry_after;
                    shed.payload.send(Err(PoolError::Shed { retry_after })).ok();
                }
                let waiting = Waiting {
                    position,
                    id,
                    receiver,
                    deadline: budget.deadline(),
                    shared: Arc::clone(shared),
                };
                shared.dispatch();
                Ok(waiting)
            }
            Err(Refused { why, retry_after, .. }) => {
                Err(PoolError::of_refusal(why, retry_after, shared.limit, order))
            }
        }
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Scheduler<Waiter>> {
        self.scheduler.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn now(&self) -> Time {
        self.epoch.elapsed()
    }

    fn time(&self, at: Instant) -> Time {
        at.saturating_duration_since(self.epoch)
    }

    /// Gives every free place to whoever is next.
    fn dispatch(self: &Arc<Self>) {
        loop {
            let begun = self.lock().take(self.now(), |_| Fit::Now);
            let Some(begun) = begun else { return };
            let pass = Pass { id: begun.id, shared: Arc::clone(self), began: Instant::now() };
            // Whoever is gone gives it back by dropping it, outside the lock.
            begun.payload.send(Ok(pass)).ok();
        }
    }
}

/// A call that waits for its turn. Dropping it gives up its place.
#[derive(Debug)]
pub(crate) struct Waiting {
    /// Calls before it when it came.
    pub(crate) position: usize,
    id: JobId,
    receiver: oneshot::Receiver<Result<Pass, PoolError>>,
    deadline: Option<Instant>,
    shared: Arc<Shared>,
}

impl Waiting {
    /// Ready when its turn has come.
    ///
    /// # Errors
    /// [`PoolError::Expired`] at its deadline, [`PoolError::Shed`] when it lost its place.
    pub(crate) async fn turn(mut self) -> Result<Pass, PoolError> {
        let told = match self.deadline {
            None => (&mut self.receiver).await,
            Some(deadline) => match tokio::time::timeout_at(deadline.into(), &mut self.receiver).await {
                Ok(told) => told,
                Err(_) => return Err(PoolError::Expired),
            },
        };
        told.unwrap_or(Err(PoolError::Closed))
    }
}

impl Drop for Waiting {
    fn drop(&mut self) {
        // Nothing where its turn has come. What was sent in the meantime is dropped with the receiver.
        drop(self.shared.lock().withdraw(self.id));
    }
}

/// A call's turn, until it is dropped.
#[derive(Debug)]
pub(crate) struct Pass {
    id: JobId,
    shared: Arc<Shared>,
    began: Instant,
}

impl Pass {
    /// Time since the turn began.
    pub(crate) fn elapsed(&self) -> Duration {
        self.began.elapsed()
    }
}

impl Drop for Pass {
    fn drop(&mut self) {
        self.shared.lock().end(self.shared.now(), self.id);
        self.shared.dispatch();
    }
}

#[cfg(test)]
mod tests {
    use graspd_scheduler::{Estimate, Flow};

    use super::*;

    fn budget(ms: Option<u64>) -> CallBudget {
        let now = Instant::now();
        CallBudget::new(now, ms.map(|ms| now + Duration::from_millis(ms)))
    }

    fn order(caller: u64, priority: Priority, estimate_ms: u64) -> Order {
        let takes = Duration::from_millis(estimate_ms);
        let estimate = Estimate { least: takes, expected: takes };
        Order { priority, caller: Flow(caller), hand: Flow(9), estimate }
    }

    async fn has_turn(waiting: &mut Waiting) -> bool {
        tokio::task::yield_now().await;
        !waiting.receiver.is_empty()
    }

    #[tokio::test]
    async fn as_many_have_a_turn_as_are_planned_and_one_more_and_the_next_comes_when_one_ends() {
        let outgoing = Outgoing::new(16, false);
        outgoing.set_slots(2);
        let admit = || outgoing.admit(&budget(None), &order(1, Priority::Normal, 10)).unwrap();
        let mut all: Vec<Waiting> = (0..5).map(|_| admit()).collect();
        let mut turns = Vec::new();
        for waiting in &mut all {
            turns.push(has_turn(waiting).await);
        }
        assert_eq!(turns, [true, true, true, false, false]);
        let mut all = all.into_iter();
        let first = all.next().unwrap().turn().await.unwrap();
        let mut rest: Vec<Waiting> = all.collect();
        drop(first);
        assert!(has_turn(&mut rest[2]).await && !has_turn(&mut rest[3]).await);
        // A turn that nobody takes up is given back.
        rest.remove(0);
        assert!(has_turn(&mut rest[2]).await);
        // More places, more turns; nobody knows: everybody.
        let mut more: Vec<Waiting> = (0..3).map(|_| admit()).collect();
        outgoing.set_slots(3);
        assert!(has_turn(&mut more[0]).await && !has_turn(&mut more[1]).await);
        outgoing.set_slots(0);
        assert!(has_turn(&mut more[2]).await);
        assert_eq!(outgoing.waiting_by_priority(), [0; 4]);
    }

    #[tokio::test]
    async fn what_cannot_finish_is_refused_and_the_bound_holds() {
        let outgoing = Outgoing::new(2, false);
        outgoing.set_slots(1);
        let mut held = Vec::new();
        for _ in 0..2 {
            let waiting = outgoing.admit(&budget(None), &order(1, Priority::Normal, 60_000)).unwrap();
            held.push(waiting.turn().await.unwrap());
        }
        let late = outgoing.admit(&budget(Some(1000)), &order(2, Priority::Normal, 10)).unwrap_err();
        assert!(matches!(late, PoolError::CannotFinish { .. }), "{late:?}");
        let patient = || outgoing.admit(&budget(None), &order(2, Priority::Normal, 10));
        let waiting = [patient().unwrap(), patient().unwrap()];
        assert!(matches!(patient().unwrap_err(), PoolError::Full { waiting: 2, limit: 2, .. }));
        // A more urgent call takes the place of the last one.
        let urgent = outgoing.admit(&budget(None), &order(3, Priority::High, 10)).unwrap();
        assert_eq!(outgoing.waiting_by_priority(), [0, 1, 1, 0]);
        let [first, last] = waiting;
        assert!(matches!(last.turn().await.unwrap_err(), PoolError::Shed { .. }));
        held.pop();
        urgent.turn().await.unwrap();
        first.turn().await.unwrap();
    }

    #[tokio::test]
    async fn a_call_that_waits_is_told_of_its_deadline_and_takes_no_place_after_it() {
        let outgoing = Outgoing::new(1, false);
        outgoing.set_slots(1);
        let mut held = Vec::new();
        for _ in 0..2 {
            let waiting = outgoing.admit(&budget(None), &order(1, Priority::Normal, 0)).unwrap();
            held.push(waiting.turn().await.unwrap());
        }
        let waiting = outgoing.admit(&budget(Some(20)), &order(1, Priority::Normal, 0)).unwrap();
        assert_eq!(waiting.turn().await.unwrap_err(), PoolError::Expired);
        let next = outgoing.admit(&budget(None), &order(1, Priority::Normal, 0)).unwrap();
        held.clear();
        next.turn().await.unwrap();
    }

    #[tokio::test]
    async fn a_modest_caller_does_not_wait_for_all_that_a_greedy_one_has_asked_for() {
        let outgoing = Outgoing::new(64, false);
        outgoing.set_slots(1);
        let mut greedy: Vec<Waiting> = (0..10)
            .map(|_| outgoing.admit(&budget(None), &order(1, Priority::Normal, 2000)).unwrap())
            .collect();
        let modest = outgoing.admit(&budget(None), &order(2, Priority::Normal, 2000)).unwrap();
        let first = greedy.remove(0).turn().await.unwrap();
        drop(first);
        tokio::time::timeout(Duration::from_secs(20), modest.turn()).await.unwrap().unwrap();
    }
}
