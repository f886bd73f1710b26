//! Streams: grasps that get better, and several hands in one scene.

use graspd_client::{GraspEvent, HandTask, MultiHandEvent, PlanMultiHandRequest, PlanOptions};
use graspd_proto::v1;
use graspd_tests::{BoxScene, TestServer};

use crate::{GRIPPER, request};

#[tokio::test]
async fn a_stream_is_accepted_improves_and_finishes_like_the_unary_call() {
    let server = TestServer::start().await;
    let client = server.client().await;
    let unary = client.plan_grasps(&request(GRIPPER)).await.unwrap();
    let mut stream = client.stream_grasps(&request(GRIPPER)).await.unwrap();
    let mut events = Vec::new();
    while let Some(event) = stream.next().await.unwrap() {
        events.push(event);
    }
    assert!(matches!(events.first(), Some(GraspEvent::Accepted { queue_position: 0 })), "{events:?}");
    let improved = &events[1..events.len() - 1];
    assert!(improved.iter().all(|e| matches!(e, GraspEvent::Improved(r) if !r.grasps.is_empty())));
    let Some(GraspEvent::Finished(finished)) = events.last() else { panic!("expected an end: {events:?}") };
    assert!(!finished.grasps.is_empty());
    assert_eq!(finished.grasps, unary.grasps);
}

#[tokio::test]
async fn several_hands_share_one_scene_and_a_summary_comes_last() {
    let server = TestServer::start().await;
    let client = server.client().await;
    let task = |task_id: &str, hand: &str| HandTask {
        task_id: task_id.to_owned(),
        hand: format!("hands/{hand}"),
        options: Some(PlanOptions { seed: 3, ..PlanOptions::default() }),
    };
    let plan = PlanMultiHandRequest {
        frames: vec![BoxScene::default().frame()],
        tasks: vec![task("left", GRIPPER), task("right", "leap"), task("third", GRIPPER)],
        ..PlanMultiHandRequest::default()
    };
    let mut stream = client.plan_multi_hand(&plan).await.unwrap();
    let (mut results, mut summary) = (Vec::new(), None);
    while let Some(event) = stream.next().await.unwrap() {
        assert!(summary.is_none(), "the summary comes last");
        match event {
            MultiHandEvent::Result(result) => results.push(*result),
            MultiHandEvent::Summary(s) => summary = Some(s),
        }
    }
    results.sort_by(|a, b| a.task_id.cmp(&b.task_id));
    let responses: Vec<_> = results
        .iter()
        .map(|r| match &r.outcome {
            Some(v1::hand_task_result::Outcome::Response(response)) => response,
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(results.iter().map(|r| r.task_id.as_str()).collect::<Vec<_>>(), ["left", "right", "third"]);
    assert!(!responses[0].grasps.is_empty());
    assert_eq!(responses[0].grasps, responses[2].grasps, "same hand, same seed, same scene");
    assert_ne!(responses[0].grasps[0].wrist_link, "");
    // The scene was read once: its stages took the same time for every hand to the nanosecond.
    let scene_stages = |r: &v1::PlanGraspsResponse| {
        let stages = r.stats.clone().unwrap().stages;
        stages.into_iter().take_while(|s| s.name != "initialize").take(4).collect::<Vec<_>>()
    };
    assert!(scene_stages(responses[0]).len() >= 4);
    assert_eq!(scene_stages(responses[0]), scene_stages(responses[1]));
    let summary = summary.unwrap();
    assert_eq!(summary.with_grasp_count + summary.without_grasp_count, 3);
    assert_eq!(summary.failed_count, 0);
}

/// A plan for two tasks with one hand, and an arm for each.
fn two_arms(arms: [v1::AssignmentArm; 2]) -> PlanMultiHandRequest {
    let task = |task_id: &str| HandTask {
        task_id: task_id.to_owned(),
        hand: format!("hands/{GRIPPER}"),
        options: Some(PlanOptions { seed: 3, ..PlanOptions::default() }),
    };
    PlanMultiHandRequest {
        frames: vec![BoxScene::default().frame()],
        tasks: vec![task("left"), task("right")],
        assignment: Some(v1::AssignmentRequest { arms: arms.into(), ..Default::default() }),
        ..PlanMultiHandRequest::default()
    }
}

/// An arm that is looked at as a hand alone.
fn hand_only(task_id: &str) -> v1::AssignmentArm {
    v1::AssignmentArm { task_id: task_id.to_owned(), arm_radius_m: Some(0.0), ..Default::default() }
}

async fn assignment(server: &TestServer, plan: &PlanMultiHandRequest) -> (Vec<v1::Grasp>, v1::Assignment) {
    let client = server.client().await;
    let mut stream = client.plan_multi_hand(plan).await.unwrap();
    let mut left = Vec::new();
    loop {
        match stream.next().await.unwrap().expect("a summary") {
            MultiHandEvent::Result(result) if result.task_id == "left" => {
                let Some(v1::hand_task_result::Outcome::Response(response)) = result.outcome else {
                    panic!()
                };
                left = response.grasps;
            }
            MultiHandEvent::Result(_) => {}
            MultiHandEvent::Summary(summary) => return (left, summary.assignment.expect("an assignment")),
        }
    }
}

#[tokio::test]
async fn one_object_goes_to_one_arm_and_the_other_hears_why() {
    let server = TestServer::start().await;
    let plan = two_arms([hand_only("left"), hand_only("right")]);
    let (grasps, found) = assignment(&server, &plan).await;
    assert!(found.optimal && found.value == found.bound, "{found:?}");
    let [left, right] = &found.decisions[..] else { panic!("{found:?}") };
    let taken = [left, right].map(|d| d.grasp_index.is_some());
    assert!(taken == [true, false] || taken == [false, true], "one box: {found:?}");
    let (with, without) = if taken[0] { (left, right) } else { (right, left) };
    let index = with.grasp_index.unwrap() as usize;
    // Both plan the same, so the answer of one tells of both.
    assert!((grasps[index].score - with.score).abs() < 1e-12, "{with:?}");
    assert!((with.score * with.size * with.reach - with.value).abs() < 1e-12);
    assert!(without.reason.contains(&with.task_id), "{}", without.reason);
}

#[tokio::test]
async fn the_arm_that_reaches_takes_it() {
    let server = TestServer::start().await;
    let identity = v1::Pose {
        position: Some(v1::Vector3 { x: 50.0, y: 0.0, z: 0.0 }),
        orientation: Some(v1::Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }),
    };
    let far = v1::AssignmentArm {
        base_pose: Some(identity),
        reach: Some(v1::assignment_arm::Reach::ReachShell(v1::ReachShell {
            min_radius_m: 0.1,
            max_radius_m: 0.5,
        })),
        ..hand_only("left")
    };
    let (grasps, found) = assignment(&server, &two_arms([far, hand_only("right")])).await;
    assert_eq!(found.decisions[0].grasp_index, None);
    assert_eq!(found.decisions[0].rejected_counts["out_of_reach"] as usize, grasps.len());
    assert!(found.decisions[0].reason.contains("from the arm, expected 0.1 to 0.5"), "{found:?}");
    assert!(found.decisions[1].grasp_index.is_some(), "{found:?}");
}

#[tokio::test]
async fn an_assignment_that_makes_no_sense_is_refused_by_field() {
    let server = TestServer::start().await;
    let client = server.client().await;
    let shell = |min_radius_m, max_radius_m| {
        Some(v1::assignment_arm::Reach::ReachShell(v1::ReachShell { min_radius_m, max_radius_m }))
    };
    for (arm, field) in [
        (hand_only("nobody"), "assignment.arms[0].task_id"),
        (hand_only("right"), "assignment.arms[1].task_id"),
        (v1::AssignmentArm { arm_radius_m: None, ..hand_only("left") }, "assignment.arms[0].base_pose"),
        (v1::AssignmentArm { reach: shell(0.1, 0.5), ..hand_only("left") }, "assignment.arms[0].base_pose"),
        (
            v1::AssignmentArm { hand_radius_m: Some(0.0), ..hand_only("left") },
            "assignment.arms[0].hand_radius_m",
        ),
        (v1::AssignmentArm { lift_m: Some(f64::NAN), ..hand_only("left") }, "assignment.arms[0].lift_m"),
    ] {
        let error = match client.plan_multi_hand(&two_arms([arm, hand_only("right")])).await {
            Ok(_) => panic!("{field} is accepted"),
            Err(error) => error,
        };
        let call = error.call().expect("an answer of the server");
        assert_eq!(call.violations.first().map(|v| v.field.as_str()), Some(field));
    }
}
