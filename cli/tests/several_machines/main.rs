//! Fronts, workers and a NATS broker as processes: workers that are killed, a broker that is, a cable that is pulled,
//! hands that are known everywhere, and full queues.
#![cfg(feature = "nats")]
#![allow(clippy::unwrap_used, reason = "helpers of tests are not in test functions")]

mod fronts;
mod installation;
mod leases;
mod namespaces;

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use graspd_client::wire::Scheme;
use graspd_client::{
    CallError, Client, ClientError, Code, GraspEvent, HandTask, MultiHandEvent, PlanGraspsRequest,
    PlanMultiHandRequest, PlanOptions, SceneOptions,
};
use graspd_tests::BoxScene;
use installation::{Cable, Installation, eventually};

const GRIPPER: &str = "robotiq-2f85";

/// A search over so many candidates and iterations in the box scene.
fn search(batch_size: i32, iteration_count: i32) -> PlanGraspsRequest {
    let scheme = Some(Scheme { iteration_count, penetration_iteration_count: 2 });
    PlanGraspsRequest {
        hand: format!("hands/{GRIPPER}"),
        frames: vec![BoxScene::default().frame()],
        scene_options: Some(SceneOptions { volume_resolution: 40, ..SceneOptions::default() }),
        options: Some(PlanOptions { seed: 1, batch_size, scheme, ..PlanOptions::default() }),
        ..PlanGraspsRequest::default()
    }
}

/// Some milliseconds.
fn small() -> PlanGraspsRequest {
    search(4, 4)
}

/// Longer than any test, but for its budget.
fn slow() -> PlanGraspsRequest {
    let mut request = search(4096, 10_000);
    request.options.as_mut().unwrap().budget = Some("3s".parse().unwrap());
    request
}

fn error<T: std::fmt::Debug>(result: Result<T, ClientError>) -> CallError {
    match result {
        Err(ClientError::Call(error)) => error,
        other => panic!("expected the call to fail, found {other:?}"),
    }
}

/// Numbers that look random, the same in every run.
struct Dice(u64);

impl Dice {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % limit
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_call_is_answered_once_while_workers_are_killed() {
    const JOBS: usize = 200;
    let Some(installation) = Installation::start("kills") else { return };
    let mut workers: Vec<_> = (0..3).map(|_| installation.worker()).collect();
    let front = installation.front(&[]);
    workers.iter_mut().for_each(|worker| drop(worker.wait_for("working")));
    let client = front.client().await;
    let (next, answered) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicUsize::new(0)));
    let callers: Vec<_> = (0..6)
        .map(|_| {
            let (client, next, answered) = (client.clone(), Arc::clone(&next), Arc::clone(&answered));
            tokio::spawn(async move {
                let mut plans = Vec::new();
                loop {
                    let job = next.fetch_add(1, Ordering::Relaxed);
                    if job >= JOBS {
                        return plans;
                    }
                    let mut request = small();
                    request.options.as_mut().unwrap().seed = job as u64;
                    let answer = client.plan_grasps(&request).await;
                    answered.fetch_add(1, Ordering::Relaxed);
                    plans.push((job, answer));
                }
            })
        })
        .collect();
    let (mut dice, mut kills, mut next_kill) = (Dice(7), 0, 5);
    while answered.load(Ordering::Relaxed) < JOBS {
        tokio::time::sleep(Duration::from_millis(dice.below(20))).await;
        let victim = &mut workers[usize::try_from(dice.below(3)).unwrap()];
        // One that is starting has nothing to lose.
        if answered.load(Ordering::Relaxed) >= next_kill && !victim.lines_with("working").is_empty() {
            victim.kill();
            kills += 1;
            next_kill += 20 + usize::try_from(dice.below(20)).unwrap();
            *victim = installation.worker();
        }
    }
    let mut plans = BTreeSet::new();
    for caller in callers {
        for (job, answer) in caller.await.unwrap() {
            let answer = answer.unwrap_or_else(|e| panic!("job {job}: {e}"));
            assert!(answer.stats.is_some() && plans.insert(answer.plan_id), "job {job}");
        }
    }
    assert_eq!(plans.len(), JOBS);
    assert!(kills >= 3, "{kills}");

    // A worker that is killed in the middle of a job for certain: another one has the job's second delivery.
    workers.truncate(0);
    let mut first = installation.worker();
    first.wait_for("working");
    let calling = tokio::spawn(async move { client.plan_grasps(&slow()).await });
    first.wait_for("attempt=1");
    first.kill();
    let mut second = installation.worker();
    second.wait_for("attempt=2");
    calling.await.unwrap().unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_job_is_given_back_by_a_worker_that_ends_and_given_up_with_the_third_that_is_lost() {
    let Some(installation) = Installation::start("leaving") else { return };
    let front = installation.front(&[]);
    let (mut ends, client) = (installation.worker(), front.client().await);
    ends.wait_for("working");
    let mut endless = slow();
    endless.options.as_mut().unwrap().budget = None;
    let calling = tokio::spawn(async move { client.plan_grasps(&endless).await });
    ends.wait_for("attempt=1");
    // After a second of grace.
    ends.terminate();
    ends.wait_for("job given back");
    for attempt in ["attempt=2", "attempt=3"] {
        let mut lost = installation.worker();
        lost.wait_for(attempt);
        lost.kill();
    }
    // The broker notices when the next one asks for work, who does not get it.
    let spared = installation.worker();
    let given_up = error(calling.await.unwrap());
    assert!(spared.lines_with("attempt=").is_empty());
    assert_eq!(given_up.code, Code::Internal, "{given_up}");
    assert!(given_up.message.contains("3 workers"), "{given_up}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn callers_hear_at_once_that_the_broker_is_away_and_the_service_recovers() {
    let Some(mut installation) = Installation::start("broker") else { return };
    let mut worker = installation.worker();
    let front = installation.front(&[]);
    worker.wait_for("working");
    let client = front.client().await;
    client.plan_grasps(&small()).await.unwrap();
    let calling = {
        let client = client.clone();
        tokio::spawn(async move { client.plan_grasps(&slow()).await })
    };
    eventually("the job runs", async || worker.lines_with("waited_ms").len() == 2).await;
    let killed = Instant::now();
    installation.broker.kill();
    let running = error(calling.await.unwrap());
    assert_eq!((running.code, running.reason.as_str()), (Code::Unavailable, "ENGINE_AWAY"), "{running}");
    let next = error(client.plan_grasps(&small()).await);
    assert_eq!((next.code, next.reason.as_str()), (Code::Unavailable, "ENGINE_AWAY"), "{next}");
    // Both have a minute.
    assert!(killed.elapsed() < Duration::from_secs(20), "{:?}", killed.elapsed());
    // What needs no worker is served all the same.
    assert!(!client.list_hands().await.unwrap().is_empty());
    installation.restart_broker();
    eventually("plans again", async || client.plan_grasps(&small()).await.is_ok()).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_job_behind_a_cable_that_is_cut_goes_to_another_worker() {
    let Some(installation) = Installation::start("cable") else { return };
    let cable = Cable::to(installation.addr()).await;
    let mut cut_off = Installation::worker_at(cable.addr);
    let front = installation.front(&[]);
    cut_off.wait_for("working");
    let client = front.client().await;
    let calling = {
        let client = client.clone();
        tokio::spawn(async move { client.plan_grasps(&slow()).await })
    };
    cut_off.wait_for("attempt=1");
    cable.set_cut(true);
    let mut other = installation.worker();
    other.wait_for("attempt=2");
    calling.await.unwrap().unwrap();
    // Healed, the first one works again; the other one is gone.
    cable.set_cut(false);
    other.kill();
    client.plan_grasps(&small()).await.unwrap();
    assert!(cut_off.lines_with("waited_ms").len() >= 2);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_hand_created_at_one_front_is_known_to_all_fronts_and_workers() {
    let Some(installation) = Installation::start("hands") else { return };
    let (mut before, fronts) = (installation.worker(), [installation.front(&[]), installation.front(&[])]);
    before.wait_for("working");
    let [one, two] = [fronts[0].client().await, fronts[1].client().await];
    let files = graspd_hands::library::files("finray-2f").unwrap().files;
    one.create_hand("mine", &files, false).await.unwrap();
    let request = PlanGraspsRequest { hand: "hands/mine".to_owned(), ..small() };
    // At once: a worker that has not heard of it looks for it.
    one.plan_grasps(&request).await.unwrap();
    eventually("the other front knows it", async || two.get_hand("hands/mine").await.is_ok()).await;
    let again = error(two.create_hand("mine", &files, false).await);
    assert_eq!((again.code, again.reason.as_str()), (Code::AlreadyExists, "HAND_EXISTS"));
    before.kill();
    let mut after = installation.worker();
    after.wait_for("working");
    two.plan_grasps(&request).await.unwrap();
    assert!(!after.lines_with("hand loaded from the store").is_empty());
    // Fronts that start later know it too.
    let three = installation.front(&[]);
    assert!(three.client().await.get_hand("hands/mine").await.is_ok());
    two.delete_hand("hands/mine").await.unwrap();
    eventually("it is gone everywhere", async || one.get_hand("hands/mine").await.is_err()).await;
    assert_eq!(error(one.plan_grasps(&request).await).code, Code::NotFound);
    // Another hand of that name is another hand.
    let files = graspd_hands::library::files("robotiq-2f85").unwrap().files;
    one.create_hand("mine", &files, false).await.unwrap();
    one.plan_grasps(&request).await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn full_queues_deadlines_and_callers_that_leave_are_as_on_one_machine() {
    let Some(installation) = Installation::start("queue") else { return };
    let front = installation.front(&["--engine-queue", "2"]);
    let client = front.client().await;
    // Nobody works yet. A place that the question below has taken is asked for again.
    let waiting: Vec<_> = (0..2).map(|_| spawn_plan(&client, small())).collect();
    let full = Arc::new(tokio::sync::Mutex::new(None));
    let brief = client.with_timeout(Duration::from_millis(500));
    eventually("the queue is full", async || {
        let refused = error(brief.plan_grasps(&small()).await);
        let is_full = refused.code == Code::ResourceExhausted;
        *full.lock().await = Some(refused);
        is_full
    })
    .await;
    let refused = full.lock().await.take().unwrap();
    assert_eq!(refused.reason, "QUEUE_FULL", "{refused}");
    assert!(refused.retry_after.is_some());
    // One leaves, and takes its job out of the queue: a deadline then passes in it.
    waiting[0].abort();
    eventually("a place is free", async || {
        error(brief.plan_grasps(&small()).await).code == Code::DeadlineExceeded
    })
    .await;
    let mut worker = installation.worker();
    let [_, patient] = <[_; 2]>::try_from(waiting).unwrap();
    patient.await.unwrap().unwrap();
    worker.wait_for("job ended");

    // A running job stops when its caller leaves.
    let leaving = spawn_plan(&client, slow());
    eventually("it runs", async || worker.lines_with("waited_ms").len() == 2).await;
    leaving.abort();
    worker.wait_for("job cancelled");
    client.plan_grasps(&small()).await.unwrap();
}

fn spawn_plan(
    client: &Client,
    request: PlanGraspsRequest,
) -> tokio::task::JoinHandle<Result<graspd_client::PlanGraspsResponse, ClientError>> {
    let client = client.clone();
    tokio::spawn(async move {
        loop {
            match client.plan_grasps(&request).await {
                Err(ClientError::Call(full)) if full.code == Code::ResourceExhausted => {
                    tokio::time::sleep(Duration::from_millis(20)).await;
                }
                done => return done,
            }
        }
    })
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn streams_several_hands_errors_and_large_frames_come_through() {
    let Some(installation) = Installation::start("kinds") else { return };
    let mut worker = installation.worker();
    let front = installation.front(&[]);
    worker.wait_for("working");
    let client = front.client().await;
    // The same seed gives the same grasps here and there.
    let alone = client.plan_grasps(&search(16, 30)).await.unwrap();
    let mut stream = client.stream_grasps(&search(16, 30)).await.unwrap();
    let (mut improved, mut finished) = (0, None);
    while let Some(event) = stream.next().await.unwrap() {
        match event {
            GraspEvent::Accepted { .. } => {}
            GraspEvent::Improved(_) => improved += 1,
            GraspEvent::Finished(answer) => finished = Some(answer),
        }
    }
    assert!(improved >= 1, "{improved}");
    assert_eq!(finished.unwrap().grasps, alone.grasps);

    let task = |id: &str, hand: &str| HandTask {
        task_id: id.to_owned(),
        hand: format!("hands/{hand}"),
        options: small().options,
    };
    let several = PlanMultiHandRequest {
        frames: small().frames,
        scene_options: small().scene_options,
        tasks: vec![task("left", GRIPPER), task("right", "finray-2f")],
        request_id: "several".to_owned(),
        ..PlanMultiHandRequest::default()
    };
    let mut names = Vec::new();
    // The second time from what the front has kept.
    for _ in 0..2 {
        let mut stream = client.plan_multi_hand(&several).await.unwrap();
        let (mut tasks, mut summary) = (BTreeSet::new(), None);
        while let Some(event) = stream.next().await.unwrap() {
            match event {
                MultiHandEvent::Result(result) => {
                    let Some(graspd_client::wire::hand_task_result::Outcome::Response(answer)) =
                        result.outcome
                    else {
                        panic!("{result:?}")
                    };
                    tasks.insert((result.task_id, answer.plan_id));
                }
                MultiHandEvent::Summary(done) => summary = Some(done),
            }
        }
        let summary = summary.unwrap();
        assert_eq!((tasks.len(), summary.failed_count), (2, 0));
        names.push(tasks);
    }
    assert_eq!(names[0], names[1]);

    // What a worker refuses reaches the caller as its own server would say it.
    let mut broken = small();
    broken.frames[0].encoding = graspd_client::wire::DepthEncoding::PngU16.into();
    let refused = error(client.plan_grasps(&broken).await);
    assert_eq!(
        (refused.code, refused.reason.as_str()),
        (Code::InvalidArgument, "INVALID_IMAGE"),
        "{refused}"
    );
    assert!(!refused.violations.is_empty());

    // Larger than a message of this broker, which has its own default of a megabyte.
    let mut large = small();
    let frame = large.frames[0].clone();
    large.frames = (0..5).map(|_| frame.clone()).collect();
    let bytes: usize = large.frames.iter().map(|frame| frame.data.len()).sum();
    assert!(bytes > 1 << 20, "{bytes}");
    client.plan_grasps(&large).await.unwrap();
}
