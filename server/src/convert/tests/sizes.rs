//! What a request may announce and how much room its scene takes.

use super::*;

/// A PNG file of zeros; the compression of zeros makes it small.
fn zeros_png(width: u32, height: u32, depth: ::png::BitDepth) -> Bytes {
    let mut file = Vec::new();
    let mut encoder = ::png::Encoder::new(&mut file, width, height);
    encoder.set_color(::png::ColorType::Grayscale);
    encoder.set_depth(depth);
    let bytes = (width * height * if depth == ::png::BitDepth::Sixteen { 2 } else { 1 }) as usize;
    encoder.write_header().unwrap().write_image_data(&vec![0; bytes]).unwrap();
    file.into()
}

fn png_frame(width: u32, height: u32) -> v1::DepthFrame {
    v1::DepthFrame {
        encoding: v1::DepthEncoding::PngU16.into(),
        width_px: 0,
        height_px: 0,
        data: zeros_png(width, height, ::png::BitDepth::Sixteen),
        ..frame()
    }
}

#[test]
fn sizes_are_checked_before_anything_is_decoded() {
    let fault = |frames: Vec<v1::DepthFrame>| {
        let error = plan_grasps(v1::PlanGraspsRequest { frames, ..request() }, "plan").unwrap_err();
        assert_eq!(error.reason, FieldReason::Image, "{error}");
        (error.field.clone(), error.to_string())
    };
    let no_png =
        v1::DepthFrame { data: Bytes::from_static(b"\x89PNG\r\n\x1a\n, no more"), ..png_frame(1, 1) };
    assert_eq!(fault(vec![no_png]).0, "plan.frames[0].data");
    // A hundred kilobytes that would become 67 million pixels.
    let large = fault(vec![png_frame(8192, 8192)]);
    assert_eq!(large.0, "plan.frames[0].data");
    assert!(large.1.contains("8192 × 8192 pixels, expected at most 8388608"), "{}", large.1);
    // Each of them is small enough, all of them are not.
    let posed = v1::DepthFrame {
        camera_pose: Some(v1::PoseInFrame { frame_id: String::new(), pose: pose(1.0) }),
        ..png_frame(2048, 2048)
    };
    let many = fault(vec![posed.clone(), posed.clone(), posed.clone()]);
    assert_eq!(many.0, "plan.frames[2]");
    assert!(many.1.contains("12582912 pixels"), "{}", many.1);
    let Parsed { scene, .. } =
        plan_grasps(v1::PlanGraspsRequest { frames: vec![posed.clone(), posed], ..request() }, "").unwrap();
    assert_eq!(scene.room(), 1 + 4);

    let labels = |encoding: v1::LabelEncoding, data: Bytes| v1::DepthFrame {
        labels: Some(v1::LabelImage { encoding: encoding.into(), data }),
        ..frame()
    };
    let raw = labels(v1::LabelEncoding::RawU8, Bytes::from_static(&[1; 7]));
    assert_eq!(fault(vec![raw]).0, "plan.frames[0].labels.data");
    let wider = labels(v1::LabelEncoding::PngU8, zeros_png(5, 2, ::png::BitDepth::Eight));
    assert_eq!(fault(vec![wider]).0, "plan.frames[0].labels.data");
}

#[test]
fn a_header_that_promises_too_much_is_found_where_it_is_decoded() {
    let mut cut = png_frame(64, 48);
    cut.data.truncate(40);
    let Parsed { scene, .. } =
        plan_grasps(v1::PlanGraspsRequest { frames: vec![cut], ..request() }, "plan").unwrap();
    let error = scene.frames[0].decode().unwrap_err();
    assert_eq!((error.field.as_str(), error.reason), ("plan.frames[0].data", FieldReason::Image));
}

#[test]
fn room_grows_with_the_volume() {
    for (volume_resolution, room) in [(0, 1), (16, 1), (80, 1), (81, 2), (100, 2), (128, 5)] {
        let scene_options = Some(v1::SceneOptions { volume_resolution, ..Default::default() });
        let Parsed { scene, .. } =
            plan_grasps(v1::PlanGraspsRequest { scene_options, ..request() }, "").unwrap();
        assert_eq!(scene.room(), room, "{volume_resolution}");
    }
}
