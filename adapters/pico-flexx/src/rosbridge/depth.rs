//! Depth from the bytes of ROS messages: images and organized point clouds.
//!
//! Every size in a message is only a claim: it is checked against the bytes that came.

use super::messages::{CameraInfo, Image, PointCloud2};

use graspd_adapters_core::Lens;

/// Largest side of an image, pixels.
pub const MOST_SIDE: u32 = 2048;
/// Datatype of a 32-bit float in `sensor_msgs/PointField`.
const FLOAT32: u8 = 7;

/// Why a message is not taken.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: found {found}, expected {expected}")]
pub struct MessageError {
    /// The offending field.
    pub field: &'static str,
    /// Found value.
    pub found: String,
    /// What is expected.
    pub expected: String,
}

fn refuse<T>(
    field: &'static str,
    found: impl ToString,
    expected: impl Into<String>,
) -> Result<T, MessageError> {
    Err(MessageError { field, found: found.to_string(), expected: expected.into() })
}

/// Width, height, bytes of a row and of a pixel, checked against the bytes that came.
fn layout(width: u32, height: u32, step: u32, pixel: u32, came: usize) -> Result<[usize; 4], MessageError> {
    for (field, side) in [("width", width), ("height", height)] {
        if !(1..=MOST_SIDE).contains(&side) {
            return refuse(field, side, format!("1 to {MOST_SIDE} pixels"));
        }
    }
    if pixel == 0 || u64::from(step) < u64::from(width) * u64::from(pixel) {
        return refuse("step", step, format!("{} bytes or more", u64::from(width) * u64::from(pixel)));
    }
    let expected = u64::from(step) * u64::from(height);
    if (came as u64) < expected {
        return refuse("data", format!("{came} bytes"), format!("{expected}"));
    }
    Ok([width as usize, height as usize, step as usize, pixel as usize])
}

/// Nothing that is not a distance ahead.
fn distance(z_m: f32) -> f32 {
    if z_m.is_finite() && z_m > 0.0 { z_m } else { 0.0 }
}

fn float(bytes: [u8; 4], big: bool) -> f32 {
    if big { f32::from_be_bytes(bytes) } else { f32::from_le_bytes(bytes) }
}

/// Depth of an image, metres, row major; 0 where there is none.
///
/// # Errors
/// [`MessageError`] for other encodings than 32FC1 (metres) and 16UC1 or mono16 (millimetres), and sizes that do not fit.
pub fn of_image(image: &Image) -> Result<Vec<f32>, MessageError> {
    let big = image.is_bigendian;
    let bytes = &image.data.0;
    match image.encoding.as_str() {
        "32FC1" => {
            let [width, height, step, _] = layout(image.width, image.height, image.step, 4, bytes.len())?;
            let row = |row: &[u8]| row.as_chunks::<4>().0.iter().map(|b| distance(float(*b, big))).collect();
            Ok(rows(bytes, height, step, width * 4, row))
        }
        "16UC1" | "mono16" => {
            let [width, height, step, _] = layout(image.width, image.height, image.step, 2, bytes.len())?;
            let millimetres = |b: &[u8; 2]| if big { u16::from_be_bytes(*b) } else { u16::from_le_bytes(*b) };
            let row = |row: &[u8]| {
                row.as_chunks::<2>().0.iter().map(|b| f32::from(millimetres(b)) * 1e-3).collect()
            };
            Ok(rows(bytes, height, step, width * 2, row))
        }
        other => refuse("encoding", other, "32FC1 (metres) or 16UC1 (millimetres)"),
    }
}

fn rows(bytes: &[u8], height: usize, step: usize, used: usize, row: impl Fn(&[u8]) -> Vec<f32>) -> Vec<f32> {
    bytes.chunks(step).take(height).flat_map(|bytes| row(&bytes[..used])).collect()
}

/// Depth of an organized point cloud, metres, row major; 0 where there is none or where it is noisier than `max_noise_m`.
///
/// # Errors
/// [`MessageError`] for clouds that are not organized, have no field `z` of 32-bit floats, or sizes that do not fit.
pub fn of_points(cloud: &PointCloud2, max_noise_m: f32) -> Result<Vec<f32>, MessageError> {
    let offset = |name: &str| match cloud.fields.iter().find(|field| field.name == name) {
        None => Ok(None),
        Some(field) if field.datatype != FLOAT32 => {
            refuse("fields", format!("{name} of datatype {}", field.datatype), "FLOAT32 (7)")
        }
        Some(field) if u64::from(field.offset) + 4 > u64::from(cloud.point_step) => refuse(
            "fields",
            format!("{name} at {}", field.offset),
            format!("within a point of {} bytes", cloud.point_step),
        ),
        Some(field) => Ok(Some(field.offset as usize)),
    };
    let Some(z) = offset("z")? else {
        let names: Vec<&str> = cloud.fields.iter().map(|f| f.name.as_str()).collect();
        return refuse("fields", names.join(", "), "a field z");
    };
    let noise = offset("noise")?;
    if cloud.height < 2 {
        return refuse("height", cloud.height, "an organized cloud: rows of an image");
    }
    let bytes = &cloud.data.0;
    let [width, height, step, point] =
        layout(cloud.width, cloud.height, cloud.row_step, cloud.point_step, bytes.len())?;
    let value = |point: &[u8], at: usize| {
        let four = point[at..].first_chunk::<4>().copied().unwrap_or_default();
        float(four, cloud.is_bigendian)
    };
    let row = |row: &[u8]| {
        let depth = |point: &[u8]| {
            // A noise that is no number is that of an invalid point.
            let sure = noise.is_none_or(|at| value(point, at) < max_noise_m);
            if sure { distance(value(point, z)) } else { 0.0 }
        };
        row.chunks_exact(point).map(depth).collect()
    };
    Ok(rows(bytes, height, step, width * point, row))
}

/// The lens of a `CameraInfo`.
///
/// # Errors
/// [`MessageError`] for other models than `plumb_bob` and `rational_polynomial`, and numbers that no lens has.
pub fn lens(info: &CameraInfo) -> Result<Lens, MessageError> {
    let [fx, skew, cx, _, fy, cy, ..] = info.k;
    let focal = fx.is_finite() && fx > 0.0 && fy.is_finite() && fy > 0.0;
    if !focal || !cx.is_finite() || !cy.is_finite() || skew != 0.0 {
        return refuse("K", format!("{:?}", info.k), "focal lengths above 0, no skew");
    }
    let count = match info.distortion_model.as_str() {
        "" | "plumb_bob" => 5,
        "rational_polynomial" => 8,
        other => return refuse("distortion_model", other, "plumb_bob or rational_polynomial"),
    };
    if info.d.len() > count || info.d.iter().any(|d| !d.is_finite()) {
        return refuse("D", format!("{:?}", info.d), format!("at most {count} numbers"));
    }
    // Both models begin with k1, k2, p1, p2, k3; the rational one goes on with k4, k5, k6.
    let mut distortion = [0.0; 8];
    distortion[..info.d.len()].copy_from_slice(&info.d);
    Ok(Lens { fx_px: fx, fy_px: fy, cx_px: cx, cy_px: cy, distortion })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rosbridge::messages::{Bytes, PointField};
    use proptest::prelude::*;

    fn image(encoding: &str, is_bigendian: bool, step: u32, data: Vec<u8>) -> Image {
        Image {
            width: 2,
            height: 2,
            step,
            encoding: encoding.into(),
            is_bigendian,
            data: Bytes(data),
            ..Image::default()
        }
    }

    /// Points as the pico flexx' driver lays them out: 19 bytes.
    fn cloud(points: &[(f32, f32)]) -> PointCloud2 {
        let field =
            |name: &str, offset, datatype| PointField { name: name.into(), offset, datatype, count: 1 };
        let mut data = Vec::new();
        for (z, noise) in points {
            for value in [0.1, 0.2, *z, *noise] {
                data.extend(f32::to_le_bytes(value));
            }
            data.extend([1, 2, 3]);
        }
        PointCloud2 {
            width: 2,
            height: 2,
            fields: vec![
                field("x", 0, 7),
                field("y", 4, 7),
                field("z", 8, 7),
                field("noise", 12, 7),
                field("intensity", 16, 4),
                field("gray", 18, 2),
            ],
            is_bigendian: false,
            point_step: 19,
            row_step: 38,
            data: Bytes(data),
            ..PointCloud2::default()
        }
    }

    #[test]
    fn images_of_metres_and_of_millimetres_are_read_in_either_order_of_bytes() {
        let metres: Vec<u8> = [1.5f32, f32::NAN, 0.0, -2.0].iter().flat_map(|v| v.to_le_bytes()).collect();
        assert_eq!(of_image(&image("32FC1", false, 8, metres)).unwrap(), [1.5, 0.0, 0.0, 0.0]);
        let metres: Vec<u8> = [0.25f32, 1.0, 2.0, 4.0].iter().flat_map(|v| v.to_be_bytes()).collect();
        assert_eq!(of_image(&image("32FC1", true, 8, metres)).unwrap(), [0.25, 1.0, 2.0, 4.0]);
        // Rows are padded.
        let padded = vec![232, 3, 208, 7, 9, 9, 0, 0, 1, 0, 9, 9];
        assert_eq!(of_image(&image("16UC1", false, 6, padded)).unwrap(), [1.0, 2.0, 0.0, 0.001]);
    }

    #[test]
    fn points_are_read_and_noisy_ones_left_out() {
        let cloud = cloud(&[(1.5, 0.01), (1.6, 0.08), (f32::NAN, f32::NAN), (2.0, f32::NAN)]);
        assert_eq!(of_points(&cloud, 0.07).unwrap(), [1.5, 0.0, 0.0, 0.0]);
        let plain = PointCloud2 {
            fields: cloud.fields.iter().filter(|f| f.name != "noise").cloned().collect(),
            ..cloud
        };
        assert_eq!(of_points(&plain, 0.07).unwrap(), [1.5, 1.6, 0.0, 2.0]);
    }

    #[test]
    fn what_does_not_fit_is_refused_by_name() {
        let bytes = || vec![0; 16];
        for (image, field) in [
            (image("rgb8", false, 8, bytes()), "encoding"),
            (image("32FC1", false, 7, bytes()), "step"),
            (image("32FC1", false, 9, bytes()), "data"),
            (Image { width: 0, ..image("32FC1", false, 8, bytes()) }, "width"),
            (Image { height: u32::MAX, ..image("32FC1", false, 8, bytes()) }, "height"),
        ] {
            assert_eq!(of_image(&image).unwrap_err().field, field);
        }
        let good = cloud(&[(1.0, 0.0); 4]);
        let field = |at: usize, change: fn(&mut PointField)| {
            let mut cloud = good.clone();
            change(&mut cloud.fields[at]);
            cloud
        };
        for (cloud, expected) in [
            (field(2, |f| f.name = "height".into()), "fields"),
            (field(2, |f| f.datatype = 8), "fields"),
            (field(2, |f| f.offset = 17), "fields"),
            (field(3, |f| f.offset = u32::MAX), "fields"),
            (PointCloud2 { height: 1, width: 4, ..good.clone() }, "height"),
            (PointCloud2 { row_step: 37, ..good.clone() }, "step"),
            (PointCloud2 { data: Bytes(vec![0; 75]), ..good.clone() }, "data"),
        ] {
            assert_eq!(of_points(&cloud, 0.07).unwrap_err().field, expected);
        }
    }

    #[test]
    fn lenses_are_those_of_both_models() {
        let k = [212.0, 0.0, 112.0, 0.0, 213.0, 86.0, 0.0, 0.0, 1.0];
        let info = CameraInfo {
            k,
            d: vec![1.0, 2.0, 3.0, 4.0, 5.0],
            distortion_model: "plumb_bob".into(),
            ..CameraInfo::default()
        };
        let found = lens(&info).unwrap();
        assert_eq!((found.fx_px, found.fy_px, found.cx_px, found.cy_px), (212.0, 213.0, 112.0, 86.0));
        assert_eq!(found.distortion, [1.0, 2.0, 3.0, 4.0, 5.0, 0.0, 0.0, 0.0]);
        let bare = lens(&CameraInfo { d: Vec::new(), ..info.clone() }).unwrap();
        assert_eq!(bare.distortion, [0.0; 8]);
        for (info, field) in [
            (CameraInfo { distortion_model: "equidistant".into(), ..info.clone() }, "distortion_model"),
            (CameraInfo { d: vec![0.0; 6], ..info.clone() }, "D"),
            (CameraInfo { d: vec![f64::NAN], ..info.clone() }, "D"),
            (CameraInfo { k: [0.0; 9], ..info.clone() }, "K"),
        ] {
            assert_eq!(lens(&info).unwrap_err().field, field);
        }
    }

    proptest! {
        #[test]
        fn any_sizes_end_without_panic_and_whole_images_only(
            width in 0u32..5, height in 0u32..5, step in 0u32..40, huge in any::<bool>(), big in any::<bool>(),
            data in proptest::collection::vec(any::<u8>(), 0..120), short in any::<bool>(),
        ) {
            let width = if huge { width.wrapping_sub(3) } else { width };
            let encoding = if short { "16UC1" } else { "32FC1" }.to_owned();
            let image =
                Image { width, height, step, encoding, is_bigendian: big, data: Bytes(data), ..Image::default() };
            if let Ok(depth) = of_image(&image) {
                prop_assert_eq!(depth.len(), (width * height) as usize);
                prop_assert!(depth.iter().all(|d| d.is_finite() && *d >= 0.0));
            }
        }

        #[test]
        fn any_clouds_end_without_panic_and_whole_images_only(
            width in 0u32..5, height in 0u32..5, point_step in 0u32..24, row_step in 0u32..90,
            offsets in proptest::array::uniform2(prop_oneof![0u32..24, any::<u32>()]),
            data in proptest::collection::vec(any::<u8>(), 0..300), big in any::<bool>(),
        ) {
            let field = |name: &str, offset| PointField { name: name.into(), offset, datatype: 7, count: 1 };
            let cloud = PointCloud2 {
                width, height, point_step, row_step, is_bigendian: big, data: Bytes(data),
                fields: vec![field("z", offsets[0]), field("noise", offsets[1])],
                ..PointCloud2::default()
            };
            if let Ok(depth) = of_points(&cloud, 0.07) {
                prop_assert_eq!(depth.len(), (width * height) as usize);
                prop_assert!(depth.iter().all(|d| d.is_finite() && *d >= 0.0));
            }
        }
    }
}
