//! What those see who watch over a server: metrics, liveness, readiness.

use std::net::SocketAddr;
use std::time::Duration;

use graspd_client::Code;
use graspd_server::ServerConfig;
use graspd_server::security::Limits;
use graspd_tests::{STALLS, TestServer};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

use crate::{GRIPPER, call_error, request, request_with};

/// The status line and the body of a GET.
pub(crate) async fn get(addr: SocketAddr, path: &str) -> (String, String) {
    let mut stream = TcpStream::connect(addr).await.unwrap();
    let request = format!("GET {path} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).await.unwrap();
    let mut text = String::new();
    stream.read_to_string(&mut text).await.unwrap();
    let (head, body) = text.split_once("\r\n\r\n").unwrap();
    (head.lines().next().unwrap().to_owned(), body.to_owned())
}

/// The value of a line of the metrics.
fn value(text: &str, name: &str) -> f64 {
    let line = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' '));
    line.unwrap_or_else(|| panic!("{name} is not in\n{text}")).parse().unwrap()
}

fn config() -> ServerConfig {
    ServerConfig { metrics_listen: Some(SocketAddr::from(([127, 0, 0, 1], 0))), ..TestServer::config() }
}

#[tokio::test]
async fn calls_are_counted_by_how_they_end() {
    let limits = Limits { calls_per_caller: 2, ..Limits::default() };
    let server = TestServer::start_with(ServerConfig { limits, ..config() }).await;
    let metrics = server.metrics.unwrap();
    let client = server.client().await;
    client.plan_grasps(&request(GRIPPER)).await.unwrap();
    assert_eq!(call_error(client.plan_grasps(&request("nobody")).await).code, Code::NotFound);
    let mut stream = client.stream_grasps(&request(GRIPPER)).await.unwrap();
    while stream.next().await.unwrap().is_some() {}
    let late = client.with_timeout(Duration::from_millis(400));
    call_error(late.plan_grasps(&request_with(STALLS)).await);
    let dropped = {
        let client = client.clone();
        tokio::spawn(async move { client.plan_grasps(&request_with(STALLS)).await })
    };
    server.busy().await;
    let (_, text) = get(metrics, "/metrics").await;
    assert_eq!(value(&text, "graspd_calls_in_flight"), 1.0);
    assert_eq!(value(&text, "graspd_jobs_running"), 1.0);
    dropped.abort();
    server.idle_within(Duration::from_secs(10)).await;
    tokio::time::sleep(Duration::from_millis(50)).await;
    let (status, text) = get(metrics, "/metrics").await;
    assert_eq!(status, "HTTP/1.1 200 OK");
    let calls = |method: &str, code: &str| {
        value(&text, &format!("graspd_calls_total{{method=\"{method}\",code=\"{code}\"}}"))
    };
    assert_eq!(calls("PlanGrasps", "OK"), 1.0);
    assert_eq!(calls("PlanGrasps", "NOT_FOUND"), 1.0);
    assert_eq!(calls("PlanGrasps", "DEADLINE_EXCEEDED"), 1.0);
    assert_eq!(calls("PlanGrasps", "CANCELLED"), 1.0);
    assert_eq!(calls("StreamGrasps", "OK"), 1.0);
    assert_eq!(value(&text, "graspd_calls_in_flight"), 0.0);
    assert_eq!(value(&text, "graspd_scenes_read"), 2.0);
    assert_eq!(value(&text, "graspd_ready"), 1.0);
    let plans = format!("graspd_plans_total{{hand=\"{GRIPPER}\",outcome=\"grasps\"}}");
    assert_eq!(value(&text, &plans), 2.0);
    for stage in ["decode", "volume", "estimate", "refine", "optimize", "rank"] {
        let count = format!("graspd_stage_duration_seconds_count{{stage=\"{stage}\"}}");
        assert_eq!(value(&text, &count), 2.0, "{stage}");
    }
    assert!(text.ends_with("# EOF\n"));
    // No address, no token: callers are not in the metrics.
    assert!(!text.contains("127.0.0.1"), "{text}");
}

#[tokio::test]
async fn a_server_is_ready_until_it_drains() {
    let server = TestServer::start_with(config()).await;
    let metrics = server.metrics.unwrap();
    assert_eq!(get(metrics, "/readyz").await.0, "HTTP/1.1 200 OK");
    assert_eq!(get(metrics, "/livez").await.0, "HTTP/1.1 200 OK");
    assert_eq!(get(metrics, "/").await.0, "HTTP/1.1 404 Not Found");
    let client = server.client().await;
    let mut slow = request_with(STALLS);
    slow.options.as_mut().unwrap().budget = Some("1.5s".parse().unwrap());
    let running = tokio::spawn(async move { client.plan_grasps(&slow).await });
    server.busy().await;
    let ended = server.stop();
    tokio::time::sleep(Duration::from_millis(200)).await;
    assert_eq!(get(metrics, "/readyz").await.0, "HTTP/1.1 503 Service Unavailable");
    assert_eq!(get(metrics, "/livez").await.0, "HTTP/1.1 200 OK");
    running.await.unwrap().unwrap();
    ended.await.unwrap().unwrap();
}
