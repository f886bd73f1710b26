//! Several arms sort one tray (Supplementary Note 7, Task 3).
//!
//! One camera looks while no arm is over the tray, or past those that are; the planner answers for every hand that is free
//! from that one frame; [`graspd_assign`] gives grasps to the arms that are free, and again whenever one is; each arm picks with
//! the steps and the recoveries of a run of its own, at the same time as the others. When the tray has changed, the camera
//! looks again.
//!
//! | module | concept |
//! |---|---|
//! | [`config`] | `sort.toml`: arms, bins, rules |
//! | [`objects`] | what lies in the tray, with sizes, from a depth frame |
//! | [`shadow`] | what arms hide of it |
//! | [`way`] | the way of a pick, and the space that arm and hand sweep on it |
//! | [`space`] | who is where: grounds and leases |
//! | `offer` | the grasps of a look, each with object, size, rule, reach and corridor |
//! | `worker` | an arm in a task of its own |
//! | `lead` | the loop: look, assign, dispatch, hear |
//! | [`clock`], [`shares`] | the clock of the devices; where an arm's time goes |
//! | [`table`], [`report`], [`record`] | who does what, live; how it ended; what is kept |

pub mod clock;
pub mod config;
pub mod objects;
pub mod record;
pub mod report;
pub mod shadow;
pub mod shares;
pub mod space;
pub mod table;
pub mod way;

mod lead;
mod offer;
mod worker;

pub use lead::{ArmCell, Recognizer, SortCell, SortError, sort};
