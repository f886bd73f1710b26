//! One labelled view, and its bytes in a shard (the payload of `docs/dataset.md`).

use graspd_planner::grid::{MAX_RESOLUTION, MIN_RESOLUTION};
use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};

use super::view::Preview;

/// Codes of TSDF values that mean an occupied voxel: above 0 (unseen) and up to 0.5 (the surface).
pub const OCCUPIED: std::ops::RangeInclusive<u8> = 1..=127;
/// A quaternion's components are stored times this.
const ONE: f64 = 32767.0;

/// A contact's voxel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ContactLabel {
    /// Memory index.
    pub index: u32,
    /// Score times 255, at least 1.
    pub score: u8,
    /// Orientation x y z w times 32767; w ≥ 0.
    pub orientation: [i16; 4],
}

impl ContactLabel {
    /// A label; `None` for a score that rounds to nothing.
    pub fn new(index: u32, score: f64, orientation: &UnitQuaternion<f64>) -> Option<Self> {
        let sign = if orientation.w < 0.0 { -1.0 } else { 1.0 };
        // Casts keep to the bounds of their type.
        let code = |c: f64| (c * sign * ONE).round() as i16;
        let score = code_of(score)?;
        Some(Self { index, score, orientation: <[f64; 4]>::from(orientation.coords).map(code) })
    }

    /// 0 to 1.
    pub fn score(&self) -> f32 {
        f32::from(self.score) / 255.0
    }

    /// The orientation, volume frame.
    pub fn quaternion(&self) -> UnitQuaternion<f64> {
        let [x, y, z, w] = self.orientation.map(f64::from);
        UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z))
    }

    /// From the finger into the object, volume frame.
    pub fn inward(&self) -> Vector3<f64> {
        self.quaternion() * Vector3::z()
    }
}

/// A centroid's voxel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CentroidLabel {
    /// Memory index.
    pub index: u32,
    /// Score times 255, at least 1.
    pub score: u8,
}

impl CentroidLabel {
    /// A label; `None` for a score that rounds to nothing.
    pub fn new(index: u32, score: f64) -> Option<Self> {
        Some(Self { index, score: code_of(score)? })
    }

    /// 0 to 1.
    pub fn score(&self) -> f32 {
        f32::from(self.score) / 255.0
    }
}

fn code_of(score: f64) -> Option<u8> {
    let code = (score * 255.0).round() as u8;
    (code > 0).then_some(code)
}

/// A labelled view.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// Number of its scene.
    pub scene: u32,
    /// Number of the view of the scene.
    pub view: u32,
    /// Voxels along each edge.
    pub resolution: u32,
    /// Pose of the volume, row by row.
    pub world_from_volume: [f32; 16],
    /// Pose of the camera, row by row.
    pub world_from_camera: [f32; 16],
    /// Height of the table top in the volume, metres; not a number when none was found.
    pub table_m: f32,
    /// TSDF times 255, one per voxel.
    pub tsdf: Vec<u8>,
    /// Occupancy, a bit a voxel, the lowest bit of each byte first.
    pub occupancy: Vec<u8>,
    /// Contacts by ascending memory index, none where the TSDF is [`OCCUPIED`].
    pub contacts: Vec<ContactLabel>,
    /// Centroids by ascending memory index.
    pub centroids: Vec<CentroidLabel>,
    /// The depth image, small.
    pub preview: Preview,
}

/// What is wrong with a payload.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: found {found}, expected {expected}")]
pub struct SampleError {
    /// The field.
    pub field: &'static str,
    /// What was found.
    pub found: String,
    /// What is expected.
    pub expected: String,
}

impl Sample {
    /// True when the occupancy volume has a voxel occupied; false beyond the volume.
    pub fn is_occupied(&self, index: usize) -> bool {
        self.occupancy.get(index / 8).is_some_and(|byte| byte >> (index % 8) & 1 == 1)
    }

    /// The contacts that the occupancy volume leaves: those in voxels that were seen to be free.
    pub fn contacts_of_occupancy(&self) -> impl Iterator<Item = &ContactLabel> {
        self.contacts.iter().filter(|c| !self.is_occupied(c.index as usize))
    }

    /// The payload's bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let labels = 13 * self.contacts.len() + 5 * self.centroids.len();
        let mut out = Vec::with_capacity(
            200 + self.tsdf.len() + self.occupancy.len() + labels + 2 * self.preview.depth_mm.len(),
        );
        for number in [self.scene, self.view, self.resolution] {
            out.extend(number.to_le_bytes());
        }
        for number in self.world_from_volume.iter().chain(&self.world_from_camera).chain([&self.table_m]) {
            out.extend(number.to_le_bytes());
        }
        out.extend(&self.tsdf);
        out.extend(&self.occupancy);
        out.extend((self.contacts.len() as u32).to_le_bytes());
        out.extend(self.contacts.iter().flat_map(|c| c.index.to_le_bytes()));
        out.extend(self.contacts.iter().map(|c| c.score));
        out.extend(self.contacts.iter().flat_map(|c| c.orientation).flat_map(i16::to_le_bytes));
        out.extend((self.centroids.len() as u32).to_le_bytes());
        out.extend(self.centroids.iter().flat_map(|c| c.index.to_le_bytes()));
        out.extend(self.centroids.iter().map(|c| c.score));
        out.extend(self.preview.width.to_le_bytes());
        out.extend(self.preview.height.to_le_bytes());
        out.extend(self.preview.depth_mm.iter().flat_map(|d| d.to_le_bytes()));
        out
    }

    /// A sample from its payload. Bytes from anywhere are safe: nothing is kept that the payload does not hold.
    ///
    /// # Errors
    /// [`SampleError`] for the first field that is cut off, out of range or not in order, and for bytes left over.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, SampleError> {
        let mut rest = Rest(bytes);
        let [scene, view, resolution] = [rest.u32("scene")?, rest.u32("view")?, rest.u32("resolution")?];
        if !(MIN_RESOLUTION..=MAX_RESOLUTION).contains(&(resolution as usize)) {
            return Err(SampleError {
                field: "resolution",
                found: resolution.to_string(),
                expected: format!("{MIN_RESOLUTION} to {MAX_RESOLUTION}"),
            });
        }
        let voxels = (resolution as usize).pow(3);
        let world_from_volume = rest.pose("world_from_volume")?;
        let world_from_camera = rest.pose("world_from_camera")?;
        let table_m = f32::from_le_bytes(rest.array("table_m")?);
        let tsdf = rest.take("tsdf", voxels)?.to_vec();
        let occupancy = rest.take("occupancy", voxels.div_ceil(8))?.to_vec();

        let (indices, scores) = rest.labels(["contacts.index", "contacts.score"], voxels)?;
        let orientations = rest.take("contacts.orientation", 8 * indices.len())?;
        let quaternions = orientations.chunks_exact(8).map(|q| {
            let q: [i16; 4] = std::array::from_fn(|i| i16::from_le_bytes([q[2 * i], q[2 * i + 1]]));
            let length = q.iter().map(|&c| f64::from(c).powi(2)).sum::<f64>().sqrt() / ONE;
            let fine = (0.99..1.01).contains(&length);
            fine.then_some(q).ok_or_else(|| SampleError {
                field: "contacts.orientation",
                found: format!("{q:?}"),
                expected: "a quaternion of length 32767".into(),
            })
        });
        let contacts = indices
            .into_iter()
            .zip(scores)
            .zip(quaternions)
            .map(|((index, &score), q)| Ok(ContactLabel { index, score, orientation: q? }))
            .collect::<Result<_, SampleError>>()?;
        let (indices, scores) = rest.labels(["centroids.index", "centroids.score"], voxels)?;
        let centroids =
            indices.into_iter().zip(scores).map(|(index, &score)| CentroidLabel { index, score }).collect();

        let width = u16::from_le_bytes(rest.array("preview.width")?);
        let height = u16::from_le_bytes(rest.array("preview.height")?);
        let pixels = rest.take("preview.depth", 2 * usize::from(width) * usize::from(height))?;
        let depth_mm = pixels.chunks_exact(2).map(|p| u16::from_le_bytes([p[0], p[1]])).collect();
        if !rest.0.is_empty() {
            return Err(SampleError {
                field: "payload",
                found: format!("{} bytes behind its end", rest.0.len()),
                expected: "none".into(),
            });
        }
        Ok(Self {
            scene,
            view,
            resolution,
            world_from_volume,
            world_from_camera,
            table_m,
            tsdf,
            occupancy,
            contacts,
            centroids,
            preview: Preview { width, height, depth_mm },
        })
    }
}

/// A pose as 4 × 4 numbers, row by row.
pub fn rows(pose: &Isometry3<f64>) -> [f32; 16] {
    let matrix = pose.to_homogeneous();
    std::array::from_fn(|i| matrix[(i / 4, i % 4)] as f32)
}

/// What is left to read.
struct Rest<'a>(&'a [u8]);

impl<'a> Rest<'a> {
    fn take(&mut self, field: &'static str, count: usize) -> Result<&'a [u8], SampleError> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or_else(|| SampleError {
            field,
            found: format!("{} bytes", self.0.len()),
            expected: format!("{count} bytes"),
        })?;
        self.0 = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self, field: &'static str) -> Result<[u8; N], SampleError> {
        let mut out = [0; N];
        out.copy_from_slice(self.take(field, N)?);
        Ok(out)
    }

    fn u32(&mut self, field: &'static str) -> Result<u32, SampleError> {
        Ok(u32::from_le_bytes(self.array(field)?))
    }

    fn pose(&mut self, field: &'static str) -> Result<[f32; 16], SampleError> {
        let mut out = [0.0; 16];
        for number in &mut out {
            *number = f32::from_le_bytes(self.array(field)?);
        }
        if out.iter().all(|x| x.is_finite()) {
            return Ok(out);
        }
        Err(SampleError { field, found: format!("{out:?}"), expected: "finite numbers".into() })
    }

    /// Indices and scores of labels: as many as are said to follow.
    fn labels(
        &mut self,
        [index, score]: [&'static str; 2],
        voxels: usize,
    ) -> Result<(Vec<u32>, &'a [u8]), SampleError> {
        let count = self.u32(index)? as usize;
        if count > voxels {
            return Err(SampleError {
                field: index,
                found: format!("{count} labels"),
                expected: format!("at most {voxels}"),
            });
        }
        let quads = self.take(index, 4 * count)?.chunks_exact(4);
        let indices: Vec<u32> = quads.map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
        let ascend = indices.windows(2).all(|w| w[0] < w[1]);
        if !ascend || indices.last().is_some_and(|&last| last as usize >= voxels) {
            return Err(SampleError {
                field: index,
                found: "indices out of order or range".into(),
                expected: format!("ascending, below {voxels}"),
            });
        }
        let scores = self.take(score, count)?;
        if scores.contains(&0) {
            return Err(SampleError { field: score, found: "0".into(), expected: "1 to 255".into() });
        }
        Ok((indices, scores))
    }
}

/// Samples for the tests of this crate.
#[cfg(test)]
pub(crate) mod samples {
    use proptest::prelude::*;

    use super::*;

    /// Any sample that can be written, on a small grid.
    pub(crate) fn any_sample() -> impl Strategy<Value = Sample> {
        let numbers = (any::<u32>(), any::<u32>(), 8..12u32, any::<u64>());
        let labels = prop::collection::btree_map(0..512u32, (1..=255u8, -1.0..1.0f64), 0..20);
        (numbers, labels.clone(), labels, 0..5u16, 0..5u16).prop_map(
            |((scene, view, resolution, noise), contacts, centroids, width, height)| {
                let voxels = resolution.pow(3) as usize;
                let byte = |i: usize| (noise.rotate_left(i as u32 % 64) as usize ^ (i * 31)) as u8;
                let pose = Isometry3::new(Vector3::new(0.1, 0.2, 0.3), Vector3::x() * f64::from(view % 7));
                let turned = |angle: f64| UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angle);
                let contact = |(index, (score, angle))| {
                    ContactLabel::new(index, f64::from(score) / 255.0, &turned(angle)).unwrap()
                };
                Sample {
                    scene,
                    view,
                    resolution,
                    world_from_volume: rows(&pose),
                    world_from_camera: rows(&pose.inverse()),
                    table_m: 0.1,
                    tsdf: (0..voxels).map(byte).collect(),
                    occupancy: (0..voxels.div_ceil(8)).map(byte).collect(),
                    contacts: contacts.into_iter().map(contact).collect(),
                    centroids: centroids
                        .into_iter()
                        .map(|(index, (score, _))| CentroidLabel { index, score })
                        .collect(),
                    preview: Preview {
                        width,
                        height,
                        depth_mm: (0..width * height).map(|i| i * 7).collect(),
                    },
                }
            },
        )
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::samples::any_sample;
    use super::*;

    proptest! {
        #[test]
        fn a_sample_comes_back_from_its_bytes(sample in any_sample()) {
            prop_assert_eq!(Sample::from_bytes(&sample.to_bytes()), Ok(sample));
        }

        #[test]
        fn cut_off_or_prolonged_bytes_are_refused(sample in any_sample(), share in 0.0..1.0f64) {
            let mut bytes = sample.to_bytes();
            let cut = (bytes.len() as f64 * share) as usize;
            prop_assert!(Sample::from_bytes(&bytes[..cut]).is_err());
            bytes.push(0);
            prop_assert!(Sample::from_bytes(&bytes).is_err());
        }

        /// Whatever is read without an error is within its bounds.
        #[test]
        fn garbled_bytes_never_panic(sample in any_sample(), at in any::<prop::sample::Index>(), with in any::<u32>()) {
            let mut bytes = sample.to_bytes();
            let at = at.index(bytes.len() - 3);
            bytes[at..at + 4].copy_from_slice(&with.to_le_bytes());
            if let Ok(read) = Sample::from_bytes(&bytes) {
                let voxels = read.resolution.pow(3);
                prop_assert_eq!(read.tsdf.len(), voxels as usize);
                prop_assert!(read.contacts.iter().all(|c| c.index < voxels && c.score > 0));
                prop_assert!(read.centroids.iter().all(|c| c.index < voxels && c.score > 0));
            }
        }

        #[test]
        fn garbage_never_panics(bytes in prop::collection::vec(any::<u8>(), 0..2000)) {
            prop_assert!(Sample::from_bytes(&bytes).is_err());
        }
    }

    #[test]
    fn labels_keep_their_values() {
        let q = UnitQuaternion::from_euler_angles(0.3, -1.0, 2.9);
        let label = ContactLabel::new(3, 0.8765, &q).unwrap();
        assert!(label.quaternion().angle_to(&q) < 1e-4 && (label.score() - 0.8765).abs() < 0.002);
        assert!(label.orientation[3] >= 0);
        assert_eq!(ContactLabel::new(3, 0.001, &q), None);
        assert_eq!(CentroidLabel::new(3, 2.0).unwrap().score(), 1.0);
    }
}
