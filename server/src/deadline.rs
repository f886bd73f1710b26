//! Time and cancellation of a call: when it arrived, when its answer is due, and whether anybody still waits.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use graspd_planner::budget::{Budget, Stop};
use tonic::codegen::http::HeaderMap;

use crate::give_way::give_way;
use crate::trace::TraceContext;

/// At most this much of a call's time is kept back for ranking, encoding and sending.
const MOST_RESERVE: Duration = Duration::from_millis(250);
/// A job that is later than this says something about itself, not about the next one.
const MOST_OVERRUN: Duration = Duration::from_millis(100);

/// When a call arrived and when its caller stops waiting.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CallClock {
    /// Arrival of the call's headers.
    pub(crate) arrived: Instant,
    /// `grpc-timeout`, if the caller sent one.
    pub(crate) timeout: Option<Duration>,
    /// What the call is part of.
    pub(crate) trace: TraceContext,
}

impl CallClock {
    /// Reads the clock of a call that arrives now.
    pub(crate) fn start(headers: &HeaderMap) -> Self {
        let timeout = headers.get("grpc-timeout").and_then(|v| v.to_str().ok()).and_then(parse_timeout);
        Self { arrived: Instant::now(), timeout, trace: TraceContext::of_call(headers) }
    }

    /// Time since the arrival.
    pub(crate) fn elapsed(&self) -> Duration {
        self.arrived.elapsed()
    }

    /// When planning must end so that its answer can be ranked, encoded and sent before the caller stops
    /// waiting. `overrun` is how far jobs have lately run past their end.
    pub(crate) fn planning_deadline(&self, overrun: Duration) -> Option<Instant> {
        let timeout = self.timeout?;
        let share = (timeout / 10).max(Duration::from_millis(10));
        // However late others were: planning gets most of the time.
        let reserve = share.max(overrun * 3 / 2).min(MOST_RESERVE).min(timeout / 5);
        self.arrived.checked_add(timeout.saturating_sub(reserve))
    }

    /// When an answer must leave even if it is only DEADLINE_EXCEEDED: before the transport's own timer,
    /// which would say CANCELLED.
    pub(crate) fn answer_deadline(&self) -> Option<Instant> {
        let reserve = |t: Duration| (t / 20).min(Duration::from_millis(20));
        self.timeout.and_then(|t| self.arrived.checked_add(t.saturating_sub(reserve(t))))
    }
}

/// How far jobs run past their end: stopping takes an iteration and a last ranking, and how long those take
/// depends on the machine and on what else it does. Remembers the worst up to 100 ms, and forgets it slowly.
#[derive(Debug, Default)]
pub(crate) struct Overrun(AtomicU64);

impl Overrun {
    /// A job that was to end at `deadline` has just ended.
    pub(crate) fn observe(&self, deadline: Instant) {
        let seen = deadline.elapsed().min(MOST_OVERRUN).as_micros();
        let seen = u64::try_from(seen).unwrap_or(u64::MAX);
        let remember = |old: u64| Some(seen.max(old - old / 8));
        // The closure never declines, so this cannot fail.
        self.0.fetch_update(Ordering::Relaxed, Ordering::Relaxed, remember).ok();
    }

    /// What to expect of the next job.
    pub(crate) fn expected(&self) -> Duration {
        Duration::from_micros(self.0.load(Ordering::Relaxed))
    }
}

/// Parses a `grpc-timeout` header: at most 8 digits and a unit (gRPC over HTTP/2, "Timeout").
pub(crate) fn parse_timeout(text: &str) -> Option<Duration> {
    let unit_at = text.len().checked_sub(1)?;
    let (digits, unit) = (text.get(..unit_at)?, text.get(unit_at..)?);
    if digits.is_empty() || digits.len() > 8 || !digits.bytes().all(|b| b.is_ascii_digit()) {
        return None;
    }
    let n: u64 = digits.parse().ok()?;
    Some(match unit {
        "H" => Duration::from_secs(n * 3600),
        "M" => Duration::from_secs(n * 60),
        "S" => Duration::from_secs(n),
        "m" => Duration::from_millis(n),
        "u" => Duration::from_micros(n),
        "n" => Duration::from_nanos(n),
        _ => return None,
    })
}

/// Whether work was cancelled, and when: nanoseconds since the first look at [`base`], plus one; 0 if it was not.
#[derive(Debug, Default)]
struct Cancelled(AtomicU64);

impl Cancelled {
    fn set(&self) {
        let at = u64::try_from(base().elapsed().as_nanos()).unwrap_or(u64::MAX - 1) + 1;
        // The first counts.
        self.0.compare_exchange(0, at, Ordering::Relaxed, Ordering::Relaxed).ok();
    }

    fn is_set(&self) -> bool {
        self.0.load(Ordering::Relaxed) != 0
    }

    fn since(&self) -> Option<Duration> {
        let at = self.0.load(Ordering::Relaxed).checked_sub(1)?;
        Some(base().elapsed().saturating_sub(Duration::from_nanos(at)))
    }
}

/// What moments of cancellation count from.
fn base() -> Instant {
    static BASE: OnceLock<Instant> = OnceLock::new();
    *BASE.get_or_init(Instant::now)
}

/// The budget of a call's work, or of one hand's share of it. Clones share the cancellation.
#[derive(Debug, Clone)]
pub struct CallBudget {
    start: Instant,
    deadline: Option<Instant>,
    cancelled: Arc<Cancelled>,
    /// Set when the whole server ends.
    aborted: Arc<AtomicBool>,
    /// Work that counts only when all of it is done.
    is_indivisible: bool,
}

impl CallBudget {
    /// Work that began at `start` and has to end at `deadline`.
    pub fn new(start: Instant, deadline: Option<Instant>) -> Self {
        Self { start, deadline, cancelled: Arc::default(), aborted: Arc::default(), is_indivisible: false }
    }

    /// For work that counts only when all of it is done: it is not told how long it has, lest it do less.
    #[must_use]
    pub(crate) fn indivisible(self, is_indivisible: bool) -> Self {
        Self { is_indivisible, ..self }
    }

    /// Also stops when `aborted` is set, which many calls may share.
    #[must_use]
    pub fn abort_with(self, aborted: &Arc<AtomicBool>) -> Self {
        Self { aborted: Arc::clone(aborted), ..self }
    }

    /// The same work with an end `budget` after its start, if that is earlier.
    #[must_use]
    pub fn within(&self, budget: Option<Duration>) -> Self {
        let own = budget.and_then(|b| self.start.checked_add(b));
        let deadline = [self.deadline, own].into_iter().flatten().min();
        Self { deadline, ..self.clone() }
    }

    /// What [`Budget::stop`] says, for who holds a lock.
    pub(crate) fn ended(&self) -> Option<Stop> {
        if self.cancelled.is_set() || self.aborted.load(Ordering::Relaxed) {
            return Some(Stop::Cancelled);
        }
        match self.deadline {
            Some(deadline) if Instant::now() >= deadline => Some(Stop::Deadline),
            _ => None,
        }
    }

    /// When the call arrived.
    pub fn start(&self) -> Instant {
        self.start
    }

    /// When work has to end.
    pub fn deadline(&self) -> Option<Instant> {
        self.deadline
    }

    /// Cancels this work and every clone of it.
    pub fn cancel(&self) {
        self.cancelled.set();
    }

    /// True once it was cancelled.
    pub fn is_cancelled(&self) -> bool {
        self.cancelled.is_set()
    }

    /// How long ago it was cancelled, if it was.
    pub fn cancelled_for(&self) -> Option<Duration> {
        self.cancelled.since()
    }

    /// Cancels when the guard is dropped: whoever waits for the work holds it.
    #[must_use]
    pub fn cancel_on_drop(&self) -> CancelOnDrop {
        CancelOnDrop(Arc::clone(&self.cancelled))
    }
}

impl Budget for CallBudget {
    fn elapsed(&self) -> Duration {
        self.start.elapsed()
    }

    fn stop(&self) -> Option<Stop> {
        give_way();
        self.ended()
    }

    fn remaining(&self) -> Option<Duration> {
        let deadline = self.deadline.filter(|_| !self.is_indivisible);
        deadline.map(|deadline| deadline.saturating_duration_since(Instant::now()))
    }
}

/// Cancels a call's work when it is dropped.
#[derive(Debug)]
pub struct CancelOnDrop(Arc<Cancelled>);

impl Drop for CancelOnDrop {
    fn drop(&mut self) {
        self.0.set();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn timeouts_are_read_as_the_protocol_says() {
        let cases = [
            ("1H", Some(Duration::from_secs(3600))),
            ("2M", Some(Duration::from_secs(120))),
            ("3S", Some(Duration::from_secs(3))),
            ("250m", Some(Duration::from_millis(250))),
            ("99999999u", Some(Duration::from_micros(99_999_999))),
            ("7n", Some(Duration::from_nanos(7))),
            ("0m", Some(Duration::ZERO)),
            ("123456789n", None),
            ("m", None),
            ("", None),
            ("-1S", None),
            ("+1S", None),
            ("1é", None),
            ("10s", None),
        ];
        for (text, expected) in cases {
            assert_eq!(parse_timeout(text), expected, "{text:?}");
        }
    }

    #[test]
    fn planning_ends_before_the_answer_and_the_answer_before_the_caller() {
        for ms in [1, 20, 100, 1000, 60_000] {
            let clock = CallClock {
                arrived: Instant::now(),
                timeout: Some(Duration::from_millis(ms)),
                trace: TraceContext::default(),
            };
            let answer = clock.answer_deadline().unwrap();
            for overrun in [Duration::ZERO, Duration::from_millis(7), Duration::from_secs(5)] {
                let planning = clock.planning_deadline(overrun).unwrap();
                assert!(clock.arrived < planning && planning <= answer, "{ms} {overrun:?}");
                let kept_back = Duration::from_millis(ms) - (planning - clock.arrived);
                assert!(kept_back <= Duration::from_millis(ms) / 5, "{ms} {overrun:?}");
                assert!(kept_back <= Duration::from_millis(250), "{ms} {overrun:?}");
            }
            assert!(answer < clock.arrived + Duration::from_millis(ms), "{ms}");
        }
    }

    #[test]
    fn an_overrun_is_remembered_and_slowly_forgotten() {
        let overrun = Overrun::default();
        assert_eq!(overrun.expected(), Duration::ZERO);
        let past = |ms| Instant::now().checked_sub(Duration::from_millis(ms)).unwrap();
        overrun.observe(past(80));
        let worst = overrun.expected();
        assert!(worst >= Duration::from_millis(80));
        overrun.observe(past(5000));
        assert_eq!(overrun.expected(), MOST_OVERRUN, "one job does not tell what others take");
        for _ in 0..60 {
            overrun.observe(past(1));
        }
        assert!(overrun.expected() < worst / 8, "{:?}", overrun.expected());
    }

    #[test]
    fn a_budget_ends_at_the_earlier_of_both_and_cancels_together() {
        let start = Instant::now();
        let call = CallBudget::new(start, Some(start + Duration::from_secs(10)));
        let hand = call.within(Some(Duration::from_secs(3)));
        assert_eq!(hand.deadline(), Some(start + Duration::from_secs(3)));
        assert_eq!(call.within(Some(Duration::from_secs(30))).deadline(), call.deadline());
        assert_eq!(CallBudget::new(start, None).within(None).deadline(), None);
        assert_eq!(CallBudget::new(start, Some(start)).stop(), Some(Stop::Deadline));
        assert_eq!(CallBudget::new(start, Some(start)).remaining(), Some(Duration::ZERO));
        assert_eq!(CallBudget::new(start, None).remaining(), None);
        let later = CallBudget::new(start, Some(start + Duration::from_secs(60)));
        assert!(later.remaining().is_some_and(|left| left > Duration::from_secs(50)));
        assert_eq!(later.indivisible(true).remaining(), None);
        let guard = call.cancel_on_drop();
        assert_eq!(hand.stop(), None);
        drop(guard);
        assert_eq!(hand.stop(), Some(Stop::Cancelled));
        assert_eq!(call.stop(), Some(Stop::Cancelled));
    }
}
