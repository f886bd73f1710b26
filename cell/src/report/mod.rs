//! What a run came to: the tally, the end, the table.

mod table;
mod tally;

use serde::{Deserialize, Serialize};

use crate::outcome::{End, Holding};

pub use tally::Tally;

/// The result of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Report {
    /// Id of the hand.
    pub hand: String,
    /// Revision of its description.
    pub hand_revision: String,
    /// Why the run ended.
    pub end: End,
    /// What is in the hand now.
    pub holding: Holding,
    /// Everything counted.
    pub tally: Tally,
    /// Duration of the run, seconds.
    pub duration_s: f64,
    /// The first trouble with the record, when there was any: the run went on without.
    pub record_trouble: Option<String>,
}
