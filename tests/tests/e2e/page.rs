//! The page for browsers: what is served, to whom, that its calls are calls, and all of it in a real browser.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use base64::Engine as _;
use graspd_planner::estimator::Geometric;
use graspd_proto::v1;
use graspd_server::security::{Access, Role, Token};
use graspd_server::{Estimators, Example, Page, ServerConfig};
use graspd_tests::{BoxScene, TestServer};
use prost::Message;
use rcgen::{KeyPair, PublicKeyData as _};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

use crate::{GRIPPER, request};

/// Set to 1 where a browser must be at hand: then a missing one is a failure.
const REQUIRED: &str = "GRASPD_REQUIRE_BROWSER";

fn assets() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../cli/assets")
}

/// The page with the frame that comes with graspd.
fn page() -> Option<Page> {
    let read = |name: &str| std::fs::read(assets().join(name)).unwrap().into();
    let example = Example { depth_png: read("demo_depth.png"), frame_json: read("demo_frame.json") };
    Some(Page { example: Some(example) })
}

fn with_page() -> ServerConfig {
    ServerConfig { page: page(), ..TestServer::config() }
}

fn tokens() -> Access {
    let hash = |text: &str| {
        ring::digest::digest(&ring::digest::SHA256, text.as_bytes()).as_ref().try_into().unwrap()
    };
    let token = |name: &str, role| Token { name: name.to_owned(), sha256: hash(name), role };
    Access {
        tokens: vec![token("viewer", Role::Viewer), token("controller", Role::Controller)],
        ..Access::default()
    }
}

/// What a server answers to bytes: its head, and its body without the marks of chunks.
async fn answer(addr: SocketAddr, request: &[u8]) -> (String, Vec<u8>) {
    let mut stream = TcpStream::connect(addr).await.unwrap();
    stream.write_all(request).await.unwrap();
    let mut all = Vec::new();
    // A server that refuses may close before everything is sent.
    stream.read_to_end(&mut all).await.ok();
    let end = all.windows(4).position(|w| w == b"\r\n\r\n").unwrap_or(all.len().saturating_sub(4));
    let head = String::from_utf8_lossy(&all[..end]).to_lowercase();
    let mut body = all[end + 4..].to_vec();
    if head.contains("transfer-encoding: chunked") {
        let (mut rest, mut whole) = (&body[..], Vec::new());
        while let Some(line) = rest.windows(2).position(|w| w == b"\r\n") {
            let size = usize::from_str_radix(std::str::from_utf8(&rest[..line]).unwrap(), 16).unwrap();
            whole.extend_from_slice(&rest[line + 2..line + 2 + size]);
            rest = &rest[line + 4 + size..];
            if size == 0 {
                break;
            }
        }
        body = whole;
    }
    (head, body)
}

async fn get(addr: SocketAddr, path: &str, headers: &str) -> (String, Vec<u8>) {
    let host = if headers.contains("Host:") { String::new() } else { format!("Host: {addr}\r\n") };
    answer(addr, format!("GET {path} HTTP/1.1\r\n{host}{headers}Connection: close\r\n\r\n").as_bytes()).await
}

/// A call as the page makes it: the head of the answer, its messages, and its trailers.
async fn web_call(
    addr: SocketAddr,
    method: &str,
    message: &impl Message,
    headers: &str,
) -> (String, Vec<Vec<u8>>, String) {
    let (head, body) = answer(addr, &web_request(addr, method, message, headers)).await;
    let (mut messages, mut trailers) = (Vec::new(), String::new());
    // What is refused before it is a call is text.
    let mut rest = if head.contains("application/grpc-web") { &body[..] } else { &[] };
    while let [kind, a, b, c, d, tail @ ..] = rest {
        let (data, next) = tail.split_at(u32::from_be_bytes([*a, *b, *c, *d]) as usize);
        match kind {
            0 => messages.push(data.to_vec()),
            _ => trailers = String::from_utf8_lossy(data).into_owned(),
        }
        rest = next;
    }
    (head, messages, trailers)
}

/// The bytes of a call as the page makes it.
fn web_request(addr: SocketAddr, method: &str, message: &impl Message, headers: &str) -> Vec<u8> {
    let message = message.encode_to_vec();
    let mut bytes = format!(
        "POST /graspd.v1.{method} HTTP/1.1\r\nHost: {addr}\r\ncontent-type: application/grpc-web+proto\r\n\
         accept: application/grpc-web+proto\r\n{headers}content-length: {}\r\nConnection: close\r\n\r\n",
        message.len() + 5
    )
    .into_bytes();
    bytes.push(0);
    bytes.extend(u32::try_from(message.len()).unwrap().to_be_bytes());
    bytes.extend(message);
    bytes
}

#[tokio::test]
async fn the_page_is_served_with_what_protects_it() {
    let server = TestServer::start_with(with_page()).await;
    let (head, body) = get(server.addr, "/", "").await;
    assert!(head.starts_with("http/1.1 200"), "{head}");
    for header in [
        "content-type: text/html; charset=utf-8",
        "content-security-policy: default-src 'none'; script-src 'self'",
        "frame-ancestors 'none'",
        "x-content-type-options: nosniff",
        "cross-origin-resource-policy: same-origin",
    ] {
        assert!(head.contains(header), "{header} in {head}");
    }
    assert!(!head.contains("access-control-allow-origin"), "nobody else's pages read this: {head}");
    let html = String::from_utf8(body).unwrap();
    // Everything that it names is there.
    let names = html.split('"').filter(|part| part.starts_with("/page/"));
    let mut count = 0;
    for name in names {
        let (head, body) = get(server.addr, name, "").await;
        assert!(head.starts_with("http/1.1 200") && !body.is_empty(), "{name}: {head}");
        count += 1;
    }
    assert!(count >= 3);
    let (head, body) = get(server.addr, "/example/depth.png", "").await;
    assert!(head.contains("image/png") && body.starts_with(b"\x89PNG"), "{head}");
    assert!(get(server.addr, "/example/frame.json", "").await.0.starts_with("http/1.1 200"));
    assert!(get(server.addr, "/../Cargo.toml", "").await.0.starts_with("http/1.1 404"));
    assert!(get(server.addr, "/page/", "").await.0.starts_with("http/1.1 404"));
    let (_, metrics) = get(server.addr, "/metrics", "").await;
    assert!(String::from_utf8(metrics).unwrap().contains("graspd_jobs_running 0"));
    let post =
        format!("POST / HTTP/1.1\r\nHost: {}\r\ncontent-length: 0\r\nConnection: close\r\n\r\n", server.addr);
    assert!(answer(server.addr, post.as_bytes()).await.0.starts_with("http/1.1 405"));
    // Calls of programs are what they were.
    server.client().await.plan_grasps(&request(GRIPPER)).await.unwrap();
}

#[tokio::test]
async fn calls_of_the_page_are_calls() {
    let server = TestServer::start_with(with_page()).await;
    let (head, messages, trailers) =
        web_call(server.addr, "HandService/ListHands", &v1::ListHandsRequest::default(), "").await;
    assert!(
        head.contains("content-type: application/grpc-web+proto") && trailers.contains("grpc-status:0"),
        "{head} {trailers}"
    );
    let hands = v1::ListHandsResponse::decode(&messages[0][..]).unwrap().hands;
    assert!(hands.len() > 10);
    let several = v1::PlanMultiHandRequest {
        frames: vec![BoxScene::default().frame()],
        tasks: ["robotiq-2f85", "leap"]
            .map(|id| v1::HandTask { task_id: id.to_owned(), hand: format!("hands/{id}"), options: None })
            .to_vec(),
        ..Default::default()
    };
    let (_, messages, trailers) = web_call(server.addr, "PlannerService/PlanMultiHand", &several, "").await;
    assert!(messages.len() == 3 && trailers.contains("grpc-status:0"), "{} {trailers}", messages.len());
    let wrong = v1::ReadSceneRequest { max_point_count: -1, ..Default::default() };
    let (head, messages, trailers) = web_call(server.addr, "PlannerService/ReadScene", &wrong, "").await;
    let said = head + &trailers;
    assert!(
        messages.is_empty() && said.contains("grpc-status: 3") && said.contains("max_point_count"),
        "{said}"
    );
    // The deadline of a call is that of any other.
    let slow = v1::ReadSceneRequest {
        frames: vec![BoxScene::default().frame()],
        scene_options: Some(v1::SceneOptions {
            estimator: graspd_tests::STALLS.to_owned(),
            ..Default::default()
        }),
        ..Default::default()
    };
    let (head, _, trailers) =
        web_call(server.addr, "PlannerService/ReadScene", &slow, "grpc-timeout: 300m\r\n").await;
    assert!((head + &trailers).contains("grpc-status: 4"));
}

#[tokio::test]
async fn a_browser_that_goes_away_takes_its_call_with_it() {
    let server = TestServer::start_with(with_page()).await;
    let slow = v1::ReadSceneRequest {
        frames: vec![BoxScene::default().frame()],
        scene_options: Some(v1::SceneOptions {
            estimator: graspd_tests::STALLS.to_owned(),
            ..Default::default()
        }),
        ..Default::default()
    };
    let mut stream = TcpStream::connect(server.addr).await.unwrap();
    stream.write_all(&web_request(server.addr, "PlannerService/ReadScene", &slow, "")).await.unwrap();
    server.busy().await;
    drop(stream);
    server.idle_within(Duration::from_secs(20)).await;
}

#[tokio::test]
async fn a_scene_is_what_the_planner_reads() {
    let server = TestServer::start().await;
    let channel = tonic::transport::Channel::from_shared(server.endpoint()).unwrap().connect().await.unwrap();
    let mut client =
        v1::planner_service_client::PlannerServiceClient::new(channel).max_decoding_message_size(64 << 20);
    let frames = vec![BoxScene::default().frame()];
    let asked = v1::ReadSceneRequest { frames: frames.clone(), max_point_count: 5000, ..Default::default() };
    let read = client.read_scene(asked.clone()).await.unwrap().into_inner();
    let plan = server.client().await.plan_grasps(&request(GRIPPER)).await.unwrap();
    let (field, stats) = (read.contact_field.unwrap(), plan.stats.unwrap());
    assert_eq!(read.workspace, plan.workspace);
    assert_eq!(field.certainties.len(), usize::try_from(stats.focal_contact_count).unwrap());
    assert_eq!(
        (field.contacts_m.len(), field.inward.len()),
        (3 * field.certainties.len(), 3 * field.certainties.len())
    );
    assert_eq!(field.centroid_weights.len(), usize::try_from(stats.centered_centroid_count).unwrap());
    assert_eq!(read.estimator, "geometric");
    assert!(field.certainties.iter().all(|c| (0.0..=1.0).contains(c)) && !field.certainties.is_empty());
    for direction in field.inward.chunks(3) {
        assert!((direction.iter().map(|x| x * x).sum::<f32>() - 1.0).abs() < 1e-3, "{direction:?}");
    }
    let [points] = &read.points[..] else { panic!("{} frames", read.points.len()) };
    let count = usize::try_from(points.width * points.height).unwrap();
    assert!(count <= 5000 && points.points_m.len() == 3 * count && count > 1000, "{count}");
    // No points where none were asked for; and what is not there is named.
    let none = v1::ReadSceneRequest { max_point_count: 0, ..asked.clone() };
    assert!(client.read_scene(none).await.unwrap().into_inner().points.is_empty());
    let missing =
        client.read_scene(v1::ReadSceneRequest { frames: Vec::new(), ..asked.clone() }).await.unwrap_err();
    assert!(missing.message().starts_with("frames: "), "{missing:?}");
    let many =
        client.read_scene(v1::ReadSceneRequest { max_point_count: 1_000_001, ..asked }).await.unwrap_err();
    assert!(many.message().contains("max_point_count"), "{many:?}");
}

#[tokio::test]
async fn other_sites_and_names_get_nothing() {
    let server = TestServer::start_with(with_page()).await;
    let asked = v1::ListHandsRequest::default();
    for (headers, status) in [
        ("Host: evil.example\r\n", "http/1.1 421"),
        ("Origin: http://evil.example\r\n", "http/1.1 403"),
        ("Sec-Fetch-Site: cross-site\r\n", "http/1.1 403"),
    ] {
        let (head, body) = get(server.addr, "/metrics", headers).await;
        assert!(head.starts_with(status), "{headers}: {head}");
        assert!(!String::from_utf8_lossy(&body).contains("graspd_"));
        if !headers.starts_with("Host") {
            let (head, messages, _) = web_call(server.addr, "HandService/ListHands", &asked, headers).await;
            assert!(head.starts_with(status) && messages.is_empty(), "{headers}: {head}");
        }
    }
    // Others may link to the page.
    assert!(get(server.addr, "/", "Sec-Fetch-Site: cross-site\r\n").await.0.starts_with("http/1.1 200"));
    // What a page may ask before it calls another site is answered with no.
    let ask = format!(
        "OPTIONS /graspd.v1.HandService/ListHands HTTP/1.1\r\nHost: {}\r\nOrigin: http://evil.example\r\n\
         Access-Control-Request-Method: POST\r\nConnection: close\r\n\r\n",
        server.addr
    );
    let (head, _) = answer(server.addr, ask.as_bytes()).await;
    assert!(head.starts_with("http/1.1 403") && !head.contains("access-control-allow"), "{head}");
    let long = format!("x-long: {}\r\n", "y".repeat(20_000));
    assert!(get(server.addr, "/", &long).await.0.starts_with("http/1.1 431"));
}

#[tokio::test]
async fn roles_hold_for_the_page_and_without_it_there_is_none() {
    let server = TestServer::start_with(ServerConfig { access: tokens(), ..with_page() }).await;
    assert!(
        get(server.addr, "/", "").await.0.starts_with("http/1.1 200"),
        "the page itself asks for the token"
    );
    assert!(get(server.addr, "/metrics", "").await.0.starts_with("http/1.1 401"));
    let viewer = "authorization: Bearer viewer\r\n";
    assert!(get(server.addr, "/metrics", viewer).await.0.starts_with("http/1.1 200"));
    let list = v1::ListHandsRequest::default();
    let said = |(head, _, trailers): (String, Vec<Vec<u8>>, String)| head + &trailers;
    let none = said(web_call(server.addr, "HandService/ListHands", &list, "").await);
    assert!(none.contains("grpc-status: 16"), "{none}");
    let listed = said(web_call(server.addr, "HandService/ListHands", &list, viewer).await);
    assert!(listed.contains("grpc-status:0"), "{listed}");
    let scene = v1::ReadSceneRequest { frames: vec![BoxScene::default().frame()], ..Default::default() };
    let forbidden = said(web_call(server.addr, "PlannerService/ReadScene", &scene, viewer).await);
    assert!(forbidden.contains("grpc-status: 7"), "{forbidden}");
    let controller = "authorization: Bearer controller\r\n";
    let read = said(web_call(server.addr, "PlannerService/ReadScene", &scene, controller).await);
    assert!(read.contains("grpc-status:0"), "{read}");

    let without = TestServer::start().await;
    let (head, body) = get(without.addr, "/", "").await;
    assert!(!head.contains("200") && !String::from_utf8_lossy(&body).contains("<html"), "{head}");
}

/// A browser, if there is one.
fn browser() -> Option<PathBuf> {
    let named = std::env::var_os("GRASPD_BROWSER").map(PathBuf::from);
    let known = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"];
    let path = std::env::var_os("PATH").unwrap_or_default();
    let on_path = std::env::split_paths(&path).flat_map(|folder| known.map(|name| folder.join(name)));
    named.into_iter().chain(on_path).find(|program| program.is_file())
}

fn has_python() -> bool {
    Command::new("python3").arg("--version").output().is_ok_and(|said| said.status.success())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_person_uses_the_page_in_a_browser() {
    let (Some(browser), true) = (browser(), has_python()) else {
        let required = std::env::var(REQUIRED).is_ok_and(|v| !matches!(&v[..], "" | "0"));
        assert!(!required, "{REQUIRED} is set and there is no Chromium, or no python3");
        eprintln!("skipped: no Chromium (or GRASPD_BROWSER), or no python3");
        return;
    };
    // Two plans to replay.
    let scratch = crate::recording::Scratch::new();
    let recorded = TestServer::start_with(crate::recording::config(&scratch.0, 1.0)).await;
    let client = recorded.client().await;
    for hand in [GRIPPER, "leap"] {
        client.plan_grasps(&request(hand)).await.unwrap();
    }
    drop(client);
    crate::recording::stop(recorded).await;
    let recording = graspd_recording::files(&scratch.0).unwrap().remove(0);

    let estimators = || Estimators::new(std::sync::Arc::new(Geometric), Vec::new());
    let server = TestServer::start_with(ServerConfig { estimators: estimators(), ..with_page() }).await;
    let guarded =
        TestServer::start_with(ServerConfig { access: tokens(), estimators: estimators(), ..with_page() })
            .await;
    let authority = crate::security::Authority::new("page");
    let tls = authority.files(false);
    let key = KeyPair::from_pem(&std::fs::read_to_string(&tls.key).unwrap()).unwrap();
    let key = ring::digest::digest(&ring::digest::SHA256, &key.subject_public_key_info());
    let key = base64::engine::general_purpose::STANDARD.encode(key);
    let config = ServerConfig { tls: Some(tls), access: tokens(), estimators: estimators(), ..with_page() };
    let encrypted = TestServer::start_with(config).await;
    let encrypted_url = format!("https://localhost:{}", encrypted.addr.port());
    let (url, guarded_url) = (server.endpoint(), guarded.endpoint());
    let out = Path::new(env!("CARGO_TARGET_TMPDIR")).join("page");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("browser/page.py");
    let used = tokio::task::spawn_blocking(move || {
        Command::new("python3")
            .arg("-B")
            .arg(script)
            .args([&browser, &out])
            .args(["--server", &url, "--tokens", &guarded_url, "controller"])
            .args(["--tls", &encrypted_url, &key, "controller", "--assets"])
            .arg(assets())
            .arg("--recording")
            .arg(recording)
            .output()
            .unwrap()
    });
    let used = used.await.unwrap();
    let said = String::from_utf8_lossy(&[used.stdout.as_slice(), &used.stderr].concat()).into_owned();
    assert!(used.status.success() && said.contains("all checks passed"), "{said}");
}
