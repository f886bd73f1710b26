//! Which arm takes which grasp, where several hands were planned for from one frame (Supplementary Note 7, Task 3: there a
//! person chose).
//!
//! [`assign`] maximizes the expected number of objects that arrive: the sum of score × size suitability × reach over the
//! chosen grasps, at most one for each arm, no object twice, no two approach corridors in conflict, nothing in space that
//! is kept out of or occupied. Exact where the search ends within its budget, else the best found with a bound on what
//! is missing. Every decision says why.
//!
//! Pure: no clock, no threads, no randomness; one problem has one answer, bit for bit. Lengths in metres, world frame.
//!
//! ```
//! use graspd_assign::*;
//! use nalgebra::{Isometry3, Point3};
//!
//! let grasp = |x: f64, score| Grasp {
//!     world_from_pregrasp: Isometry3::translation(x, 0.0, 0.30),
//!     world_from_hand: Isometry3::translation(x, 0.0, 0.20),
//!     score,
//!     object: ObjectKey::At(Point3::new(x, 0.0, 0.03)),
//!     width_m: Some(0.04),
//!     reach: Reach::Within(1.0),
//!     barred: None,
//!     corridor: None,
//! };
//! let arm = |name: &str, x: f64, grasps| Arm {
//!     opening_m: Some((0.0, 0.085)),
//!     body: Body { shoulder: Point3::new(x, 0.0, 0.3), ..Body::default() },
//!     ..Arm::new(name, grasps)
//! };
//! let arms = [arm("left", -0.6, vec![grasp(-0.15, 0.9)]), arm("right", 0.6, vec![grasp(-0.15, 0.95), grasp(0.15, 0.8)])];
//! let found = assign(&Problem { arms: &arms, ..Problem::default() }, &Settings::default(), &mut || false);
//! assert_eq!(found.decisions[0].chosen.as_ref().map(|c| c.grasp), Some(0));
//! assert_eq!(found.decisions[1].chosen.as_ref().map(|c| c.grasp), Some(1));
//! assert!(found.optimal);
//! ```

mod judge;
mod problem;
mod reason;
mod search;
mod swept;
mod volume;

pub use judge::{Factors, size_suitability};
pub use problem::{
    Arm, Body, Grasp, KeepOut, ObjectKey, Occupied, Problem, Reach, ReachRegion, Settings, Taken,
};
pub use reason::{Assignment, Cause, Chosen, Decision, Reason, Rejected};
pub use swept::Swept;
pub use volume::{Capsule, OrientedBox, corridor};

/// Gives grasps to arms. `stop` is asked now and then whether the search shall end: for a time budget, which this crate
/// has no clock for; the best so far is returned then.
pub fn assign(problem: &Problem<'_>, settings: &Settings, stop: &mut dyn FnMut() -> bool) -> Assignment {
    let judged = judge::judge(problem, settings);
    let found = search::search(&judged, settings, stop);
    reason::explain(problem, &judged, &found)
}
