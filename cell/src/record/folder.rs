//! Writing and reading the folder of a run.

use std::fs::{self, File};
use std::io::Write as _;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::AttemptRecord;
use crate::config::CellConfig;
use crate::frame::{Frame, FrameError};
use crate::report::Report;

/// Why a run cannot be recorded or read.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// A file cannot be read or written.
    #[error("{file}: {why}")]
    File {
        /// The file.
        file: String,
        /// Why.
        why: String,
    },
    /// The folder holds something already.
    #[error("{folder}: found files in it, expected a new or an empty folder")]
    NotEmpty {
        /// The folder.
        folder: String,
    },
    /// A file is not what it should be.
    #[error("{file}: {problem}")]
    Content {
        /// The file.
        file: String,
        /// What is wrong.
        problem: String,
    },
    /// A frame cannot be encoded or read.
    #[error(transparent)]
    Frame(#[from] FrameError),
}

/// `run.json`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunInfo {
    /// Version of graspd that ran the cell.
    pub graspd: String,
    /// Id of the hand.
    pub hand: String,
    /// Revision of its description.
    pub hand_revision: String,
    /// Camera, arm and hand: name and model.
    pub devices: [String; 3],
    /// Configuration with everything that stood above the file.
    pub config: CellConfig,
}

/// Writes a run's folder. Files are written whole, lines are flushed: what a killed run had done is kept.
#[derive(Debug)]
pub struct Recorder {
    folder: PathBuf,
    attempts: File,
}

impl Recorder {
    /// Begins a record.
    ///
    /// # Errors
    /// [`RecordError`] when the folder is not empty or cannot be written.
    pub fn create(folder: &Path, info: &RunInfo) -> Result<Self, RecordError> {
        let frames = folder.join("frames");
        if fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_some()) {
            return Err(RecordError::NotEmpty { folder: folder.display().to_string() });
        }
        fs::create_dir_all(&frames).map_err(|e| fault(&frames, e))?;
        write(&folder.join("run.json"), &json(&folder.join("run.json"), info)?)?;
        let path = folder.join("attempts.jsonl");
        let attempts = File::create(&path).map_err(|e| fault(&path, e))?;
        Ok(Self { folder: folder.to_owned(), attempts })
    }

    /// Keeps an attempt's frame.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn frame(&self, attempt: u32, frame: &Frame) -> Result<(), RecordError> {
        let stem = self.folder.join(frame_stem(attempt));
        write(&stem.with_extension("png"), &frame.png()?)?;
        write(&stem.with_extension("json"), frame.json()?.as_bytes())
    }

    /// Keeps an attempt.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn attempt(&mut self, record: &AttemptRecord) -> Result<(), RecordError> {
        let path = self.folder.join("attempts.jsonl");
        let mut line = serde_json::to_vec(record)
            .map_err(|e| RecordError::Content { file: path.display().to_string(), problem: e.to_string() })?;
        line.push(b'\n');
        self.attempts.write_all(&line).and_then(|()| self.attempts.flush()).map_err(|e| fault(&path, e))
    }

    /// Ends the record.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn finish(&self, report: &Report) -> Result<(), RecordError> {
        let path = self.folder.join("report.json");
        write(&path, &json(&path, report)?)
    }
}

/// Stem of the files of an attempt's frame, relative to the run's folder.
pub fn frame_stem(attempt: u32) -> String {
    format!("frames/{attempt:04}")
}

/// Reads `run.json`.
///
/// # Errors
/// [`RecordError`].
pub fn read_run(folder: &Path) -> Result<RunInfo, RecordError> {
    let path = folder.join("run.json");
    serde_json::from_slice(&read(&path)?)
        .map_err(|e| RecordError::Content { file: path.display().to_string(), problem: e.to_string() })
}

/// The attempts of a recorded run.
#[derive(Debug, Clone, PartialEq)]
pub struct Attempts {
    /// In the order in which they were made.
    pub records: Vec<AttemptRecord>,
    /// Number of the last line, from 1, where it was cut off: the run was killed while it wrote, and the attempt of
    /// that line is lost.
    pub cut_line: Option<usize>,
}

/// Reads all attempts. A last line without its end is left out, and told.
///
/// # Errors
/// [`RecordError`] with the line that is wrong.
pub fn read_attempts(folder: &Path) -> Result<Attempts, RecordError> {
    let path = folder.join("attempts.jsonl");
    let text = String::from_utf8_lossy(&read(&path)?).into_owned();
    let whole = text.is_empty() || text.ends_with('\n');
    let last = text.lines().count();
    let mut attempts = Attempts { records: Vec::new(), cut_line: None };
    for (line, number) in text.lines().zip(1..).filter(|(line, _)| !line.trim().is_empty()) {
        match serde_json::from_str(line) {
            Ok(record) => attempts.records.push(record),
            // Lines are written with their end: one that has none was not written to it.
            Err(_) if number == last && !whole => attempts.cut_line = Some(number),
            Err(e) => {
                let (file, problem) = (path.display().to_string(), format!("line {number}: {e}"));
                return Err(RecordError::Content { file, problem });
            }
        }
    }
    Ok(attempts)
}

/// Reads the frame of an attempt.
///
/// # Errors
/// [`RecordError`].
pub fn read_frame(folder: &Path, attempt: u32) -> Result<Frame, RecordError> {
    let stem = folder.join(frame_stem(attempt));
    Ok(Frame::read(&read(&stem.with_extension("png"))?, &read(&stem.with_extension("json"))?)?)
}

fn fault(path: &Path, source: std::io::Error) -> RecordError {
    RecordError::File { file: path.display().to_string(), why: source.to_string() }
}

fn read(path: &Path) -> Result<Vec<u8>, RecordError> {
    fs::read(path).map_err(|e| fault(path, e))
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), RecordError> {
    fs::write(path, bytes).map_err(|e| fault(path, e))
}

fn json<T: Serialize>(path: &Path, value: &T) -> Result<Vec<u8>, RecordError> {
    serde_json::to_vec_pretty(value)
        .map_err(|e| RecordError::Content { file: path.display().to_string(), problem: e.to_string() })
}
