//! The bridge against a real server over a real socket: what comes in and goes out, without DDS.

use std::net::SocketAddr;
use std::time::Duration;

use graspd_client::{ClientConfig, RetryPolicy};
use graspd_ros2::bridge::{Bridge, BridgeConfig, Incoming, Outgoing, TopicNames};
use graspd_ros2::depth::Lens;
use graspd_ros2::link::Link;
use graspd_ros2::messages::{
    CameraInfo, Header, Image, MarkerArray, Point, PointStamped, Stamp, TriggerResponse, action, level,
};
use graspd_ros2::pairing::PairingRules;
use graspd_tests::{BOX_HALF_M, BoxScene, TestServer};
use nalgebra::Point3;
use serde_json::{Value, json};
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinHandle;

/// Longer than anything takes on a slow and busy machine.
const PATIENCE: Duration = Duration::from_secs(120);
const FRAME: &str = "camera_optical";
/// A goal that would go on for hours.
const ENDLESS: &str = r#"{"id": "long", "batch": 4096, "iterations": 10000}"#;

/// A bridge, its ends, and a test that stands for the node.
struct Running {
    to_bridge: mpsc::Sender<Incoming>,
    from_bridge: mpsc::UnboundedReceiver<Outgoing>,
    stop: Option<oneshot::Sender<()>>,
    bridge: JoinHandle<()>,
    keeper: JoinHandle<()>,
}

impl Drop for Running {
    fn drop(&mut self) {
        self.keeper.abort();
        self.bridge.abort();
    }
}

fn config() -> BridgeConfig {
    BridgeConfig {
        node: "/graspd".into(),
        server: "the server".into(),
        hands: vec!["robotiq-2f85".into(), "leap".into()],
        pairing: PairingRules::default(),
        lens: Lens::Raw,
        max_age: None,
        max_grasps: 5,
        drawn_grasps: 2,
        max_goals: 2,
        step: Duration::from_secs(1),
        topics: TopicNames { image: "/depth".into(), info: "/info".into(), labels: None },
    }
}

fn start(addr: SocketAddr, config: BridgeConfig) -> Running {
    let client = ClientConfig {
        call_timeout: PATIENCE,
        retry: RetryPolicy::NONE,
        ..ClientConfig::new(format!("http://{addr}"))
    };
    let (link, keeper) = Link::new(client, &config.hands[0]);
    let (to_bridge, incoming) = mpsc::channel(16);
    let (out, from_bridge) = mpsc::unbounded_channel();
    let (stop, stopped) = oneshot::channel();
    let bridge = Bridge::new(config, link, out).run(incoming, async {
        stopped.await.ok();
    });
    Running {
        to_bridge,
        from_bridge,
        stop: Some(stop),
        bridge: tokio::spawn(bridge),
        keeper: tokio::spawn(keeper),
    }
}

impl Running {
    async fn send(&self, message: Incoming) {
        self.to_bridge.send(message).await.expect("the bridge has ended");
    }

    /// The box on its table, seen at a time.
    async fn see(&self, sec: i32) {
        let scene = BoxScene::default();
        let (image, info) = messages(&scene, sec);
        self.send(Incoming::Info(info.into())).await;
        self.send(Incoming::Image(image)).await;
    }

    async fn goal(&self, goal: &str) {
        self.send(Incoming::Goal(goal.to_owned())).await;
    }

    async fn next<T>(&mut self, mut wanted: impl FnMut(Outgoing) -> Option<T>) -> T {
        let found = async {
            loop {
                let message = self.from_bridge.recv().await.expect("the bridge has ended");
                if let Some(found) = wanted(message) {
                    return found;
                }
            }
        };
        tokio::time::timeout(PATIENCE, found).await.expect("it never came")
    }

    /// The next result, which must be of this goal.
    async fn result(&mut self, id: &str) -> Value {
        let found = self.next(|m| if let Outgoing::Result(text) = m { Some(text) } else { None }).await;
        let found: Value = serde_json::from_str(&found).expect("a result is JSON");
        assert_eq!(found["goal_id"], json!(id), "{found}");
        found
    }

    async fn status(&mut self, mut fits: impl FnMut(&Value) -> bool) -> Value {
        self.next(|m| {
            let Outgoing::Status(text) = m else { return None };
            let status: Value = serde_json::from_str(&text).expect("a status is JSON");
            fits(&status).then_some(status)
        })
        .await
    }

    async fn connected(&mut self) {
        self.status(|s| s["server"]["state"] == "up").await;
    }

    async fn call(&self, hand: Option<&str>) -> oneshot::Receiver<TriggerResponse> {
        let (reply, answer) = oneshot::channel();
        self.send(Incoming::Service { hand: hand.map(str::to_owned), reply }).await;
        answer
    }
}

fn header(sec: i32) -> Header {
    Header { stamp: Stamp { sec, nanosec: 5 }, frame_id: FRAME.into() }
}

fn messages(scene: &BoxScene, sec: i32) -> (Image, CameraInfo) {
    let lens = BoxScene::intrinsics();
    let frame = scene.frame_without_pose();
    let (width, height) = (frame.width_px as u32, frame.height_px as u32);
    let image = Image {
        header: header(sec),
        height,
        width,
        encoding: "16UC1".into(),
        is_bigendian: 0,
        step: 2 * width,
        data: frame.data.to_vec(),
    };
    let k = [lens.fx_px, 0.0, lens.cx_px, 0.0, lens.fy_px, lens.cy_px, 0.0, 0.0, 1.0];
    let info = CameraInfo { header: header(sec), height, width, k, ..CameraInfo::default() };
    (image, info)
}

fn drawn(markers: &MarkerArray, ns: &str) -> usize {
    markers.markers.iter().filter(|m| m.ns == ns).count()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_goal_becomes_grasps_at_the_object() {
    let server = TestServer::start().await;
    let mut bridge = start(server.addr, config());
    bridge.connected().await;
    bridge.goal(r#"{"id": "early"}"#).await;
    let early = bridge.result("early").await;
    assert_eq!((&early["state"], &early["reason"]), (&json!("refused"), &json!("NO_FRAME")));
    assert!(early["message"].as_str().unwrap().contains("/depth"), "{early}");
    bridge.see(7).await;
    bridge.goal(r#"{"id": "pick", "max_grasps": 3}"#).await;
    let mut feedback = Vec::new();
    let (answer, markers) = bridge
        .next(|m| match m {
            Outgoing::Feedback(text) => {
                feedback.push(serde_json::from_str::<Value>(&text).unwrap());
                None
            }
            Outgoing::Plan(plan) => Some(*plan),
            _ => None,
        })
        .await;
    let result = bridge.result("pick").await;
    assert_eq!(feedback[0]["goal_id"], json!("pick"));
    assert_eq!(feedback[0]["phase"], json!("accepted"));
    assert_eq!((&result["state"], &result["hand"]), (&json!("succeeded"), &json!("robotiq-2f85")));
    // Frame and stamp are the image's everywhere.
    assert_eq!((&result["frame_id"], &result["stamp"]["sec"]), (&json!(FRAME), &json!(7)));
    assert_eq!((&answer.grasps.header, &answer.pregrasps.header), (&header(7), &header(7)));
    assert!(markers.markers.iter().all(|m| m.header == header(7)));
    let best = answer.best.expect("a grasp");
    assert_eq!((&best.pose.header, &best.joints.header), (&header(7), &header(7)));
    assert_eq!(best.pose.pose, answer.grasps.poses[0]);
    // At most as many as asked for, best first.
    let grasps = result["grasps"].as_array().unwrap();
    assert!((1..=3).contains(&grasps.len()));
    assert_eq!((grasps.len(), answer.pregrasps.poses.len()), (answer.grasps.poses.len(), grasps.len()));
    let scores: Vec<f64> = grasps.iter().map(|g| g["score"].as_f64().unwrap()).collect();
    assert!(scores.is_sorted_by(|a, b| a >= b), "{scores:?}");
    // The fingers are about the box, which the camera sees where the scene has put it.
    let scene = BoxScene::default();
    let object = scene.world_from_camera.inverse() * scene.box_center.unwrap();
    for grasp in grasps {
        let p = |v: &Value| {
            Point3::new(v["x"].as_f64().unwrap(), v["y"].as_f64().unwrap(), v["z"].as_f64().unwrap())
        };
        let away = (p(&grasp["tool_point"]) - object).norm();
        assert!(away < 2.0 * BOX_HALF_M.norm(), "{away} m from the box");
        let contact = (p(&grasp["contacts"][0]["point"]) - object).norm();
        assert!(contact < BOX_HALF_M.norm() + 0.02, "{contact} m from the box");
    }
    assert!(!best.joints.name.is_empty() && best.joints.name.len() == best.joints.position.len());
    assert_eq!(best.trajectory.points.len(), 3);
    assert_eq!(markers.markers[0].action, action::DELETEALL);
    let shown = grasps.len().min(2);
    assert_eq!((drawn(&markers, "score"), drawn(&markers, "approach")), (shown, shown));
    assert!(drawn(&markers, "hand") > shown, "the hand has several parts");
}

#[tokio::test(flavor = "multi_thread")]
async fn services_answer_for_their_hands() {
    let server = TestServer::start().await;
    let mut bridge = start(server.addr, config());
    bridge.connected().await;
    let early = bridge.call(None).await.await.unwrap();
    assert!(!early.success && early.message.contains("NO_FRAME"), "{}", early.message);
    bridge.see(1).await;
    let (default, leap) = (bridge.call(None).await, bridge.call(Some("leap")).await);
    for (answer, hand) in [(default, "robotiq-2f85"), (leap, "leap")] {
        let answer = tokio::time::timeout(PATIENCE, answer).await.unwrap().unwrap();
        let result: Value = serde_json::from_str(&answer.message).unwrap();
        assert!(answer.success, "{result}");
        assert_eq!(result["hand"], json!(hand));
    }
    // A clicked point beside the box, on the bare table.
    let scene = BoxScene::default();
    let beside = scene.world_from_camera.inverse() * Point3::new(0.12, 0.05, 0.0);
    let point = Point { x: beside.x, y: beside.y, z: beside.z };
    bridge.send(Incoming::Point(PointStamped { header: header(1), point })).await;
    let ended = bridge.status(|s| s["ended"]["no_grasp"] == json!(1)).await;
    assert_eq!(ended["ended"]["succeeded"], json!(2));
    // The same in a frame that nobody transforms.
    let header = Header { frame_id: "base_link".into(), ..header(1) };
    bridge.send(Incoming::Point(PointStamped { header, point })).await;
    let refused = bridge.result("point-5").await;
    assert_eq!(refused["reason"], json!("FRAME_MISMATCH"));
}

#[tokio::test(flavor = "multi_thread")]
async fn cancelling_ends_the_servers_work() {
    let server = TestServer::start().await;
    let mut bridge = start(server.addr, config());
    bridge.connected().await;
    bridge.see(1).await;
    bridge.goal(ENDLESS).await;
    bridge.status(|s| s["goals"][0]["id"] == "long" && s["goals"][0]["phase"] != "waiting").await;
    server.busy().await;
    // Another goal of its name is refused, and so is one more than may be.
    bridge.goal(ENDLESS).await;
    assert_eq!(bridge.result("long").await["reason"], json!("GOAL_ID_IN_USE"));
    let service = bridge.call(None).await;
    bridge.goal(r#"{"id": "third"}"#).await;
    let third = bridge.result("third").await;
    assert_eq!((&third["state"], &third["reason"]), (&json!("refused"), &json!("BUSY")));
    let service = tokio::time::timeout(PATIENCE, service).await.unwrap().unwrap();
    assert!(service.success, "{}", service.message);
    bridge.result("service-1").await;
    bridge.send(Incoming::Cancel("unknown".into())).await;
    bridge.send(Incoming::Cancel("long".into())).await;
    let result = bridge.result("long").await;
    assert_eq!((&result["state"], &result["reason"]), (&json!("canceled"), &json!("CANCELED")));
    server.idle_within(PATIENCE).await;
    // The name is free again; an end of the bridge cancels too, and says so.
    bridge.goal(ENDLESS).await;
    server.busy().await;
    bridge.stop.take().unwrap().send(()).unwrap();
    assert_eq!(bridge.result("long").await["reason"], json!("STOPPING"));
    bridge.status(|s| s["stopping"] == json!(true)).await;
    server.idle_within(PATIENCE).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_comes_back_is_found() {
    let server = TestServer::start().await;
    let addr = server.addr;
    let mut bridge = start(addr, config());
    bridge.connected().await;
    bridge.see(1).await;
    bridge.goal(r#"{"id": "before"}"#).await;
    assert_eq!(bridge.result("before").await["state"], json!("succeeded"));
    tokio::time::timeout(PATIENCE, server.stop()).await.unwrap().unwrap().unwrap();
    bridge.status(|s| s["server"]["state"] == "away").await;
    let told = bridge.next(|m| if let Outgoing::Diagnostics(d) = m { Some(d) } else { None }).await;
    assert_eq!(told.status[0].level, level::ERROR, "{told:?}");
    bridge.goal(r#"{"id": "while"}"#).await;
    let lost = bridge.result("while").await;
    assert_eq!((&lost["state"], &lost["reason"]), (&json!("aborted"), &json!("SERVER_AWAY")));
    let mut again = TestServer::config();
    again.listen = addr;
    let _server = TestServer::start_with(again).await;
    bridge.connected().await;
    bridge.goal(r#"{"id": "after"}"#).await;
    assert_eq!(bridge.result("after").await["state"], json!("succeeded"));
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_planned_is_said() {
    let server = TestServer::start().await;
    let old = BridgeConfig { max_age: Some(Duration::from_millis(300)), ..config() };
    let mut bridge = start(server.addr, old);
    bridge.connected().await;
    let (image, info) = messages(&BoxScene::empty(), 1);
    bridge.send(Incoming::Image(image)).await;
    bridge.goal(r#"{"id": "a"}"#).await;
    assert!(
        bridge.result("a").await["message"].as_str().unwrap().contains("no camera info has come on /info")
    );
    bridge.send(Incoming::Info(CameraInfo { header: header(3), ..info.clone() }.into())).await;
    bridge.goal(r#"{"id": "b"}"#).await;
    assert!(bridge.result("b").await["message"].as_str().unwrap().contains("differs by 2.000 s"));
    bridge.send(Incoming::Info(info.into())).await;
    tokio::time::sleep(Duration::from_millis(400)).await;
    bridge.goal(r#"{"id": "c"}"#).await;
    assert_eq!(bridge.result("c").await["reason"], json!("FRAME_TOO_OLD"));
    drop(bridge);
    let mut bridge = start(server.addr, config());
    bridge.connected().await;
    let (image, info) = messages(&BoxScene::empty(), 1);
    bridge.send(Incoming::Image(Image { encoding: "rgb8".into(), ..image })).await;
    bridge.send(Incoming::Info(info.into())).await;
    bridge.goal(r#"{"id": "d"}"#).await;
    let wrong = bridge.result("d").await;
    assert_eq!(wrong["reason"], json!("INVALID_FRAME"));
    assert!(wrong["message"].as_str().unwrap().contains("image.encoding: found \"rgb8\""), "{wrong}");
    // Faults that the server finds come through with the field; an empty table is an answer.
    let (image, info) = messages(&BoxScene::empty(), 2);
    bridge.send(Incoming::Image(image)).await;
    bridge.send(Incoming::Info(info.into())).await;
    for (goal, state, reason) in [
        (r#"{"id": "e", "hand": "no-such"}"#, "refused", "HAND_NOT_FOUND"),
        (r#"{"id": "e", "min_score": 7}"#, "refused", ""),
        (r#"{"id": "e", "target_label": 1}"#, "refused", "NO_LABELS"),
        (r#"{"id": "e", "hnad": 1}"#, "refused", "INVALID_GOAL"),
        (r#"{"id": "e"}"#, "no_grasp", ""),
    ] {
        bridge.goal(goal).await;
        let result = bridge.result("e").await;
        assert_eq!(result["state"], json!(state), "{goal} {result}");
        assert!(reason.is_empty() || result["reason"] == json!(reason), "{result}");
        assert!(!result["message"].as_str().unwrap().is_empty(), "{result}");
    }
    // Whoever draws clears what was there; poses are none.
    bridge.goal(r#"{"id": "f"}"#).await;
    let plan = bridge.next(|m| if let Outgoing::Plan(p) = m { Some(p) } else { None }).await;
    assert!(plan.0.grasps.poses.is_empty() && plan.0.best.is_none());
    assert_eq!(plan.1.markers.len(), 1);
}
