//! Reading recordings back, those too that have no end.

use std::collections::HashMap;
use std::fs::{self, File};
use std::io::{self, Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use bytes::Bytes;
use graspd_proto::v1::plan_record::Request;
use graspd_proto::v1::{OutcomeRecord, PlanRecord, hand_task_result};
use mcap::read::Options;
use mcap::{MAGIC, MessageStream};
use prost::Message as _;

use crate::foxglove::RawImage;
use crate::name::{file_name, is_recording};
use crate::schema::{Bundle, Message, Schema};
use crate::{OUTCOME_TOPIC, PLAN_TOPIC, PlanId};

/// Why a file is no recording.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadError {
    /// It cannot be read.
    #[error("{}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// It is no MCAP file, or is damaged before its end.
    #[error("no recording, or a damaged one: {problem}")]
    Mcap {
        /// What the reader says.
        problem: String,
    },
    /// A message is not what its topic promises.
    #[error("topic {topic}: {problem}")]
    Message {
        /// The topic.
        topic: String,
        /// What the decoder says.
        problem: String,
    },
}

/// What is in a file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Recording {
    /// Calls in the order of their ends, with the pixels of their frames.
    pub plans: Vec<PlanRecord>,
    /// Reports in their order.
    pub outcomes: Vec<OutcomeRecord>,
    /// False for a file without an end: it is being written, or its process was killed.
    pub ended: bool,
}

/// The files of a recording, oldest first: a folder's, or the one file that is named.
///
/// # Errors
/// What the file system says.
pub fn files(path: &Path) -> io::Result<Vec<PathBuf>> {
    if !fs::metadata(path)?.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let mut found = Vec::new();
    for entry in fs::read_dir(path)? {
        let path = entry?.path();
        if is_recording(&path) {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

/// Reads a file.
///
/// # Errors
/// [`ReadError`].
pub fn read_file(path: &Path) -> Result<Recording, ReadError> {
    let bytes = fs::read(path).map_err(|source| ReadError::Io { path: path.to_owned(), source })?;
    read_bytes(&bytes)
}

/// Reads the bytes of a file.
///
/// # Errors
/// [`ReadError::Mcap`], [`ReadError::Message`].
pub fn read_bytes(bytes: &[u8]) -> Result<Recording, ReadError> {
    let mut recording = Recording::default();
    // Pixels by camera, of the bundle that is being read.
    let mut pixels: (u32, HashMap<String, Bytes>) = Default::default();
    recording.ended = messages(bytes, |message| {
        let decoded = |problem: prost::DecodeError| ReadError::Message {
            topic: message.channel.topic.clone(),
            problem: problem.to_string(),
        };
        let topic = message.channel.topic.as_str();
        match message.channel.schema.as_ref().map(|schema| schema.name.as_str()) {
            Some("foxglove.RawImage") => {
                let image = RawImage::decode(&*message.data).map_err(decoded)?;
                if pixels.0 != message.sequence {
                    pixels = (message.sequence, HashMap::new());
                }
                pixels.1.insert(topic.to_owned(), image.data);
            }
            Some("graspd.v1.PlanRecord") if topic == PLAN_TOPIC => {
                let mut record =
                    PlanRecord::decode(Bytes::copy_from_slice(&message.data)).map_err(decoded)?;
                if pixels.0 == message.sequence {
                    put_back(&mut record, &mut pixels.1);
                }
                recording.plans.push(record);
            }
            Some("graspd.v1.OutcomeRecord") if topic == OUTCOME_TOPIC => {
                recording.outcomes.push(OutcomeRecord::decode(&*message.data).map_err(decoded)?);
            }
            _ => {}
        }
        Ok(())
    })?;
    Ok(recording)
}

/// Gives frames their pixels.
fn put_back(record: &mut PlanRecord, pixels: &mut HashMap<String, Bytes>) {
    let frames = match &mut record.request {
        Some(Request::PlanGrasps(plan)) => &mut plan.frames[..],
        Some(Request::PlanMultiHand(plan)) => &mut plan.frames[..],
        None => &mut [],
    };
    for (i, frame) in frames.iter_mut().enumerate() {
        if let (true, Some(data)) = (frame.data.is_empty(), pixels.remove(&crate::depth_topic(i))) {
            frame.data = data;
        }
    }
}

/// A plan that was found by its name.
#[derive(Debug, Clone, PartialEq)]
pub struct FoundPlan {
    /// "hands/{hand}".
    pub hand: String,
    /// Uncalibrated score and score of each grasp.
    pub scores: Vec<(f64, f64)>,
    /// Name of the calibration; empty: none.
    pub calibration: String,
}

/// Looks for a plan in the files of a folder that can have it.
///
/// # Errors
/// What the file system says; damaged files are passed over.
pub fn find_plan(folder: &Path, id: PlanId) -> io::Result<Option<FoundPlan>> {
    /// A call ends, and is written, some time after its plan got its name; files are begun meanwhile.
    const FILES: usize = 4;
    let all = files(folder)?;
    let name = file_name(id.unix_ms());
    let begun_before =
        all.partition_point(|path| path.file_name().is_some_and(|n| *n.to_string_lossy() <= name[..]));
    let text = id.to_string();
    for path in all.iter().skip(begun_before.saturating_sub(1)).take(FILES) {
        let bytes = match fs::read(path) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
            Err(error) => return Err(error),
        };
        let mut found = None;
        let looked = messages(&bytes, |message| {
            if message.channel.topic == PLAN_TOPIC && found.is_none() {
                let record = PlanRecord::decode(&*message.data).unwrap_or_default();
                found = in_record(&record, &text);
            }
            Ok(())
        });
        // A damaged file may have had it before the damage.
        drop(looked);
        if found.is_some() {
            return Ok(found);
        }
    }
    Ok(None)
}

fn in_record(record: &PlanRecord, id: &str) -> Option<FoundPlan> {
    record.results.iter().find_map(|result| match &result.outcome {
        Some(hand_task_result::Outcome::Response(answer)) if answer.plan_id == id => Some(FoundPlan {
            hand: answer.stats.as_ref().map(|s| s.hand.clone()).unwrap_or_default(),
            scores: answer.grasps.iter().map(|g| (g.uncalibrated_score, g.score)).collect(),
            calibration: answer.calibration.as_ref().map(|c| c.name.clone()).unwrap_or_default(),
        }),
        _ => None,
    })
}

/// True if the file has its end.
pub(crate) fn has_end(path: &Path) -> io::Result<bool> {
    let mut file = File::open(path)?;
    let length = file.metadata()?.len();
    if length < 2 * MAGIC.len() as u64 {
        return Ok(false);
    }
    let mut end = [0; MAGIC.len()];
    file.seek(SeekFrom::Start(length - MAGIC.len() as u64))?;
    file.read_exact(&mut end)?;
    Ok(end == MAGIC)
}

/// Every bundle of a file with its sequence number; whether the file has an end.
pub(crate) fn bundles(
    bytes: &[u8],
    mut each: impl FnMut(u32, Bundle) -> io::Result<()>,
) -> Result<bool, ReadError> {
    const ALL: [Schema; 9] = [
        Schema::RawImage,
        Schema::CameraCalibration,
        Schema::FrameTransform,
        Schema::PointCloud,
        Schema::PosesInFrame,
        Schema::SceneUpdate,
        Schema::PlanRecord,
        Schema::PlanStats,
        Schema::OutcomeRecord,
    ];
    let fault = |source| ReadError::Io { path: PathBuf::new(), source };
    let mut open: Option<(u32, Bundle)> = None;
    let ended = messages(bytes, |message| {
        let name = message.channel.schema.as_ref().map_or("", |schema| schema.name.as_str());
        let Some(schema) = ALL.into_iter().find(|schema| schema.name() == name) else { return Ok(()) };
        let (topic, data) = (message.channel.topic.clone(), message.data.into_owned());
        match &mut open {
            Some((sequence, bundle)) if *sequence == message.sequence => {
                bundle.messages.push(Message { topic, schema, data });
            }
            _ => {
                let messages = vec![Message { topic, schema, data }];
                let next = (message.sequence, Bundle::of(message.log_time, messages));
                if let Some((sequence, bundle)) = open.replace(next) {
                    each(sequence, bundle).map_err(fault)?;
                }
            }
        }
        Ok(())
    })?;
    if let Some((sequence, bundle)) = open {
        each(sequence, bundle).map_err(fault)?;
    }
    Ok(ended)
}

/// Every message of a file; whether the file has an end. Where it has none, what comes after the last whole chunk is
/// left out without a word: that is how a killed process leaves it.
fn messages(
    bytes: &[u8],
    mut each: impl FnMut(mcap::Message<'static>) -> Result<(), ReadError>,
) -> Result<bool, ReadError> {
    let mcap = |error: mcap::McapError| ReadError::Mcap { problem: error.to_string() };
    let ended = bytes.len() > 2 * MAGIC.len() && bytes.ends_with(MAGIC);
    let options = if ended {
        Options::ValidateChunkCrcs.into()
    } else {
        Options::IgnoreEndMagic | Options::ValidateChunkCrcs
    };
    if !bytes.starts_with(MAGIC) {
        return Err(ReadError::Mcap { problem: "it does not begin like an MCAP file".to_owned() });
    }
    for message in MessageStream::new_with_options(bytes, options).map_err(mcap)? {
        match message {
            Ok(message) => each(message)?,
            Err(_) if !ended => break,
            Err(error) => return Err(mcap(error)),
        }
    }
    Ok(ended)
}
