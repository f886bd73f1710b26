//! How much of a hand's dexterity grasps use: what they touch objects with, where the touching pads are and where they
//! point, for contacts found by an estimator against contacts of exactly known geometry (Supplementary Note 6).

mod geometry;
mod pattern;
mod picture;
mod report;
mod run;
mod spread;

pub use geometry::SimulatedGeometry;
pub use pattern::{Pattern, Touch};
pub use picture::{directions_svg, reach_svg};
pub use report::{DiversityReport, HandDiversity, Overlap, SourceDiversity};
pub use run::{DiversitySettings, GEOMETRY, HandPatterns, diversity};
