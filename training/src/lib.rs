//! What learns from the simulated world, and what measures in it: planner and simulation meet here.
//!
//! [`dataset`] makes what contact estimation networks learn from: views of clutter, labelled with contacts.
//! [`evaluate`] measures the project's grasp quality: trays cleared by every hand as in Supplementary Table 4,
//! and the average precision of the parallel jaw as in Supplementary Note 3.
//!
//! No files: callers read and write; bytes, strings and values come in and go out.

pub mod dataset;
pub mod evaluate;
