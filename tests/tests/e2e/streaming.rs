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
