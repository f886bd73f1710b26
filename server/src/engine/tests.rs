//! Tests of the engine: how many scenes live at the same time when many calls come at once.

use std::sync::Weak;
use std::sync::atomic::{AtomicUsize, Ordering};

use bytes::Bytes;

use super::*;
use crate::convert;
use crate::pool::PoolConfig;

/// Looks down from 0.5 m on a table with a block of 10 cm on it.
fn request(hands: usize, volume_resolution: i32) -> v1::PlanMultiHandRequest {
    let (width, height) = (80i32, 60i32);
    let depth_mm = |row: i32, column: i32| {
        if (20..40).contains(&row) && (30..50).contains(&column) { 400u16 } else { 500 }
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
    }
}

fn engine(scene_room: usize) -> Arc<Engine> {
    let config = PoolConfig { threads: 1, slots: 3, queue: 64, scene_room };
    Arc::new(Engine {
        pool: Pool::start(config).unwrap(),
        registry: Registry::with_library(),
        estimators: Estimators::default(),
        aborted: Arc::default(),
        overrun: Arc::default(),
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
    let (scene, jobs) = convert::multi_hand(wire).unwrap();
    let tasks: Vec<Task> = jobs.into_iter().map(|job| engine.task(job).unwrap()).collect();
    let call = engine.call(CallClock { arrived: Instant::now(), timeout: None }, scene).unwrap();
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

/// Sends `calls` at once; the most scenes that lived at the same time.
async fn most_alive(engine: &Arc<Engine>, calls: usize, volume_resolution: i32) -> usize {
    let census = Arc::new(Census::default());
    let running: Vec<_> = (0..calls)
        .map(|_| {
            let (engine, census) = (Arc::clone(engine), Arc::clone(&census));
            tokio::spawn(async move { call(&engine, &census, request(4, volume_resolution)).await })
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
    for _ in 0..3 {
        let (scene, jobs) = convert::multi_hand(request(1, 48)).unwrap();
        let tasks: Vec<Task> = jobs.into_iter().map(|job| engine.task(job).unwrap()).collect();
        let call = engine.call(CallClock { arrived: Instant::now(), timeout: None }, scene).unwrap();
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
        frames: request(1, 0).frames,
        ..Default::default()
    };
    let (scene, _) = convert::plan_grasps(plan, "plan").unwrap();
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
