//! Matroska files, as far as recordings of the device need them: no more elements than these, written by nobody else.
//!
//! - [`ebml`]: elements and their lengths; every length is checked against what is there.
//! - [`container`]: tracks, attachments, tags, clusters and blocks.
//! - [`mod@write`]: the same layout written: made-up recordings.
//!
//! Why a reader of our own: the Rust demultiplexers at hand read no attachments, and the calibration is one.

pub mod container;
pub mod ebml;
pub mod write;

pub use container::{Attachment, Block, Container, Tag, Track};
pub use ebml::MkvError;

/// Element ids, with their length marker.
pub(crate) mod id {
    pub(crate) const EBML: u32 = 0x1A45_DFA3;
    pub(crate) const DOC_TYPE: u32 = 0x4282;
    pub(crate) const SEGMENT: u32 = 0x1853_8067;
    pub(crate) const INFO: u32 = 0x1549_A966;
    pub(crate) const TIMECODE_SCALE: u32 = 0x2A_D7B1;
    pub(crate) const TITLE: u32 = 0x7BA9;
    pub(crate) const MUXING_APP: u32 = 0x4D80;
    pub(crate) const WRITING_APP: u32 = 0x5741;
    pub(crate) const TRACKS: u32 = 0x1654_AE6B;
    pub(crate) const TRACK_ENTRY: u32 = 0xAE;
    pub(crate) const TRACK_NUMBER: u32 = 0xD7;
    pub(crate) const TRACK_UID: u32 = 0x73C5;
    pub(crate) const TRACK_TYPE: u32 = 0x83;
    pub(crate) const TRACK_NAME: u32 = 0x536E;
    pub(crate) const CODEC_ID: u32 = 0x86;
    pub(crate) const CODEC_PRIVATE: u32 = 0x63A2;
    pub(crate) const DEFAULT_DURATION: u32 = 0x23_E383;
    pub(crate) const VIDEO: u32 = 0xE0;
    pub(crate) const PIXEL_WIDTH: u32 = 0xB0;
    pub(crate) const PIXEL_HEIGHT: u32 = 0xBA;
    pub(crate) const ATTACHMENTS: u32 = 0x1941_A469;
    pub(crate) const ATTACHED_FILE: u32 = 0x61A7;
    pub(crate) const FILE_NAME: u32 = 0x466E;
    pub(crate) const FILE_MIME: u32 = 0x4660;
    pub(crate) const FILE_DATA: u32 = 0x465C;
    pub(crate) const FILE_UID: u32 = 0x46AE;
    pub(crate) const TAGS: u32 = 0x1254_C367;
    pub(crate) const TAG: u32 = 0x7373;
    pub(crate) const TARGETS: u32 = 0x63C0;
    pub(crate) const TAG_TRACK_UID: u32 = 0x63C5;
    pub(crate) const TAG_ATTACHMENT_UID: u32 = 0x63C6;
    pub(crate) const SIMPLE_TAG: u32 = 0x67C8;
    pub(crate) const TAG_NAME: u32 = 0x45A3;
    pub(crate) const TAG_STRING: u32 = 0x4487;
    pub(crate) const CUES: u32 = 0x1C53_BB6B;
    pub(crate) const SEEK_HEAD: u32 = 0x114D_9B74;
    pub(crate) const CHAPTERS: u32 = 0x1043_A770;
    pub(crate) const CLUSTER: u32 = 0x1F43_B675;
    pub(crate) const TIMECODE: u32 = 0xE7;
    pub(crate) const SIMPLE_BLOCK: u32 = 0xA3;
    pub(crate) const BLOCK_GROUP: u32 = 0xA0;
    pub(crate) const BLOCK: u32 = 0xA1;

    /// Elements that stand directly in a segment: where one begins, a cluster of unknown length has ended.
    pub(crate) const TOP: [u32; 8] = [INFO, TRACKS, ATTACHMENTS, TAGS, CUES, SEEK_HEAD, CHAPTERS, CLUSTER];
}
