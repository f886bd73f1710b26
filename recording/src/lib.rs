//! Recordings: every plan and what became of it, in MCAP files that Foxglove and Rerun open and that can be planned
//! again.
//!
//! A [`Folder`] writes files within a disk budget, the oldest go first. What belongs to one call is a [`Bundle`]: one
//! chunk of a file, so that after a crash it is there whole or not at all. [`read_file`] gives back calls with their
//! pixels, and outcomes. Files have no compression: depth images hardly shrink, and no C library is needed.

mod file;
mod folder;
mod name;
mod plan_id;
mod read;
mod schema;

pub use folder::{Folder, FolderError, LEAST_BUDGET_BYTES, Opened};
pub use plan_id::PlanId;
pub use read::{FoundPlan, ReadError, Recording, files, find_plan, read_bytes, read_file};
pub use schema::{Bundle, Message, Schema};

/// Messages of the schemas that viewers know.
#[allow(missing_docs, missing_debug_implementations, unreachable_pub)]
#[allow(clippy::all, clippy::pedantic, clippy::unwrap_used, clippy::uninlined_format_args)]
pub mod foxglove {
    include!(concat!(env!("OUT_DIR"), "/foxglove.rs"));
}

/// Topic of the depth image of camera `index` of a call.
pub fn depth_topic(index: usize) -> String {
    format!("/camera/{index}/depth")
}

/// Topic of the calls with their answers.
pub const PLAN_TOPIC: &str = "/graspd/plan";
/// Topic of what callers reported.
pub const OUTCOME_TOPIC: &str = "/graspd/outcomes";
/// Topic of each answer's figures and stage times, for plots.
pub const STATS_TOPIC: &str = "/graspd/stats";

/// Topic of the answers to frames of servo streams.
pub const SERVO_TOPIC: &str = "/servo/answer";

#[cfg(test)]
mod tests;
