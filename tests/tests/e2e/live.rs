//! The live view of a real server: what viewers see is what gRPC answered, in its frames and schemas; who may look.

use std::io::{BufRead as _, BufReader};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use futures_util::StreamExt as _;
use graspd_client::wire::{self, PoseInFrame};
use graspd_client::{
    HandTask, PlanGraspsRequest, PlanMultiHandRequest, PlanOptions, ServoConfig, ServoFrame,
};
use graspd_proto::v1::hand_task_result::Outcome;
use graspd_proto::v1::{Grasp, PlanGraspsResponse};
use graspd_server::{LiveConfig, ServeError, Server, ServerConfig};
use graspd_tests::{BoxScene, TestServer};
use serde_json::{Value, json};
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;

use crate::python::{REQUIRED, environment, required, text};
use crate::recording::Scratch;
use crate::{GRIPPER, request};

/// A WebSocket client that knows nothing of Foxglove, and the owner's schemas.
const VIEWER: [&str; 3] = ["websockets==15.0.1", "protobuf==6.31.1", "foxglove-schemas-protobuf==0.4.0"];

fn config() -> ServerConfig {
    let live = LiveConfig::at(SocketAddr::from(([127, 0, 0, 1], 0)));
    ServerConfig { live: Some(live), ..TestServer::config() }
}

fn numbers(pose: &Option<PoseInFrame>) -> [f64; 7] {
    let pose = pose.as_ref().unwrap().pose.as_ref().unwrap();
    let (p, q) = (pose.position.unwrap(), pose.orientation.unwrap());
    [p.x, p.y, p.z, q.x, q.y, q.z, q.w]
}

fn poses(grasps: &[Grasp]) -> Vec<[f64; 7]> {
    grasps.iter().map(|grasp| numbers(&grasp.wrist_pose)).collect()
}

fn told(answer: &PlanGraspsResponse) -> Value {
    json!({
        "plan_id": answer.plan_id,
        "hand": answer.stats.as_ref().unwrap().hand,
        "frame_id": answer.grasps[0].wrist_pose.as_ref().unwrap().frame_id,
        "poses": poses(&answer.grasps),
    })
}

/// Written whole or not at all.
fn write(path: &Path, value: &Value) {
    let part = path.with_extension("part");
    std::fs::write(&part, value.to_string()).unwrap();
    std::fs::rename(&part, path).unwrap();
}

async fn several(server: &TestServer) -> Value {
    let task = |id: &str, hand: &str| HandTask {
        task_id: id.to_owned(),
        hand: format!("hands/{hand}"),
        options: Some(PlanOptions { seed: 5, ..PlanOptions::default() }),
    };
    let asked = PlanMultiHandRequest {
        frames: vec![BoxScene::default().frame()],
        tasks: vec![task("left arm", GRIPPER), task("right", "leap")],
        ..PlanMultiHandRequest::default()
    };
    let mut stream = server.client().await.plan_multi_hand(&asked).await.unwrap();
    let mut all = serde_json::Map::new();
    while let Some(event) = stream.next().await.unwrap() {
        if let graspd_client::MultiHandEvent::Result(result) = event
            && let Some(Outcome::Response(answer)) = result.outcome
        {
            all.insert(result.task_id.replace(' ', "_"), told(&answer));
        }
    }
    assert_eq!(all.len(), 2);
    all.into()
}

async fn servo(server: &TestServer) -> Value {
    let config = ServoConfig {
        hand: format!("hands/{GRIPPER}"),
        options: Some(wire::PlanOptions { batch_size: 32, seed: 1, ..Default::default() }),
        ..ServoConfig::default()
    };
    let mut stream = server.client().await.servo_grasp(config).await.unwrap();
    let mut last = None;
    for sequence in 1..=5 {
        let frame = Some(BoxScene::default().frame());
        stream.send(ServoFrame { sequence, frame, hand: None }).await.unwrap();
        last = stream.next().await.unwrap();
    }
    let last = last.unwrap();
    json!({ "sequence": last.sequence, "poses": poses(last.grasp.as_slice()) })
}

#[tokio::test]
async fn python_sees_live_what_grpc_answers() {
    let scratch = Scratch::new();
    std::fs::create_dir_all(&scratch.0).unwrap();
    let environments = PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
    let made = move || environment(&environments.join("python-live"), &VIEWER);
    let python = match tokio::task::spawn_blocking(made).await.unwrap() {
        Ok(python) => python,
        Err(reason) => {
            assert!(!required(std::env::var(REQUIRED).ok().as_deref()), "{REQUIRED} is set and {reason}");
            return eprintln!("skipped: {reason}");
        }
    };
    let server = TestServer::start_with(config()).await;
    let client = server.client().await;
    let files = ["first", "second", "third"].map(|name| scratch.0.join(name).with_extension("json"));
    let answer = client.plan_grasps(&request(GRIPPER)).await.unwrap();
    assert!(!answer.recorded, "shown, not recorded");
    write(&files[0], &told(&answer));

    let mut viewer = Command::new(&python)
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("python/live_view.py"))
        .arg(server.live.unwrap().port().to_string())
        .args(&files)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let said = BufReader::new(viewer.stdout.take().unwrap());
    let (lines, mut heard) = tokio::sync::mpsc::unbounded_channel();
    std::thread::spawn(move || said.lines().map_while(Result::ok).try_for_each(|line| lines.send(line)));
    let mut stage = async |expected: &str| {
        let line = tokio::time::timeout(Duration::from_secs(120), heard.recv()).await.unwrap();
        if line.as_deref() != Some(expected) {
            return Err(format!("expected {expected:?}, found {line:?}"));
        }
        Ok(())
    };
    let ended = async {
        stage("looking").await?;
        write(&files[1], &several(&server).await);
        stage("looking at the servo").await?;
        write(&files[2], &servo(&server).await);
        stage("looking at the end").await
    }
    .await;
    server.stop().await.unwrap().unwrap();
    let output = tokio::task::spawn_blocking(move || viewer.wait_with_output()).await.unwrap().unwrap();
    assert!(output.status.success() && ended.is_ok(), "{ended:?}: {}", text(&output));
}

#[tokio::test]
async fn viewers_change_nothing_of_what_is_answered_and_are_counted() {
    let metrics_listen = Some(SocketAddr::from(([127, 0, 0, 1], 0)));
    let server = TestServer::start_with(ServerConfig { metrics_listen, ..config() }).await;
    let plain = TestServer::start().await;
    let asked = PlanGraspsRequest { request_id: "seen".to_owned(), ..request(GRIPPER) };
    let mut asking = format!("ws://{}/", server.live.unwrap()).into_client_request().unwrap();
    asking.headers_mut().insert("sec-websocket-protocol", "foxglove.sdk.v1".parse().unwrap());
    let (mut viewer, response) = tokio_tungstenite::connect_async(asking).await.unwrap();
    assert_eq!(response.headers()["sec-websocket-protocol"], "foxglove.sdk.v1");
    let seen = server.client().await.plan_grasps(&asked).await.unwrap();
    let unseen = plain.client().await.plan_grasps(&asked).await.unwrap();
    assert_eq!(seen.grasps, unseen.grasps);
    // Server info, no channels, then those of the call.
    let mut channels = 0;
    while channels == 0 {
        let words = tokio::time::timeout(Duration::from_secs(60), viewer.next()).await.unwrap();
        // Between words there may be signs of life.
        let Message::Text(words) = words.unwrap().unwrap() else { continue };
        let words: Value = serde_json::from_str(&words).unwrap();
        channels = words["channels"].as_array().map_or(0, Vec::len);
    }
    assert_eq!(channels, 9);
    let (_, text) = crate::telemetry::get(server.metrics.unwrap(), "/metrics").await;
    for line in ["graspd_live_clients 1", "graspd_live_total{outcome=\"picture_drawn\"} 0"] {
        assert!(text.contains(line), "{line} in\n{text}");
    }
}

#[tokio::test]
async fn an_address_that_others_can_reach_is_refused() {
    let open = LiveConfig::at("0.0.0.0:0".parse().unwrap());
    // Whatever else is allowed.
    let config = ServerConfig { live: Some(open), insecure_listen: true, ..TestServer::config() };
    let refused = Server::bind(config).await.unwrap_err();
    assert!(matches!(refused, ServeError::Live(_)), "{refused}");
    assert!(refused.to_string().contains("ssh -L"), "{refused}");
}
