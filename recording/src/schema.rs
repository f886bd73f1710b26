//! What can be in a recording: messages with their schemas, bundled by call.

use std::collections::BTreeSet;

use prost::Message as _;

use crate::foxglove;

/// Kinds of messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Schema {
    /// A depth image.
    RawImage,
    /// A lens.
    CameraCalibration,
    /// Where a camera stood.
    FrameTransform,
    /// Points of a depth image.
    PointCloud,
    /// Grasps as poses of the wrist.
    PosesInFrame,
    /// Grasps and the hand as shapes.
    SceneUpdate,
    /// A call with its answers.
    PlanRecord,
    /// Figures of an answer.
    PlanStats,
    /// What became of a grasp.
    OutcomeRecord,
    /// The answer to a frame of a servo stream.
    ServoAnswer,
}

impl Schema {
    /// Full name of the protobuf message.
    pub fn name(self) -> &'static str {
        match self {
            Self::RawImage => "foxglove.RawImage",
            Self::CameraCalibration => "foxglove.CameraCalibration",
            Self::FrameTransform => "foxglove.FrameTransform",
            Self::PointCloud => "foxglove.PointCloud",
            Self::PosesInFrame => "foxglove.PosesInFrame",
            Self::SceneUpdate => "foxglove.SceneUpdate",
            Self::PlanRecord => "graspd.v1.PlanRecord",
            Self::PlanStats => "graspd.v1.PlanStats",
            Self::OutcomeRecord => "graspd.v1.OutcomeRecord",
            Self::ServoAnswer => "graspd.v1.ServoGraspResponse",
        }
    }

    /// Descriptors of the message and of everything that it is made of.
    pub fn descriptors(self) -> Vec<u8> {
        match self {
            Self::PlanRecord | Self::PlanStats | Self::OutcomeRecord | Self::ServoAnswer => own_descriptors(),
            _ => FOXGLOVE.to_vec(),
        }
    }
}

const FOXGLOVE: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/foxglove.descriptors.bin"));

/// The protocol's descriptors without its comments, which would be most of a small file.
fn own_descriptors() -> Vec<u8> {
    let full = graspd_proto::FILE_DESCRIPTOR_SET;
    let Ok(mut set) = prost_types::FileDescriptorSet::decode(full) else { return full.to_vec() };
    set.file.iter_mut().for_each(|file| file.source_code_info = None);
    set.encode_to_vec()
}

/// One message.
#[derive(Debug, Clone, PartialEq)]
pub struct Message {
    /// Where viewers find it.
    pub topic: String,
    /// What it is.
    pub schema: Schema,
    /// Encoded.
    pub data: Vec<u8>,
}

impl Message {
    fn new(topic: impl Into<String>, schema: Schema, message: &impl prost::Message) -> Self {
        Self { topic: topic.into(), schema, data: message.encode_to_vec() }
    }
}

/// Of which topics a bundle takes messages.
#[derive(Debug, Clone, PartialEq, Default)]
enum Wanted {
    #[default]
    All,
    Only(BTreeSet<String>),
}

/// What belongs together: written as one chunk, with one time and one sequence number. A bundle may want messages of
/// some topics alone; the others are not encoded.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Bundle {
    /// When it happened, nanoseconds since 1970.
    pub time_ns: u64,
    /// In the order in which they are written.
    pub messages: Vec<Message>,
    wanted: Wanted,
    /// Topics that were offered, where not all are wanted.
    offered: Vec<(String, Schema)>,
}

impl Bundle {
    /// Nothing yet, at this time.
    pub fn at(time_ns: u64) -> Self {
        Self::of(time_ns, Vec::new())
    }

    /// These messages, at this time.
    pub fn of(time_ns: u64, messages: Vec<Message>) -> Self {
        Self { time_ns, messages, wanted: Wanted::All, offered: Vec::new() }
    }

    /// Nothing yet, at this time, and of these topics alone from now on; [`Self::offered`] tells which others there
    /// are.
    pub fn only(time_ns: u64, topics: BTreeSet<String>) -> Self {
        Self { wanted: Wanted::Only(topics), ..Self::at(time_ns) }
    }

    /// Every topic that was offered to a bundle made by [`Self::only`], in the order of the first offers.
    pub fn offered(&self) -> &[(String, Schema)] {
        &self.offered
    }

    /// Bytes of all messages.
    pub fn len_bytes(&self) -> u64 {
        self.messages.iter().map(|m| m.data.len() as u64 + 64).sum()
    }

    /// Adds a call with its answers: the raw pixels of its frames as images of their own, which has to come before
    /// images of the same cameras that are only to be looked at.
    pub fn push_plan(&mut self, mut record: graspd_proto::v1::PlanRecord) {
        use graspd_proto::v1::DepthEncoding;
        use graspd_proto::v1::plan_record::Request;

        let frames = match &mut record.request {
            Some(Request::PlanGrasps(plan)) => &mut plan.frames[..],
            Some(Request::PlanMultiHand(plan)) => &mut plan.frames[..],
            None => &mut [],
        };
        for (i, frame) in frames.iter_mut().enumerate() {
            let (encoding, pixel_bytes) = match frame.encoding() {
                DepthEncoding::RawU16 => ("16UC1", 2),
                DepthEncoding::RawF32 => ("32FC1", 4),
                DepthEncoding::PngU16 | DepthEncoding::Unspecified => continue,
            };
            let (Ok(width), Ok(height)) = (u32::try_from(frame.width_px), u32::try_from(frame.height_px))
            else {
                continue;
            };
            let image = foxglove::RawImage {
                timestamp: Some(self.timestamp()),
                frame_id: camera_name(&frame.camera_frame_id).to_owned(),
                width,
                height,
                encoding: encoding.to_owned(),
                step: width.saturating_mul(pixel_bytes),
                data: std::mem::take(&mut frame.data),
            };
            self.push(crate::depth_topic(i), Schema::RawImage, &image);
        }
        self.push(crate::PLAN_TOPIC, Schema::PlanRecord, &record);
    }

    /// Adds a report.
    pub fn push_outcome(&mut self, outcome: &graspd_proto::v1::OutcomeRecord) {
        self.push(crate::OUTCOME_TOPIC, Schema::OutcomeRecord, outcome);
    }

    /// Adds any message; its type has to be that of the schema.
    pub fn push(&mut self, topic: impl Into<String>, schema: Schema, message: &impl prost::Message) {
        let topic = topic.into();
        if self.wants(&topic, schema) {
            self.messages.push(Message::new(topic, schema, message));
        }
    }

    /// Adds a message that is made only if it is wanted.
    pub fn add<M: prost::Message>(
        &mut self,
        topic: impl Into<String>,
        schema: Schema,
        message: impl FnOnce() -> M,
    ) {
        let topic = topic.into();
        if self.wants(&topic, schema) {
            self.messages.push(Message::new(topic, schema, &message()));
        }
    }

    /// Offers a topic; true if messages of it are wanted.
    pub fn wants(&mut self, topic: &str, schema: Schema) -> bool {
        match &self.wanted {
            Wanted::All => true,
            Wanted::Only(topics) => {
                let wanted = topics.contains(topic);
                if !self.offered.iter().any(|(known, _)| known == topic) {
                    self.offered.push((topic.to_owned(), schema));
                }
                wanted
            }
        }
    }

    /// The bundle's time on the wire.
    pub fn timestamp(&self) -> prost_types::Timestamp {
        prost_types::Timestamp {
            seconds: i64::try_from(self.time_ns / 1_000_000_000).unwrap_or(i64::MAX),
            nanos: i32::try_from(self.time_ns % 1_000_000_000).unwrap_or(0),
        }
    }
}

/// The name of a camera's optical frame, where the caller gave none too.
pub(crate) fn camera_name(given: &str) -> &str {
    if given.is_empty() { "camera" } else { given }
}
