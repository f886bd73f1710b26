//! A cell as it stands in a laboratory: `graspd cell run` with a file that names a camera, an arm and a hand by their
//! addresses, and nothing simulated. It does not know that a world of physics stands behind all three: a ROS driver
//! that publishes what a camera there sees, a controller that moves a wrist there, a gripper that closes fingers there.
#![cfg(feature = "sim")]
#![allow(clippy::unwrap_used, reason = "helpers of tests are not in test functions")]

use std::f64::consts::{FRAC_PI_2, PI};
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::Arc;
use std::time::Duration;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use futures_util::{SinkExt as _, StreamExt as _};
use graspd_adapters_core::DepthCamera;
use graspd_adapters_emulators::line::SerialLine;
use graspd_adapters_emulators::robotiq::{Gripper, GripperConfig, Model};
use graspd_adapters_emulators::ur::{UrEmulator, UrModel, UrSettings};
use graspd_adapters_mock::plants::{GripperPlant, WristMount, WristPlant};
use graspd_adapters_mock::{
    Bin, CameraSettings, Faults, MockCamera, Mount, SharedWorld, SharedWorldSettings,
};
use graspd_cell::config::CellConfig;
use graspd_cell::pose::pointing_down;
use graspd_hands::library;
use graspd_sim::camera::look_at;
use graspd_sim::object::Object;
use graspd_sim::sensor::Sensor;
use graspd_sim::world::{HandId, Tray, World, WorldSettings};
use nalgebra::{Isometry3, Point3, Vector3};
use serde_json::{Value, json};
use tokio::net::{TcpListener, TcpStream};
use tokio_tungstenite::tungstenite::Message;

/// The controller's ports are fixed: an address that no other test uses.
const ARM: Ipv4Addr = Ipv4Addr::new(127, 0, 0, 47);
/// Where the arm's base stands, as in the worked example.
const BASE_M: [f64; 3] = [0.10, 0.50, 0.0];
const HZ: f64 = 10.0;

/// A folder that goes with the test.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Self {
        let path = std::env::temp_dir().join(format!("graspd-real-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // What cannot be removed now is the system's to clean up.
        let _left = std::fs::remove_dir_all(&self.0);
    }
}

/// Two blocks in a tray, and a gripper above the place where things are dropped.
async fn laboratory(config: &CellConfig) -> (SharedWorld, HandId, Isometry3<f64>) {
    let mut world = World::new(WorldSettings { tray: Some(Tray::default()), ..WorldSettings::default() });
    for (name, x, y) in [("first", -0.05, 0.04), ("second", 0.06, -0.05)] {
        let block = Object::cuboid(name, Vector3::new(0.02, 0.03, 0.025)).unwrap();
        world.add(Arc::new(Object { mass_kg: 0.1, ..block }), &Isometry3::translation(x, y, 0.025));
    }
    let drop = Vector3::from(config.drop.position_m);
    let bin = Bin { center_m: [drop.x, drop.y], ..Bin::default() };
    let shared = SharedWorld::new(world, SharedWorldSettings { speed: 1.0, bins: vec![bin] }).unwrap();
    let hand = library::hand("robotiq-2f85").unwrap();
    let home = pointing_down(&hand.approach, &Vector3::x(), &hand.tool_point.coords, &drop, 0.0);
    let id = shared.add_hand(Arc::new(hand.clone()), home, None).await.unwrap();
    (shared, id, home)
}

/// A controller on the ports of one, whose arm carries the hand.
async fn controller(shared: &SharedWorld, hand: HandId, home: &Isometry3<f64>) -> UrEmulator {
    let (model, world_from_base) = (UrModel::Ur5e, Isometry3::translation(BASE_M[0], BASE_M[1], BASE_M[2]));
    let flange = world_from_base.inverse() * home;
    let towards = flange.translation.vector.y.atan2(flange.translation.vector.x);
    let folded = [towards - PI, -FRAC_PI_2, FRAC_PI_2, -FRAC_PI_2, -FRAC_PI_2, 0.0];
    let joints = model.joints(&flange, &folded).unwrap();
    let mount = WristMount { model, world_from_base, flange_from_hand: Isometry3::identity(), joints };
    let plant = WristPlant::new(shared, hand, mount).await.unwrap();
    let settings = UrSettings { address: IpAddr::V4(ARM), joints: Some(joints), ..UrSettings::of(model) };
    UrEmulator::start_with(settings, Box::new(plant)).await.unwrap()
}

/// A gripper on a serial port.
async fn gripper(shared: &SharedWorld, hand: HandId, port: PathBuf) -> (Gripper, SerialLine) {
    let plant = GripperPlant::two_finger(shared, hand).await.unwrap();
    let gripper = Gripper::new(GripperConfig::new(Model::TwoFinger), plant);
    let line = gripper.serve_rtu(Some(port)).unwrap();
    (gripper, line)
}

/// A rosbridge server with the topics of a pico flexx above the tray.
async fn driver(shared: &SharedWorld, config: &CellConfig) -> SocketAddr {
    let (eye, target) = (Point3::from(config.camera.position_m), Point3::from(config.camera.looks_at_m));
    let mount = Mount::Fixed { world_from_camera: look_at(&eye, &target, &Vector3::z()) };
    let settings = CameraSettings { frame_rate_hz: HZ, ..CameraSettings::default() };
    let camera = MockCamera::new(shared, settings, Sensor::pico_flexx(), mount, Faults::default()).unwrap();
    let camera = Arc::new(camera);
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    tokio::spawn(async move {
        while let Ok((stream, _)) = listener.accept().await {
            tokio::spawn(publish(stream, camera.clone()));
        }
    });
    address
}

/// Publishes frames to one client until it goes.
async fn publish(stream: TcpStream, camera: Arc<MockCamera>) {
    let Ok(socket) = tokio_tungstenite::accept_async(stream).await else { return };
    let (mut sink, mut source) = socket.split();
    let mut topics = Vec::new();
    while topics.len() < 2 {
        let Some(Ok(Message::Text(text))) = source.next().await else { return };
        let order: Value = serde_json::from_str(&text).unwrap();
        assert_eq!(order["op"], "subscribe");
        topics.push(order["topic"].as_str().unwrap().to_owned());
    }
    let second = Duration::from_secs(1);
    loop {
        let Ok(frame) = camera.capture(second, 10 * second).await else { return };
        let (lens, ns) = (&frame.lens, frame.stamp.as_nanos() as u64);
        let stamp = json!({"sec": 1_700_000_000 + ns / 1_000_000_000, "nanosec": ns % 1_000_000_000});
        let header = json!({"stamp": stamp, "frame_id": "optical"});
        let [k1, k2, p1, p2, k3, ..] = lens.distortion;
        let info = json!({"header": header, "width": frame.width, "height": frame.height,
            "distortion_model": "plumb_bob", "d": [k1, k2, p1, p2, k3],
            "k": [lens.fx_px, 0, lens.cx_px, 0, lens.fy_px, lens.cy_px, 0, 0, 1]});
        let depth: Vec<u8> = frame.depth_m.iter().flat_map(|d| d.to_le_bytes()).collect();
        let image = json!({"header": header, "width": frame.width, "height": frame.height,
            "encoding": "32FC1", "is_bigendian": 0, "step": 4 * frame.width, "data": STANDARD.encode(depth)});
        for (topic, message) in [(&topics[0], info), (&topics[1], image)] {
            let message = json!({"op": "publish", "topic": topic, "msg": message});
            if sink.send(Message::text(message.to_string())).await.is_err() {
                return;
            }
        }
        tokio::time::sleep(Duration::from_secs_f64(1.0 / HZ)).await;
    }
}

/// The worked example, as a laboratory would fill it in: three addresses, no simulation.
fn file(camera: SocketAddr, port: &Path) -> String {
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cell/examples/ur_robotiq_2f.toml");
    let text = std::fs::read_to_string(example).unwrap();
    let (text, _simulation) = text.split_once("[simulation]").unwrap();
    let camera = format!("kind = \"pico-flexx\"\naddress = \"ws://{camera}\" #");
    let text = text.replacen("kind = \"mock\"", &camera, 1);
    let text = text.replacen("address = \"emulator\"", &format!("address = \"{ARM}\""), 1);
    let text = text.replacen("address = \"emulator\"", &format!("address = \"{}\"", port.display()), 1);
    // Machines of tests pause for long.
    let text = text.replace("max_force_n = 235.0 ", "reply_timeout_ms = 500\nmax_force_n = 235.0 ");
    assert!(!text.contains("kind = \"mock\"") && !text.contains("address = \"emulator\""), "{text}");
    text + "\n[camera.settings.pico-flexx]\nframe_rate_hz = 10.0\nsilence_ms = 10000\n\
            \n[arm.settings.ur.heartbeat]\ntimeout_s = 0.8\n\n[arm.settings.ur.arrival]\nsettle_s = 20.0\n"
}

/// The program, which ends on its own: a run has its trials and its time limit.
async fn graspd(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_graspd"));
    command.args(arguments).env_remove("RUST_LOG").env_remove("GRASPD_SERVER");
    tokio::task::spawn_blocking(move || command.output().unwrap()).await.unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_cell_that_names_only_addresses_clears_a_tray() {
    let folder = Folder::new();
    let port = folder.0.join("ttyGripper");
    let config = CellConfig::default();
    let (shared, hand, home) = laboratory(&config).await;
    let _controller = controller(&shared, hand, &home).await;
    let _gripper = gripper(&shared, hand, port.clone()).await;
    let text = file(driver(&shared, &config).await, &port);
    // What is told of the cell is what stands in its file: none of it is emulated, none of it is a mock.
    let path = folder.0.join("cell.toml");
    std::fs::write(&path, &text).unwrap();
    let file = path.display().to_string();
    let listed = graspd(&["device", "list", "--config", &file, "--json"]).await;
    let told: Value = serde_json::from_slice(&listed.stdout).unwrap();
    let kinds: Vec<&str> =
        told["devices"].as_array().unwrap().iter().map(|d| d["kind"].as_str().unwrap()).collect();
    assert_eq!(kinds, ["pico-flexx", "ur", "robotiq-2f"], "{told}");

    let cleared = graspd(&["cell", "run", "--trials", "8", "--json", &file]).await;
    let complaint = String::from_utf8(cleared.stderr).unwrap();
    let summary: Value =
        serde_json::from_slice(&cleared.stdout).unwrap_or_else(|e| panic!("{e}: {complaint}"));
    assert!(cleared.status.success(), "{summary}\n{complaint}");
    // The cell has no witness: it counts what the hand felt, and sees that the tray is empty.
    let tally = &summary["report"]["tally"];
    assert!(tally["delivered"].is_null() && tally["successes"].as_u64().unwrap() >= 1, "{summary}");
    // We have one.
    shared.wait(1.0).await.unwrap();
    let census = shared.census().await.unwrap();
    let counted = census.delivered.len() + census.elsewhere.len();
    assert_eq!((census.tray.len(), counted), (0, 2), "{census:?}\n{complaint}");
    assert!(!census.delivered.is_empty(), "{census:?}\n{complaint}");
}
