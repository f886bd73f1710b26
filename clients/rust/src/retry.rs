//! When a call is tried again, and after how long.
//!
//! Only what is safe and useful is repeated: `UNAVAILABLE` (the server is starting, draining or gone for a
//! moment) after an exponential back-off with jitter, and `RESOURCE_EXHAUSTED` where the server itself says
//! when to come back. Everything happens within the call's one deadline. A hand is created under a name of the request,
//! so that a repetition is safe; deleting one is never repeated.

use std::future::Future;
use std::hash::{BuildHasher as _, RandomState};
use std::time::{Duration, Instant};

use tonic::{Code, Status};

use crate::error::{CallError, ClientError};

/// How often and after how long a call is repeated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RetryPolicy {
    /// Attempts in all; 1 never repeats.
    pub attempts: u32,
    /// First back-off; each further one is twice as long.
    pub first_backoff: Duration,
    /// Longest back-off.
    pub longest_backoff: Duration,
}

impl Default for RetryPolicy {
    /// 4 attempts, back-off from 50 ms to 1 s.
    fn default() -> Self {
        Self {
            attempts: 4,
            first_backoff: Duration::from_millis(50),
            longest_backoff: Duration::from_secs(1),
        }
    }
}

impl RetryPolicy {
    /// Never repeats.
    pub const NONE: Self =
        Self { attempts: 1, first_backoff: Duration::ZERO, longest_backoff: Duration::ZERO };

    /// How long to wait before attempt `next` (the second is 1), or `None` to give up. `jitter` is 0 to 1.
    fn wait(&self, error: &CallError, next: u32, jitter: f64) -> Option<Duration> {
        if next >= self.attempts {
            return None;
        }
        match (error.code, error.retry_after) {
            // Everybody who was refused comes back: a little later each, not all at once.
            (Code::ResourceExhausted, Some(asked)) => Some(asked.mul_f64(1.0 + 0.5 * jitter)),
            (Code::Unavailable, asked) => {
                let doubled = self.first_backoff.saturating_mul(1 << (next - 1).min(16));
                let backoff = doubled.min(self.longest_backoff).mul_f64(0.5 + 0.5 * jitter);
                Some(backoff.max(asked.unwrap_or_default()))
            }
            _ => None,
        }
    }
}

/// Runs `attempt` with the time that is left, until it succeeds, must not be repeated, or time is up.
pub(crate) async fn retried<T, F, Fut>(
    policy: &RetryPolicy,
    timeout: Duration,
    mut attempt: F,
) -> Result<T, ClientError>
where
    F: FnMut(Duration) -> Fut,
    Fut: Future<Output = Result<T, Status>>,
{
    let began = Instant::now();
    let mut next = 1;
    loop {
        let left = timeout.saturating_sub(began.elapsed());
        if left.is_zero() {
            return Err(CallError::late().into());
        }
        // The server answers just before its timer; ours, a little later, only catches a lost connection.
        let done = tokio::time::timeout(left + Duration::from_millis(100), attempt(left)).await;
        let error = match done {
            Ok(Ok(value)) => return Ok(value),
            Ok(Err(status)) => CallError::from(&status),
            Err(_) => CallError::late(),
        };
        let Some(wait) = policy.wait(&error, next, jitter()) else { return Err(error.into()) };
        if wait >= timeout.saturating_sub(began.elapsed()) {
            return Err(error.into());
        }
        tokio::time::sleep(wait).await;
        next += 1;
    }
}

/// A number from 0 to 1 that differs between calls and processes.
fn jitter() -> f64 {
    (RandomState::new().hash_one(0u8) >> 11) as f64 / (1u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    fn error(code: Code, retry_after: Option<u64>) -> CallError {
        CallError { code, retry_after: retry_after.map(Duration::from_millis), ..CallError::late() }
    }

    #[test]
    fn only_what_is_documented_is_repeated() {
        let policy = RetryPolicy::default();
        for code in (0..17).map(Code::from) {
            let repeated = policy.wait(&error(code, None), 1, 0.5).is_some();
            assert_eq!(repeated, code == Code::Unavailable, "{code:?}");
        }
        let asked = policy.wait(&error(Code::ResourceExhausted, Some(40)), 1, 0.0);
        assert_eq!(asked, Some(Duration::from_millis(40)));
        assert_eq!(policy.wait(&error(Code::Unavailable, None), 4, 0.0), None);
        assert_eq!(RetryPolicy::NONE.wait(&error(Code::Unavailable, None), 1, 0.0), None);
    }

    #[test]
    fn back_off_grows_and_is_bounded() {
        let policy = RetryPolicy { attempts: 40, ..RetryPolicy::default() };
        let waits: Vec<_> =
            (1..40).filter_map(|n| policy.wait(&error(Code::Unavailable, None), n, 1.0)).collect();
        assert_eq!(waits.len(), 39);
        assert_eq!(waits[0], Duration::from_millis(50));
        assert!(waits.is_sorted());
        assert_eq!(waits.last(), Some(&policy.longest_backoff));
        assert!((0..100).map(|_| jitter()).all(|j| (0.0..1.0).contains(&j)));
    }

    #[tokio::test]
    async fn the_deadline_holds_for_all_attempts_together() {
        let policy = RetryPolicy { attempts: 1000, ..RetryPolicy::default() };
        let attempts = Cell::new(0);
        let began = Instant::now();
        let ended: Result<(), _> = retried(&policy, Duration::from_millis(300), |left| {
            assert!(left <= Duration::from_millis(300));
            attempts.set(attempts.get() + 1);
            async { Err(Status::unavailable("not yet")) }
        })
        .await;
        assert_eq!(ended.unwrap_err().call().unwrap().code, Code::Unavailable);
        assert!(attempts.get() > 1 && began.elapsed() < Duration::from_millis(900));
    }

    #[tokio::test]
    async fn a_second_attempt_can_succeed() {
        let attempts = Cell::new(0);
        let value = retried(&RetryPolicy::default(), Duration::from_secs(5), |_| {
            attempts.set(attempts.get() + 1);
            let first = attempts.get() == 1;
            async move { if first { Err(Status::unavailable("once")) } else { Ok(7) } }
        })
        .await;
        assert_eq!((value.unwrap(), attempts.get()), (7, 2));
    }
}
