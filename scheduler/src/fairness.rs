//! Who has had how much time lately, and whose turn it therefore is.

use std::collections::BTreeMap;
use std::time::Duration;

use crate::types::{Flow, Time};

/// Time that was used loses half its weight in this long.
const HALF_LIFE: Duration = Duration::from_secs(10);
/// Flows this close to the one that has had least count as equal.
const QUANTUM: Duration = Duration::from_millis(250);
/// Less than this is forgotten.
const FORGOTTEN_S: f64 = 1e-4;

/// Time that flows have used, fading.
#[derive(Debug, Default)]
pub(crate) struct Usage {
    used: BTreeMap<Flow, (f64, Time)>,
}

impl Usage {
    /// Seconds that a flow has used, faded to `now`.
    pub(crate) fn of(&self, flow: Flow, now: Time) -> f64 {
        self.used.get(&flow).map_or(0.0, |&(used, at)| faded(used, at, now))
    }

    /// Adds to what a flow has used; negative where it used less than was assumed.
    pub(crate) fn charge(&mut self, flow: Flow, seconds: f64, now: Time) {
        let used = (self.of(flow, now) + seconds).max(0.0);
        self.used.insert(flow, (used, now));
        if self.used.len() > 64 {
            self.used.retain(|_, &mut (used, at)| faded(used, at, now) > FORGOTTEN_S);
        }
    }

    /// The least that any of these flows has used.
    pub(crate) fn least(&self, flows: impl Iterator<Item = Flow>, now: Time) -> f64 {
        flows.map(|flow| self.of(flow, now)).fold(f64::INFINITY, f64::min)
    }

    /// True for a flow that has had more than its share, where `least` is what the most modest has had.
    pub(crate) fn is_over(&self, flow: Flow, least: f64, now: Time) -> bool {
        self.of(flow, now) > least + QUANTUM.as_secs_f64()
    }
}

fn faded(used: f64, at: Time, now: Time) -> f64 {
    used * (-now.saturating_sub(at).as_secs_f64() / HALF_LIFE.as_secs_f64()).exp2()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn use_fades_and_is_forgotten() {
        let mut usage = Usage::default();
        usage.charge(Flow(1), 4.0, Time::ZERO);
        assert!((usage.of(Flow(1), HALF_LIFE) - 2.0).abs() < 1e-9);
        assert!(usage.is_over(Flow(1), usage.least([Flow(1), Flow(2)].into_iter(), HALF_LIFE), HALF_LIFE));
        usage.charge(Flow(1), -9.0, HALF_LIFE);
        assert_eq!(usage.of(Flow(1), HALF_LIFE), 0.0);
        for flow in 10..200 {
            usage.charge(Flow(flow), 1e-3, Time::from_secs(flow * 60));
        }
        assert!(usage.used.len() <= 66, "{} flows are remembered", usage.used.len());
    }
}
