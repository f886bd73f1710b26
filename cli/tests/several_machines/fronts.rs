//! What a front does with calls before the broker has them: who is refused, who is first; and what it says of itself.

use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use graspd_client::Code;

use crate::installation::{Front, Installation, Process, eventually};
use crate::{error, search, slow, small};

/// A front with an address for those who watch.
fn watched(installation: &Installation) -> (Front, SocketAddr) {
    // Free a moment ago.
    let http = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    (installation.front(&["--metrics-listen", &http.to_string()]), http)
}

/// Status line and body.
fn get(addr: SocketAddr, path: &str) -> (String, String) {
    let mut stream = TcpStream::connect(addr).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    write!(stream, "GET {path} HTTP/1.1\r\nHost: {addr}\r\nConnection: close\r\n\r\n").unwrap();
    let mut text = String::new();
    stream.read_to_string(&mut text).unwrap();
    let (head, body) = text.split_once("\r\n\r\n").unwrap();
    (head.lines().next().unwrap().to_owned(), body.to_owned())
}

/// A metric's value.
fn value(http: SocketAddr, series: &str) -> Option<u64> {
    let (_, text) = get(http, "/metrics");
    // Of a series that may be absent, and has no labels, the braces are written all the same.
    let text = text.replace("{} ", " ");
    text.lines().find_map(|line| line.strip_prefix(series)?.trim().parse().ok())
}

fn ready(http: SocketAddr) -> Result<(), String> {
    match get(http, "/readyz") {
        (status, _) if status.contains("200") => Ok(()),
        (status, why) => {
            assert!(status.contains("503"), "{status}");
            Err(why.trim().to_owned())
        }
    }
}

fn jobs_seen(worker: &Process) -> usize {
    worker.lines_with("waited_ms").len()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_front_is_ready_while_broker_and_workers_are_there_and_tells_how_they_are() {
    let Some(mut installation) = Installation::start("ready") else { return };
    let (front, http) = watched(&installation);
    assert_eq!(ready(http), Err("no worker is there".to_owned()));
    let mut worker = installation.worker();
    worker.wait_for("working");
    eventually("the front is ready", async || ready(http).is_ok()).await;
    let client = front.client().await;
    client.plan_grasps(&small()).await.unwrap();
    let series = |name: &str| value(http, &format!("graspd_engine_{name} "));
    assert_eq!((series("connected"), series("workers"), series("slots")), (Some(1), Some(1), Some(1)));
    let running = r#"graspd_engine_jobs{priority="normal",state="worker"} "#;
    let calling = {
        let client = client.clone();
        tokio::spawn(async move { client.plan_grasps(&slow()).await })
    };
    eventually("a job runs", async || value(http, running) == Some(1)).await;
    // A worker that is killed: another one begins its job again.
    worker.kill();
    let mut second = installation.worker();
    second.wait_for("attempt=2");
    calling.await.unwrap().unwrap();
    eventually("that is counted", async || series("redelivered") == Some(1)).await;

    installation.broker.kill();
    eventually("the front says so", async || ready(http) == Err("the broker is away".to_owned())).await;
    assert_eq!(series("connected"), Some(0));
    installation.restart_broker();
    eventually("the front is ready again", async || ready(http).is_ok()).await;
    assert_eq!(series("reconnects"), Some(1));
    // A worker that is asked to end says goodbye: nobody waits until it has been silent for long.
    second.terminate();
    eventually("no worker is there", async || ready(http) == Err("no worker is there".to_owned())).await;
}

/// Waits until a front knows of this many slots.
async fn with_slots(http: SocketAddr, slots: u64) {
    eventually("the front knows its workers", async || value(http, "graspd_engine_slots ") == Some(slots))
        .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_front_refuses_what_cannot_finish_before_a_worker_has_it() {
    let Some(installation) = Installation::start("admission") else { return };
    let mut worker = installation.worker();
    worker.wait_for("working");
    let (front, http) = watched(&installation);
    with_slots(http, 1).await;
    let client = front.client().await;
    // A search of its whole length, so that it is known how long one takes.
    let whole = |iterations| {
        let mut request = search(64, iterations);
        request.options.as_mut().unwrap().require_complete = true;
        request
    };
    for _ in 0..3 {
        client.plan_grasps(&whole(60)).await.unwrap();
    }
    let before = jobs_seen(&worker);
    // A million times as long as the one that was just made cannot be done within a second.
    let brief = client.with_timeout(Duration::from_secs(1));
    let mut endless = whole(10_000);
    endless.options.as_mut().unwrap().batch_size = 4096;
    let refused = error(brief.plan_grasps(&endless).await);
    assert_eq!(
        (refused.code, refused.reason.as_str()),
        (Code::ResourceExhausted, "CANNOT_FINISH"),
        "{refused}"
    );
    assert!(refused.retry_after.is_some());
    assert_eq!(jobs_seen(&worker), before, "it went to a worker");
    client.plan_grasps(&small()).await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_front_is_fair_to_callers_and_its_queue_is_ordered_and_bounded() {
    const GREEDY: usize = 12;
    let Some(installation) = Installation::start("fair") else { return };
    let mut worker = installation.worker();
    worker.wait_for("working");
    let (front, http) = watched(&installation);
    with_slots(http, 1).await;
    // Callers without a name are told apart by their connections.
    let (greedy, modest) = (front.client().await, front.client().await);
    let mut endless = slow();
    endless.options.as_mut().unwrap().budget = None;
    let blocker = {
        let greedy = greedy.clone();
        tokio::spawn(async move { greedy.plan_grasps(&endless).await })
    };
    eventually("it runs", async || jobs_seen(&worker) == 1).await;
    let answered = Arc::new(AtomicUsize::new(0));
    let many: Vec<_> = (0..GREEDY)
        .map(|_| {
            let (greedy, answered) = (greedy.clone(), Arc::clone(&answered));
            let request = search(64, 200);
            tokio::spawn(async move {
                let answer = greedy.plan_grasps(&request).await;
                answered.fetch_add(1, Ordering::SeqCst);
                answer
            })
        })
        .collect();
    let at_front = r#"graspd_engine_jobs{priority="normal",state="front"} "#;
    // One of them is on its way to the worker, the others wait here.
    eventually("the others wait", async || value(http, at_front) == Some(GREEDY as u64 - 1)).await;
    let last = {
        let modest = modest.clone();
        tokio::spawn(async move { modest.plan_grasps(&search(64, 200)).await })
    };
    eventually("so does the last one", async || value(http, at_front) == Some(GREEDY as u64)).await;
    // What is used of a worker up to now is the greedy one's.
    tokio::time::sleep(Duration::from_millis(500)).await;
    blocker.abort();
    last.await.unwrap().unwrap();
    let before = answered.load(Ordering::SeqCst);
    assert!(before < GREEDY / 2, "{before} of {GREEDY} calls of the greedy one were answered before");
    for call in many {
        call.await.unwrap().unwrap();
    }
    assert_eq!(value(http, at_front), Some(0));
}
