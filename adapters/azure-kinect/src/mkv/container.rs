//! Tracks, attachments, tags, clusters and blocks of a Matroska file.

use std::io::{Read, Seek};

use super::ebml::{Element, MkvError, Source};
use super::id;

/// Most tracks, attachments and tags that are kept: a recording has a dozen.
const MOST_ENTRIES: usize = 1024;
/// Longest codec description that is read; a bitmap header has 40 bytes.
const MOST_PRIVATE: u64 = 4096;

/// A track.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Track {
    /// Number that blocks name it by.
    pub number: u64,
    /// Id that tags name it by.
    pub uid: u64,
    /// Name, for example `DEPTH`.
    pub name: String,
    /// Codec, for example `V_MS/VFW/FOURCC`.
    pub codec: String,
    /// The codec's own description.
    pub private: Vec<u8>,
    /// Width and height, pixels; zeros where it is no video.
    pub size: (u64, u64),
    /// Duration of a frame, nanoseconds; 0 where it does not say.
    pub frame_ns: u64,
}

/// An attached file. Its bytes are read by [`Container::attached`].
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Attachment {
    /// File name.
    pub name: String,
    /// Id that tags name it by.
    pub uid: u64,
    at: u64,
    length: u64,
}

/// A tag: one name, one text, and what it is about.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Tag {
    /// Name, for example `K4A_DEPTH_MODE`.
    pub name: String,
    /// Text.
    pub text: String,
    /// Tracks that it is about; none for the whole file.
    pub tracks: Vec<u64>,
    /// Attachments that it is about.
    pub attachments: Vec<u64>,
}

/// A block: bytes of one track at one time. Its bytes are read by [`Container::payload`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Block {
    /// Number of its track.
    pub track: u64,
    /// Time since the file's zero, nanoseconds.
    pub time_ns: i64,
    /// Several frames in one block.
    pub laced: bool,
    /// Where its bytes begin.
    pub at: u64,
    /// How many they are.
    pub length: u64,
}

/// Where the next block is looked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Place {
    at: u64,
    /// End of the cluster that it lies in; `None` between clusters.
    cluster_end: Option<u64>,
    cluster_time: u64,
}

/// A Matroska file.
#[derive(Debug)]
pub struct Container<R> {
    source: Source<R>,
    /// Nanoseconds of one tick.
    pub tick_ns: u64,
    /// The program that wrote it.
    pub writer: String,
    /// Its tracks.
    pub tracks: Vec<Track>,
    /// Its attachments.
    pub attachments: Vec<Attachment>,
    /// Its tags.
    pub tags: Vec<Tag>,
    /// True when the file ends before its last element does: a recording that was cut off.
    pub cut: bool,
    segment_end: u64,
    first_cluster: Option<u64>,
    place: Place,
}

impl<R: Read + Seek> Container<R> {
    /// Reads everything but the blocks.
    ///
    /// # Errors
    /// [`MkvError`] for a file of another kind, or one that is broken before its first cluster.
    pub fn open(inner: R) -> Result<Self, MkvError> {
        let mut source = Source::new(inner)?;
        let head = source.element()?;
        if head.id != id::EBML || head.exceeds(source.len()) {
            return Err(MkvError::wrong(0, "the file", format!("id {:#x}", head.id), "a Matroska file"));
        }
        let mut kind = "matroska".to_owned();
        let end = head.end(source.len());
        while source.at() < end {
            let child = source.element()?;
            if child.id == id::DOC_TYPE {
                kind = source.text(&child, "the document type")?;
            }
            source.seek(child.end(end))?;
        }
        if kind != "matroska" {
            return Err(MkvError::wrong(0, "the document type", kind, "matroska"));
        }
        let segment = source.element()?;
        if segment.id != id::SEGMENT {
            let found = format!("id {:#x}", segment.id);
            return Err(MkvError::wrong(segment.at, "the file", found, "a segment"));
        }
        let segment_end = segment.end(source.len());
        let mut container = Self {
            cut: segment.exceeds(source.len()),
            source,
            tick_ns: 1_000_000,
            writer: String::new(),
            tracks: Vec::new(),
            attachments: Vec::new(),
            tags: Vec::new(),
            segment_end,
            first_cluster: None,
            place: Place { at: segment.body, cluster_end: None, cluster_time: 0 },
        };
        container.read_top(segment.body)?;
        container.rewind();
        Ok(container)
    }

    /// Goes through what stands directly in the segment. Behind the first cluster nothing must be there, and a broken
    /// element ends the search.
    fn read_top(&mut self, from: u64) -> Result<(), MkvError> {
        self.source.seek(from)?;
        while self.source.at() < self.segment_end {
            let step = self.read_top_element();
            match step {
                Ok(()) => {}
                Err(_) if self.first_cluster.is_some() => {
                    self.cut = true;
                    break;
                }
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    fn read_top_element(&mut self) -> Result<(), MkvError> {
        let element = self.source.element()?;
        let end = element.end(self.segment_end);
        if element.exceeds(self.segment_end) {
            self.cut = true;
        }
        match element.id {
            id::CLUSTER => {
                self.first_cluster.get_or_insert(element.at);
                if element.length.is_none() {
                    let end = self.skip_open_cluster(element.body)?;
                    return self.source.seek(end);
                }
            }
            id::INFO => self.read_info(end)?,
            id::TRACKS => self.read_each(end, id::TRACK_ENTRY, Self::read_track)?,
            id::ATTACHMENTS => self.read_each(end, id::ATTACHED_FILE, Self::read_attachment)?,
            id::TAGS => self.read_each(end, id::TAG, Self::read_tag)?,
            _ => {}
        }
        self.source.seek(end)
    }

    /// Where a cluster of unknown length ends: at the next element that stands directly in the segment.
    fn skip_open_cluster(&mut self, from: u64) -> Result<u64, MkvError> {
        self.source.seek(from)?;
        while self.source.at() < self.segment_end {
            let child = self.source.element()?;
            if id::TOP.contains(&child.id) {
                return Ok(child.at);
            }
            self.source.seek(child.end(self.segment_end))?;
        }
        Ok(self.segment_end)
    }

    fn read_info(&mut self, end: u64) -> Result<(), MkvError> {
        while self.source.at() < end {
            let child = self.source.element()?;
            match child.id {
                id::TIMECODE_SCALE => {
                    let tick_ns = self.source.unsigned(&child, "the timecode scale")?;
                    if !(1..=1_000_000_000).contains(&tick_ns) {
                        let expected = "1 to 1000000000 ns";
                        return Err(MkvError::wrong(child.body, "the timecode scale", tick_ns, expected));
                    }
                    self.tick_ns = tick_ns;
                }
                id::WRITING_APP => self.writer = self.source.text(&child, "the writing program")?,
                _ => {}
            }
            self.source.seek(child.end(end))?;
        }
        Ok(())
    }

    fn read_each(
        &mut self,
        end: u64,
        wanted: u32,
        read: fn(&mut Self, u64) -> Result<(), MkvError>,
    ) -> Result<(), MkvError> {
        while self.source.at() < end {
            let child = self.source.element()?;
            if child.id == wanted {
                if self.tracks.len().max(self.attachments.len()).max(self.tags.len()) >= MOST_ENTRIES {
                    let expected = "at most 1024 tracks, attachments or tags";
                    return Err(MkvError::wrong(child.at, "the file", "more", expected));
                }
                read(self, child.end(end))?;
            }
            self.source.seek(child.end(end))?;
        }
        Ok(())
    }

    /// The elements up to `end`, each with what it is read by.
    fn children(
        &mut self,
        end: u64,
        mut read: impl FnMut(&mut Source<R>, &Element) -> Result<(), MkvError>,
    ) -> Result<(), MkvError> {
        while self.source.at() < end {
            let child = self.source.element()?;
            read(&mut self.source, &child)?;
            self.source.seek(child.end(end))?;
        }
        Ok(())
    }

    fn read_track(&mut self, end: u64) -> Result<(), MkvError> {
        let mut track = Track::default();
        self.children(end, |source, child| {
            match child.id {
                id::TRACK_NUMBER => track.number = source.unsigned(child, "a track's number")?,
                id::TRACK_UID => track.uid = source.unsigned(child, "a track's id")?,
                id::TRACK_NAME => track.name = source.text(child, "a track's name")?,
                id::CODEC_ID => track.codec = source.text(child, "a track's codec")?,
                id::CODEC_PRIVATE => {
                    track.private = source.body(child, MOST_PRIVATE, "a codec's description")?;
                }
                id::DEFAULT_DURATION => track.frame_ns = source.unsigned(child, "a frame's duration")?,
                id::VIDEO => {
                    let end = child.end(end);
                    while source.at() < end {
                        let inner = source.element()?;
                        match inner.id {
                            id::PIXEL_WIDTH => track.size.0 = source.unsigned(&inner, "a width")?,
                            id::PIXEL_HEIGHT => track.size.1 = source.unsigned(&inner, "a height")?,
                            _ => {}
                        }
                        source.seek(inner.end(end))?;
                    }
                }
                _ => {}
            }
            Ok(())
        })?;
        self.tracks.push(track);
        Ok(())
    }

    fn read_attachment(&mut self, end: u64) -> Result<(), MkvError> {
        let mut attachment = Attachment::default();
        self.children(end, |source, child| {
            match child.id {
                id::FILE_NAME => attachment.name = source.text(child, "an attachment's name")?,
                id::FILE_UID => attachment.uid = source.unsigned(child, "an attachment's id")?,
                id::FILE_DATA => {
                    (attachment.at, attachment.length) =
                        (child.body, child.end(end).saturating_sub(child.body));
                }
                _ => {}
            }
            Ok(())
        })?;
        self.attachments.push(attachment);
        Ok(())
    }

    fn read_tag(&mut self, end: u64) -> Result<(), MkvError> {
        let mut tag = Tag::default();
        self.children(end, |source, child| {
            if child.id != id::TARGETS && child.id != id::SIMPLE_TAG {
                return Ok(());
            }
            let end = child.end(end);
            while source.at() < end {
                let inner = source.element()?;
                match inner.id {
                    id::TAG_TRACK_UID => tag.tracks.push(source.unsigned(&inner, "a tag's target")?),
                    id::TAG_ATTACHMENT_UID => {
                        tag.attachments.push(source.unsigned(&inner, "a tag's target")?)
                    }
                    id::TAG_NAME => tag.name = source.text(&inner, "a tag's name")?,
                    id::TAG_STRING => tag.text = source.text(&inner, "a tag's text")?,
                    _ => {}
                }
                source.seek(inner.end(end))?;
            }
            Ok(())
        })?;
        self.tags.push(tag);
        Ok(())
    }

    /// The text of a tag.
    pub fn tag(&self, name: &str) -> Option<&str> {
        self.tags.iter().find(|tag| tag.name == name).map(|tag| tag.text.as_str())
    }

    /// The bytes of an attachment, at most `most`.
    ///
    /// # Errors
    /// [`MkvError`].
    pub fn attached(&mut self, attachment: &Attachment, most: u64) -> Result<Vec<u8>, MkvError> {
        self.source.bytes(attachment.at, attachment.length, most, "an attachment")
    }

    /// Goes back to the first block.
    pub fn rewind(&mut self) {
        let at = self.first_cluster.unwrap_or(self.segment_end);
        self.place = Place { at, cluster_end: None, cluster_time: 0 };
    }

    /// The next block of any track, in the file's order; `None` at the end, which in a file that was cut off is its last
    /// whole block.
    ///
    /// # Errors
    /// [`MkvError`]. The next call then ends.
    pub fn next_block(&mut self) -> Result<Option<Block>, MkvError> {
        let next = self.find_block();
        match next {
            Err(MkvError::Cut { .. }) => {
                self.cut = true;
                self.place = Place { at: self.segment_end, cluster_end: None, cluster_time: 0 };
                Ok(None)
            }
            Err(error) => {
                self.place = Place { at: self.segment_end, cluster_end: None, cluster_time: 0 };
                Err(error)
            }
            found => found,
        }
    }

    fn find_block(&mut self) -> Result<Option<Block>, MkvError> {
        loop {
            if let Some(end) = self.place.cluster_end
                && self.place.at >= end
            {
                self.place.cluster_end = None;
            }
            if self.place.at >= self.segment_end {
                return Ok(None);
            }
            self.source.seek(self.place.at)?;
            let element = self.source.element()?;
            let limit = self.place.cluster_end.unwrap_or(self.segment_end);
            let inside = self.place.cluster_end.is_some();
            match element.id {
                id::CLUSTER => {
                    let end = element.end(self.segment_end);
                    self.place = Place { at: element.body, cluster_end: Some(end), cluster_time: 0 };
                    continue;
                }
                id::TIMECODE if inside => {
                    self.place.cluster_time = self.source.unsigned(&element, "a cluster's time")?;
                }
                // What is in a group is looked at as if it stood in the cluster itself.
                id::BLOCK_GROUP if inside => {
                    self.place.at = element.body;
                    continue;
                }
                id::SIMPLE_BLOCK | id::BLOCK if inside => {
                    let block = self.read_block(&element)?;
                    self.place.at = element.end(limit);
                    return Ok(Some(block));
                }
                _ => {}
            }
            self.place.at = element.end(limit);
        }
    }

    fn read_block(&mut self, element: &Element) -> Result<Block, MkvError> {
        if element.length.is_none() {
            return Err(MkvError::wrong(element.at, "a block", "an unknown length", "a known one"));
        }
        if element.exceeds(self.source.len()) {
            return Err(MkvError::Cut { at: element.at, what: "a block" });
        }
        let end = element.end(self.source.len());
        let (track, _) = self.source.number("a block's track")?;
        let ticks = i16::from_be_bytes([self.source.byte("a block")?, self.source.byte("a block")?]);
        let flags = self.source.byte("a block's flags")?;
        if self.source.at() > end {
            return Err(MkvError::wrong(element.at, "a block", "a head beyond its end", "a whole head"));
        }
        let ticks = i128::from(self.place.cluster_time) + i128::from(ticks);
        let time_ns = i64::try_from(ticks * i128::from(self.tick_ns)).map_err(|_| {
            MkvError::wrong(element.at, "a block's time", ticks, "at most 292 years in nanoseconds")
        })?;
        let at = self.source.at();
        Ok(Block { track, time_ns, laced: flags & 0x06 != 0, at, length: end.saturating_sub(at) })
    }

    /// The bytes of a block, at most `most`.
    ///
    /// # Errors
    /// [`MkvError`].
    pub fn payload(&mut self, block: &Block, most: u64) -> Result<Vec<u8>, MkvError> {
        self.source.bytes(block.at, block.length, most, "a block")
    }
}
