//! What those see who watch over a server: metrics, liveness, readiness.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use graspd_client::Code;
use graspd_planner::estimator::Geometric;
use graspd_proto::v1::planner_service_client::PlannerServiceClient;
use graspd_server::Estimators;
use graspd_server::ServerConfig;
use graspd_server::security::Limits;
use graspd_tests::{PANICS, Panics, STALLS, TestServer};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};
use tonic::transport::Channel;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;

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

async fn channel(server: &TestServer) -> Channel {
    Channel::from_shared(server.endpoint()).unwrap().connect().await.unwrap()
}

async fn health(server: &TestServer, service: &str) -> Result<ServingStatus, Code> {
    let request = HealthCheckRequest { service: service.to_owned() };
    let answer = HealthClient::new(channel(server).await).check(request).await;
    answer.map(|a| a.into_inner().status()).map_err(|status| status.code())
}

#[tokio::test]
async fn each_hand_has_a_health_of_its_own() {
    let server = TestServer::start().await;
    let gripper = format!("hand/{GRIPPER}");
    assert_eq!(health(&server, &gripper).await, Ok(ServingStatus::Serving));
    assert_eq!(health(&server, "hand/mine").await, Err(Code::NotFound));
    let client = server.client().await;
    let files = graspd_hands::library::files(GRIPPER).unwrap().files;
    client.create_hand("mine", &files, false).await.unwrap();
    assert_eq!(health(&server, "hand/mine").await, Ok(ServingStatus::Serving));
    client.delete_hand("hands/mine").await.unwrap();
    assert_eq!(health(&server, "hand/mine").await, Err(Code::NotFound));
    // A hand whose jobs crash every time, until one does not.
    for crashes in 1..=3 {
        assert_eq!(health(&server, &gripper).await, Ok(ServingStatus::Serving), "{crashes}");
        assert_eq!(call_error(client.plan_grasps(&request_with(PANICS)).await).code, Code::Internal);
    }
    assert_eq!(health(&server, &gripper).await, Ok(ServingStatus::NotServing));
    assert_eq!(health(&server, "hand/leap").await, Ok(ServingStatus::Serving));
    assert_eq!(health(&server, "").await, Ok(ServingStatus::Serving));
    client.plan_grasps(&request(GRIPPER)).await.unwrap();
    assert_eq!(health(&server, &gripper).await, Ok(ServingStatus::Serving));
}

#[tokio::test]
async fn a_server_that_cannot_plan_is_not_ready() {
    let estimators = Estimators::new(Arc::new(Panics), vec![Arc::new(Geometric)]);
    let server = TestServer::start_with(ServerConfig { estimators, ..config() }).await;
    for service in ["", "graspd.v1.PlannerService", "hand/leap"] {
        assert_eq!(health(&server, service).await, Ok(ServingStatus::NotServing), "{service:?}");
    }
    let (status, why) = get(server.metrics.unwrap(), "/readyz").await;
    assert_eq!(status, "HTTP/1.1 503 Service Unavailable");
    assert!(why.contains("first plan"), "{why}");
    assert_eq!(get(server.metrics.unwrap(), "/livez").await.0, "HTTP/1.1 200 OK");
}

/// Spans as a collector gets them; the messages are read by hand, so that no mistake is shared with the server.
#[derive(Debug, Clone, PartialEq)]
struct Span {
    trace: Vec<u8>,
    id: Vec<u8>,
    parent: Vec<u8>,
    begin_ns: u64,
    end_ns: u64,
    /// Text and numbers of its attributes.
    attributes: BTreeMap<String, String>,
}

/// The fields of a protobuf message: number, and bytes or a number.
fn fields(mut bytes: &[u8]) -> Vec<(u64, Vec<u8>, u64)> {
    fn varint(bytes: &mut &[u8]) -> u64 {
        let mut value = 0;
        for shift in (0..).step_by(7) {
            let byte = bytes[0];
            *bytes = &bytes[1..];
            value |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return value;
            }
        }
        unreachable!()
    }
    let mut found = Vec::new();
    while !bytes.is_empty() {
        let key = varint(&mut bytes);
        match key & 7 {
            0 => found.push((key >> 3, Vec::new(), varint(&mut bytes))),
            1 => {
                found.push((key >> 3, Vec::new(), u64::from_le_bytes(bytes[..8].try_into().unwrap())));
                bytes = &bytes[8..];
            }
            2 => {
                let length = usize::try_from(varint(&mut bytes)).unwrap();
                found.push((key >> 3, bytes[..length].to_vec(), 0));
                bytes = &bytes[length..];
            }
            wire => panic!("wire type {wire}"),
        }
    }
    found
}

fn inner(message: &[u8], number: u64) -> Vec<Vec<u8>> {
    fields(message).into_iter().filter(|f| f.0 == number).map(|f| f.1).collect()
}

fn spans(export: &[u8]) -> Vec<(String, Span)> {
    let mut all = Vec::new();
    for resource in inner(export, 1) {
        let service = inner(&inner(&resource, 1)[0], 1);
        assert!(service.iter().any(|pair| inner(pair, 1)[0] == b"service.name"));
        for span in inner(&resource, 2).iter().flat_map(|scope| inner(scope, 2)) {
            let one = |number| inner(&span, number).pop().unwrap_or_default();
            let time = |number| fields(&span).iter().find(|f| f.0 == number).unwrap().2;
            let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
            let attribute = |pair: Vec<u8>| {
                let value = fields(&inner(&pair, 2)[0]).remove(0);
                let value = if value.0 == 1 { text(value.1) } else { value.2.to_string() };
                (text(inner(&pair, 1).remove(0)), value)
            };
            let attributes = inner(&span, 9).into_iter().map(attribute).collect();
            let (begin_ns, end_ns) = (time(7), time(8));
            all.push((
                text(one(5)),
                Span { trace: one(1), id: one(2), parent: one(4), begin_ns, end_ns, attributes },
            ));
        }
    }
    all
}

/// A collector: takes what comes and answers that all is well.
async fn collector() -> (String, Arc<Mutex<Vec<(String, Span)>>>) {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    let got: Arc<Mutex<Vec<(String, Span)>>> = Arc::default();
    let kept = Arc::clone(&got);
    tokio::spawn(async move {
        loop {
            let (stream, _) = listener.accept().await.unwrap();
            let kept = Arc::clone(&kept);
            tokio::spawn(async move {
                let mut connection = h2::server::handshake(stream).await.unwrap();
                while let Some(Ok((request, mut respond))) = connection.accept().await {
                    let path = request.uri().path().to_owned();
                    assert_eq!(path, "/opentelemetry.proto.collector.trace.v1.TraceService/Export");
                    let mut body = request.into_body();
                    let kept = Arc::clone(&kept);
                    tokio::spawn(async move {
                        let mut bytes = Vec::new();
                        while let Some(Ok(data)) = body.data().await {
                            body.flow_control().release_capacity(data.len()).unwrap();
                            bytes.extend_from_slice(&data);
                        }
                        // One message, not compressed.
                        assert_eq!(bytes[0], 0);
                        kept.lock().unwrap().extend(spans(&bytes[5..]));
                        let head = http::Response::builder().header("content-type", "application/grpc");
                        let mut send = respond.send_response(head.body(()).unwrap(), false).unwrap();
                        send.send_data(bytes::Bytes::from_static(&[0, 0, 0, 0, 0]), false).unwrap();
                        let mut end = http::HeaderMap::new();
                        end.insert("grpc-status", "0".parse().unwrap());
                        send.send_trailers(end).unwrap();
                    });
                }
            });
        }
    });
    (url, got)
}

#[tokio::test]
async fn a_call_is_traced_through_every_stage() {
    let (url, got) = collector().await;
    let server = TestServer::start_with(ServerConfig { otlp: Some(url), ..TestServer::config() }).await;
    let mut planner = PlannerServiceClient::new(channel(&server).await);
    let traced = |sampled: bool| {
        let mut call = tonic::Request::new(request(GRIPPER));
        let flags = if sampled { "01" } else { "00" };
        let context = format!("00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-{flags}");
        call.metadata_mut().insert("traceparent", context.parse().unwrap());
        call
    };
    // Nobody wants to see this one.
    planner.plan_grasps(traced(false)).await.unwrap();
    let answer = planner.plan_grasps(traced(true)).await.unwrap().into_inner();
    server.stop().await.unwrap().unwrap();
    let began = Instant::now();
    while got.lock().unwrap().iter().all(|(name, _)| !name.contains("PlanGrasps")) {
        assert!(began.elapsed() < Duration::from_secs(20), "no spans");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let got = got.lock().unwrap().clone();
    let trace =
        [0x4b, 0xf9, 0x2f, 0x35, 0x77, 0xb3, 0x4d, 0xa6, 0xa3, 0xce, 0x92, 0x9d, 0x0e, 0x0e, 0x47, 0x36];
    assert!(got.iter().all(|(_, span)| span.trace == trace && span.begin_ns <= span.end_ns));
    let all = |name: &str| got.iter().filter(|(n, _)| n == name).map(|(_, span)| span).collect::<Vec<_>>();
    let one = |name: &str| {
        let found = all(name);
        assert_eq!(found.len(), 1, "{name} in {got:?}");
        found[0]
    };
    let call = one("graspd.v1.PlannerService/PlanGrasps");
    assert_eq!(call.parent, [0x00, 0xf0, 0x67, 0xaa, 0x0b, 0xa9, 0x02, 0xb7]);
    assert_eq!(call.attributes["rpc.grpc.status_code"], "0");
    let (read, search) = (one("read scene"), one("search grasps"));
    assert_eq!(search.attributes["plan_id"], answer.plan_id);
    assert_eq!(search.attributes["hand"], GRIPPER);
    for part in [one("wait"), read, search] {
        assert_eq!(part.parent, call.id);
        assert!(part.begin_ns >= call.begin_ns && part.end_ns <= call.end_ns);
    }
    for (parent, stages) in
        [(read, &["decode", "frame", "volume", "estimate", "refine"][..]), (search, &["optimize", "rank"])]
    {
        for stage in stages {
            let stage = one(stage);
            assert_eq!(stage.parent, parent.id);
            assert!(stage.begin_ns >= parent.begin_ns && stage.end_ns <= parent.end_ns);
        }
    }
}

#[tokio::test]
async fn nobody_waits_for_a_collector_that_is_not_there() {
    // A port on which nobody listens.
    let free = TcpListener::bind("127.0.0.1:0").await.unwrap().local_addr().unwrap();
    let config = ServerConfig { otlp: Some(format!("http://{free}")), ..TestServer::config() };
    let server = TestServer::start_with(config).await;
    server.client().await.plan_grasps(&request(GRIPPER)).await.unwrap();
    tokio::time::timeout(Duration::from_secs(30), server.stop()).await.unwrap().unwrap().unwrap();
    for wrong in ["127.0.0.1:4317", "https://collector:4317", "http://[", ""] {
        let config = ServerConfig { otlp: Some(wrong.to_owned()), ..TestServer::config() };
        let error = graspd_server::Server::bind(config).await.unwrap_err();
        assert!(matches!(error, graspd_server::ServeError::Collector(_)), "{wrong}: {error}");
    }
}
