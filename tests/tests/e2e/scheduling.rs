//! Who is served when there is more to do than time: priorities, servo room, refusals, shared frames, repeated calls.

use std::time::{Duration, Instant};

use graspd_client::{Client, Code, PlanGraspsRequest, PlanOptions};
use graspd_proto::v1;
use graspd_server::ServerConfig;
use graspd_server::pool::PoolConfig;
use graspd_tests::{STALLS, TestServer};
use tokio::task::JoinHandle;

use crate::{GRIPPER, call_error, request, request_with};

/// A server with one slot, so that what waits and what runs is known.
async fn narrow(servo_slots: usize) -> TestServer {
    let pool =
        PoolConfig { threads: 1, slots: 1, servo_slots, queue: 4, scene_room: 8, nice: 0, plain_fifo: false };
    TestServer::start_with(ServerConfig { pool, ..TestServer::config() }).await
}

/// Keeps the only slot of the server busy.
async fn occupy(server: &TestServer, client: &Client) -> JoinHandle<()> {
    let client = client.clone();
    let busy = tokio::spawn(async move {
        client.plan_grasps(&request_with(STALLS)).await.ok();
    });
    server.busy().await;
    busy
}

fn with(priority: v1::Priority, plan: PlanGraspsRequest) -> PlanGraspsRequest {
    let options = plan.options.clone().unwrap_or_default();
    PlanGraspsRequest { options: Some(PlanOptions { priority: priority.into(), ..options }), ..plan }
}

#[tokio::test]
async fn a_servo_call_is_answered_while_every_other_slot_is_busy() {
    let server = narrow(1).await;
    let client = server.client().await;
    let busy = occupy(&server, &client).await;
    let answer = client.plan_grasps(&with(v1::Priority::Servo, request(GRIPPER))).await.unwrap();
    assert!(!answer.grasps.is_empty());
    assert!(!busy.is_finished());
    busy.abort();
}

#[tokio::test]
async fn a_call_that_expires_while_it_waits_is_answered_at_that_moment() {
    let server = narrow(0).await;
    let client = server.client().await;
    let busy = occupy(&server, &client).await;
    let deadline = Duration::from_millis(600);
    let began = Instant::now();
    let error = call_error(client.with_timeout(deadline).plan_grasps(&request(GRIPPER)).await);
    let took = began.elapsed();
    assert_eq!((error.code, error.reason.as_str()), (Code::DeadlineExceeded, "DEADLINE_EXCEEDED"));
    assert_eq!(error.metadata["stage"], "in the queue");
    assert!(took > deadline / 2 && took < deadline + Duration::from_millis(100), "{took:?}");
    assert_eq!(server.load.waiting(), 0);
    busy.abort();
}

#[tokio::test]
async fn a_call_that_cannot_finish_is_refused_at_once() {
    let server = narrow(0).await;
    let client = server.client().await;
    // How long this machine takes is learned from a call that was answered.
    let long = v1::Scheme { iteration_count: 3000, penetration_iteration_count: 3000 };
    let mut plan = request(GRIPPER);
    plan.options = Some(PlanOptions { scheme: Some(long), require_complete: true, ..PlanOptions::default() });
    let began = Instant::now();
    client.plan_grasps(&plan).await.unwrap();
    let whole = began.elapsed();
    let began = Instant::now();
    let error = call_error(client.with_timeout(whole / 4).plan_grasps(&plan).await);
    let took = began.elapsed();
    assert_eq!((error.code, error.reason.as_str()), (Code::ResourceExhausted, "CANNOT_FINISH"), "{error:?}");
    assert!(error.retry_after.is_some_and(|d| !d.is_zero()));
    assert!(took < whole / 8, "refused after {took:?}, planning takes {whole:?}");
    // Who takes the best so far is served.
    plan.options.as_mut().unwrap().require_complete = false;
    // On a machine with other things to do an answer may come after the deadline that it was meant for.
    let mut answered = Err(String::new());
    for _ in 0..5 {
        answered = match client.with_timeout(whole / 2).plan_grasps(&plan).await {
            Ok(answer) => Ok(answer),
            Err(error) => {
                let error = call_error(Err::<v1::PlanGraspsResponse, _>(error));
                assert_eq!(error.code, Code::DeadlineExceeded, "{error:?}");
                Err(format!("{error:?}"))
            }
        };
        if answered.is_ok() {
            break;
        }
    }
    assert!(answered.unwrap().stats.unwrap().budget_exhausted);
}

#[tokio::test]
async fn less_than_the_whole_is_an_error_for_those_who_say_so() {
    let server = narrow(0).await;
    let mut plan = request(GRIPPER);
    let endless = v1::Scheme { iteration_count: 10_000, penetration_iteration_count: 10_000 };
    let options = PlanOptions {
        batch_size: 512,
        scheme: Some(endless),
        require_complete: true,
        budget: Some("0.5s".parse().unwrap()),
        ..PlanOptions::default()
    };
    plan.options = Some(options);
    let error = call_error(server.client().await.plan_grasps(&plan).await);
    assert_eq!(error.code, Code::DeadlineExceeded);
}

#[tokio::test]
async fn the_more_urgent_call_is_served_first_and_takes_the_place_of_a_lesser_one() {
    let server = narrow(0).await;
    let client = server.client().await;
    let busy = occupy(&server, &client).await;
    let send = |priority| {
        let client = client.clone();
        tokio::spawn(async move { client.plan_grasps(&with(priority, request(GRIPPER))).await })
    };
    let mut low = Vec::new();
    for waiting in 1..=4 {
        low.push(send(v1::Priority::Low));
        while server.load.waiting() < waiting {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }
    let high = send(v1::Priority::High);
    while low.iter().all(|call| !call.is_finished()) {
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    assert_eq!(server.load.waiting(), 4);
    busy.abort();
    let high = high.await.unwrap().unwrap().stats.unwrap();
    assert!(!high.rejected_counts.is_empty() || high.candidate_count > 0);
    let mut shed = 0;
    for call in low {
        if let Err(error) = call.await.unwrap() {
            let error = call_error::<()>(Err(error));
            assert_eq!((error.code, error.reason.as_str()), (Code::ResourceExhausted, "SHED"));
            assert!(error.retry_after.is_some());
            shed += 1;
        }
    }
    assert_eq!(shed, 1);
}

#[tokio::test]
async fn callers_with_the_same_frame_share_one_scene() {
    let server = narrow(0).await;
    let client = server.client().await;
    let busy = occupy(&server, &client).await;
    let mut calls = Vec::new();
    for hand in [GRIPPER, "leap", GRIPPER] {
        // Connections of their own.
        let client = server.client().await;
        calls.push(tokio::spawn(async move { client.plan_grasps(&request(hand)).await }));
    }
    while server.load.waiting() < 3 {
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    let before = server.load.scenes_read();
    busy.abort();
    let mut answers = Vec::new();
    for call in calls {
        answers.push(call.await.unwrap().unwrap());
    }
    assert_eq!(server.load.scenes_read() - before, 1);
    assert_eq!(answers[0].grasps, answers[2].grasps);
    assert_ne!(answers[0].stats.as_ref().unwrap().hand, answers[1].stats.as_ref().unwrap().hand);
}

#[tokio::test]
async fn a_repeated_request_id_is_the_same_call() {
    let server = TestServer::start().await;
    let client = server.client().await;
    let plan = PlanGraspsRequest { request_id: "7f3d".to_owned(), ..request(GRIPPER) };
    let (first, second) = tokio::join!(client.plan_grasps(&plan), client.plan_grasps(&plan));
    let first = first.unwrap();
    assert_eq!(first, second.unwrap(), "the very same answer, its timings included");
    assert_eq!(first, client.plan_grasps(&plan).await.unwrap());
    assert_eq!(server.load.scenes_read(), 1);
    let mut stream = client.stream_grasps(&plan).await.unwrap();
    let mut finished = None;
    while let Some(event) = stream.next().await.unwrap() {
        if let graspd_client::GraspEvent::Finished(answer) = event {
            finished = Some(answer);
        }
    }
    assert_eq!(finished.unwrap(), first);
    let other = PlanGraspsRequest { hand: "hands/leap".to_owned(), ..plan.clone() };
    let error = call_error(client.plan_grasps(&other).await);
    assert_eq!((error.code, error.reason.as_str()), (Code::InvalidArgument, "REQUEST_ID_REUSED"));
    // The connection was lost: the same caller comes back on another one.
    let again = server.client().await;
    assert_eq!(first, again.plan_grasps(&plan).await.unwrap());
    let long = PlanGraspsRequest { request_id: "x".repeat(129), ..plan };
    assert_eq!(call_error(client.plan_grasps(&long).await).violations[0].field, "request_id");
}

#[tokio::test]
async fn a_quick_hand_does_not_wait_for_a_slow_one_of_its_call() {
    let server = narrow(0).await;
    let client = server.client().await;
    let task = |id: &str, batch_size, iterations| v1::HandTask {
        task_id: id.to_owned(),
        hand: format!("hands/{GRIPPER}"),
        options: Some(PlanOptions {
            batch_size,
            scheme: Some(v1::Scheme { iteration_count: iterations, penetration_iteration_count: 10 }),
            ..PlanOptions::default()
        }),
    };
    let plan = v1::PlanMultiHandRequest {
        frames: request(GRIPPER).frames,
        tasks: vec![task("slow", 64, 600), task("middle", 32, 60), task("quick", 8, 10)],
        ..v1::PlanMultiHandRequest::default()
    };
    // By what is asked, and then by what the server has learned.
    for _ in 0..2 {
        let mut stream = client.plan_multi_hand(&plan).await.unwrap();
        let mut order = Vec::new();
        while let Some(event) = stream.next().await.unwrap() {
            if let graspd_client::MultiHandEvent::Result(result) = event {
                order.push(result.task_id);
            }
        }
        assert_eq!(order, ["quick", "middle", "slow"]);
    }
}
