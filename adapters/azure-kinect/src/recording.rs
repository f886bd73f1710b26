//! Recordings of the device (`k4arecorder`, `.mkv`): depth and infrared images with their times, and the calibration.

use std::fs::File;
use std::io::{Read, Seek};
use std::path::Path;
use std::time::Duration;

use crate::calibration::{Calibration, CalibrationError, MAX_BYTES};
use crate::lens::{KinectLens, LensError};
use crate::mkv::{Block, Container, MkvError, Track};
use crate::mode::DepthMode;

/// Fastest and slowest frame period that is believed.
const PERIODS_NS: std::ops::RangeInclusive<u64> = 1_000_000..=60_000_000_000;
/// Frame period of a recording that does not say: 30 frames a second.
const DEFAULT_PERIOD_NS: u64 = 33_333_333;

/// Why a recording cannot be read.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// The file cannot be opened.
    #[error("{path}: {detail}")]
    Open {
        /// The file.
        path: String,
        /// What the file system said.
        detail: String,
    },
    /// It is no Matroska file, or a broken one.
    #[error(transparent)]
    Format(#[from] MkvError),
    /// The calibration is wrong.
    #[error(transparent)]
    Calibration(#[from] CalibrationError),
    /// The lens is one that frames cannot carry.
    #[error(transparent)]
    Lens(#[from] LensError),
    /// Something that a recording needs is missing or of another kind.
    #[error("{what}: found {found}, expected {expected}")]
    Content {
        /// What was looked for.
        what: &'static str,
        /// Found value.
        found: String,
        /// What is expected.
        expected: String,
    },
}

fn content<T>(
    what: &'static str,
    found: impl ToString,
    expected: impl Into<String>,
) -> Result<T, RecordingError> {
    Err(RecordingError::Content { what, found: found.to_string(), expected: expected.into() })
}

/// Which image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Channel {
    /// Depth, millimetres along the optical axis; 0 where there is none.
    Depth,
    /// Infrared brightness.
    Infrared,
}

/// An image of 16 bits a pixel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    /// Which.
    pub channel: Channel,
    /// Row major.
    pub values: Vec<u16>,
    /// Time of the device's clock.
    pub stamp: Duration,
    /// Time since the file's zero.
    pub time: Duration,
}

/// A recording that is read from beginning to end.
#[derive(Debug)]
pub struct Recording<R = File> {
    file: Container<R>,
    mode: DepthMode,
    calibration: Calibration,
    depth: u64,
    infrared: Option<u64>,
    period: Duration,
    start_offset: Duration,
}

impl Recording {
    /// Opens a file. Blocking.
    ///
    /// # Errors
    /// [`RecordingError`].
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let file = File::open(path).map_err(|error| RecordingError::Open {
            path: path.display().to_string(),
            detail: error.to_string(),
        })?;
        Self::new(file)
    }
}

impl<R: Read + Seek> Recording<R> {
    /// Reads everything but the images. Blocking, where the source is.
    ///
    /// # Errors
    /// [`RecordingError`].
    pub fn new(source: R) -> Result<Self, RecordingError> {
        let mut file = Container::open(source)?;
        let mode = match file.tag("K4A_DEPTH_MODE") {
            Some(tag) => match DepthMode::from_tag(tag) {
                Some(mode) => mode,
                None => return content("K4A_DEPTH_MODE", tag, "a mode that measures depth"),
            },
            None => {
                let found = file.tracks.iter().map(|t| t.name.as_str()).collect::<Vec<_>>().join(", ");
                let found = format!("no such tag, and tracks [{found}]");
                return content("K4A_DEPTH_MODE", found, "a recording of an Azure Kinect with depth");
            }
        };
        let Some(depth) = find(&file, "K4A_DEPTH_TRACK", "DEPTH").cloned() else {
            return content("the depth track", "none", "a track named DEPTH");
        };
        check_track(&depth, mode)?;
        let infrared = find(&file, "K4A_IR_TRACK", "IR").map(|track| track.number);
        let start_offset = match file.tag("K4A_START_OFFSET_NS").map(str::parse::<u64>) {
            None => Duration::ZERO,
            Some(Ok(ns)) => Duration::from_nanos(ns),
            Some(Err(error)) => return content("K4A_START_OFFSET_NS", error, "nanoseconds"),
        };
        let name = file.tag("K4A_CALIBRATION_FILE").unwrap_or("calibration.json").to_owned();
        let Some(attachment) = file.attachments.iter().find(|a| a.name == name).cloned() else {
            return content("the calibration", "no attachment of its name", name);
        };
        let text = file.attached(&attachment, MAX_BYTES as u64)?;
        let calibration = Calibration::from_json(&text)?;
        let period_ns = if PERIODS_NS.contains(&depth.frame_ns) { depth.frame_ns } else { DEFAULT_PERIOD_NS };
        Ok(Self {
            file,
            mode,
            calibration,
            depth: depth.number,
            infrared,
            period: Duration::from_nanos(period_ns),
            start_offset,
        })
    }

    /// Depth mode.
    pub fn mode(&self) -> DepthMode {
        self.mode
    }

    /// Calibration of the device.
    pub fn calibration(&self) -> &Calibration {
        &self.calibration
    }

    /// The depth camera's lens.
    pub fn lens(&self) -> KinectLens {
        self.calibration.depth_lens(self.mode)
    }

    /// Duration of a frame.
    pub fn period(&self) -> Duration {
        self.period
    }

    /// Serial number of the device, where it says.
    pub fn serial(&self) -> Option<&str> {
        self.file.tag("K4A_DEVICE_SERIAL_NUMBER")
    }

    /// The file's tracks, tags and attachments.
    pub fn container(&self) -> &Container<R> {
        &self.file
    }

    /// True when the file ends before its last element does.
    pub fn is_cut(&self) -> bool {
        self.file.cut
    }

    /// Goes back to the beginning.
    pub fn rewind(&mut self) {
        self.file.rewind();
    }

    /// The next image of depth or infrared, in the file's order; `None` at the end.
    ///
    /// # Errors
    /// [`RecordingError`].
    pub fn next_image(&mut self) -> Result<Option<Image>, RecordingError> {
        self.next_of(true)
    }

    /// The next depth image; `None` at the end.
    ///
    /// # Errors
    /// [`RecordingError`].
    pub fn next_depth(&mut self) -> Result<Option<Image>, RecordingError> {
        self.next_of(false)
    }

    fn next_of(&mut self, infrared: bool) -> Result<Option<Image>, RecordingError> {
        while let Some(block) = self.file.next_block()? {
            if block.track == self.depth {
                return self.image(&block, Channel::Depth).map(Some);
            }
            if infrared && Some(block.track) == self.infrared {
                return self.image(&block, Channel::Infrared).map(Some);
            }
        }
        Ok(None)
    }

    fn image(&mut self, block: &Block, channel: Channel) -> Result<Image, RecordingError> {
        let (width, height) = self.mode.size();
        let expected = (width * height * 2) as u64;
        if block.laced || block.length != expected {
            let laced = if block.laced { ", laced" } else { "" };
            let found = format!("{} bytes{laced}", block.length);
            return content("an image", found, format!("{expected} bytes ({width} x {height})"));
        }
        let bytes = self.file.payload(block, expected)?;
        let (pairs, _) = bytes.as_chunks::<2>();
        let values = pairs.iter().map(|pair| u16::from_be_bytes(*pair)).collect();
        let time = Duration::from_nanos(u64::try_from(block.time_ns).unwrap_or(0));
        Ok(Image { channel, values, stamp: self.start_offset.saturating_add(time), time })
    }
}

/// The track that a tag names by its id, else the one of a name.
fn find<'a, R>(file: &'a Container<R>, tag: &str, name: &str) -> Option<&'a Track>
where
    R: Read + Seek,
{
    let uid = file.tag(tag).and_then(|text| text.parse::<u64>().ok());
    let tagged = uid.and_then(|uid| file.tracks.iter().find(|track| track.uid == uid));
    tagged.or_else(|| file.tracks.iter().find(|track| track.name == name))
}

/// Depth must be what its mode says, sixteen bits a pixel, highest byte first.
fn check_track(track: &Track, mode: DepthMode) -> Result<(), RecordingError> {
    let (width, height) = mode.size();
    if track.size != (width as u64, height as u64) {
        let (found_width, found_height) = track.size;
        let expected = format!("{width} x {height} ({})", mode.tag());
        return content("the depth track", format!("{found_width} x {found_height}"), expected);
    }
    let code = track.private.get(16..20).unwrap_or_default();
    if track.codec != "V_MS/VFW/FOURCC" || code != b"b16g" {
        let found = format!("{} {:?}", track.codec, String::from_utf8_lossy(code));
        return content("the depth track's codec", found, "V_MS/VFW/FOURCC \"b16g\"");
    }
    Ok(())
}

#[cfg(test)]
pub(crate) mod tests {
    use std::io::Cursor;

    use super::*;
    use crate::calibration::EXAMPLE;
    use crate::mkv::write::{Header, Recorder};
    use proptest::prelude::*;

    /// A recording of the smallest mode: frame `n` is at `n` periods, its pixel `i` has the depth `1000 + 10 n + i % 7`.
    pub(crate) fn made_up(frames: u64) -> Vec<u8> {
        let header = Header {
            mode: DepthMode::Nfov2x2binned,
            frame_ns: 33_333_333,
            start_offset_ns: 336_277_000,
            calibration: EXAMPLE,
            serial: "000123",
        };
        let mut recorder = Recorder::new(&header);
        for n in 0..frames {
            let depth: Vec<u16> = (0..320 * 288).map(|i| 1000 + 10 * n as u16 + (i % 7) as u16).collect();
            let infrared = vec![500 + n as u16; 320 * 288];
            assert!(recorder.push(n * 33_333, &depth, &infrared));
        }
        recorder.finish()
    }

    #[test]
    fn what_was_written_is_read() {
        let mut recording = Recording::new(Cursor::new(made_up(3))).unwrap();
        assert_eq!((recording.mode(), recording.serial()), (DepthMode::Nfov2x2binned, Some("000123")));
        assert_eq!(recording.period(), Duration::from_nanos(33_333_333));
        assert_eq!(recording.container().writer, "graspd");
        assert!(!recording.is_cut());
        for _ in 0..2 {
            for n in 0..3u16 {
                let image = recording.next_depth().unwrap().unwrap();
                assert_eq!(image.time, Duration::from_micros(33_333 * u64::from(n)));
                assert_eq!(image.stamp, image.time + Duration::from_nanos(336_277_000));
                assert_eq!((image.values.len(), image.values[8]), (320 * 288, 1001 + 10 * n));
            }
            assert_eq!(recording.next_depth().unwrap(), None);
            assert_eq!(recording.next_depth().unwrap(), None);
            recording.rewind();
        }
        let channels: Vec<_> =
            std::iter::from_fn(|| recording.next_image().unwrap()).map(|image| image.channel).collect();
        assert_eq!(channels, [Channel::Depth, Channel::Infrared].repeat(3));
    }

    #[test]
    fn a_recording_that_was_cut_off_gives_its_whole_frames() {
        let file = made_up(3);
        let frame = 2 * 320 * 288 * 2;
        for kept in [file.len() - 10, file.len() - frame / 2 - 100, file.len() - frame] {
            let mut recording = Recording::new(Cursor::new(file[..kept].to_vec())).unwrap();
            assert!(recording.is_cut());
            let mut frames = 0;
            while recording.next_depth().unwrap().is_some() {
                frames += 1;
            }
            assert!((2..=3).contains(&frames), "{frames} of 3 in {kept} bytes");
        }
    }

    #[test]
    fn other_files_are_refused_with_what_is_wrong() {
        let file = made_up(1);
        let swap = |from: &[u8], to: &[u8]| {
            let at = file.windows(from.len()).position(|w| w == from).unwrap();
            let mut other = file.clone();
            other[at..at + to.len()].copy_from_slice(to);
            Recording::new(Cursor::new(other)).unwrap_err().to_string()
        };
        for (from, to, expected) in [
            (&b"matroska"[..], &b"webmwebm"[..], "expected matroska"),
            (b"NFOV_2X2BINNED", b"PASSIVE_IR\0\0\0\0", "a mode that measures depth"),
            (b"NFOV_2X2BINNED", b"NFOV_UNBINNED\0", "640 x 576"),
            (b"b16g", b"MJPG", "b16g"),
            (b"calibration.json", b"calibration.jsox", "the calibration"),
            (b"CALIBRATION_CameraLocationD0", b"CALIBRATION_CameraLocationD9", "Cameras"),
            (b"336277000", b"33627700x", "K4A_START_OFFSET_NS"),
        ] {
            let error = swap(from, to);
            assert!(error.contains(expected), "{error}");
        }
        let empty = Recording::new(Cursor::new(Vec::new())).unwrap_err();
        assert!(matches!(empty, RecordingError::Format(MkvError::Cut { at: 0, .. })), "{empty}");
        let text = Recording::new(Cursor::new(b"hello, world, this is text".to_vec())).unwrap_err();
        assert!(matches!(text, RecordingError::Format(MkvError::Wrong { .. })), "{text}");
        let missing = Recording::open(Path::new("/nowhere/at/all.mkv")).unwrap_err();
        assert!(matches!(missing, RecordingError::Open { .. }), "{missing}");
    }

    /// Reads all that can be read.
    fn drain(bytes: Vec<u8>) {
        let Ok(mut recording) = Recording::new(Cursor::new(bytes)) else { return };
        let mut images = 0;
        // An image that is refused is passed over by the next call.
        while images < 50
            && matches!(recording.next_image(), Ok(Some(_)) | Err(RecordingError::Content { .. }))
        {
            images += 1;
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

        #[test]
        fn arbitrary_bytes_end_without_panic(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            drain(bytes.clone());
            // Behind a whole head, in a segment of unknown length.
            let mut behind_a_head = made_up(0);
            let segment = [0x18, 0x53, 0x80, 0x67];
            let at = behind_a_head.windows(4).position(|w| w == segment).unwrap() + 4;
            behind_a_head[at..at + 8].copy_from_slice(&0x01ff_ffff_ffff_ffffu64.to_be_bytes());
            behind_a_head.extend(bytes);
            drain(behind_a_head);
        }

        #[test]
        fn garbled_recordings_end_without_panic(
            changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>(), any::<bool>()), 1..12),
            cut in any::<prop::sample::Index>(), whole in any::<bool>(),
        ) {
            let mut file = made_up(1);
            // Heads lie before and directly in front of images: most changes go where they hurt.
            let head = file.len() - 2 * 320 * 288 * 2;
            for (at, byte, anywhere) in changes {
                let at = at.index(if anywhere { file.len() } else { head });
                file[at] = byte;
            }
            if !whole {
                file.truncate(cut.index(file.len()));
            }
            drain(file);
        }

        #[test]
        fn garbled_lengths_end_without_panic(element in any::<prop::sample::Index>(), length in any::<u64>()) {
            let mut file = made_up(1);
            // Every length of a made-up recording has eight bytes and begins with 0x01.
            let heads: Vec<usize> =
                (0..file.len() - 8).filter(|&i| file[i] == 1 && file[i + 1..i + 5] == [0; 4]).collect();
            let at = *element.get(&heads);
            file[at..at + 8].copy_from_slice(&(0x0100_0000_0000_0000 | length >> 8).to_be_bytes());
            drain(file);
        }
    }
}
