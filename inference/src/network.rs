//! A loaded network: what its file says of it, and running it.

use std::fmt;
use std::sync::Mutex;

use prost::Message;

use crate::MAX_BYTES;
use crate::compile::{Plan, compile};
use crate::error::{ModelError, RunError};
use crate::kernel::Isa;
use crate::layer::{self, Layer, Read, Slot};
use crate::onnx::Model;

/// The only format of metadata that is known.
const FORMAT: &str = "1";
/// What stands before the checksum's eight digits in a file: the end of its key, and the value's tag and length.
const BEFORE_CHECKSUM: &[u8] = b"graspd.crc32\x12\x08";
/// Voxels along an edge that a network may have.
const SIDES: std::ops::RangeInclusive<usize> = 8..=160;

/// Which encoding of a volume a network reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VolumeInput {
    /// Truncated signed distance, 0 to 1; 0 where unseen or beyond the truncation.
    Tsdf,
    /// 1 unless seen to be free.
    Occupancy,
}

/// How a network expresses orientations.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OrientationKind {
    /// Quaternions.
    Quaternion,
    /// The first two columns of rotation matrices.
    R6d,
}

/// What a model file says of itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Info {
    /// What it reads.
    pub volume: VolumeInput,
    /// What its orientations are.
    pub orientation: OrientationKind,
    /// Voxels along an edge of the volume.
    pub side: usize,
    /// Commit of the program that trained it.
    pub commit: Option<String>,
    /// CRC-32 of the file, which names it.
    pub crc32: u32,
}

/// The orientations of all voxels, in memory order, as the network gives them.
#[derive(Debug, Clone, PartialEq)]
pub enum Orientations {
    /// Quaternions x, y, z, w, not normalized.
    Quaternion(Vec<[f32; 4]>),
    /// First and second column of rotation matrices, not orthonormalized.
    R6d(Vec<[f32; 6]>),
}

impl Orientations {
    /// The image of +z at a voxel: a unit vector from the finger into the object; zeros where the numbers say nothing,
    /// or the voxel does not exist.
    pub fn inward(&self, voxel: usize) -> [f32; 3] {
        match self {
            Self::Quaternion(all) => {
                let [x, y, z, w] = all.get(voxel).copied().unwrap_or_default();
                unit([2.0 * (x * z + y * w), 2.0 * (y * z - x * w), w * w + z * z - x * x - y * y])
            }
            Self::R6d(all) => {
                let [a, b, c, d, e, f] = all.get(voxel).copied().unwrap_or_default();
                unit([b * f - c * e, c * d - a * f, a * e - b * d])
            }
        }
    }
}

/// A vector of length 1 in the same direction, or zeros.
fn unit(v: [f32; 3]) -> [f32; 3] {
    let length = v.iter().map(|c| c * c).sum::<f32>().sqrt();
    match length.is_normal() {
        true => v.map(|c| c / length),
        false => [0.0; 3],
    }
}

/// What a network says of a volume; every array has one entry per voxel in the volume's memory order.
#[derive(Debug, Clone, PartialEq)]
pub struct Output {
    /// `P_c`: certainty of a contact, 0 to 1.
    pub certainty: Vec<f32>,
    /// `Φ_c`: orientation of the contact.
    pub orientation: Orientations,
    /// `P_e`: likelihood of a contact centroid, 0 to 1.
    pub centroid: Vec<f32>,
}

/// A contact network that is ready to run; may be run from several threads at once.
pub struct Network {
    info: Info,
    isa: Isa,
    plan: Plan,
    /// Activations of former runs: their margins are zero already, and their pages are there.
    spare: Mutex<Vec<Vec<Vec<f32>>>>,
}

impl fmt::Debug for Network {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Network").field("info", &self.info).field("isa", &self.isa).finish_non_exhaustive()
    }
}

impl Network {
    /// Reads a model file.
    ///
    /// # Errors
    /// [`ModelError`]: the file is no ONNX, damaged, somebody else's, or computes what this crate does not know.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, ModelError> {
        Self::with_isa(bytes, Isa::detect())
    }

    pub(crate) fn with_isa(bytes: &[u8], isa: Isa) -> Result<Self, ModelError> {
        if bytes.len() > MAX_BYTES {
            return Err(ModelError::TooLarge { found: bytes.len() });
        }
        let model = Model::decode(bytes)
            .map_err(|e| ModelError::NotOnnx { found: e.to_string(), bytes: bytes.len() })?;
        let entry = |key: &'static str| {
            let found = model.metadata.iter().find(|e| e.key == key);
            found.map(|e| e.value.as_str()).ok_or(ModelError::Foreign { key })
        };
        let expected = match u32::from_str_radix(entry("graspd.crc32")?, 16) {
            Ok(expected) => expected,
            Err(_) => {
                let found = entry("graspd.crc32")?.to_owned();
                return Err(ModelError::Metadata {
                    key: "graspd.crc32",
                    found,
                    expected: "eight hexadecimal digits",
                });
            }
        };
        let found = checksum(bytes);
        if found != expected {
            return Err(ModelError::Damaged { found, expected });
        }

        let wrong =
            |key, found: &str, expected| ModelError::Metadata { key, found: found.to_owned(), expected };
        let format = entry("graspd.format")?;
        if format != FORMAT {
            return Err(wrong("graspd.format", format, FORMAT));
        }
        let volume = match entry("graspd.volume")? {
            "tsdf" => VolumeInput::Tsdf,
            "occupancy" => VolumeInput::Occupancy,
            other => return Err(wrong("graspd.volume", other, "`tsdf` or `occupancy`")),
        };
        let (orientation, numbers) = match entry("graspd.orientation")? {
            "quaternion" => (OrientationKind::Quaternion, 4),
            "r6d" => (OrientationKind::R6d, 6),
            other => return Err(wrong("graspd.orientation", other, "`quaternion` or `r6d`")),
        };
        let side = entry("graspd.side")?;
        let Some(side) = side.parse().ok().filter(|s| SIDES.contains(s)) else {
            return Err(wrong("graspd.side", side, "8 to 160 voxels"));
        };
        let commit = entry("graspd.commit").ok().map(str::to_owned);
        let plan = compile(&model.graph.unwrap_or_default(), side, numbers, isa)?;
        let info = Info { volume, orientation, side, commit, crc32: expected };
        Ok(Self { info, isa, plan, spare: Mutex::default() })
    }

    /// What the file says of itself.
    pub fn info(&self) -> &Info {
        &self.info
    }

    /// The network's answer to a volume, given in memory order: x, y, z with z fastest.
    ///
    /// Works on the rayon pool it is called in. The answer does not depend on the number of threads, but its last bits
    /// depend on the processor's instruction set.
    ///
    /// # Errors
    /// [`RunError::Size`].
    pub fn run(&self, volume: &[f32]) -> Result<Output, RunError> {
        self.run_while(volume, &|| true)
    }

    /// Like [`Self::run`]; asks before every layer, that is at least every few milliseconds, whether to go on.
    ///
    /// # Errors
    /// [`RunError::Size`]; [`RunError::Stopped`] once `go_on` said no.
    pub fn run_while(&self, volume: &[f32], go_on: &dyn Fn() -> bool) -> Result<Output, RunError> {
        let (side, voxels) = (self.info.side, self.info.side.pow(3));
        if volume.len() != voxels {
            return Err(RunError::Size { found: volume.len(), expected: voxels, side });
        }
        let spare = self.spare.lock().ok().and_then(|mut s| s.pop());
        let mut slots =
            spare.unwrap_or_else(|| self.plan.shapes.iter().map(|s| vec![0.0; s.len()]).collect());
        let done = self.layers(volume, &mut slots, go_on);
        let output = done.map(|()| self.answer(&slots));
        if let Ok(mut spare) = self.spare.lock() {
            spare.push(slots);
        }
        output
    }

    fn layers(
        &self,
        volume: &[f32],
        slots: &mut [Vec<f32>],
        go_on: &dyn Fn() -> bool,
    ) -> Result<(), RunError> {
        let shapes = &self.plan.shapes;
        for (slot, block) in &self.plan.volumes {
            layer::load(volume, *block, shapes[*slot], &mut slots[*slot]);
        }
        for layer in &self.plan.layers {
            if !go_on() {
                return Err(RunError::Stopped);
            }
            let to = match layer {
                Layer::Conv(conv) => conv.output,
                Layer::Pool { output, .. } | Layer::Concat { output, .. } => *output,
            };
            let mut output = std::mem::take(&mut slots[to]);
            let read = |slot: Slot| Read { shape: shapes[slot], values: &slots[slot] };
            match layer {
                Layer::Conv(conv) => {
                    conv.run(self.isa, read(conv.input), conv.residual.map(read), shapes[to], &mut output);
                }
                Layer::Pool { input, .. } => layer::pool(read(*input), shapes[to], &mut output),
                Layer::Concat { inputs, .. } => layer::concat(inputs.map(read), shapes[to], &mut output),
            }
            slots[to] = output;
        }
        match go_on() {
            true => Ok(()),
            false => Err(RunError::Stopped),
        }
    }

    /// The last layer.
    fn answer(&self, slots: &[Vec<f32>]) -> Output {
        let head = &self.plan.head;
        let voxels = self.info.side.pow(3);
        let input = Read { shape: self.plan.shapes[head.input], values: &slots[head.input] };
        let (mut certainty, mut centroid) = (vec![0.0; voxels], vec![0.0; voxels]);
        let orientation = match self.info.orientation {
            OrientationKind::Quaternion => {
                let mut all = vec![[0.0; 4]; voxels];
                head.run(self.isa, input, [&mut certainty, &mut centroid], all.as_flattened_mut());
                Orientations::Quaternion(all)
            }
            OrientationKind::R6d => {
                let mut all = vec![[0.0; 6]; voxels];
                head.run(self.isa, input, [&mut certainty, &mut centroid], all.as_flattened_mut());
                Orientations::R6d(all)
            }
        };
        Output { certainty, orientation, centroid }
    }
}

/// CRC-32 of a file whose own checksum is read as eight zeros.
fn checksum(bytes: &[u8]) -> u32 {
    let at = bytes.windows(BEFORE_CHECKSUM.len()).rposition(|w| w == BEFORE_CHECKSUM);
    let mut hasher = crc32fast::Hasher::new();
    match at.map(|at| at + BEFORE_CHECKSUM.len()) {
        Some(at) if at + 8 <= bytes.len() => {
            hasher.update(&bytes[..at]);
            hasher.update(b"00000000");
            hasher.update(&bytes[at + 8..]);
        }
        _ => hasher.update(bytes),
    }
    hasher.finalize()
}
