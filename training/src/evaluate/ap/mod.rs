//! Average precision of the parallel jaw, as Supplementary Note 3 measures it: many grasps a view, judged
//! analytically against the exact scene instead of being executed.

mod exact;
mod jaw;
mod planned;
mod precision;
mod report;
mod run;
mod surface;
mod thresholds;

pub(crate) use jaw::{BEHIND_M, Contact, FINGER_M, between, worst_angle};
pub use jaw::{DEPTH_M, FRICTIONS, HEIGHT_M, JawGrasp, MAX_WIDTH_M, Target, Verdict, judge};
pub use precision::{PER_OBJECT, Precision, TOP, average_precision, select, suppress};
pub use report::{ApReport, ViewFigures, VolumeResult};
pub use run::{ApSettings, average};
pub(crate) use surface::meet;
pub use surface::{Hit, SPACING_M, cast, sample, table_points};
pub use thresholds::{FOCAL_CENTROID, FOCAL_CONTACT, ThresholdCell, ThresholdReport, thresholds};
