//! Contact estimators that misbehave on purpose.

use std::time::Duration;

use graspd_planner::budget::{Budget, Stop};
use graspd_planner::contact_field::ContactField;
use graspd_planner::estimator::ContactEstimator;
use graspd_planner::volume::Volume;

/// Name of the estimator that panics.
pub const PANICS: &str = "panics";
/// Name of the estimator that works until it is stopped.
pub const STALLS: &str = "stalls";

/// Panics.
#[derive(Debug, Clone, Copy)]
pub struct Panics;

impl ContactEstimator for Panics {
    fn name(&self) -> &str {
        PANICS
    }

    fn estimate(&self, _volume: &Volume, _budget: &dyn Budget) -> Result<ContactField, Stop> {
        panic!("this estimator panics on purpose");
    }
}

/// Works until its budget ends; gives up after a minute so that a failing test ends too.
pub(crate) struct Stalls;

impl ContactEstimator for Stalls {
    fn name(&self) -> &str {
        STALLS
    }

    fn estimate(&self, _volume: &Volume, budget: &dyn Budget) -> Result<ContactField, Stop> {
        for _ in 0..60_000 {
            if let Some(stop) = budget.stop() {
                return Err(stop);
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        Err(Stop::Deadline)
    }
}
