//! What a robot cell does with graspd: clear a tray, as the paper's Task 1 does (Supplementary Note 7).
//!
//! Arm out of the camera's view → capture → plan over gRPC → open the hand → above, then to the pre-grasp → straight
//! approach → close → is something in the hand? → lift → still? → to the drop pose → still? → open; again, until the
//! planner sees an empty tray. The loop knows devices by the traits of `graspd-adapters-core` alone and the planner by
//! its protocol.
//!
//! [`sort`] does the same with several arms over one tray (Supplementary Note 7, Task 3).
//!
//! What is done about trouble in each step stands in one table, [`recovery::TABLE`], which the loop obeys and
//! `docs/cell.md` prints. The loop ends in every case, and every attempt has exactly one outcome.

pub mod config;
pub mod frame;
pub mod observer;
pub mod outcome;
pub mod plan;
pub mod pose;
pub mod record;
pub mod recovery;
pub mod report;
pub mod sort;
pub mod steps;
pub mod witness;

mod run;

pub use run::{Cell, CellError, clear_tray};
