//! Tests of the conversion: every fault names its field, defaults are the documented ones, and no wire
//! message makes it panic.

mod faults;
mod laws;
mod sizes;

use bytes::Bytes;
use graspd_planner::options::{PlanOptions, Reaching, SceneOptions, Scheme, Target, WorkspaceRequest};
use graspd_proto::v1;

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
    let Parsed { scene, jobs: job, .. } = plan_grasps(request(), "").unwrap();
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
    let Parsed { jobs: job, .. } = plan_grasps(wire, "").unwrap();
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
        grasp_region: Some(v1::GraspRegion {
            pose: pose(1.0),
            half_extents_m: Some(v1::Vector3 { x: 0.17, y: 0.16, z: 0.2 }),
        }),
        ..Default::default()
    });
    let mut flat = placed.clone();
    let region = flat.scene_options.as_mut().unwrap().grasp_region.as_mut().unwrap();
    region.half_extents_m = Some(v1::Vector3 { x: 0.17, y: 0.0, z: 0.2 });
    assert_eq!(plan_grasps(flat, "").unwrap_err().field, "scene_options.grasp_region.half_extents_m.y");
    let Parsed { scene, .. } = plan_grasps(placed, "").unwrap();
    assert_eq!((scene.world_frame_id(), scene.camera_frame_id()), ("base", "camera"));
    assert_eq!(scene.estimator.as_deref(), Some("net"));
    assert!(
        matches!(scene.options.workspace, WorkspaceRequest::Placed { table_m: Some(t), .. } if t == 0.05)
    );
    assert_eq!(scene.options.region.unwrap().half_extents_m.y, 0.16);
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
        plan_grasps(wire, "").unwrap().jobs.options.orientation
    };
    let roll = Some(v1::RollRange { min_rad: 0.0, max_rad: 0.5 });
    assert_eq!(free(None, roll).cone_rad, 1.3);
    assert_eq!(free(None, roll).roll_rad, Some((0.0, 0.5)));
    assert_eq!(free(Some(0.2), None).cone_rad, 0.2);
    let unset = options(|o| o.reaching = v1::Reaching::Free.into());
    assert_eq!(plan_grasps(unset, "").unwrap().jobs.options.orientation.cone_rad, 1.3);
    let top_down = plan_grasps(options(|o| o.trace = true), "").unwrap().jobs.options;
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
fn tasks_are_checked_one_by_one() {
    let task =
        |id: &str| v1::HandTask { task_id: id.to_owned(), hand: "hands/leap".to_owned(), options: None };
    let with = |tasks| v1::PlanMultiHandRequest { frames: vec![frame()], tasks, ..Default::default() };
    let Parsed { jobs: HandJobs { jobs, .. }, .. } =
        multi_hand(with(vec![task("left"), task("right")])).unwrap();
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
