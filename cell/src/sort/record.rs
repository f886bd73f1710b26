//! What is kept of a sorting run: each arm's folder as that of a run with one arm (so that each attempt can be planned again),
//! and beside them `sort.json` (configuration), `decisions.jsonl` (who was given what, and why) and `report.json`.

use std::fs::{self, File};
use std::io::Write as _;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::config::SortConfig;
use super::report::SortReport;
use crate::record::RecordError;

/// A decision about one arm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DecisionRecord {
    /// Seconds since the run began, on the cell's clock.
    pub time_s: f64,
    /// The look that the grasps are from.
    pub look: u32,
    /// The arm.
    pub arm: String,
    /// What it was given; `None`: nothing.
    pub given: Option<Given>,
    /// Why.
    pub reason: String,
}

/// What an arm was given.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Given {
    /// Number of the object in that look.
    pub object: usize,
    /// Its width, metres.
    pub width_m: f64,
    /// Rule that it fits.
    pub rule: String,
    /// Bin.
    pub bin: String,
    /// Rank of the grasp in the answer for the arm's hand.
    pub rank: usize,
    /// Expected success.
    pub value: f64,
    /// What it is made of: score, size, reach.
    pub factors: [f64; 3],
}

/// Writes the files beside the arms' folders.
#[derive(Debug)]
pub(super) struct SortRecorder {
    folder: PathBuf,
    decisions: File,
}

fn fault(path: &Path, why: impl ToString) -> RecordError {
    RecordError::File { file: path.display().to_string(), why: why.to_string() }
}

fn write_json(path: &Path, value: &impl Serialize) -> Result<(), RecordError> {
    let bytes = serde_json::to_vec_pretty(value).map_err(|e| fault(path, e))?;
    fs::write(path, bytes).map_err(|e| fault(path, e))
}

impl SortRecorder {
    pub(super) fn create(folder: &Path, config: &SortConfig) -> Result<Self, RecordError> {
        if fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_some()) {
            return Err(RecordError::NotEmpty { folder: folder.display().to_string() });
        }
        fs::create_dir_all(folder).map_err(|e| fault(folder, e))?;
        write_json(&folder.join("sort.json"), config)?;
        let path = folder.join("decisions.jsonl");
        let decisions = File::create(&path).map_err(|e| fault(&path, e))?;
        Ok(Self { folder: folder.to_owned(), decisions })
    }

    pub(super) fn decided(&mut self, records: &[DecisionRecord]) -> Result<(), RecordError> {
        let path = self.folder.join("decisions.jsonl");
        for record in records {
            let mut line = serde_json::to_vec(record).map_err(|e| fault(&path, e))?;
            line.push(b'\n');
            self.decisions.write_all(&line).map_err(|e| fault(&path, e))?;
        }
        self.decisions.flush().map_err(|e| fault(&path, e))
    }

    pub(super) fn finish(&self, report: &SortReport) -> Result<(), RecordError> {
        write_json(&self.folder.join("report.json"), report)
    }
}
