//! Tests of the engine: how many scenes live at the same time when many calls come at once.

use std::sync::Weak;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use bytes::Bytes;
use graspd_planner::budget::{Budget as _, Stop};
use graspd_planner::grid::GridError;
use graspd_planner::scene::SceneError;

use super::fault::scene_fault;
use super::*;
use crate::convert::{self, Parsed};
use crate::pool::PoolConfig;

/// Looks down from 0.5 m on a table with a block on it.
fn request(hands: usize, volume_resolution: i32, block_mm: u16) -> v1::PlanMultiHandRequest {
    let (width, height) = (80i32, 60i32);
    let depth_mm = |row: i32, column: i32| {
        if (20..40).contains(&row) && (30..50).contains(&column) { 500 - block_mm } else { 500 }
    };
    let pixels = (0..height).flat_map(|row| (0..width).map(move |column| depth_mm(row, column)));
    let frame = v1::DepthFrame {
        width_px: width,
        height_px: height,
        encoding: v1::DepthEncoding::RawU16.into(),
        depth_scale_m: 0.001,
        data: pixels.flat_map(u16::to_le_bytes).collect::<Bytes>(),
        intrinsics: Some(v1::CameraIntrinsics {
            fx_px: 80.0,
            fy_px: 80.0,
            cx_px: 40.0,
            cy_px: 30.0,
            distortion: vec![],
        }),
        ..Default::default()
    };
    let options = v1::PlanOptions {
        batch_size: 4,
        scheme: Some(v1::Scheme { iteration_count: 3, penetration_iteration_count: 1 }),
        ..Default::default()
    };
    let task = |i: usize| v1::HandTask {
        task_id: i.to_string(),
        hand: "hands/antipodal".to_owned(),
        options: Some(options.clone()),
    };
    v1::PlanMultiHandRequest {
        frames: vec![frame],
        scene_options: Some(v1::SceneOptions { volume_resolution, ..Default::default() }),
        tasks: (0..hands).map(task).collect(),
        ..Default::default()
    }
}

fn engine(scene_room: usize) -> Arc<Engine> {
    let config = PoolConfig {
        threads: 1,
        slots: 3,
        servo_slots: 0,
        queue: 64,
        scene_room,
        nice: 0,
        plain_fifo: false,
    };
    Arc::new(Engine {
        pool: Pool::start(config).unwrap(),
        registry: Registry::with_library(),
        estimators: Estimators::default(),
        aborted: Arc::default(),
        overrun: Arc::default(),
        estimates: Arc::default(),
        scenes: Scenes::default(),
        metrics: Arc::default(),
        answers: Arc::default(),
        recorder: None,
        live: None,
        calibration: None,
        health: Health::default(),
        tracer: Tracer::default(),
        elsewhere: None,
        outgoing: Outgoing::new(64, false),
        hand_store: None,
    })
}

/// Scenes that were ever read, and the most that lived at the same time.
#[derive(Default)]
struct Census {
    read: std::sync::Mutex<Vec<Weak<ReadScene>>>,
    most: AtomicUsize,
}

impl Census {
    fn count(&self) -> usize {
        let alive = self.read.lock().unwrap().iter().filter(|scene| scene.strong_count() > 0).count();
        self.most.fetch_max(alive, Ordering::Relaxed);
        alive
    }
}

/// A call for several hands as the service makes it; how many hands were answered.
async fn call(engine: &Engine, census: &Census, wire: v1::PlanMultiHandRequest) -> usize {
    let Parsed { scene, jobs: convert::HandJobs { jobs, .. }, .. } = convert::multi_hand(wire).unwrap();
    let tasks: Vec<Task> =
        jobs.into_iter().map(|job| engine.task(&Caller::named("test"), job).unwrap()).collect();
    let call = engine.call(now(), &Caller::named("test"), scene).unwrap();
    let ticket = engine.submit_scene(&call, &tasks).unwrap();
    let read = engine.scene(&call, ticket).await.unwrap();
    census.read.lock().unwrap().push(Arc::downgrade(&read));
    census.count();
    let tickets: Vec<_> = tasks.iter().map(|task| engine.submit_hand(&call, &read, task).unwrap()).collect();
    drop(read);
    let mut answered = 0;
    for (task, ticket) in tasks.iter().zip(tickets) {
        engine.answer(&call, task, ticket).await.unwrap();
        census.count();
        answered += 1;
    }
    answered
}

fn now() -> CallClock {
    CallClock { arrived: Instant::now(), timeout: None, trace: Default::default() }
}

/// Sends `calls` at once, each with a scene of its own; the most scenes that lived at the same time.
async fn most_alive(engine: &Arc<Engine>, calls: usize, volume_resolution: i32) -> usize {
    let census = Arc::new(Census::default());
    let running: Vec<_> = (0..calls)
        .map(|i| {
            let (engine, census) = (Arc::clone(engine), Arc::clone(&census));
            tokio::spawn(
                async move { call(&engine, &census, request(4, volume_resolution, 80 + i as u16)).await },
            )
        })
        .collect();
    for call in running {
        assert_eq!(call.await.unwrap(), 4);
    }
    assert_eq!((census.count(), engine.pool.scene_room_taken()), (0, 0));
    census.most.load(Ordering::Relaxed)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn no_more_scenes_live_than_there_is_room_for() {
    let narrow = engine(2);
    assert!((1..=2).contains(&most_alive(&narrow, 12, 48).await));
    // Each of these takes two rooms.
    assert_eq!(most_alive(&narrow, 4, 96).await, 1);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_scene_that_is_held_keeps_its_room() {
    let engine = engine(2);
    let mut calls = Vec::new();
    for i in 0..3 {
        let Parsed { scene, jobs: convert::HandJobs { jobs, .. }, .. } =
            convert::multi_hand(request(1, 48, 80 + i)).unwrap();
        let tasks: Vec<Task> =
            jobs.into_iter().map(|job| engine.task(&Caller::named("test"), job).unwrap()).collect();
        let call = engine.call(now(), &Caller::named("test"), scene).unwrap();
        let ticket = engine.submit_scene(&call, &tasks).unwrap();
        calls.push((call, ticket));
    }
    let (third, mut third_ticket) = calls.pop().unwrap();
    let mut held = Vec::new();
    for (call, ticket) in calls {
        held.push(engine.scene(&call, ticket).await.unwrap());
    }
    let early = tokio::time::timeout(Duration::from_millis(100), third_ticket.wait()).await;
    assert!(early.is_err(), "the third scene was read where there is room for two");
    assert_eq!((engine.pool.scene_room_taken(), engine.pool.waiting()), (2, 1));
    held.pop();
    held.push(engine.scene(&third, third_ticket).await.unwrap());
    assert_eq!((engine.pool.scene_room_taken(), engine.pool.waiting()), (2, 0));
}

#[test]
fn what_the_planner_refuses_names_its_own_field() {
    let plan = v1::PlanGraspsRequest {
        hand: "hands/antipodal".to_owned(),
        frames: request(1, 0, 100).frames,
        ..Default::default()
    };
    let scene = convert::plan_grasps(plan, "plan").unwrap().scene;
    let workspace =
        |field| SceneError::Workspace { field, found: "1".to_owned(), expected: "less".to_owned() };
    let cases = [
        (workspace("table_m"), "plan.scene_options.workspace.table_height_m"),
        (workspace("world_from_volume"), "plan.scene_options.workspace.pose"),
        (
            SceneError::Region { field: "world_from_box", found: "1".to_owned(), expected: "less" },
            "plan.scene_options.grasp_region.pose",
        ),
        (
            SceneError::Threshold { field: "focal_contact_threshold", found: 2.0 },
            "plan.scene_options.focal_contact_threshold",
        ),
        (GridError::Resolution { found: 1 }.into(), "plan.scene_options.volume_resolution"),
        (GridError::Size { found: 0.0 }.into(), "plan.scene_options.volume_size_m"),
        (SceneError::MissingPose { index: 1, count: 2 }, "plan.frames[1].camera_pose"),
        (SceneError::NoFrames, "plan.frames"),
    ];
    for (error, field) in cases {
        assert_eq!(scene_fault(&error, &scene).field, field, "{error}");
    }
}

/// A call that is ready to be submitted.
fn ready(engine: &Engine, wire: v1::PlanMultiHandRequest) -> (Call, Vec<Task>) {
    let Parsed { scene, jobs: convert::HandJobs { jobs, .. }, .. } = convert::multi_hand(wire).unwrap();
    let tasks = jobs.into_iter().map(|job| engine.task(&Caller::named("test"), job).unwrap()).collect();
    (engine.call(now(), &Caller::named("test"), scene).unwrap(), tasks)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn calls_with_the_same_frames_read_them_once_and_others_do_not() {
    let engine = engine(3);
    let mut running = Vec::new();
    for block_mm in [100, 100, 100, 90, 100] {
        let (call, tasks) = ready(&engine, request(1, 64, block_mm));
        let ticket = engine.submit_single(&call, &tasks[0], None).unwrap();
        running.push((call, tasks, ticket));
    }
    let mut answers = Vec::new();
    for (call, tasks, ticket) in running {
        answers.push(engine.answer(&call, &tasks[0], ticket).await.unwrap());
    }
    assert_eq!(engine.scenes.read_count(), 2, "one for each of two different frames");
    assert_eq!(answers[0].grasps, answers[4].grasps);
    assert_eq!(engine.pool.scene_room_taken(), 0, "a scene goes with the last call that needs it");
    // A call that comes later reads anew.
    let (call, tasks) = ready(&engine, request(1, 64, 100));
    let ticket = engine.submit_single(&call, &tasks[0], None).unwrap();
    engine.answer(&call, &tasks[0], ticket).await.unwrap();
    assert_eq!(engine.scenes.read_count(), 3);
}

#[tokio::test]
async fn a_scene_that_nobody_wanted_for_a_moment_is_read_anew() {
    let engine = engine(8);
    let Parsed { scene, .. } = convert::multi_hand(request(1, 40, 30)).unwrap();
    let estimator = engine.estimators.get(None).unwrap();
    let shared = engine.scenes.get(&Arc::new(scene), estimator);
    let (first, second) = (CallBudget::new(Instant::now(), None), CallBudget::new(Instant::now(), None));
    shared.want(&first);
    let reading = shared.reading();
    assert_eq!(reading.stop(), None);
    first.cancel();
    assert_eq!(reading.stop(), Some(Stop::Cancelled));
    // Something may have been left out in this moment: who comes now does not get it.
    shared.want(&second);
    assert_eq!(reading.stop(), Some(Stop::Cancelled));
    drop(reading);
    assert!(shared.is_unread() && shared.reading().stop().is_none());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_shared_scene_outlives_the_call_that_began_to_read_it() {
    let engine = engine(3);
    let wire = request(1, 96, 100);
    let (first, first_tasks) = ready(&engine, wire.clone());
    let (second, second_tasks) = ready(&engine, wire);
    let leader = engine.submit_single(&first, &first_tasks[0], None).unwrap();
    let follower = engine.submit_single(&second, &second_tasks[0], None).unwrap();
    first.budget.cancel();
    drop((leader, first));
    let answer = engine.answer(&second, &second_tasks[0], follower).await.unwrap();
    assert!(answer.workspace.is_some());
    assert_eq!(engine.scenes.read_count(), 1);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_deadline_picks_the_scheme_unless_the_caller_does() {
    let engine = engine(3);
    let iterations = async |timeout_ms: Option<u64>, scheme: Option<v1::Scheme>| {
        let mut wire = request(1, 48, 100);
        wire.tasks[0].options = Some(v1::PlanOptions { batch_size: 4, scheme, ..Default::default() });
        let Parsed { scene, jobs: convert::HandJobs { jobs, .. }, .. } = convert::multi_hand(wire).unwrap();
        let clock = CallClock {
            arrived: Instant::now(),
            timeout: timeout_ms.map(Duration::from_millis),
            trace: Default::default(),
        };
        let call = engine.call(clock, &Caller::named("test"), scene).unwrap();
        let task = engine.task(&Caller::named("test"), jobs.into_iter().next().unwrap()).unwrap();
        let ticket = engine.submit_single(&call, &task, None).unwrap();
        engine.answer(&call, &task, ticket).await.unwrap().stats.unwrap().iteration_count
    };
    assert_eq!(iterations(None, None).await, 200);
    assert_eq!(iterations(Some(60_000), None).await, 200);
    // A machine on which an iteration of four candidates takes 40 ms.
    let slow = graspd_planner::grasp::PlanStats {
        candidates: 4,
        iterations: 100,
        stages: vec![("optimize", Duration::from_secs(4))],
        ..Default::default()
    };
    for _ in 0..200 {
        engine.estimates.observe_search("antipodal", &slow);
    }
    let five = v1::Scheme { iteration_count: 5, penetration_iteration_count: 5 };
    assert_eq!(iterations(Some(60_000), Some(five)).await, 5);
    assert_eq!(iterations(None, None).await, 200);
    for _ in 0..200 {
        engine.estimates.observe_search("antipodal", &slow);
    }
    assert_eq!(iterations(Some(7_000), None).await, 100);
    for _ in 0..200 {
        engine.estimates.observe_search("antipodal", &slow);
    }
    assert_eq!(iterations(Some(4_000), None).await, 60);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_repeated_request_gets_the_answer_of_the_first() {
    let engine = engine(3);
    let asked = AtomicUsize::new(0);
    let repeatable = |id: &str, asked| Repeatable {
        key: RequestKey { caller: Flow(1), request_id: id.to_owned(), task_id: String::new() },
        asked,
    };
    let plan = async || {
        asked.fetch_add(1, Ordering::Relaxed);
        tokio::time::sleep(Duration::from_millis(30)).await;
        Ok(v1::PlanGraspsResponse::default())
    };
    let a = repeatable("a", 1);
    let (one, two, other) =
        tokio::join!(engine.once(Some(&a), plan), engine.once(Some(&a), plan), engine.once(None, plan));
    assert_eq!((one.unwrap(), two.unwrap()), (other.unwrap(), v1::PlanGraspsResponse::default()));
    assert_eq!(asked.load(Ordering::Relaxed), 2);
    engine.once(Some(&a), plan).await.unwrap();
    assert_eq!(asked.load(Ordering::Relaxed), 2);
    assert_eq!(engine.once(Some(&repeatable("a", 2)), plan).await, Err(ServiceError::RequestIdReused));
    // Errors are not answers, and a caller that is gone does not keep the id.
    let b = repeatable("b", 1);
    let failed = engine.once(Some(&b), async || Err(ServiceError::Cancelled)).await;
    assert_eq!(failed, Err(ServiceError::Cancelled));
    tokio::time::timeout(Duration::from_millis(5), engine.once(Some(&b), plan)).await.unwrap_err();
    engine.once(Some(&b), plan).await.unwrap();
    assert_eq!(asked.load(Ordering::Relaxed), 4);
}
