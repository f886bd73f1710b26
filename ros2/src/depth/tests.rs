//! Images of any size, step and order of bytes come out as what was put in; everything else is refused by name.

use graspd_client::wire::DepthEncoding;
use proptest::prelude::*;

use super::*;
use crate::messages::{Header, RegionOfInterest};

fn header() -> Header {
    Header { stamp: Stamp { sec: 5, nanosec: 7 }, frame_id: "optical".into() }
}

fn info(width: u32, height: u32) -> CameraInfo {
    CameraInfo {
        header: header(),
        width,
        height,
        distortion_model: "plumb_bob".into(),
        d: vec![0.0; 5],
        k: [600.0, 0.0, 320.0, 0.0, 610.0, 240.0, 0.0, 0.0, 1.0],
        p: [500.0, 0.0, 310.0, 0.0, 0.0, 510.0, 230.0, 0.0, 0.0, 0.0, 1.0, 0.0],
        ..CameraInfo::default()
    }
}

/// Rows of bytes with so many spare ones behind each.
fn image(width: u32, encoding: &str, rows: &[Vec<u8>], spare: usize, big: bool) -> Image {
    let data: Vec<u8> = rows.iter().flat_map(|r| r.iter().copied().chain(vec![0xAA; spare])).collect();
    Image {
        header: header(),
        height: rows.len() as u32,
        width,
        encoding: encoding.into(),
        is_bigendian: big.into(),
        step: (rows[0].len() + spare) as u32,
        data,
    }
}

fn small() -> (Image, CameraInfo) {
    (image(2, "16UC1", &[vec![1, 0, 2, 0], vec![3, 0, 0, 1]], 0, false), info(2, 2))
}

proptest! {
    #[test]
    fn millimetres_come_out_as_they_went_in(
        width in 1usize..9, height in 1usize..9, spare in 0usize..5, big: bool, seed: u16,
    ) {
        let value = |i: usize| (i as u16).wrapping_mul(40_503).wrapping_add(seed);
        let row = |r: usize| (0..width).flat_map(|c| {
            let v = value(r * width + c);
            if big { v.to_be_bytes() } else { v.to_le_bytes() }
        }).collect::<Vec<u8>>();
        let rows: Vec<_> = (0..height).map(row).collect();
        let message = image(width as u32, "16UC1", &rows, spare, big);
        let frame = frame(&message, &info(width as u32, height as u32), None, Lens::Raw).unwrap();
        prop_assert_eq!(frame.encoding, i32::from(DepthEncoding::RawU16));
        prop_assert_eq!(frame.depth_scale_m, 0.001);
        prop_assert_eq!((frame.width_px, frame.height_px), (width as i32, height as i32));
        let expected: Vec<u8> = (0..width * height).flat_map(|i| value(i).to_le_bytes()).collect();
        prop_assert_eq!(frame.data.to_vec(), expected);
    }

    #[test]
    fn metres_come_out_as_they_went_in(
        width in 1usize..6, depths in proptest::collection::vec(any::<f32>(), 1..30), spare in 0usize..5, big: bool,
    ) {
        let depths = &depths[..depths.len() / width * width];
        prop_assume!(!depths.is_empty());
        let bytes = |v: &f32| if big { v.to_be_bytes() } else { v.to_le_bytes() };
        let rows: Vec<Vec<u8>> =
            depths.chunks(width).map(|row| row.iter().flat_map(bytes).collect()).collect();
        let message = image(width as u32, "32FC1", &rows, spare, big);
        let frame = frame(&message, &info(width as u32, rows.len() as u32), None, Lens::Raw).unwrap();
        prop_assert_eq!(frame.encoding, i32::from(DepthEncoding::RawF32));
        let read: Vec<f32> = frame.data.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
        prop_assert_eq!(read.len(), depths.len());
        for (found, sent) in read.iter().zip(depths) {
            prop_assert!(if sent.is_finite() { found == sent } else { found.is_nan() }, "{} {}", found, sent);
        }
    }

    #[test]
    fn no_message_panics(
        width in 0u32..5, height in 0u32..5, step in 0u32..20, length in 0usize..90, encoding in 0usize..4, big: u8,
        k in proptest::array::uniform9(-1.0f64..2.0), binning: u32, roi: (u32, u32, u32, u32),
    ) {
        let encoding = ["16UC1", "32FC1", "mono16", "rgb8"][encoding];
        let message = Image {
            header: header(), height, width, encoding: encoding.into(), is_bigendian: big, step, data: vec![0; length],
        };
        let lens = CameraInfo {
            k, binning_x: binning,
            roi: RegionOfInterest { x_offset: roi.0, y_offset: roi.1, width: roi.2, height: roi.3, do_rectify: false },
            ..info(width, height)
        };
        let read = frame(&message, &lens, None, Lens::Raw);
        prop_assert_eq!(read.is_ok(), check(&message, &lens, Lens::Raw).is_ok());
        if let Ok(frame) = read {
            let pixel = if encoding == "32FC1" { 4 } else { 2 };
            prop_assert_eq!(frame.data.len(), (width * height) as usize * pixel);
        }
    }
}

#[test]
fn a_frame_keeps_name_and_time() {
    let (image, info) = small();
    let frame = frame(&image, &info, None, Lens::Raw).unwrap();
    assert_eq!(frame.camera_frame_id, "optical");
    assert_eq!(frame.capture_time, Some(prost_types::Timestamp { seconds: 5, nanos: 7 }));
    let lens = frame.intrinsics.unwrap();
    assert_eq!((lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px), (600.0, 610.0, 320.0, 240.0));
    assert!(lens.distortion.is_empty());
}

#[test]
fn lenses_are_those_of_the_image() {
    let (image, plain) = small();
    let lens = |info: &CameraInfo, lens| frame(&image, info, None, lens).unwrap().intrinsics.unwrap();
    let bent = CameraInfo { d: vec![0.1, 0.2, 0.3, 0.4, 0.5], ..plain.clone() };
    assert_eq!(lens(&bent, Lens::Raw).distortion, [0.1, 0.2, 0.3, 0.4, 0.5]);
    let rectified = lens(&bent, Lens::Rectified);
    assert!(rectified.distortion.is_empty());
    assert_eq!(
        (rectified.fx_px, rectified.fy_px, rectified.cx_px, rectified.cy_px),
        (500.0, 510.0, 310.0, 230.0)
    );
    let many =
        CameraInfo { distortion_model: "rational_polynomial".into(), d: vec![0.1; 8], ..plain.clone() };
    assert_eq!(lens(&many, Lens::Raw).distortion.len(), 8);
    // Every second pixel of a region: pixel 0 of the image is the mean of columns 100 and 101.
    let part = CameraInfo {
        width: 640,
        height: 480,
        binning_x: 2,
        binning_y: 2,
        roi: RegionOfInterest { x_offset: 100, y_offset: 50, width: 4, height: 4, do_rectify: false },
        ..plain
    };
    let found = lens(&part, Lens::Raw);
    assert_eq!((found.fx_px, found.fy_px), (300.0, 305.0));
    assert_eq!((found.cx_px, found.cy_px), ((220.0 + 0.5) / 2.0 - 0.5, (190.0 + 0.5) / 2.0 - 0.5));
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let (image, info) = small();
    let images = [
        (Image { encoding: "rgb8".into(), ..image.clone() }, "image.encoding"),
        (Image { width: 0, ..image.clone() }, "image.width, image.height"),
        (Image { width: 5000, height: 5000, ..image.clone() }, "image.width, image.height"),
        (Image { step: 3, ..image.clone() }, "image.step"),
        (Image { data: vec![0; 7], ..image.clone() }, "image.data"),
        (Image { data: vec![0; 9], ..image.clone() }, "image.data"),
    ];
    for (wrong, field) in images {
        assert_eq!(frame(&wrong, &info, None, Lens::Raw).unwrap_err().field, field);
    }
    let other = Header { frame_id: "colour".into(), ..header() };
    let infos = [
        (CameraInfo { header: other, ..info.clone() }, "camera_info.header.frame_id"),
        (CameraInfo { width: 3, ..info.clone() }, "camera_info.width, camera_info.height"),
        (CameraInfo { binning_x: 2, ..info.clone() }, "camera_info.width, camera_info.height"),
        (CameraInfo { k: [0.0; 9], ..info.clone() }, "camera_info.k"),
        (CameraInfo { k: [f64::NAN; 9], ..info.clone() }, "camera_info.k"),
        (CameraInfo { d: vec![0.1; 3], ..info.clone() }, "camera_info.d"),
        (CameraInfo { d: vec![f64::INFINITY; 5], ..info.clone() }, "camera_info.d"),
        (
            CameraInfo { d: vec![0.1; 4], distortion_model: "equidistant".into(), ..info.clone() },
            "camera_info.distortion_model",
        ),
    ];
    for (wrong, field) in infos {
        assert_eq!(frame(&image, &wrong, None, Lens::Raw).unwrap_err().field, field);
    }
    let wrong = CameraInfo { p: [0.0; 12], ..info };
    assert_eq!(frame(&image, &wrong, None, Lens::Rectified).unwrap_err().field, "camera_info.p");
}

#[test]
fn labels_are_of_the_same_size() {
    let (depth, info) = small();
    let labels = image(2, "8UC1", &[vec![1, 2], vec![3, 4]], 3, false);
    let read = frame(&depth, &info, Some(&labels), Lens::Raw).unwrap().labels.unwrap();
    assert_eq!(read.data.to_vec(), [1, 2, 3, 4]);
    let wrong = [
        (Image { encoding: "bgr8".into(), ..labels.clone() }, "labels.encoding"),
        (image(2, "mono8", &[vec![1, 2]], 0, false), "labels.width, labels.height"),
    ];
    for (labels, field) in wrong {
        assert_eq!(frame(&depth, &info, Some(&labels), Lens::Raw).unwrap_err().field, field);
    }
}
