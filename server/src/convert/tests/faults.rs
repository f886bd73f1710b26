//! Every fault of a request names its field and its kind.

use super::*;

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
