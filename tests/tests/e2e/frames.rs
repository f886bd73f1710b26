//! Several frames of one scene: fused where their cameras are known, refused where one is not.

use graspd_client::PlanGraspsRequest;
use graspd_tests::{BoxScene, TestServer};
use nalgebra::{Isometry3, Point3, Vector3};

use crate::{GRIPPER, call_error, request};

/// The box seen from another side: the camera turned about the world's z axis through the box.
fn from_the_other_side(scene: &BoxScene) -> BoxScene {
    let center = scene.box_center.unwrap_or_else(Point3::origin);
    let about = Isometry3::rotation_wrt_point(
        nalgebra::UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI),
        center,
    );
    BoxScene { world_from_camera: about * scene.world_from_camera, ..scene.clone() }
}

#[tokio::test]
async fn two_views_are_fused_in_the_frame_of_the_world() {
    let server = TestServer::start().await;
    let client = server.client().await;
    let scene = BoxScene::default();
    let plan = PlanGraspsRequest {
        frames: vec![scene.frame(), from_the_other_side(&scene).frame()],
        ..request(GRIPPER)
    };
    let answer = client.plan_grasps(&plan).await.unwrap();
    assert!(!answer.grasps.is_empty(), "{:?} {:?}", answer.no_grasp, answer.stats);
    let center = scene.box_center.unwrap();
    for grasp in &answer.grasps {
        let c = grasp.centroid.unwrap();
        let off = (Point3::new(c.x, c.y, c.z) - center).norm();
        assert!(off < 0.03, "a centroid {off} m from the middle of the box");
    }
    // What the first view alone had to guess, the second has seen: the answers differ.
    let single = client.plan_grasps(&request(GRIPPER)).await.unwrap();
    assert_ne!(single.grasps, answer.grasps);
}

#[tokio::test]
async fn of_several_frames_every_one_needs_a_pose() {
    let server = TestServer::start().await;
    let client = server.client().await;
    let scene = BoxScene::default();
    let plan =
        PlanGraspsRequest { frames: vec![scene.frame(), scene.frame_without_pose()], ..request(GRIPPER) };
    let error = call_error(client.plan_grasps(&plan).await);
    assert_eq!(error.code, graspd_client::Code::InvalidArgument, "{error:?}");
    assert!(error.violations.iter().any(|v| v.field == "frames[1].camera_pose"), "{error:?}");
}
