//! Tests of the conversion: every fault names its field, defaults are the documented ones, and no wire
//! message makes it panic.

use bytes::Bytes;
use graspd_planner::options::{PlanOptions, Reaching, SceneOptions, Scheme, Target, WorkspaceRequest};
use graspd_proto::v1;
use proptest::prelude::*;

use super::*;
use crate::error::FieldReason;

fn vector(x: f64, y: f64, z: f64) -> Option<v1::Vector3> {
    Some(v1::Vector3 { x, y, z })
}

fn pose(w: f64) -> Option<v1::Pose> {
    Some(v1::Pose {
        position: vector(0.1, 0.2, 0.3),
        orientation: Some(v1::Quaternion { x: 0.0, y: 0.0, z: 0.0, w }),
    })
}

fn frame() -> v1::DepthFrame {
    v1::DepthFrame {
        width_px: 4,
        height_px: 2,
        encoding: v1::DepthEncoding::RawU16.into(),
        depth_scale_m: 0.001,
        data: Bytes::from(vec![1; 16]),
        intrinsics: Some(v1::CameraIntrinsics {
            fx_px: 5.0,
            fy_px: 5.0,
            cx_px: 2.0,
            cy_px: 1.0,
            distortion: vec![],
        }),
        ..Default::default()
    }
}

fn request() -> v1::PlanGraspsRequest {
    v1::PlanGraspsRequest { hand: "hands/leap".to_owned(), frames: vec![frame()], ..Default::default() }
}

fn options(edit: impl FnOnce(&mut v1::PlanOptions)) -> v1::PlanGraspsRequest {
    let mut wire = v1::PlanOptions::default();
    edit(&mut wire);
    v1::PlanGraspsRequest { options: Some(wire), ..request() }
}

fn edited(edit: impl FnOnce(&mut v1::DepthFrame)) -> v1::PlanGraspsRequest {
    let mut request = request();
    edit(&mut request.frames[0]);
    request
}

fn lens(edit: impl FnOnce(&mut v1::CameraIntrinsics)) -> v1::PlanGraspsRequest {
    edited(|f| edit(f.intrinsics.as_mut().unwrap()))
}

#[test]
fn nothing_but_a_frame_takes_the_defaults() {
    let (scene, job) = plan_grasps(request(), "").unwrap();
    assert_eq!(scene.options, SceneOptions::default());
    assert_eq!(scene.estimator, None);
    assert_eq!((scene.world_frame_id(), scene.camera_frame_id()), ("camera", "camera"));
    assert_eq!(job.options, PlanOptions::default());
    assert_eq!((job.hand_id.as_str(), job.budget), ("leap", None));
    let (decoded, invalid) = scene.frames[0].decode().unwrap();
    assert_eq!((decoded.image.depth_m.len(), invalid), (8, 0));
    assert_eq!(decoded.world_from_camera, None);
}

#[test]
fn everything_that_is_asked_for_arrives() {
    let wire = options(|o| {
        o.batch_size = 100;
        o.scheme = Some(v1::Scheme { iteration_count: 60, penetration_iteration_count: 60 });
        o.reaching = v1::Reaching::Direction.into();
        o.reaching_direction = vector(0.0, 0.0, -2.0);
        o.orientation_limits = Some(v1::OrientationLimits {
            max_tilt_rad: Some(0.0),
            roll: Some(v1::RollRange { min_rad: -1.0, max_rad: 1.0 }),
        });
        o.keep_out_boxes = vec![v1::KeepOutBox { pose: pose(1.0), half_extents_m: vector(0.1, 0.2, 0.3) }];
        o.target = Some(v1::plan_options::Target::TargetPoint(v1::TargetPoint {
            point: vector(1.0, 2.0, 3.0),
            radius_m: 0.05,
        }));
        o.seed = 7;
        o.budget = Some(prost_types::Duration { seconds: 0, nanos: 250_000_000 });
        o.max_grasp_count = 3;
        o.min_score = Some(0.0);
        o.trace = true;
    });
    let (_, job) = plan_grasps(wire, "").unwrap();
    let options = job.options;
    assert_eq!((options.batch, options.scheme), (100, Scheme::QUICK));
    assert!(matches!(options.reaching, Reaching::Direction(d) if (d.z + 1.0).abs() < 1e-12));
    assert_eq!((options.orientation.cone_rad, options.orientation.roll_rad), (0.0, Some((-1.0, 1.0))));
    assert_eq!(options.keep_out[0].half_extents_m.z, 0.3);
    assert!(matches!(options.target, Some(Target::Point { radius_m, .. }) if radius_m == 0.05));
    assert_eq!((options.seed, options.max_grasps, options.trace), (7, 3, true));
    assert_eq!(job.budget, Some(Duration::from_millis(250)));

    let mut placed = request();
    placed.frames[0].camera_pose = Some(v1::PoseInFrame { frame_id: "base".to_owned(), pose: pose(1.0005) });
    placed.scene_options = Some(v1::SceneOptions {
        estimator: "net".to_owned(),
        workspace: Some(v1::WorkspacePlacement { pose: pose(-1.0), table_height_m: Some(0.05) }),
        ..Default::default()
    });
    let (scene, _) = plan_grasps(placed, "").unwrap();
    assert_eq!((scene.world_frame_id(), scene.camera_frame_id()), ("base", "camera"));
    assert_eq!(scene.estimator.as_deref(), Some("net"));
    assert!(
        matches!(scene.options.workspace, WorkspaceRequest::Placed { table_m: Some(t), .. } if t == 0.05)
    );
    let rotation = scene.frames[0].world_from_camera.unwrap().rotation;
    assert!((rotation.norm() - 1.0).abs() < 1e-12, "normalized");
}

#[test]
fn a_hand_that_reaches_from_anywhere_tilts_further_unless_told() {
    let free = |max_tilt_rad: Option<f64>, roll| {
        let wire = options(|o| {
            o.reaching = v1::Reaching::Free.into();
            o.orientation_limits = Some(v1::OrientationLimits { max_tilt_rad, roll });
        });
        plan_grasps(wire, "").unwrap().1.options.orientation
    };
    let roll = Some(v1::RollRange { min_rad: 0.0, max_rad: 0.5 });
    assert_eq!(free(None, roll).cone_rad, 1.3);
    assert_eq!(free(None, roll).roll_rad, Some((0.0, 0.5)));
    assert_eq!(free(Some(0.2), None).cone_rad, 0.2);
    let unset = options(|o| o.reaching = v1::Reaching::Free.into());
    assert_eq!(plan_grasps(unset, "").unwrap().1.options.orientation.cone_rad, 1.3);
    let top_down = plan_grasps(options(|o| o.trace = true), "").unwrap().1.options;
    assert_eq!(top_down.orientation.cone_rad, std::f64::consts::FRAC_PI_3);
}

#[test]
fn the_lateral_axis_is_across_the_approach() {
    let hand = graspd_hands::library::hand("antipodal").unwrap();
    for (approach, lateral) in [
        (nalgebra::Vector3::z_axis(), vector(1.0, 0.0, 0.0)),
        (nalgebra::Vector3::x_axis(), vector(0.0, 1.0, 0.0)),
        (-nalgebra::Vector3::x_axis(), vector(0.0, 1.0, 0.0)),
    ] {
        let turned = graspd_hands::Hand { approach, ..hand.clone() };
        let message = hand_message(&turned, crate::registry::Origin::Library, None);
        assert_eq!(message.lateral_axis, lateral, "{approach:?}");
    }
}

#[test]
fn every_fault_names_its_field_and_kind() {
    use FieldReason::{Image, Intrinsics, Missing, Pose, Value};

    let point = |radius_m| {
        Some(v1::plan_options::Target::TargetPoint(v1::TargetPoint {
            point: vector(0.0, 0.0, 0.0),
            radius_m,
        }))
    };
    let posed =
        |w: f64| edited(|f| f.camera_pose = Some(v1::PoseInFrame { frame_id: String::new(), pose: pose(w) }));
    let scene = |edit: fn(&mut v1::SceneOptions)| {
        let mut wire = v1::SceneOptions::default();
        edit(&mut wire);
        v1::PlanGraspsRequest { scene_options: Some(wire), ..request() }
    };
    let cases: Vec<(v1::PlanGraspsRequest, &str, FieldReason)> = vec![
        (v1::PlanGraspsRequest { hand: String::new(), ..request() }, "hand", Missing),
        (v1::PlanGraspsRequest { hand: "leap".to_owned(), ..request() }, "hand", Value),
        (v1::PlanGraspsRequest { hand: "hands/../x".to_owned(), ..request() }, "hand", Value),
        (v1::PlanGraspsRequest { hand: "hands/x".repeat(5000), ..request() }, "hand", Value),
        (v1::PlanGraspsRequest { frames: vec![], ..request() }, "frames", Missing),
        (v1::PlanGraspsRequest { frames: vec![frame(); 17], ..request() }, "frames", Value),
        (v1::PlanGraspsRequest { frames: vec![frame(); 2], ..request() }, "frames[0].camera_pose", Missing),
        (edited(|f| f.encoding = 0), "frames[0].encoding", Missing),
        (edited(|f| f.encoding = 99), "frames[0].encoding", Value),
        (edited(|f| f.depth_scale_m = 0.0), "frames[0].depth_scale_m", Image),
        (edited(|f| f.depth_scale_m = f64::NAN), "frames[0].depth_scale_m", Image),
        (edited(|f| f.width_px = -4), "frames[0].width_px", Image),
        (edited(|f| f.height_px = 0), "frames[0].height_px", Image),
        (edited(|f| f.width_px = i32::MAX), "frames[0].width_px", Image),
        (edited(|f| f.data = Bytes::new()), "frames[0].data", Missing),
        (edited(|f| f.data = Bytes::from_static(&[0; 15])), "frames[0].data", Image),
        (edited(|f| f.intrinsics = None), "frames[0].intrinsics", Missing),
        (lens(|i| i.fx_px = 0.0), "frames[0].intrinsics.fx_px", Intrinsics),
        (lens(|i| i.fy_px = -1.0), "frames[0].intrinsics.fy_px", Intrinsics),
        (lens(|i| i.cx_px = f64::NAN), "frames[0].intrinsics.cx_px", Intrinsics),
        (lens(|i| i.distortion = vec![0.0; 3]), "frames[0].intrinsics.distortion", Intrinsics),
        (
            lens(|i| i.distortion = vec![0.0, 0.0, 0.0, f64::INFINITY]),
            "frames[0].intrinsics.distortion[3]",
            Intrinsics,
        ),
        (posed(1.01), "frames[0].camera_pose.pose.orientation", Pose),
        (posed(0.0), "frames[0].camera_pose.pose.orientation", Pose),
        (posed(f64::NAN), "frames[0].camera_pose.pose.orientation", Pose),
        (edited(|f| f.camera_pose = Some(v1::PoseInFrame::default())), "frames[0].camera_pose.pose", Missing),
        (
            edited(|f| {
                let mut pose = pose(1.0).unwrap();
                pose.position = vector(f64::INFINITY, 0.0, 0.0);
                f.camera_pose = Some(v1::PoseInFrame { frame_id: String::new(), pose: Some(pose) });
            }),
            "frames[0].camera_pose.pose.position.x",
            Pose,
        ),
        (edited(|f| f.labels = Some(v1::LabelImage::default())), "frames[0].labels.data", Missing),
        (edited(|f| f.camera_frame_id = "x".repeat(300)), "frames[0].camera_frame_id", Value),
        (scene(|s| s.volume_kind = 9), "scene_options.volume_kind", Value),
        (scene(|s| s.focal_contact_threshold = Some(0.0)), "scene_options.focal_contact_threshold", Value),
        (scene(|s| s.focal_centroid_threshold = Some(1.1)), "scene_options.focal_centroid_threshold", Value),
        (
            scene(|s| s.workspace = Some(v1::WorkspacePlacement::default())),
            "scene_options.workspace.pose",
            Missing,
        ),
        (
            scene(|s| {
                s.workspace = Some(v1::WorkspacePlacement { pose: pose(1.0), table_height_m: Some(0.5) })
            }),
            "scene_options.workspace.table_height_m",
            Value,
        ),
        (
            scene(|s| {
                // The size itself: nothing would be above the table.
                s.workspace = Some(v1::WorkspacePlacement { pose: pose(1.0), table_height_m: Some(0.4) })
            }),
            "scene_options.workspace.table_height_m",
            Value,
        ),
        (scene(|s| s.volume_size_m = Some(0.0)), "scene_options.volume_size_m", Value),
        (scene(|s| s.volume_resolution = 500), "scene_options.volume_resolution", Value),
        (options(|o| o.batch_size = -1), "options.batch_size", Value),
        (options(|o| o.batch_size = 1_000_000), "options.batch_size", Value),
        (options(|o| o.scheme = Some(v1::Scheme::default())), "options.scheme.iteration_count", Value),
        (
            options(|o| o.scheme = Some(v1::Scheme { iteration_count: 5, penetration_iteration_count: 6 })),
            "options.scheme.penetration_iteration_count",
            Value,
        ),
        (options(|o| o.reaching = 77), "options.reaching", Value),
        (options(|o| o.reaching = 3), "options.reaching_direction", Missing),
        (options(|o| o.reaching_direction = vector(0.0, 0.0, 1.0)), "options.reaching_direction", Value),
        (
            options(|o| {
                o.reaching = 3;
                o.reaching_direction = vector(0.0, 0.0, 0.0);
            }),
            "options.reaching_direction",
            Value,
        ),
        (
            options(|o| {
                o.orientation_limits = Some(v1::OrientationLimits { max_tilt_rad: Some(4.0), roll: None });
            }),
            "options.orientation_limits.max_tilt_rad",
            Value,
        ),
        (
            options(|o| {
                let roll = Some(v1::RollRange { min_rad: 1.0, max_rad: 0.0 });
                o.orientation_limits = Some(v1::OrientationLimits { max_tilt_rad: None, roll });
            }),
            "options.orientation_limits.roll.max_rad",
            Value,
        ),
        (
            options(|o| o.keep_out_boxes = vec![v1::KeepOutBox::default()]),
            "options.keep_out_boxes[0].pose",
            Missing,
        ),
        (
            options(|o| {
                let half_extents_m = vector(0.1, 0.0, 0.1);
                o.keep_out_boxes = vec![v1::KeepOutBox { pose: pose(1.0), half_extents_m }];
            }),
            "options.keep_out_boxes[0].half_extents_m.y",
            Value,
        ),
        (
            options(|o| o.keep_out_boxes = vec![v1::KeepOutBox::default(); 65]),
            "options.keep_out_boxes",
            Value,
        ),
        (
            options(|o| o.target = Some(v1::plan_options::Target::TargetLabel(256))),
            "options.target_label",
            Value,
        ),
        (
            options(|o| o.target = Some(v1::plan_options::Target::TargetLabel(1))),
            "options.target_label",
            Value,
        ),
        (options(|o| o.target = point(0.0)), "options.target_point.radius_m", Value),
        (options(|o| o.budget = Some(prost_types::Duration::default())), "options.budget", Value),
        (
            options(|o| o.budget = Some(prost_types::Duration { seconds: -1, nanos: 0 })),
            "options.budget",
            Value,
        ),
        (options(|o| o.max_grasp_count = 1001), "options.max_grasp_count", Value),
        (options(|o| o.min_score = Some(f64::NAN)), "options.min_score", Value),
        (options(|o| o.friction = Some(0.0)), "options.friction", Value),
        (options(|o| o.pregrasp_offset_m = Some(-0.1)), "options.pregrasp_offset_m", Value),
        (options(|o| o.opening_fraction = Some(1.5)), "options.opening_fraction", Value),
    ];
    for (wire, field, reason) in cases {
        let error = plan_grasps(wire, "").unwrap_err();
        assert_eq!((error.field.as_str(), error.reason), (field, reason), "{error}");
        assert!(error.to_string().len() < 400, "{error}");
    }
    let nested = plan_grasps(v1::PlanGraspsRequest::default(), "plan").unwrap_err();
    assert_eq!(nested.field, "plan.hand");
}

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
    let (scene, _) =
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
    let (scene, _) = plan_grasps(v1::PlanGraspsRequest { frames: vec![cut], ..request() }, "plan").unwrap();
    let error = scene.frames[0].decode().unwrap_err();
    assert_eq!((error.field.as_str(), error.reason), ("plan.frames[0].data", FieldReason::Image));
}

#[test]
fn room_grows_with_the_volume() {
    for (volume_resolution, room) in [(0, 1), (16, 1), (80, 1), (81, 2), (100, 2), (128, 5)] {
        let scene_options = Some(v1::SceneOptions { volume_resolution, ..Default::default() });
        let (scene, _) = plan_grasps(v1::PlanGraspsRequest { scene_options, ..request() }, "").unwrap();
        assert_eq!(scene.room(), room, "{volume_resolution}");
    }
}

#[test]
fn tasks_are_checked_one_by_one() {
    let task =
        |id: &str| v1::HandTask { task_id: id.to_owned(), hand: "hands/leap".to_owned(), options: None };
    let with = |tasks| v1::PlanMultiHandRequest { frames: vec![frame()], tasks, ..Default::default() };
    let (_, jobs) = multi_hand(with(vec![task("left"), task("right")])).unwrap();
    assert_eq!(jobs.iter().map(|j| j.task_id.as_str()).collect::<Vec<_>>(), ["left", "right"]);
    let bad_hand = v1::HandTask { hand: "x".to_owned(), ..task("b") };
    for (tasks, field) in [
        (vec![], "tasks"),
        (vec![task("a"); 17], "tasks"),
        (vec![task("a"), task("a")], "tasks[1].task_id"),
        (vec![task("")], "tasks[0].task_id"),
        (vec![task("a"), bad_hand], "tasks[1].hand"),
    ] {
        assert_eq!(multi_hand(with(tasks)).unwrap_err().field, field);
    }
}

#[test]
fn long_texts_are_cut() {
    assert_eq!(quoted("a\n"), "\"a\\n\"");
    let long = quoted(&"é".repeat(1000));
    assert!(long.len() < 400 && long.ends_with("more bytes"), "{long}");
}

fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![any::<f64>(), -2.0..2.0f64, Just(0.0), Just(1.0)]
}

fn any_vector() -> impl Strategy<Value = Option<v1::Vector3>> {
    proptest::option::of((any_number(), any_number(), any_number()).prop_map(|(x, y, z)| v1::Vector3 {
        x,
        y,
        z,
    }))
}

fn any_pose() -> impl Strategy<Value = Option<v1::Pose>> {
    let rotation = (any_number(), any_number(), any_number(), any_number());
    (any_vector(), proptest::option::of(rotation)).prop_map(|(position, rotation)| {
        let orientation = rotation.map(|(x, y, z, w)| v1::Quaternion { x, y, z, w });
        Some(v1::Pose { position, orientation })
    })
}

prop_compose! {
    fn any_frame()(
        size in (-2i32..6, -2i32..6),
        encoding in -1i32..6,
        depth_scale_m in any_number(),
        data in proptest::collection::vec(any::<u8>(), 0..80),
        focal in (any_number(), any_number(), any_number(), any_number()),
        distortion in proptest::collection::vec(any_number(), 0..10),
        camera in any_pose(),
        labels in proptest::option::of((-1i32..4, proptest::collection::vec(any::<u8>(), 0..30))),
    ) -> v1::DepthFrame {
        let (fx_px, fy_px, cx_px, cy_px) = focal;
        v1::DepthFrame {
            width_px: size.0,
            height_px: size.1,
            encoding,
            depth_scale_m,
            data: data.into(),
            intrinsics: Some(v1::CameraIntrinsics { fx_px, fy_px, cx_px, cy_px, distortion }),
            camera_pose: camera.map(|pose| v1::PoseInFrame { frame_id: String::new(), pose: Some(pose) }),
            labels: labels.map(|(encoding, data)| v1::LabelImage { encoding, data: data.into() }),
            ..Default::default()
        }
    }
}

prop_compose! {
    fn any_options()(
        numbers in (any::<i32>(), any::<i32>(), any::<i32>(), any::<i32>(), -1i32..7),
        shares in proptest::collection::vec(proptest::option::of(any_number()), 7),
        direction in any_vector(),
        keep_out in any_pose(),
        extents in any_vector(),
        label in any::<i32>(),
        budget in (any::<i64>(), any::<i32>()),
        seed in any::<u64>(),
    ) -> v1::PlanOptions {
        v1::PlanOptions {
            batch_size: numbers.0,
            scheme: Some(v1::Scheme { iteration_count: numbers.1, penetration_iteration_count: numbers.2 }),
            reaching: numbers.4,
            reaching_direction: direction,
            orientation_limits: Some(v1::OrientationLimits {
                max_tilt_rad: shares[0],
                roll: shares[1].map(|a| v1::RollRange { min_rad: a, max_rad: shares[2].unwrap_or(a) }),
            }),
            keep_out_boxes: vec![v1::KeepOutBox { pose: keep_out, half_extents_m: extents }],
            target: Some(v1::plan_options::Target::TargetLabel(label)),
            seed,
            budget: Some(prost_types::Duration { seconds: budget.0, nanos: budget.1 }),
            max_grasp_count: numbers.3,
            min_score: shares[3],
            friction: shares[4],
            pregrasp_offset_m: shares[5],
            opening_fraction: shares[6],
            trace: false,
        }
    }
}

proptest! {
    #[test]
    fn no_frame_panics_and_what_is_accepted_is_sound(wire in any_frame()) {
        let request = v1::PlanGraspsRequest { frames: vec![wire], ..request() };
        if let Ok((scene, _)) = plan_grasps(request, "") {
            let frame = &scene.frames[0];
            if let Some(pose) = frame.world_from_camera {
                prop_assert!((pose.rotation.norm() - 1.0).abs() < 1e-9);
                prop_assert!(pose.translation.vector.iter().all(|v| v.is_finite()));
            }
            if let Ok((decoded, _)) = frame.decode() {
                let pixels = decoded.image.width * decoded.image.height;
                prop_assert_eq!(decoded.image.depth_m.len(), pixels);
                prop_assert!(decoded.labels.is_none_or(|l| l.len() == pixels));
                prop_assert!(decoded.intrinsics.fx_px > 0.0 && decoded.intrinsics.fy_px > 0.0);
            }
        }
    }

    #[test]
    fn no_options_panic_and_what_is_accepted_is_in_range(wire in any_options(), hand in ".{0,40}") {
        let mut request = request();
        request.frames[0].labels = Some(v1::LabelImage { encoding: 1, data: vec![0; 8].into() });
        plan_grasps(v1::PlanGraspsRequest { hand, ..request.clone() }, "").ok();
        request.options = Some(wire);
        if let Ok((_, job)) = plan_grasps(request, "") {
            let options = job.options;
            prop_assert!((1..=4096).contains(&options.batch));
            prop_assert!(options.scheme.with_penetration <= options.scheme.iterations);
            prop_assert!(options.friction > 0.0 && options.friction <= 5.0);
            prop_assert!(job.budget.is_none_or(|b| !b.is_zero()));
        }
    }
}
