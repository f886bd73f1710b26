//! Deadlines, budgets, cancellation and a full queue.

use std::time::{Duration, Instant};

use graspd_client::{Code, GraspEvent, PlanGraspsRequest, PlanMultiHandRequest, PlanOptions, RetryPolicy};
use graspd_proto::v1;
use graspd_server::ServerConfig;
use graspd_server::pool::PoolConfig;
use graspd_tests::{STALLS, TestServer};

use crate::{GRIPPER, call_error, request, request_with};

/// Time in which a cancelled job has to be gone: it takes an iteration, the rest is for a loaded machine. Far less
/// than the jobs would run if nobody stopped them.
const SOON: Duration = Duration::from_secs(10);

fn stalled_tasks() -> PlanMultiHandRequest {
    let plan = request_with(STALLS);
    let task = |id: &str| v1::HandTask { task_id: id.to_owned(), hand: plan.hand.clone(), options: None };
    PlanMultiHandRequest {
        tasks: vec![task("left"), task("right")],
        frames: plan.frames.clone(),
        scene_options: plan.scene_options.clone(),
        ..PlanMultiHandRequest::default()
    }
}

#[tokio::test]
async fn a_deadline_with_nothing_to_answer_is_deadline_exceeded() {
    let server = TestServer::start().await;
    let client = server.client().await.with_timeout(Duration::from_millis(1500));
    let error = call_error(client.plan_grasps(&request_with(STALLS)).await);
    assert_eq!((error.code, error.reason.as_str()), (Code::DeadlineExceeded, "DEADLINE_EXCEEDED"));
    assert!(error.metadata.contains_key("elapsed_ms"), "the server's own answer, not the client's timer");
    server.idle_within(SOON).await;
}

#[tokio::test]
async fn a_stream_ends_at_its_deadline_too() {
    let server = TestServer::start().await;
    let client = server.client().await.with_timeout(Duration::from_millis(1500));
    let mut stream = client.stream_grasps(&request_with(STALLS)).await.unwrap();
    assert!(matches!(stream.next().await.unwrap(), Some(GraspEvent::Accepted { queue_position: 0 })));
    let error = call_error(stream.next().await);
    assert_eq!(error.code, Code::DeadlineExceeded);
    server.idle_within(SOON).await;

    let mut results = client.plan_multi_hand(&stalled_tasks()).await.unwrap();
    let mut codes = Vec::new();
    while let Ok(Some(event)) = results.next().await {
        if let graspd_client::MultiHandEvent::Result(result) = event {
            let Some(v1::hand_task_result::Outcome::Error(error)) = result.outcome else {
                panic!("expected an error, found {result:?}");
            };
            codes.push(error.code);
        }
    }
    assert_eq!(codes, [Code::DeadlineExceeded as i32; 2]);
}

#[tokio::test]
async fn a_budget_that_ends_is_an_answer() {
    let server = TestServer::start().await;
    let client = server.client().await;
    let mut plan = request_with(STALLS);
    plan.options = Some(PlanOptions { budget: Some("0.15s".parse().unwrap()), ..PlanOptions::default() });
    let began = Instant::now();
    let answer = client.plan_grasps(&plan).await.unwrap();
    assert!(began.elapsed() >= Duration::from_millis(150));
    assert!(answer.stats.unwrap().budget_exhausted);
    assert_eq!(answer.no_grasp.unwrap().reason(), v1::NoGraspReason::OutOfTime);
}

#[tokio::test]
async fn dropping_a_call_frees_its_cores() {
    let server = TestServer::start().await;
    let client = server.client().await;
    let unary = {
        let client = client.clone();
        tokio::spawn(async move { client.plan_grasps(&request_with(STALLS)).await })
    };
    server.busy().await;
    unary.abort();
    server.idle_within(SOON).await;

    let mut stream = client.stream_grasps(&request_with(STALLS)).await.unwrap();
    assert!(matches!(stream.next().await.unwrap(), Some(GraspEvent::Accepted { .. })));
    server.busy().await;
    drop(stream);
    server.idle_within(SOON).await;

    let multi = {
        let client = client.clone();
        tokio::spawn(async move { client.plan_multi_hand(&stalled_tasks()).await.map(drop) })
    };
    server.busy().await;
    multi.abort();
    server.idle_within(SOON).await;
}

#[tokio::test]
async fn a_full_queue_refuses_at_once_and_a_patient_client_gets_through() {
    let config = ServerConfig {
        pool: PoolConfig {
            threads: 1,
            slots: 1,
            servo_slots: 0,
            queue: 0,
            scene_room: 1,
            nice: 0,
            plain_fifo: false,
        },
        ..TestServer::config()
    };
    let server = TestServer::start_with(config).await;
    let client = server.client().await;
    let occupying = {
        let client = client.clone();
        tokio::spawn(async move { client.plan_grasps(&request_with(STALLS)).await })
    };
    server.busy().await;
    let error = call_error(client.plan_grasps(&request(GRIPPER)).await);
    assert_eq!((error.code, error.reason.as_str()), (Code::ResourceExhausted, "QUEUE_FULL"));
    assert!(error.retry_after.is_some_and(|d| !d.is_zero()), "{error:?}");

    let patient = client.with_retry(RetryPolicy { attempts: 200, ..RetryPolicy::default() });
    let waiting = tokio::spawn(async move { patient.plan_grasps(&request(GRIPPER)).await });
    tokio::time::sleep(Duration::from_millis(300)).await;
    assert!(!waiting.is_finished());
    occupying.abort();
    let answer = waiting.await.unwrap().unwrap();
    assert_eq!(answer.stats.unwrap().hand, format!("hands/{GRIPPER}"));
}

/// More work than any of these tests waits for on two threads.
fn endless() -> PlanGraspsRequest {
    let options = PlanOptions {
        batch_size: 512,
        scheme: Some(v1::Scheme { iteration_count: 10_000, penetration_iteration_count: 10_000 }),
        seed: 1,
        ..PlanOptions::default()
    };
    PlanGraspsRequest { options: Some(options), ..request(GRIPPER) }
}

#[tokio::test]
async fn a_short_budget_gives_the_best_so_far() {
    let server = TestServer::start().await;
    let client = server.client().await;
    let mut plan = endless();
    plan.options.as_mut().unwrap().budget = Some("2.5s".parse().unwrap());
    let began = Instant::now();
    let answer = client.plan_grasps(&plan).await.unwrap();
    let took = began.elapsed();
    let stats = answer.stats.unwrap();
    assert!(stats.budget_exhausted);
    assert!(stats.iteration_count > 0 && stats.iteration_count < 10_000, "{}", stats.iteration_count);
    assert!(!answer.grasps.is_empty(), "{:?} {:?}", answer.no_grasp, stats.rejected_counts);
    assert!(took >= Duration::from_secs(2), "the budget is used: {took:?}");
}

#[tokio::test]
async fn a_deadline_gives_the_best_so_far_in_time() {
    let server = TestServer::start().await;
    let deadline = Duration::from_secs(3);
    let client = server.client().await.with_timeout(deadline);
    let began = Instant::now();
    let answer = client.plan_grasps(&endless()).await.unwrap();
    assert!(began.elapsed() < deadline, "{:?}", began.elapsed());
    assert!(answer.stats.unwrap().budget_exhausted);
    assert!(!answer.grasps.is_empty());
}

#[tokio::test]
async fn dropping_a_call_in_the_middle_of_an_optimization_frees_its_cores() {
    let server = TestServer::start().await;
    let client = server.client().await;
    let unary = tokio::spawn(async move { client.plan_grasps(&endless()).await });
    server.busy().await;
    tokio::time::sleep(Duration::from_millis(1500)).await;
    assert!(server.load.running() == 1 && !unary.is_finished());
    unary.abort();
    let took = server.idle_within(SOON).await;
    println!("idle {took:?} after the call was dropped");
}
