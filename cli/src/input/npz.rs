//! Contact fields from NumPy archives, in the layout of the reference implementation's network output.
//!
//! Arrays, n voxels along each edge (the paper: 80), axes x, y, z: `contact_score` (1, n, n, n),
//! `contact_quat_xyzw` (4, n, n, n; rotates +z onto the inward direction), `centroid_score` (1, n, n, n) and
//! `grid` (1, n, n, n; solid above 0.5). 32- or 64-bit floats.

use std::io::{Cursor, Read, Seek};
use std::path::Path;

use graspd_planner::contact_field::ContactField;
use graspd_planner::grid::Grid;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use npyz::NpyFile;
use zip::ZipArchive;
use zip::result::ZipError;

use super::InputError;

/// Edge length of the volume that the arrays cover, metres (the paper: 0.4).
const SIZE_M: f64 = 0.4;
/// Largest grid, voxels along an edge.
const MAX_RESOLUTION: u64 = 256;

/// A contact field and the solid voxels that it belongs to.
#[derive(Debug, Clone)]
pub(crate) struct LoadedField {
    /// The field.
    pub(crate) field: ContactField,
    /// One per voxel: occupied.
    pub(crate) solid: Vec<bool>,
}

/// Reads a contact field.
///
/// # Errors
/// If an array is missing, or has another shape or type, or holds values that are no numbers.
pub(crate) fn open(path: &Path) -> Result<LoadedField, InputError> {
    parse(&path.display().to_string(), &super::read(path)?)
}

/// Checks the contents of an archive.
///
/// # Errors
/// As [`open`].
pub(super) fn parse(file: &str, bytes: &[u8]) -> Result<LoadedField, InputError> {
    let mut archive = ZipArchive::new(Cursor::new(bytes))
        .map_err(|e| InputError::wrong(file, "archive", e, "a NumPy .npz archive"))?;
    let (n, scores) = array(file, &mut archive, "contact_score", 1, None)?;
    let (_, quaternions) = array(file, &mut archive, "contact_quat_xyzw", 4, Some(n))?;
    let (_, centroids) = array(file, &mut archive, "centroid_score", 1, Some(n))?;
    let (_, solid) = array(file, &mut archive, "grid", 1, Some(n))?;
    let voxels = (n * n * n) as usize;
    let inward = (0..voxels)
        .map(|i| {
            let at = |k: usize| f64::from(quaternions[k * voxels + i]);
            let q = Quaternion::new(at(3), at(0), at(1), at(2));
            match UnitQuaternion::try_new(q, 1e-6) {
                Some(q) if scores[i] > 0.0 => {
                    let z = q * Vector3::z();
                    [z.x as f32, z.y as f32, z.z as f32]
                }
                _ => [0.0; 3],
            }
        })
        .collect();
    let grid = Grid { resolution: n as usize, size_m: SIZE_M };
    let unit = |values: Vec<f32>| values.into_iter().map(|x| x.clamp(0.0, 1.0)).collect();
    let field = ContactField { grid, certainty: unit(scores), inward, centroid: unit(centroids) };
    Ok(LoadedField { field, solid: solid.into_iter().map(|x| x > 0.5).collect() })
}

/// One array with `channels` leading entries on a cubic grid: its resolution and values.
fn array<R: Read + Seek>(
    file: &str,
    archive: &mut ZipArchive<R>,
    name: &str,
    channels: u64,
    resolution: Option<u64>,
) -> Result<(u64, Vec<f32>), InputError> {
    let broken = |e: std::io::Error| InputError::wrong(file, name, e, "a whole array");
    let present: Vec<String> =
        archive.file_names().flatten().map(|n| n.trim_end_matches(".npy").to_owned()).collect();
    let entry = match archive.by_name(&format!("{name}.npy")) {
        Ok(entry) => entry,
        Err(ZipError::FileNotFound) => {
            let found = if present.is_empty() { "none".to_owned() } else { present.join(", ") };
            return Err(InputError::wrong(file, "arrays", found, format!("{name} among them")));
        }
        Err(e) => return Err(InputError::wrong(file, name, e, "a stored or deflated array")),
    };
    let npy = NpyFile::new(entry).map_err(broken)?;
    let shape = npy.shape().to_vec();
    let edge = resolution.unwrap_or_else(|| shape.get(1).copied().unwrap_or(0));
    if shape != [channels, edge, edge, edge] || !(2..=MAX_RESOLUTION).contains(&edge) {
        let n = resolution.map_or_else(|| "n".to_owned(), |n| n.to_string());
        return Err(InputError::wrong(
            file,
            &format!("{name} shape"),
            format!("{shape:?}"),
            format!("[{channels}, {n}, {n}, {n}]"),
        ));
    }
    if npy.order() != npyz::Order::C {
        return Err(InputError::wrong(file, name, "Fortran order", "C order (np.ascontiguousarray)"));
    }
    let kind = npy.dtype().descr();
    let values: Vec<f32> = match kind.trim_matches('\'').trim_start_matches(['<', '>', '|', '=']) {
        "f4" => npy.into_vec().map_err(broken)?,
        "f8" => npy.into_vec::<f64>().map_err(broken)?.into_iter().map(|x| x as f32).collect(),
        _ => return Err(InputError::wrong(file, &format!("{name} dtype"), kind, "float32 or float64")),
    };
    if let Some(i) = values.iter().position(|x| !x.is_finite()) {
        return Err(InputError::wrong(
            file,
            name,
            format!("{} at position {i}", values[i]),
            "finite numbers",
        ));
    }
    Ok((edge, values))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use npyz::WriterBuilder;

    fn archive(arrays: &[(&str, Vec<u64>, Vec<f32>)]) -> Vec<u8> {
        let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
        for (name, shape, values) in arrays {
            zip.start_file(format!("{name}.npy"), zip::write::SimpleFileOptions::default()).unwrap();
            let options = npyz::WriteOptions::new().default_dtype().shape(shape);
            let mut npy = options.writer(&mut zip).begin_nd().unwrap();
            npy.extend(values.iter().copied()).unwrap();
            npy.finish().unwrap();
        }
        zip.finish().unwrap().into_inner()
    }

    /// A whole, small contact field.
    pub(in crate::input) fn small_archive() -> Vec<u8> {
        archive(&small())
    }

    fn small() -> Vec<(&'static str, Vec<u64>, Vec<f32>)> {
        let n = 8;
        // A half turn about x takes +z to -z.
        let quaternion = [vec![1.0; n], vec![0.0; 3 * n]].concat();
        vec![
            ("contact_score", vec![1, 2, 2, 2], vec![0.5; n]),
            ("contact_quat_xyzw", vec![4, 2, 2, 2], quaternion),
            ("centroid_score", vec![1, 2, 2, 2], vec![0.25; n]),
            ("grid", vec![1, 2, 2, 2], vec![0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        ]
    }

    #[test]
    fn reads_scores_directions_and_solid() {
        let loaded = parse("f.npz", &archive(&small())).unwrap();
        assert_eq!(loaded.field.grid.resolution, 2);
        assert_eq!(loaded.field.certainty, vec![0.5; 8]);
        assert!((loaded.field.inward[3][2] + 1.0).abs() < 1e-6);
        assert_eq!(loaded.solid.iter().filter(|&&s| s).count(), 1);
        assert!(loaded.solid[1]);
    }

    #[test]
    fn errors_name_the_array() {
        let mut arrays = small();
        arrays.remove(2);
        let message = parse("f.npz", &archive(&arrays)).unwrap_err().to_string();
        assert_eq!(
            message,
            "f.npz: arrays: found contact_score, contact_quat_xyzw, grid, expected centroid_score among them"
        );
        let mut arrays = small();
        arrays[1] = ("contact_quat_xyzw", vec![3, 2, 2, 2], vec![0.0; 24]);
        let message = parse("f.npz", &archive(&arrays)).unwrap_err().to_string();
        assert_eq!(message, "f.npz: contact_quat_xyzw shape: found [3, 2, 2, 2], expected [4, 2, 2, 2]");
        let mut arrays = small();
        arrays[0].2[5] = f32::NAN;
        let message = parse("f.npz", &archive(&arrays)).unwrap_err().to_string();
        assert_eq!(message, "f.npz: contact_score: found NaN at position 5, expected finite numbers");
        assert!(parse("f.npz", b"PK").unwrap_err().to_string().contains("expected a NumPy .npz archive"));
    }
}
