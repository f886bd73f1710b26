//! Planning for one hand in a prepared scene: initialize, optimize, rank.

use graspd_hands::Hand;

use crate::budget::Budget;
use crate::grasp::Plan;
use crate::options::PlanOptions;
use crate::scene::Scene;

/// Plans grasps of `hand` in `scene`.
///
/// `on_better` is called from the planning thread with every better set as it is found, before the final
/// plan is returned. Uses the rayon pool that it is called in. Never fails: a plan without grasps says why.
pub fn plan(
    _scene: &Scene,
    _hand: &Hand,
    _options: &PlanOptions,
    _budget: &dyn Budget,
    _on_better: &mut dyn FnMut(&Plan),
) -> Plan {
    Plan::default()
}
