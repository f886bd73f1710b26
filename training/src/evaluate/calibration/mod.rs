//! What a score says about success: ranked grasps are executed, a curve is fitted through what became of them, and
//! checked on other trays with other objects.

mod collect;
mod fit;
mod picture;
mod reliability;
mod report;

pub use collect::{CalibrationSettings, Sample, collect};
pub use fit::{LEAST_OF_A_HAND, fit_hands, fit_together};
pub use picture::svg;
pub use reliability::{Bin, Reliability, reliability};
pub use report::{CalibrationReport, HandFit};
