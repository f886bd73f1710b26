//! What a fleet goes through: servers that are restarted one after the other under load, and a thousand connections.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use graspd_client::{Client, ClientConfig, Code, PlanGraspsRequest, PlanOptions, RetryPolicy};
use graspd_proto::v1;
use graspd_proto::v1::planner_service_client::PlannerServiceClient;
use graspd_server::ServerConfig;
use graspd_tests::TestServer;
use tonic::transport::Channel;

use crate::{GRIPPER, request};

/// A search that takes a few milliseconds.
fn small() -> PlanGraspsRequest {
    let options = PlanOptions {
        batch_size: 4,
        scheme: Some(v1::Scheme { iteration_count: 4, penetration_iteration_count: 2 }),
        ..PlanOptions::default()
    };
    PlanGraspsRequest { options: Some(options), ..request(GRIPPER) }
}

/// UNAVAILABLE; or what the transport on this side makes of a connection that has ended, for which gRPC has the same
/// code and this library has others. A status of the server's has no source.
fn is_unavailable(status: &tonic::Status) -> bool {
    status.code() == Code::Unavailable || std::error::Error::source(status).is_some()
}

/// The standard retry policy of gRPC over the servers in turn: four attempts, UNAVAILABLE alone, back-off from 50 ms on.
async fn retried(
    planners: &[PlannerServiceClient<Channel>],
    turn: usize,
    request: &PlanGraspsRequest,
) -> Result<(), tonic::Status> {
    let mut last = tonic::Status::unavailable("no attempt");
    for attempt in 0..4 {
        let mut planner = planners[(turn + attempt) % planners.len()].clone();
        match planner.plan_grasps(request.clone()).await {
            Ok(_) => return Ok(()),
            Err(status) if is_unavailable(&status) => last = status,
            Err(status) => return Err(status),
        }
        tokio::time::sleep(Duration::from_millis(50) * (1 << attempt)).await;
    }
    Err(last)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_rolling_restart_under_load_is_hidden_by_the_standard_retries() {
    let config = |listen| ServerConfig { listen, ..TestServer::config() };
    let mut servers = vec![TestServer::start().await, TestServer::start().await];
    let planners: Vec<_> = servers
        .iter()
        .map(|server| Channel::from_shared(server.endpoint()).unwrap().connect_lazy())
        .map(PlannerServiceClient::new)
        .collect();
    let (done, stop) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicBool::new(false)));
    // Not more at a time than one server alone takes: an overload is another matter.
    let workers: Vec<_> = (0..3)
        .map(|worker| {
            let (planners, done, stop) = (planners.clone(), Arc::clone(&done), Arc::clone(&stop));
            tokio::spawn(async move {
                for call in 0.. {
                    if stop.load(Ordering::Relaxed) {
                        break;
                    }
                    retried(&planners, worker + call, &small()).await?;
                    done.fetch_add(1, Ordering::Relaxed);
                }
                Ok::<_, tonic::Status>(())
            })
        })
        .collect();
    let more = async |count: usize| {
        let (until, began) = (done.load(Ordering::Relaxed) + count, Instant::now());
        while done.load(Ordering::Relaxed) < until {
            if workers.iter().any(tokio::task::JoinHandle::is_finished) {
                // Their results are looked at below.
                return;
            }
            assert!(began.elapsed() < Duration::from_secs(60), "no answers any more");
            tokio::time::sleep(Duration::from_millis(2)).await;
        }
    };
    more(10).await;
    for _ in 0..2 {
        for i in 0..2 {
            let server = servers.remove(i);
            let addr = server.addr;
            // Ends when what runs is finished.
            server.stop().await.unwrap().unwrap();
            more(5).await;
            servers.insert(i, TestServer::start_with(config(addr)).await);
            more(10).await;
        }
    }
    stop.store(true, Ordering::Relaxed);
    for worker in workers {
        worker.await.unwrap().unwrap();
    }
}

/// Files that this process has open.
fn open_files() -> usize {
    std::fs::read_dir("/proc/self/fd").map_or(0, Iterator::count)
}

/// The most that it may.
fn most_files() -> usize {
    let limits = std::fs::read_to_string("/proc/self/limits").unwrap_or_default();
    let line = limits.lines().find_map(|line| line.strip_prefix("Max open files"));
    line.and_then(|line| line.split_whitespace().next()?.parse().ok()).unwrap_or(256)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_thousand_connections_are_served_and_leave_nothing_behind() {
    let server = TestServer::start().await;
    let client = server.client().await;
    client.list_hands().await.unwrap();
    // Both ends are in this process.
    let count = 1000.min(most_files().saturating_sub(open_files() + 200) / 2);
    let before = open_files();
    let connect = |i: usize| {
        let endpoint = server.endpoint();
        async move {
            let config = ClientConfig {
                connect_timeout: Duration::from_secs(60),
                call_timeout: Duration::from_secs(60),
                retry: RetryPolicy::NONE,
                ..ClientConfig::new(endpoint)
            };
            let client = Client::connect(config).await.unwrap();
            assert!(!client.list_hands().await.unwrap().is_empty(), "{i}");
            client
        }
    };
    let mut clients = Vec::with_capacity(count);
    for chunk in (0..count).collect::<Vec<_>>().chunks(100) {
        let mut set = tokio::task::JoinSet::new();
        chunk.iter().for_each(|i| drop(set.spawn(connect(*i))));
        clients.extend(set.join_all().await);
    }
    assert_eq!(clients.len(), count);
    // All of them are there, and planning goes on.
    assert!(open_files() >= before + count, "{} files before, {} now", before, open_files());
    client.plan_grasps(&small()).await.unwrap();
    let first = clients.first().unwrap().plan_grasps(&small()).await.unwrap();
    assert!(first.stats.is_some());
    drop(clients);
    let began = Instant::now();
    // Other tests of this process open and close files too.
    while open_files() > before + count / 10 {
        assert!(began.elapsed() < Duration::from_secs(60), "{} files before, {} now", before, open_files());
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    client.plan_grasps(&small()).await.unwrap();
}
