//! The state machine: waiting jobs, running jobs, and the rules of the crate's documentation.

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::time::Duration;

use crate::admission::Forecast;
use crate::fairness::Usage;
use crate::types::{
    Admitted, Ask, Begun, Config, Estimate, Fit, Flow, JobId, Priority, Refusal, Refused, Shed, Time,
};

/// One in so many jobs that begin may be the one that has waited longest.
pub const RELIEF: u32 = 8;
/// A job that was told to stop is expected to need this long for it.
const STOPPING: Duration = Duration::from_millis(5);
/// Nobody is asked to come back sooner than this, or later than the other.
const RETRY: (Duration, Duration) = (Duration::from_millis(10), Duration::from_secs(30));

/// A job that waits.
#[derive(Debug)]
pub(crate) struct Waiting<T> {
    pub(crate) id: JobId,
    pub(crate) ask: Ask,
    /// Continues a call that was admitted: not counted, not refused, not shed.
    continues: bool,
    payload: T,
}

/// A job that runs.
#[derive(Debug)]
pub(crate) struct Running {
    pub(crate) ask: Ask,
    pub(crate) began: Time,
    /// What was charged for it when it began.
    charged: Duration,
    /// It was told to stop and will in a moment.
    stops: bool,
}

/// Jobs that wait and run.
#[derive(Debug)]
pub struct Scheduler<T> {
    config: Config,
    waiting: Vec<Waiting<T>>,
    running: BTreeMap<JobId, Running>,
    callers: Usage,
    hands: Usage,
    next_id: u64,
    /// Jobs that have begun since the last relief.
    since_relief: u32,
}

/// Smaller begins earlier.
pub(crate) type Rank = (Reverse<Priority>, bool, bool, Time, Time, JobId);

impl<T> Scheduler<T> {
    /// An empty scheduler. Fewer than one slot are taken as one.
    pub fn new(config: Config) -> Self {
        Self {
            config: Config { slots: config.slots.max(1), ..config },
            waiting: Vec::new(),
            running: BTreeMap::new(),
            callers: Usage::default(),
            hands: Usage::default(),
            next_id: 0,
            since_relief: 0,
        }
    }

    /// Its size.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Says how many jobs of any priority may run at the same time from now on; fewer than one are taken as one. Jobs that
    /// run already run on.
    pub fn set_slots(&mut self, slots: usize) {
        self.config.slots = slots.max(1);
    }

    /// Jobs that wait, those that continue a call included.
    pub fn waiting(&self) -> usize {
        self.waiting.len()
    }

    /// Calls of which no job has begun.
    pub fn calls_waiting(&self) -> usize {
        self.waiting.iter().filter(|w| !w.continues).count()
    }

    /// Jobs that run.
    pub fn running(&self) -> usize {
        self.running.len()
    }

    /// Jobs that wait, by what they asked for.
    pub fn waiting_asks(&self) -> impl Iterator<Item = &Ask> {
        self.waiting.iter().map(|w| &w.ask)
    }

    /// What the owner gave with the jobs that wait.
    pub fn waiting_payloads(&self) -> impl Iterator<Item = (JobId, &T)> {
        self.waiting.iter().map(|w| (w.id, &w.payload))
    }

    /// Queues a call, or refuses it.
    ///
    /// # Errors
    /// [`Refused`] with the payload and when to try again.
    pub fn admit(&mut self, now: Time, ask: Ask, payload: T) -> Result<Admitted<T>, Refused<T>> {
        let id = JobId(self.next_id);
        let limit = self.config.queue + self.free_slots(ask.priority);
        let waiting = self.calls_waiting();
        let victim = match waiting < limit {
            true => None,
            false => match self.victim(now, &ask) {
                Some(victim) => Some(victim),
                None => {
                    let retry_after = self.forecast(now).next_free();
                    return Err(refused(Refusal::Full { waiting }, retry_after, payload));
                }
            },
        };
        if let Err((why, retry_after)) = self.check_time(now, id, &ask, victim) {
            return Err(refused(why, retry_after, payload));
        }
        let shed = victim.map(|at| {
            let gone = self.waiting.swap_remove(at);
            let retry_after = self.forecast(now).next_free().clamp(RETRY.0, RETRY.1);
            Shed { id: gone.id, payload: gone.payload, retry_after }
        });
        let (id, position) = self.push(now, ask, payload, false);
        Ok(Admitted { id, position, shed })
    }

    /// Queues a job that continues a call that was admitted. Never refused: how many there are is for the owner to
    /// limit.
    pub fn continue_call(&mut self, now: Time, ask: Ask, payload: T) -> JobId {
        self.push(now, ask, payload, true).0
    }

    /// The job that begins now, if one can. `fit` is asked about waiting jobs in their order and has the last word.
    pub fn take(&mut self, now: Time, mut fit: impl FnMut(&T) -> Fit) -> Option<Begun<T>> {
        let total = self.config.slots + self.config.servo_slots;
        if self.waiting.is_empty() || self.running.len() >= total {
            return None;
        }
        let ordinary_free = self.free_slots(Priority::Normal) > 0;
        let ranks = self.ranks(now);
        let mut order: Vec<usize> = (0..self.waiting.len()).collect();
        order.sort_unstable_by_key(|&i| ranks[i]);
        let relieved = (self.since_relief + 1 >= RELIEF).then(|| self.longest_waiting(now)).flatten();
        if let Some(longest) = relieved {
            order.retain(|&i| i != longest);
            order.insert(0, longest);
        }
        let chosen = order.into_iter().find(|&i| {
            let job = &self.waiting[i];
            (ordinary_free || job.ask.priority == Priority::Servo) && fit(&job.payload) == Fit::Now
        })?;
        let relieved = relieved == Some(chosen);
        self.since_relief = if relieved { 0 } else { self.since_relief.saturating_add(1) };
        let Waiting { id, ask, payload, .. } = self.waiting.swap_remove(chosen);
        self.charge(&ask, ask.estimate.expected.as_secs_f64(), now);
        self.running.insert(id, Running { ask, began: now, charged: ask.estimate.expected, stops: false });
        Some(Begun { id, payload, ask, relieved })
    }

    /// A job has ended. False for one that does not run.
    pub fn end(&mut self, now: Time, id: JobId) -> bool {
        let Some(Running { ask, began, charged, .. }) = self.running.remove(&id) else { return false };
        let took = now.saturating_sub(began);
        self.charge(&ask, took.as_secs_f64() - charged.as_secs_f64(), now);
        true
    }

    /// Takes a waiting job out of the queue: its caller is gone.
    pub fn withdraw(&mut self, id: JobId) -> Option<T> {
        let at = self.waiting.iter().position(|w| w.id == id)?;
        Some(self.waiting.swap_remove(at).payload)
    }

    /// Takes every waiting job out of the queue whose deadline is now or was before.
    pub fn expire(&mut self, now: Time) -> Vec<(JobId, T)> {
        let gone = self.waiting.extract_if(.., |w| w.ask.deadline.is_some_and(|d| d <= now));
        gone.map(|w| (w.id, w.payload)).collect()
    }

    /// When the next waiting job expires.
    pub fn next_expiry(&self) -> Option<Time> {
        self.waiting.iter().filter_map(|w| w.ask.deadline).min()
    }

    /// Takes everything out of the queue: the end.
    pub fn clear(&mut self) -> Vec<(JobId, T)> {
        self.waiting.drain(..).map(|w| (w.id, w.payload)).collect()
    }

    /// Says how long a running job will take after all, from its beginning.
    pub fn expect(&mut self, id: JobId, expected: Duration) {
        if let Some(running) = self.running.get_mut(&id) {
            running.ask.estimate.expected = expected;
        }
    }

    /// Says that a running job was told to stop: nobody waits for the rest of what it was expected to take.
    pub fn stops(&mut self, id: JobId) {
        if let Some(running) = self.running.get_mut(&id) {
            running.stops = true;
        }
    }

    /// True if the running job `id` could go on for `more` from now without making a waiting call of the same or a
    /// higher priority miss its deadline that would otherwise meet it.
    pub fn has_time(&self, now: Time, id: JobId, more: Duration) -> bool {
        let Some(job) = self.running.get(&id) else { return true };
        let order = self.in_order(now, None);
        let asks = order.iter().map(|&i| &self.waiting[i].ask);
        let asks: Vec<&Ask> = asks.filter(|ask| ask.priority >= job.ask.priority).collect();
        let least = job.ask.estimate.least.saturating_sub(now.saturating_sub(job.began));
        let meets = |busy: Duration| self.forecast_with(now, Some((id, busy))).meets(&asks);
        meets(least).into_iter().zip(meets(more)).all(|(before, after)| after || !before)
    }

    fn push(&mut self, now: Time, ask: Ask, payload: T, continues: bool) -> (JobId, usize) {
        let id = JobId(self.next_id);
        self.next_id += 1;
        self.waiting.push(Waiting { id, ask, continues, payload });
        let ranks = self.ranks(now);
        let own = ranks.last().copied();
        (id, ranks.iter().filter(|r| Some(**r) < own).count())
    }

    fn charge(&mut self, ask: &Ask, seconds: f64, now: Time) {
        self.callers.charge(ask.caller, seconds, now);
        self.hands.charge(ask.hand, seconds, now);
    }

    /// Slots that a job of that priority could take now.
    fn free_slots(&self, priority: Priority) -> usize {
        let all = (self.config.slots + self.config.servo_slots).saturating_sub(self.running.len());
        if priority == Priority::Servo {
            return all;
        }
        let ordinary = self.running.values().filter(|r| r.ask.priority != Priority::Servo).count();
        self.config.slots.saturating_sub(ordinary).min(all)
    }

    /// Checks that a newcomer can finish in time, and that nobody misses a deadline for it who would else meet it.
    fn check_time(
        &self,
        now: Time,
        id: JobId,
        ask: &Ask,
        victim: Option<usize>,
    ) -> Result<(), (Refusal, Duration)> {
        if self.config.plain_fifo {
            return Ok(());
        }
        // Ordinary calls are not before servo calls and have no share in their slots.
        let order = self.in_order(now, victim);
        let peers: Vec<(Rank, &Ask)> = {
            let ranks = self.ranks(now);
            order.iter().map(|&i| (ranks[i], &self.waiting[i].ask)).collect()
        };
        let own = self.rank(now, id, ask, self.least_used(now, Some(ask)));
        let at = peers.partition_point(|(rank, _)| *rank < own);
        let before: Vec<&Ask> = peers.iter().map(|(_, ask)| *ask).collect();
        let mut after = before.clone();
        after.insert(at, ask);
        let forecast =
            if ask.priority == Priority::Servo { self.servo_forecast(now) } else { self.forecast(now) };
        let finish = forecast.finish(&after, at);
        if let Some(deadline) = ask.deadline
            && finish > deadline
        {
            let needs = finish.saturating_sub(now);
            let left = deadline.saturating_sub(now);
            return Err((Refusal::CannotFinish { needs, left }, needs.saturating_sub(left)));
        }
        if ask.priority == Priority::Servo {
            return Ok(());
        }
        let mut with = forecast.meets(&after);
        with.remove(at);
        let hurt = forecast.meets(&before).into_iter().zip(with).zip(&before);
        let mut hurt = hurt.filter(|((without, with), other)| {
            *without && !*with && other.priority >= ask.priority && other.priority != Priority::Servo
        });
        match hurt.next() {
            Some(_) => Err((Refusal::InTheWay, ask.estimate.least)),
            None => Ok(()),
        }
    }

    /// The waiting job that goes where there is no place for a newcomer.
    fn victim(&self, now: Time, ask: &Ask) -> Option<usize> {
        if self.config.plain_fifo {
            return None;
        }
        let ranks = self.ranks(now);
        let last = |keep: &dyn Fn(&Waiting<T>) -> bool| {
            let calls = self.waiting.iter().enumerate().filter(|(_, w)| !w.continues && keep(w));
            calls.max_by_key(|(i, _)| ranks[*i]).map(|(i, _)| i)
        };
        let places =
            |caller: Flow| self.waiting.iter().filter(|w| !w.continues && w.ask.caller == caller).count();
        last(&|w| w.ask.priority < ask.priority).or_else(|| {
            let own = places(ask.caller);
            last(&|w| w.ask.priority == ask.priority && places(w.ask.caller) >= own + 2)
        })
    }

    /// The job that has waited longest, if that is longer than anybody should.
    fn longest_waiting(&self, now: Time) -> Option<usize> {
        if self.config.plain_fifo {
            return None;
        }
        let patience = self.config.patience;
        let late = self.waiting.iter().enumerate();
        let late = late.filter(|(_, w)| now.saturating_sub(w.ask.arrived) > patience);
        late.min_by_key(|(_, w)| (w.ask.arrived, w.id)).map(|(i, _)| i)
    }

    /// Waiting jobs as they would begin, all but one.
    fn in_order(&self, now: Time, without: Option<usize>) -> Vec<usize> {
        let ranks = self.ranks(now);
        let mut order: Vec<usize> = (0..self.waiting.len()).filter(|&i| Some(i) != without).collect();
        order.sort_unstable_by_key(|&i| ranks[i]);
        order
    }

    fn ranks(&self, now: Time) -> Vec<Rank> {
        let least = self.least_used(now, None);
        self.waiting.iter().map(|w| self.rank(now, w.id, &w.ask, least)).collect()
    }

    /// What the most modest of the waiting callers and hands has had.
    fn least_used(&self, now: Time, newcomer: Option<&Ask>) -> (f64, f64) {
        let asks = || self.waiting.iter().map(|w| &w.ask).chain(newcomer);
        (self.callers.least(asks().map(|a| a.caller), now), self.hands.least(asks().map(|a| a.hand), now))
    }

    fn rank(&self, now: Time, id: JobId, ask: &Ask, (caller, hand): (f64, f64)) -> Rank {
        if self.config.plain_fifo {
            return (Reverse(Priority::Normal), false, false, ask.arrived, ask.arrived, id);
        }
        let due = ask.deadline.unwrap_or(ask.arrived + self.config.patience);
        (
            Reverse(ask.priority),
            self.callers.is_over(ask.caller, caller, now),
            self.hands.is_over(ask.hand, hand, now),
            due,
            ask.arrived,
            id,
        )
    }

    fn forecast(&self, now: Time) -> Forecast {
        self.forecast_with(now, None)
    }

    fn forecast_with(&self, now: Time, instead: Option<(JobId, Duration)>) -> Forecast {
        Forecast::new(now, self.config.slots, self.busy(now, instead))
    }

    fn servo_forecast(&self, now: Time) -> Forecast {
        Forecast::new(now, self.config.slots + self.config.servo_slots, self.busy(now, None))
    }

    /// When each running job is expected to end.
    fn busy(&self, now: Time, instead: Option<(JobId, Duration)>) -> Vec<Time> {
        let left = |id: JobId, running: &Running| match instead {
            Some((other, left)) if other == id => left,
            _ if running.stops => STOPPING,
            _ => {
                let ran = now.saturating_sub(running.began);
                let Estimate { expected, .. } = running.ask.estimate;
                // One that is late already will be for a while.
                expected.saturating_sub(ran).max(if ran > expected { ran / 4 } else { Duration::ZERO })
            }
        };
        self.running.iter().map(|(id, running)| now + left(*id, running)).collect()
    }
}

fn refused<T>(why: Refusal, retry_after: Duration, payload: T) -> Refused<T> {
    Refused { why, retry_after: retry_after.clamp(RETRY.0, RETRY.1), payload }
}
