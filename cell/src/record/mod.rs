//! What is kept of a run: every attempt with its frame, so that any of them can be planned again.
//!
//! ```text
//! run.json                 configuration, versions, the hand's revision
//! attempts.jsonl           one line an attempt: frame, question, chosen grasp, steps, outcome
//! frames/0001.png, .json   16-bit millimetres, and lens with pose, as `graspd plan` reads them
//! report.json              how the run ended
//! ```

mod attempt;
mod folder;
mod replay;

pub use attempt::{AnswerRecord, AttemptRecord, Chosen, OutOfReach, ServoRecord, StepRecord, TroubleRecord};
pub use folder::{Attempts, RecordError, Recorder, RunInfo, frame_stem, read_attempts, read_frame, read_run};
pub use replay::{Replay, ReplayError, replay};
