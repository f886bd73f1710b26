//! Shards: files of labelled views, as `docs/dataset.md` describes them.

use std::io::Write as _;

use flate2::write::ZlibEncoder;
use flate2::{Compression, Crc};
use graspd_planner::grid::Grid;
use serde::{Deserialize, Serialize};

use super::families::Split;
use super::recipe::Recipe;
use super::sample::Sample;

/// First bytes of a shard.
pub const MAGIC: [u8; 4] = *b"GCDS";
/// The version that is written, and the only one that is read.
pub const VERSION: u32 = 1;
/// What a header says it is.
pub const FORMAT: &str = "graspd contact dataset";
/// Bytes before the header's JSON.
pub const PREFIX: usize = 16;
/// Bytes before a record's payload.
pub const RECORD_PREFIX: usize = 8;
/// Longest header that is read, bytes.
pub const MAX_HEADER: usize = 16 << 20;
/// Longest packed payload that is read, bytes.
pub const MAX_PACKED: usize = 64 << 20;
/// How hard payloads are packed: harder saves a tenth of the bytes for three times the time.
const LEVEL: u32 = 3;

/// A shard's header: all that its records depend on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// [`FORMAT`].
    pub format: String,
    /// Program and version.
    pub program: String,
    /// Commit of its source, where somebody said so.
    pub commit: Option<String>,
    /// Seed of the dataset.
    pub seed: u64,
    /// Scenes of all shards together.
    pub scenes: u32,
    /// Views of each scene.
    pub views: u32,
    /// Which shard, of how many.
    pub shard: [u32; 2],
    /// The volumes' grid.
    pub grid: GridHeader,
    /// Truncation of the signed distance, voxels.
    pub truncation_voxels: f64,
    /// Name of the depth camera.
    pub sensor: String,
    /// Which objects.
    pub families: Split,
    /// Names of the families or meshes that scenes draw from.
    pub objects: Vec<String>,
    /// Every number of the generation.
    pub recipe: Recipe,
}

/// A grid in a header.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct GridHeader {
    /// Voxels along each edge.
    pub resolution: usize,
    /// Edge length of the cube, metres.
    pub size_m: f64,
}

impl From<Grid> for GridHeader {
    fn from(grid: Grid) -> Self {
        Self { resolution: grid.resolution, size_m: grid.size_m }
    }
}

impl From<GridHeader> for Grid {
    fn from(grid: GridHeader) -> Self {
        Self { resolution: grid.resolution, size_m: grid.size_m }
    }
}

impl Header {
    /// Scenes of this shard, in order.
    pub fn scenes_here(&self) -> impl Iterator<Item = u32> + use<> {
        (self.shard[0]..self.scenes).step_by(self.shard[1].max(1) as usize)
    }

    /// Records of the whole shard.
    pub fn records(&self) -> usize {
        self.scenes_here().count() * self.views as usize
    }

    /// Name of the shard's file: `contacts-00003-of-00016.gcd`.
    pub fn file_name(&self) -> String {
        format!("contacts-{:05}-of-{:05}.gcd", self.shard[0], self.shard[1])
    }

    /// The first bytes of the file, up to its first record.
    pub fn to_bytes(&self) -> Vec<u8> {
        // Plain data with text keys always becomes JSON.
        let json = serde_json::to_vec(self).unwrap_or_default();
        let mut out = Vec::with_capacity(PREFIX + json.len());
        out.extend(MAGIC);
        out.extend(VERSION.to_le_bytes());
        out.extend((json.len() as u32).to_le_bytes());
        out.extend(crc(&json).to_le_bytes());
        out.extend(json);
        out
    }
}

/// CRC-32 as in zlib and PNG.
pub fn crc(bytes: &[u8]) -> u32 {
    let mut crc = Crc::new();
    crc.update(bytes);
    crc.sum()
}

/// A sample as a record: length, CRC, packed payload.
pub fn record(sample: &Sample) -> Vec<u8> {
    let mut packer = ZlibEncoder::new(vec![0; RECORD_PREFIX], Compression::new(LEVEL));
    // Writing into memory does not fail.
    let packed = packer.write_all(&sample.to_bytes()).and_then(|()| packer.finish());
    let mut out = packed.unwrap_or_default();
    if out.len() > RECORD_PREFIX {
        let length = (out.len() - RECORD_PREFIX) as u32;
        let sum = crc(&out[RECORD_PREFIX..]);
        out[..4].copy_from_slice(&length.to_le_bytes());
        out[4..RECORD_PREFIX].copy_from_slice(&sum.to_le_bytes());
    }
    out
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A header for tests.
    pub(crate) fn header() -> Header {
        Header {
            format: FORMAT.into(),
            program: "graspd test".into(),
            commit: None,
            seed: 1,
            scenes: 10,
            views: 3,
            shard: [1, 4],
            grid: Grid::default().into(),
            truncation_voxels: 8.0,
            sensor: "azure-kinect".into(),
            families: Split::HeldOut,
            objects: vec!["mug".into()],
            recipe: Recipe::default(),
        }
    }

    #[test]
    fn a_shard_has_every_nth_scene() {
        let header = header();
        assert_eq!(header.scenes_here().collect::<Vec<_>>(), [1, 5, 9]);
        assert_eq!(header.records(), 9);
        assert_eq!(header.file_name(), "contacts-00001-of-00004.gcd");
        let of = |i| Header { shard: [i, 4], ..header.clone() }.scenes_here().collect::<Vec<_>>();
        let mut all: Vec<u32> = (0..4).flat_map(of).collect();
        all.sort_unstable();
        assert_eq!(all, (0..10).collect::<Vec<_>>());
    }

    #[test]
    fn the_crc_is_that_of_zlib() {
        assert_eq!(crc(b"123456789"), 0xcbf4_3926);
    }
}
