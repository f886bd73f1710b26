//! Repeating, medians and percentiles, and the memory of this process.

use std::time::{Duration, Instant};

/// Times of one measurement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Times {
    /// Half of the runs were at most this long, milliseconds.
    pub(super) median_ms: f64,
    /// 95 of 100 runs were at most this long, milliseconds.
    pub(super) p95_ms: f64,
    /// Runs.
    pub(super) count: usize,
}

/// Runs something once to warm up, then `runs` times. The closure says what of its time counts.
pub(super) fn measure(runs: usize, mut run: impl FnMut() -> Duration) -> Times {
    run();
    let mut all: Vec<f64> = (0..runs).map(|_| run().as_secs_f64() * 1e3).collect();
    all.sort_by(f64::total_cmp);
    Times { median_ms: quantile(&all, 0.5), p95_ms: quantile(&all, 0.95), count: runs }
}

/// The time that something takes.
pub(super) fn time<T>(run: impl FnOnce() -> T) -> Duration {
    let start = Instant::now();
    std::hint::black_box(run());
    start.elapsed()
}

/// A quantile of sorted values, interpolated between neighbours.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else { return 0.0 };
    let at = share * last as f64;
    let low = at.floor() as usize;
    let high = (low + 1).min(last);
    sorted[low] + (sorted[high] - sorted[low]) * (at - low as f64)
}

/// The most memory that this process has held, MiB; `None` where the system does not say.
pub(super) fn peak_memory_mib() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kib: f64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kib / 1024.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_of_known_values() {
        let values: Vec<f64> = (0..=100).map(f64::from).collect();
        assert_eq!(quantile(&values, 0.5), 50.0);
        assert_eq!(quantile(&values, 0.95), 95.0);
        assert_eq!(quantile(&[1.0, 2.0], 0.5), 1.5);
        assert_eq!(quantile(&[3.0], 0.95), 3.0);
    }

    #[test]
    fn warm_up_does_not_count() {
        let mut calls = 0;
        let times = measure(3, || {
            calls += 1;
            Duration::from_millis(if calls == 1 { 1000 } else { 2 })
        });
        assert_eq!((calls, times.median_ms, times.p95_ms), (4, 2.0, 2.0));
    }
}
