//! A ROS driver over a real socket: a server that speaks the protocol of rosbridge, with faults on request.
#![allow(clippy::unwrap_used)]

use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use futures_util::{SinkExt, StreamExt};
use graspd_adapters_core::{DepthCamera, DeviceError};
use graspd_adapters_pico_flexx::settings::{DepthTopic, RosbridgeSettings, Source};
use graspd_adapters_pico_flexx::{Finding, FlexxCamera, FlexxSettings};
use serde_json::{Value, json};
use tokio::io::AsyncWriteExt;
use tokio::net::{TcpListener, TcpStream};
use tokio_tungstenite::tungstenite::Message;

const AGE: Duration = Duration::from_secs(1);
const LONG: Duration = Duration::from_secs(20);
const SIZE: (usize, usize) = (8, 6);

/// What the server does.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Mode {
    Well,
    Silent,
    WithoutInfo,
    Hangs,
    Closes,
    Garbles,
    WrongSize,
    Complains,
    Lists,
}

/// A server on a port of its own, until it is dropped.
struct Server {
    address: SocketAddr,
    mode: Arc<Mutex<Mode>>,
    asked: Arc<Mutex<Vec<Value>>>,
    task: tokio::task::JoinHandle<()>,
}

impl Drop for Server {
    fn drop(&mut self) {
        self.task.abort();
    }
}

impl Server {
    async fn new(mode: Mode) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let mode = Arc::new(Mutex::new(mode));
        let asked = Arc::new(Mutex::new(Vec::new()));
        let (shared, heard) = (mode.clone(), asked.clone());
        let task = tokio::spawn(async move {
            loop {
                let (stream, _) = listener.accept().await.unwrap();
                tokio::spawn(serve(stream, shared.clone(), heard.clone()));
            }
        });
        Self { address, mode, asked, task }
    }

    fn set(&self, mode: Mode) {
        *self.mode.lock().unwrap() = mode;
    }

    fn camera(&self, depth: DepthTopic) -> FlexxCamera {
        let topic = if depth == DepthTopic::Image { "/cam/image_depth" } else { "/cam/points" };
        let source = RosbridgeSettings {
            url: format!("ws://{}", self.address),
            depth,
            topic: topic.into(),
            camera_info: "/cam/camera_info".into(),
            use_case: "MODE_5_45FPS_500".into(),
            connect_ms: 300,
        };
        FlexxCamera::new(FlexxSettings {
            name: "flexx".into(),
            size_px: SIZE,
            latency_ms: Some(0.0),
            silence_ms: 300,
            retry_ms: 20,
            source: Source::Rosbridge(source),
            ..FlexxSettings::default()
        })
        .unwrap()
    }
}

async fn serve(mut stream: TcpStream, mode: Arc<Mutex<Mode>>, asked: Arc<Mutex<Vec<Value>>>) {
    let now = || *mode.lock().unwrap();
    if now() == Mode::Hangs {
        tokio::time::sleep(LONG).await;
        return;
    }
    if now() == Mode::Garbles {
        let _gone = stream.write_all(b"HTTP/1.1 200 OK\r\n\r\nhello").await;
        return;
    }
    let Ok(socket) = tokio_tungstenite::accept_async(stream).await else { return };
    let (mut sink, mut source) = socket.split();
    let mut topics = Vec::new();
    while topics.len() < 2 {
        let Some(Ok(Message::Text(text))) = source.next().await else { return };
        let order: Value = serde_json::from_str(&text).unwrap();
        topics.push(order["topic"].as_str().unwrap().to_owned());
        asked.lock().unwrap().push(order);
    }
    for n in 0u32.. {
        tokio::time::sleep(Duration::from_millis(22)).await;
        let mut messages = vec![];
        match now() {
            Mode::Silent => {}
            Mode::Closes => {
                let _gone = sink.send(Message::Close(None)).await;
                return;
            }
            Mode::Complains => {
                messages.push(json!({"op": "status", "level": "error", "msg": "no such topic"}))
            }
            mode => {
                if n % 4 == 0 && mode != Mode::WithoutInfo {
                    messages.push(json!({"op": "publish", "topic": topics[0], "msg": info(mode)}));
                }
                let message = if topics[1].ends_with("points") { points(n) } else { image(n, mode) };
                messages.push(json!({"op": "publish", "topic": topics[1], "msg": message}));
                // Others talk here too.
                messages.push(json!({"op": "publish", "topic": "/chatter", "msg": {"data": "hello"}}));
            }
        }
        for message in messages {
            if sink.send(Message::text(message.to_string())).await.is_err() {
                return;
            }
        }
    }
}

fn stamp(n: u32) -> Value {
    let ns = u64::from(n) * 22_222_222;
    json!({"stamp": {"sec": 1_700_000_000 + ns / 1_000_000_000, "nanosec": ns % 1_000_000_000}, "frame_id": "optical"})
}

fn info(mode: Mode) -> Value {
    let width = if mode == Mode::WrongSize { SIZE.0 + 1 } else { SIZE.0 };
    json!({"header": stamp(0), "width": width, "height": SIZE.1, "distortion_model": "plumb_bob",
           "d": [0.1, 0.2, 0.3, 0.4, 0.5], "k": [7.5, 0, 3.5, 0, 7.25, 2.5, 0, 0, 1]})
}

/// Depth of 1 m and `n` millimetres; the first pixel has none.
fn image(n: u32, mode: Mode) -> Value {
    let (width, height) = SIZE;
    let mut data: Vec<u8> =
        (0..width * height).flat_map(|_| (1.0 + 0.001 * (n % 500) as f32).to_le_bytes()).collect();
    data[..4].copy_from_slice(&f32::NAN.to_le_bytes());
    let data = if mode == Mode::Lists { json!(data) } else { json!(STANDARD.encode(data)) };
    json!({"header": stamp(n), "width": width, "height": height, "encoding": "32FC1", "is_bigendian": 0,
           "step": 4 * width, "data": data})
}

fn points(n: u32) -> Value {
    let (width, height) = SIZE;
    let mut data = Vec::new();
    for i in 0..width * height {
        let noise = if i == 0 { 0.2f32 } else { 0.01 };
        for value in [0.1, 0.2, 1.0 + 0.001 * (n % 500) as f32, noise] {
            data.extend(value.to_le_bytes());
        }
        data.extend([0; 3]);
    }
    let field = |name: &str, offset: u32, datatype: u32| json!({"name": name, "offset": offset, "datatype": datatype, "count": 1});
    json!({"header": stamp(n), "width": width, "height": height, "is_bigendian": false, "is_dense": false,
           "point_step": 19, "row_step": 19 * width, "data": STANDARD.encode(data),
           "fields": [field("x", 0, 7), field("y", 4, 7), field("z", 8, 7), field("noise", 12, 7), field("gray", 18, 2)]})
}

#[tokio::test]
async fn images_and_points_come_as_frames() {
    let server = Server::new(Mode::Well).await;
    for (depth, mode) in
        [(DepthTopic::Image, Mode::Well), (DepthTopic::Image, Mode::Lists), (DepthTopic::Points, Mode::Well)]
    {
        server.set(mode);
        let camera = server.camera(depth);
        let first = camera.capture(AGE, LONG).await.unwrap();
        assert_eq!((first.width, first.height, first.depth_m.len()), (SIZE.0, SIZE.1, SIZE.0 * SIZE.1));
        assert_eq!(first.lens.distortion, [0.1, 0.2, 0.3, 0.4, 0.5, 0.0, 0.0, 0.0]);
        assert_eq!((first.lens.fx_px, first.lens.cy_px), (7.5, 2.5));
        let n = ((first.stamp - Duration::from_secs(1_700_000_000)).as_secs_f64() / 0.022_222_222).round();
        assert_eq!(first.depth_m[0], 0.0);
        assert!((f64::from(first.depth_m[9]) - 1.0 - 0.001 * n).abs() < 1e-5, "{} {n}", first.depth_m[9]);
        let second = camera.capture(AGE, LONG).await.unwrap();
        assert!(second.sequence > first.sequence && second.stamp > first.stamp);
        camera.stop(LONG).await.unwrap();
        assert!(!camera.state().streaming);
        camera.capture(AGE, LONG).await.unwrap();
    }
    let asked = server.asked.lock().unwrap().clone();
    assert_eq!((&asked[0]["op"], &asked[0]["topic"]), (&json!("subscribe"), &json!("/cam/camera_info")));
    assert_eq!((&asked[1]["queue_length"], &asked[1]["compression"]), (&json!(1), &json!("none")));
}

#[tokio::test]
async fn every_fault_is_a_typed_error_and_frames_come_back() {
    let server = Server::new(Mode::Well).await;
    let camera = server.camera(DepthTopic::Image);
    camera.capture(AGE, LONG).await.unwrap();
    for (mode, expected) in [
        (Mode::Silent, "no message on"),
        (Mode::Closes, "closed the connection"),
        (Mode::Complains, "no such topic"),
        (Mode::WrongSize, "9 x 6"),
        (Mode::WithoutInfo, "no message on /cam/camera_info"),
        (Mode::Garbles, "200 OK"),
        (Mode::Hangs, "no connection within 300 ms"),
    ] {
        server.set(mode);
        // Modes of a new connection need one: the old one is closed.
        if matches!(mode, Mode::WithoutInfo | Mode::Garbles | Mode::Hangs) {
            camera.stop(LONG).await.unwrap();
        }
        let mut said = Vec::new();
        let found = tokio::time::timeout(LONG, async {
            loop {
                if let Err(error) = camera.capture(AGE, LONG).await {
                    said.push(error.to_string());
                    if said.last().unwrap().contains(expected) {
                        return error;
                    }
                }
            }
        });
        let error = found.await.unwrap_or_else(|_| panic!("{mode:?}: {said:?}"));
        assert!(matches!(error, DeviceError::Disconnected { .. } | DeviceError::Protocol { .. }), "{error}");
        server.set(Mode::Well);
        while camera.capture(AGE, LONG).await.is_err() {}
    }
}

#[tokio::test]
async fn nobody_there_is_said_at_once_and_found_later() {
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let mut server = Server::new(Mode::Well).await;
    server.address = port;
    let camera = server.camera(DepthTopic::Image);
    let error = camera.capture(AGE, LONG).await.unwrap_err();
    assert!(matches!(&error, DeviceError::Disconnected { .. }), "{error}");
    let found = camera.check(LONG).await;
    assert!(
        matches!(&found[..], [Finding { ok: false, advice, .. }] if advice.contains("rosbridge_server")),
        "{found:?}"
    );
    let listener = TcpListener::bind(port).await.unwrap();
    let mode = Arc::new(Mutex::new(Mode::Well));
    let serving = tokio::spawn(async move {
        loop {
            let (stream, _) = listener.accept().await.unwrap();
            tokio::spawn(serve(stream, mode.clone(), Arc::default()));
        }
    });
    while camera.capture(AGE, LONG).await.is_err() {}
    serving.abort();
}

#[tokio::test]
async fn silence_before_the_callers_time_is_a_timeout() {
    let server = Server::new(Mode::Silent).await;
    let camera = server.camera(DepthTopic::Points);
    let error = camera.capture(AGE, Duration::from_millis(100)).await.unwrap_err();
    assert!(matches!(error, DeviceError::Timeout { operation: "capture", .. }), "{error}");
    server.set(Mode::Well);
    while camera.capture(AGE, LONG).await.is_err() {}
    let found = camera.check(LONG).await;
    assert!(found.iter().all(|f| f.ok) && found.len() == 1, "{found:?}");
}
