//! Health, reflection, refused addresses, and the end of a server.

use std::net::SocketAddr;
use std::time::Duration;

use graspd_client::{Client, ClientConfig, Code, RetryPolicy};
use graspd_server::{ServeError, Server, ServerConfig};
use graspd_tests::{STALLS, TestServer};
use tokio_stream::StreamExt as _;
use tonic::transport::Channel;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;
use tonic_reflection::pb::v1::ServerReflectionRequest;
use tonic_reflection::pb::v1::server_reflection_client::ServerReflectionClient;
use tonic_reflection::pb::v1::server_reflection_request::MessageRequest;
use tonic_reflection::pb::v1::server_reflection_response::MessageResponse;

use crate::{call_error, request_with};

async fn channel(server: &TestServer) -> Channel {
    Channel::from_shared(server.endpoint()).unwrap().connect().await.unwrap()
}

#[tokio::test]
async fn every_service_says_that_it_serves() {
    let server = TestServer::start().await;
    let mut health = HealthClient::new(channel(&server).await);
    for service in ["", "graspd.v1.PlannerService", "graspd.v1.HandService"] {
        let request = HealthCheckRequest { service: service.to_owned() };
        let status = health.check(request).await.unwrap().into_inner().status();
        assert_eq!(status, ServingStatus::Serving, "{service:?}");
    }
    let unknown = HealthCheckRequest { service: "graspd.v1.Nothing".to_owned() };
    assert_eq!(health.check(unknown).await.unwrap_err().code(), Code::NotFound);
}

#[tokio::test]
async fn reflection_lists_the_services_and_their_files() {
    let server = TestServer::start().await;
    let mut reflection = ServerReflectionClient::new(channel(&server).await);
    let ask = |message| ServerReflectionRequest { host: String::new(), message_request: Some(message) };
    let questions = vec![
        ask(MessageRequest::ListServices(String::new())),
        ask(MessageRequest::FileContainingSymbol("graspd.v1.PlannerService".to_owned())),
    ];
    let mut answers =
        reflection.server_reflection_info(tokio_stream::iter(questions)).await.unwrap().into_inner();
    let Some(MessageResponse::ListServicesResponse(list)) =
        answers.next().await.unwrap().unwrap().message_response
    else {
        panic!("expected a list of services");
    };
    let names: Vec<_> = list.service.iter().map(|s| s.name.as_str()).collect();
    for service in ["graspd.v1.PlannerService", "graspd.v1.HandService", "grpc.health.v1.Health"] {
        assert!(names.contains(&service), "{names:?}");
    }
    let file = answers.next().await.unwrap().unwrap().message_response;
    assert!(
        matches!(file, Some(MessageResponse::FileDescriptorResponse(f)) if !f.file_descriptor_proto.is_empty())
    );
}

#[tokio::test]
async fn reflection_also_speaks_its_older_protocol() {
    use tonic_reflection::pb::v1alpha::server_reflection_client::ServerReflectionClient;
    use tonic_reflection::pb::v1alpha::server_reflection_request::MessageRequest;
    use tonic_reflection::pb::v1alpha::server_reflection_response::MessageResponse;

    let server = TestServer::start().await;
    let mut reflection = ServerReflectionClient::new(channel(&server).await);
    let question = tonic_reflection::pb::v1alpha::ServerReflectionRequest {
        host: String::new(),
        message_request: Some(MessageRequest::ListServices(String::new())),
    };
    let questions = tokio_stream::iter([question]);
    let mut answers = reflection.server_reflection_info(questions).await.unwrap().into_inner();
    let Some(MessageResponse::ListServicesResponse(list)) =
        answers.next().await.unwrap().unwrap().message_response
    else {
        panic!("expected a list of services");
    };
    for service in ["graspd.v1.PlannerService", "graspd.v1.HandService"] {
        assert!(list.service.iter().any(|s| s.name == service), "{list:?}");
    }
}

#[tokio::test]
async fn an_address_that_others_can_reach_is_refused() {
    let config = |insecure_listen| ServerConfig {
        listen: SocketAddr::from(([0, 0, 0, 0], 0)),
        insecure_listen,
        ..TestServer::config()
    };
    let error = Server::bind(config(false)).await.unwrap_err();
    assert!(matches!(error, ServeError::NotLoopback { .. }));
    assert!(error.to_string().contains("--insecure-listen"), "{error}");
    assert!(Server::bind(config(true)).await.is_ok());
    let taken = TestServer::start().await;
    let again = ServerConfig { listen: taken.addr, ..TestServer::config() };
    assert!(matches!(Server::bind(again).await, Err(ServeError::Bind { .. })));
}

#[tokio::test]
async fn a_server_that_ends_finishes_what_runs_and_takes_nothing_new() {
    let server = TestServer::start().await;
    let (addr, endpoint) = (server.addr, server.endpoint());
    let mut watch = HealthClient::new(channel(&server).await)
        .watch(HealthCheckRequest { service: String::new() })
        .await
        .unwrap()
        .into_inner();
    assert_eq!(watch.next().await.unwrap().unwrap().status(), ServingStatus::Serving);
    let client = server.client().await;
    let mut slow = request_with(STALLS);
    slow.options.as_mut().unwrap().budget = Some("1.5s".parse().unwrap());
    let running = tokio::spawn(async move { client.plan_grasps(&slow).await });
    server.busy().await;
    let ended = server.stop();
    assert_eq!(watch.next().await.unwrap().unwrap().status(), ServingStatus::NotServing);
    drop(watch);
    let answer = running.await.unwrap().unwrap();
    assert!(answer.stats.unwrap().budget_exhausted);
    ended.await.unwrap().unwrap();
    let config = ClientConfig {
        retry: RetryPolicy::NONE,
        connect_timeout: Duration::from_millis(200),
        ..ClientConfig::new(endpoint)
    };
    assert!(Client::connect(config).await.is_err(), "nobody listens on {addr} any more");
}

#[tokio::test]
async fn calls_that_outlive_the_grace_period_are_cancelled() {
    let config = ServerConfig { drain_grace: Duration::from_millis(200), ..TestServer::config() };
    let server = TestServer::start_with(config).await;
    let client = server.client().await;
    let running = tokio::spawn(async move { client.plan_grasps(&request_with(STALLS)).await });
    server.busy().await;
    let load = server.load.clone();
    let ended = server.stop();
    let error = call_error(running.await.unwrap());
    assert!(matches!(error.code, Code::Cancelled | Code::Unavailable), "{error:?}");
    tokio::time::timeout(Duration::from_secs(30), ended).await.unwrap().unwrap().unwrap();
    // The server does not wait for a job that it has told to stop; the job goes at its next look.
    let gone = async {
        while load.running() + load.waiting() > 0 {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    };
    tokio::time::timeout(Duration::from_secs(10), gone).await.unwrap();
}
