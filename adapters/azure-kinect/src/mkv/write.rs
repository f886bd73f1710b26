//! Recordings written in the layout of the device's own recorder: of frames that are made up or simulated, for tests and for
//! other software that reads such recordings.

use super::id;

use crate::mode::DepthMode;

/// What a recording says of itself.
#[derive(Debug, Clone, PartialEq)]
pub struct Header<'a> {
    /// Depth mode.
    pub mode: DepthMode,
    /// Duration of a frame, nanoseconds.
    pub frame_ns: u64,
    /// Device time of the file's zero, nanoseconds.
    pub start_offset_ns: u64,
    /// Text of the calibration.
    pub calibration: &'a str,
    /// Serial number of the device.
    pub serial: &'a str,
}

const DEPTH_UID: u64 = 0x1122_3344_5566_7788;
const IR_UID: u64 = 0x1122_3344_5566_7799;
const FILE_UID: u64 = 0x0102_0304_0506_0708;
const DEPTH_NUMBER: u64 = 1;
const IR_NUMBER: u64 = 2;
/// Ticks of a microsecond, as the device's recorder has them.
const TICK_NS: u64 = 1000;

/// A recording that grows frame by frame in memory.
#[derive(Debug, Clone)]
pub struct Recorder {
    /// Information, tracks, attachments and tags: id and whole element.
    head: Vec<(u32, Vec<u8>)>,
    clusters: Vec<u8>,
    /// Time of each cluster, and where in `clusters` it begins.
    times: Vec<(u64, usize)>,
    size: (usize, usize),
}

impl Recorder {
    /// A recording without a frame yet.
    pub fn new(header: &Header<'_>) -> Self {
        let mut head = Vec::new();
        let mut add = |id: u32, body: &[u8]| {
            let mut whole = Vec::new();
            master(&mut whole, id, body);
            head.push((id, whole));
        };
        let mut info = Vec::new();
        unsigned(&mut info, id::TIMECODE_SCALE, TICK_NS);
        text(&mut info, id::TITLE, "Azure Kinect");
        text(&mut info, id::MUXING_APP, "graspd");
        text(&mut info, id::WRITING_APP, "graspd");
        add(id::INFO, &info);

        let mut tracks = Vec::new();
        let (width, height) = header.mode.size();
        for (number, uid, name) in [(DEPTH_NUMBER, DEPTH_UID, "DEPTH"), (IR_NUMBER, IR_UID, "IR")] {
            let mut track = Vec::new();
            unsigned(&mut track, id::TRACK_NUMBER, number);
            unsigned(&mut track, id::TRACK_UID, uid);
            unsigned(&mut track, id::TRACK_TYPE, 1);
            text(&mut track, id::TRACK_NAME, name);
            text(&mut track, id::CODEC_ID, "V_MS/VFW/FOURCC");
            element(&mut track, id::CODEC_PRIVATE, &bitmap_header(width, height));
            unsigned(&mut track, id::DEFAULT_DURATION, header.frame_ns);
            let mut video = Vec::new();
            unsigned(&mut video, id::PIXEL_WIDTH, width as u64);
            unsigned(&mut video, id::PIXEL_HEIGHT, height as u64);
            master(&mut track, id::VIDEO, &video);
            master(&mut tracks, id::TRACK_ENTRY, &track);
        }
        add(id::TRACKS, &tracks);

        let mut file = Vec::new();
        text(&mut file, id::FILE_NAME, "calibration.json");
        text(&mut file, id::FILE_MIME, "application/octet-stream");
        element(&mut file, id::FILE_DATA, header.calibration.as_bytes());
        unsigned(&mut file, id::FILE_UID, FILE_UID);
        let mut attachments = Vec::new();
        master(&mut attachments, id::ATTACHED_FILE, &file);
        add(id::ATTACHMENTS, &attachments);

        let mut tags = Vec::new();
        tag(&mut tags, "K4A_DEPTH_TRACK", &DEPTH_UID.to_string(), Some((id::TAG_TRACK_UID, DEPTH_UID)));
        tag(&mut tags, "K4A_DEPTH_MODE", header.mode.tag(), Some((id::TAG_TRACK_UID, DEPTH_UID)));
        tag(&mut tags, "K4A_IR_TRACK", &IR_UID.to_string(), Some((id::TAG_TRACK_UID, IR_UID)));
        tag(&mut tags, "K4A_IR_MODE", "ACTIVE", Some((id::TAG_TRACK_UID, IR_UID)));
        let file_target = Some((id::TAG_ATTACHMENT_UID, FILE_UID));
        tag(&mut tags, "K4A_CALIBRATION_FILE", "calibration.json", file_target);
        tag(&mut tags, "K4A_START_OFFSET_NS", &header.start_offset_ns.to_string(), None);
        tag(&mut tags, "K4A_DEVICE_SERIAL_NUMBER", header.serial, None);
        add(id::TAGS, &tags);
        Self { head, clusters: Vec::new(), times: Vec::new(), size: (width, height) }
    }

    /// Adds a frame at a time since the file's zero. A frame of another size is not added.
    pub fn push(&mut self, time_us: u64, depth_mm: &[u16], ir: &[u16]) -> bool {
        let pixels = self.size.0 * self.size.1;
        if depth_mm.len() != pixels || ir.len() != pixels {
            return false;
        }
        let mut cluster = Vec::new();
        unsigned(&mut cluster, id::TIMECODE, time_us);
        for (number, image) in [(DEPTH_NUMBER, depth_mm), (IR_NUMBER, ir)] {
            let mut block = vec![0x80 | number as u8, 0, 0, 0x80];
            block.extend(image.iter().flat_map(|value| value.to_be_bytes()));
            element(&mut cluster, id::SIMPLE_BLOCK, &block);
        }
        self.times.push((time_us, self.clusters.len()));
        master(&mut self.clusters, id::CLUSTER, &cluster);
        true
    }

    /// Where the element `i` of the head begins in the segment, or what comes after it.
    fn position(&self, i: usize) -> usize {
        let table = seek_head(&vec![(id::CUES, 0); self.head.len() + 1]).len();
        table + self.head[..i].iter().map(|(_, element)| element.len()).sum::<usize>()
    }

    /// The whole file.
    pub fn finish(self) -> Vec<u8> {
        let mut ebml = Vec::new();
        for (number, value) in [(0x4286, 1), (0x42F7, 1), (0x42F2, 4), (0x42F3, 8)] {
            unsigned(&mut ebml, number, value);
        }
        text(&mut ebml, id::DOC_TYPE, "matroska");
        unsigned(&mut ebml, 0x4287, 2);
        unsigned(&mut ebml, 0x4285, 2);
        let mut file = Vec::new();
        master(&mut file, id::EBML, &ebml);
        // Readers of the device's own software find everything by the table in front, and frames by the one behind.
        let first_cluster = self.position(self.head.len());
        let mut cues = Vec::new();
        for (time_us, at) in &self.times {
            let mut track = Vec::new();
            unsigned(&mut track, 0xF7, DEPTH_NUMBER);
            unsigned(&mut track, 0xF1, (first_cluster + at) as u64);
            let mut point = Vec::new();
            unsigned(&mut point, 0xB3, *time_us);
            master(&mut point, 0xB7, &track);
            master(&mut cues, 0xBB, &point);
        }
        let mut places: Vec<(u32, usize)> =
            self.head.iter().enumerate().map(|(i, (id, _))| (*id, self.position(i))).collect();
        places.push((id::CUES, first_cluster + self.clusters.len()));
        let mut segment = seek_head(&places);
        for (_, element) in &self.head {
            segment.extend(element);
        }
        segment.extend(&self.clusters);
        master(&mut segment, id::CUES, &cues);
        master(&mut file, id::SEGMENT, &segment);
        file
    }
}

/// Where in the segment elements begin. Its length depends on their number only.
fn seek_head(places: &[(u32, usize)]) -> Vec<u8> {
    let mut entries = Vec::new();
    for (id, at) in places {
        let mut entry = Vec::new();
        element(&mut entry, 0x53AB, &id.to_be_bytes());
        unsigned(&mut entry, 0x53AC, *at as u64);
        master(&mut entries, 0x4DBB, &entry);
    }
    let mut table = Vec::new();
    master(&mut table, id::SEEK_HEAD, &entries);
    table
}

fn bitmap_header(width: usize, height: usize) -> Vec<u8> {
    let mut header = Vec::with_capacity(40);
    let size = (width * height * 2) as u32;
    for value in [40, width as u32, height as u32] {
        header.extend(value.to_le_bytes());
    }
    header.extend([1, 0, 16, 0]);
    header.extend(b"b16g");
    header.extend(size.to_le_bytes());
    header.resize(40, 0);
    header
}

fn element(out: &mut Vec<u8>, id: u32, body: &[u8]) {
    let bytes = id.to_be_bytes();
    let first = bytes.iter().position(|b| *b != 0).unwrap_or(3);
    out.extend(&bytes[first..]);
    // Lengths of eight bytes everywhere: simple, and what the device's recorder does for large elements.
    out.extend((0x0100_0000_0000_0000 | body.len() as u64).to_be_bytes());
    out.extend(body);
}

fn master(out: &mut Vec<u8>, id: u32, body: &[u8]) {
    element(out, id, body);
}

fn unsigned(out: &mut Vec<u8>, id: u32, value: u64) {
    element(out, id, &value.to_be_bytes());
}

fn text(out: &mut Vec<u8>, id: u32, value: &str) {
    element(out, id, value.as_bytes());
}

fn tag(out: &mut Vec<u8>, name: &str, value: &str, target: Option<(u32, u64)>) {
    let mut targets = Vec::new();
    if let Some((kind, uid)) = target {
        unsigned(&mut targets, kind, uid);
    }
    let mut simple = Vec::new();
    text(&mut simple, id::TAG_NAME, name);
    text(&mut simple, id::TAG_STRING, value);
    let mut tag = Vec::new();
    master(&mut tag, id::TARGETS, &targets);
    master(&mut tag, id::SIMPLE_TAG, &simple);
    master(out, id::TAG, &tag);
}
