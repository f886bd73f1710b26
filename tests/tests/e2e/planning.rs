//! Planning in a known scene: a box on a table.

use std::time::SystemTime;

use graspd_client::{DepthFrame, Grasp, PlanGraspsRequest, PlanOptions, SceneOptions};
use graspd_proto::v1;
use graspd_tests::{BOX_HALF_M, BoxScene, SCENE_FRAME, TestServer};
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};

use crate::{GRIPPER, request};

fn isometry(pose: &v1::PoseInFrame) -> Isometry3<f64> {
    let pose = pose.pose.unwrap();
    let (p, q) = (pose.position.unwrap(), pose.orientation.unwrap());
    let q = Quaternion::new(q.w, q.x, q.y, q.z);
    assert!((q.norm() - 1.0).abs() < 1e-9);
    Isometry3::from_parts(Translation3::new(p.x, p.y, p.z), UnitQuaternion::from_quaternion(q))
}

fn point(v: &Option<v1::Vector3>) -> Point3<f64> {
    let v = v.unwrap();
    Point3::new(v.x, v.y, v.z)
}

/// Distance of a point from the surface of the box.
fn distance_to_box(scene: &BoxScene, p: Point3<f64>) -> f64 {
    let beyond = (p - scene.box_center.unwrap()).abs() - BOX_HALF_M;
    let outside = beyond.sup(&Vector3::zeros()).norm();
    if outside > 0.0 { outside } else { -beyond.max() }
}

fn check(grasp: &Grasp, scene: &BoxScene, world: &str, camera: &str) {
    let wrist = grasp.wrist_pose.clone().unwrap();
    let in_camera = grasp.wrist_pose_in_camera.clone().unwrap();
    assert_eq!((wrist.frame_id.as_str(), in_camera.frame_id.as_str()), (world, camera));
    assert!((0.0..=1.0).contains(&grasp.score), "{}", grasp.score);
    assert!(grasp.epsilon > 0.0);
    assert!(grasp.contacts.len() >= 2);
    for postures in [grasp.joints.as_ref().unwrap(), grasp.actuators.as_ref().unwrap()] {
        let count = postures.names.len();
        assert!(count > 0);
        assert_eq!([postures.open.len(), postures.contact.len(), postures.squeezed.len()], [count; 3]);
    }
    if world == SCENE_FRAME {
        let again = scene.world_from_camera * isometry(&in_camera);
        assert!((again.translation.vector - isometry(&wrist).translation.vector).norm() < 1e-6);
        let pregrasp = scene.world_from_camera * isometry(grasp.pregrasp_pose_in_camera.as_ref().unwrap());
        let world_pregrasp = isometry(grasp.pregrasp_pose.as_ref().unwrap());
        assert!((pregrasp.translation.vector - world_pregrasp.translation.vector).norm() < 1e-6);
        for contact in &grasp.contacts {
            let off = distance_to_box(scene, point(&contact.point));
            assert!(off < 0.015, "a contact {off} m off the box");
            assert!(!contact.pad.is_empty() && !contact.finger.is_empty() && !contact.link.is_empty());
        }
        assert!(distance_to_box(scene, point(&grasp.centroid)) < 0.03);
    }
}

#[tokio::test]
async fn a_box_on_a_table_is_grasped_and_the_answer_explains_itself() {
    let server = TestServer::start().await;
    let client = server.client().await;
    let scene = BoxScene::default();
    let answer = client.plan_grasps(&request(GRIPPER)).await.unwrap();
    assert!(!answer.grasps.is_empty(), "{:?} {:?}", answer.no_grasp, answer.stats);
    assert_eq!(answer.no_grasp, None);
    assert!(answer.grasps.is_sorted_by(|a, b| a.score >= b.score));
    for grasp in &answer.grasps {
        check(grasp, &scene, SCENE_FRAME, "eye");
        assert!(grasp.jaw_width_m.is_some_and(|w| w > 0.02 && w < 0.09), "{:?}", grasp.jaw_width_m);
    }
    let workspace = answer.workspace.unwrap();
    assert_eq!(workspace.pose.as_ref().unwrap().frame_id, SCENE_FRAME);
    let table =
        isometry(workspace.pose.as_ref().unwrap()) * Point3::new(0.2, 0.2, workspace.table_height_m.unwrap());
    assert!(table.z.abs() < 0.01, "the table is at z = 0, found {}", table.z);
    let stats = answer.stats.unwrap();
    assert!(stats.focal_contact_count > 0 && stats.centered_centroid_count > 0 && stats.candidate_count > 0);
    assert_eq!((stats.estimator.as_str(), stats.seed), ("geometric", 1));
    assert_eq!(stats.stages[0].name, "decode");
    assert!(!stats.hand_revision.is_empty() && !stats.budget_exhausted);
    let again = client.plan_grasps(&request(GRIPPER)).await.unwrap();
    assert_eq!(again.grasps, answer.grasps, "same seed, same answer");
}

#[tokio::test]
async fn nothing_but_a_frame_and_a_lens_is_enough() {
    let server = TestServer::start().await;
    let client = server.client().await;
    let scene = BoxScene::default();
    let taken = SystemTime::now().into();
    let plan = PlanGraspsRequest {
        hand: format!("hands/{GRIPPER}"),
        frames: vec![DepthFrame { capture_time: Some(taken), ..scene.frame_without_pose() }],
        ..PlanGraspsRequest::default()
    };
    let answer = client.plan_grasps(&plan).await.unwrap();
    assert_eq!(answer.capture_time, Some(taken));
    assert!(!answer.grasps.is_empty(), "{:?} {:?}", answer.no_grasp, answer.stats);
    for grasp in &answer.grasps {
        check(grasp, &scene, "camera", "camera");
        assert_eq!(grasp.wrist_pose, grasp.wrist_pose_in_camera);
    }
}

#[tokio::test]
async fn what_is_asked_for_is_kept_to() {
    let server = TestServer::start().await;
    let client = server.client().await;
    let scene = BoxScene::default();
    let mut frame = scene.frame();
    frame.labels =
        Some(v1::LabelImage { encoding: v1::LabelEncoding::RawU8.into(), data: scene.labels().into() });
    let options = PlanOptions {
        max_grasp_count: 2,
        trace: true,
        target: Some(v1::plan_options::Target::TargetLabel(1)),
        scheme: Some(v1::Scheme { iteration_count: 60, penetration_iteration_count: 60 }),
        ..PlanOptions::default()
    };
    let plan = |options: PlanOptions| PlanGraspsRequest {
        frames: vec![frame.clone()],
        options: Some(options),
        ..request(GRIPPER)
    };
    let answer = client.plan_grasps(&plan(options.clone())).await.unwrap();
    assert!((1..=2).contains(&answer.grasps.len()), "{:?} {:?}", answer.no_grasp, answer.stats);
    assert!(answer.grasps.iter().all(|g| g.label == Some(1)));
    assert_eq!(answer.trace.len(), 60);
    let elsewhere = PlanOptions { target: Some(v1::plan_options::Target::TargetLabel(7)), ..options };
    let answer = client.plan_grasps(&plan(elsewhere)).await.unwrap();
    assert!(answer.grasps.is_empty());
    assert_eq!(answer.no_grasp.unwrap().reason(), v1::NoGraspReason::TargetNotFound);
}

#[tokio::test]
async fn an_empty_table_is_an_answer() {
    let server = TestServer::start().await;
    let client = server.client().await;
    let plan = PlanGraspsRequest { frames: vec![BoxScene::empty().frame()], ..request(GRIPPER) };
    let answer = client.plan_grasps(&plan).await.unwrap();
    assert!(answer.grasps.is_empty());
    let no_grasp = answer.no_grasp.unwrap();
    assert_eq!(no_grasp.reason(), v1::NoGraspReason::EmptyTable);
    assert!(!no_grasp.nearest_fix.is_empty());
}

#[tokio::test]
async fn several_frames_and_a_placed_workspace_are_read_as_told() {
    let server = TestServer::start().await;
    let client = server.client().await;
    let scene = BoxScene::default();
    let identity = v1::Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 };
    let corner = v1::Vector3 { x: -0.2, y: -0.2, z: -0.05 };
    let scene_options = SceneOptions {
        volume_kind: v1::VolumeKind::Occupancy.into(),
        workspace: Some(v1::WorkspacePlacement {
            pose: Some(v1::Pose { position: Some(corner), orientation: Some(identity) }),
            table_height_m: Some(0.05),
        }),
        ..SceneOptions::default()
    };
    // In an occupancy volume what no camera saw is solid: the way in is the way the camera looked.
    let options = PlanOptions { reaching: v1::Reaching::CameraRay.into(), ..PlanOptions::default() };
    let plan = PlanGraspsRequest {
        frames: vec![scene.frame(), scene.frame()],
        scene_options: Some(scene_options),
        options: Some(options),
        ..request(GRIPPER)
    };
    let answer = client.plan_grasps(&plan).await.unwrap();
    let workspace = answer.workspace.unwrap();
    assert_eq!(workspace.table_height_m, Some(0.05));
    assert_eq!((workspace.size_m, workspace.resolution), (0.4, 80));
    let pose = isometry(workspace.pose.as_ref().unwrap());
    assert!((pose.translation.vector - Vector3::new(-0.2, -0.2, -0.05)).norm() < 1e-12);
    assert!(!answer.grasps.is_empty(), "{:?}", answer.no_grasp);
}
