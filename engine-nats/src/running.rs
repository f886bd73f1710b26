//! One job at a worker: from its message to its acknowledgement.

use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use async_nats::client::RequestErrorKind;
use async_nats::jetstream::message::Acker;
use async_nats::jetstream::{AckKind, Message};
use async_nats::{HeaderMap, Request};
use bytes::Bytes;
use futures_util::StreamExt as _;
use graspd_server::jobs::{Job, JobEngine, JobError};
use tokio::task::JoinHandle;
use tonic::Status;

use crate::cancelled::Cancelled;
use crate::clock;
use crate::connection::Broker;
use crate::hands::NatsHands;
use crate::requests;
use crate::settings::{BROKER_PATIENCE, PROGRESS};
use crate::wire::{Posted, Reply, Said};

/// What a worker's slots share.
pub(crate) struct Shared {
    pub(crate) broker: Broker,
    pub(crate) engine: Arc<dyn JobEngine>,
    pub(crate) hands: Arc<NatsHands>,
    pub(crate) cancelled: Mutex<Cancelled>,
    /// Names of jobs as they are cancelled.
    pub(crate) cancellations: tokio::sync::broadcast::Sender<Arc<str>>,
    /// The broker's clock minus this machine's, microseconds.
    pub(crate) clock_offset_us: AtomicI64,
}

impl Shared {
    /// How old a message is.
    fn age(&self, published_ns: i128) -> Duration {
        clock::age(published_ns, self.clock_offset_us.load(Ordering::Relaxed))
    }

    fn is_cancelled(&self, job: &str) -> bool {
        self.cancelled.lock().unwrap_or_else(PoisonError::into_inner).contains(job)
    }
}

/// Says every 100 ms that somebody is at the job.
struct Progress(JoinHandle<()>);

impl Progress {
    fn begin(acker: Arc<Acker>) -> Self {
        Self(tokio::spawn(async move {
            let mut ticks = tokio::time::interval(PROGRESS);
            ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
            loop {
                ticks.tick().await;
                acker.ack_with(AckKind::Progress).await.ok();
            }
        }))
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.0.abort();
    }
}

/// How a job ended at this worker.
enum Ended {
    /// Its front has heard the last reply, or is gone.
    Done,
    /// Its front has cancelled it, and has taken it out of the stream itself.
    Cancelled,
    /// The last reply could not be delivered: somebody else may.
    Undelivered,
}

/// Plans a job and acknowledges it when its front has the last reply. Given back where `leaving` is set before.
pub(crate) async fn run(shared: &Shared, message: Message, leaving: tokio::sync::watch::Receiver<bool>) {
    let fetched = Instant::now();
    let info = message.info().map(|info| (info.published.unix_timestamp_nanos(), info.delivered));
    let Ok((published, delivered)) = info else { return };
    let age = shared.age(published);
    let (message, acker) = message.split();
    let acker = Arc::new(acker);
    let _progress = Progress::begin(Arc::clone(&acker));
    let headers = message.headers.unwrap_or_default();
    let mut posted = match Posted::read(&headers, message.payload) {
        Ok(posted) => posted,
        Err(error) => {
            tracing::error!(%error, "a job that is none");
            acker.ack_with(AckKind::Term).await.ok();
            return;
        }
    };
    let attempt = u64::try_from(delivered).unwrap_or(1);
    let id = posted.id.clone();
    let waited_ms = age.as_secs_f64() * 1e3;
    tracing::info!(job = id, attempt, waited_ms, method = posted.job.kind.name(), "job");
    // Listened to before it is asked, so that no cancellation is lost between.
    let cancellations = shared.cancellations.subscribe();
    let ended = if shared.is_cancelled(&id) {
        Ended::Cancelled
    } else {
        posted.job.age += age + fetched.elapsed();
        let work = work(shared, posted, attempt);
        tokio::select! {
            biased;
            () = cancelled(cancellations, &id) => Ended::Cancelled,
            () = left(leaving) => Ended::Undelivered,
            ended = work => ended,
        }
    };
    let ended_ms = fetched.elapsed().as_secs_f64() * 1e3;
    match ended {
        Ended::Done => {
            tracing::info!(job = id, attempt, ended_ms, "job ended");
            // Confirmed, so that the next job is fetched by a worker that holds none.
            tokio::time::timeout(BROKER_PATIENCE, acker.double_ack()).await.ok();
        }
        Ended::Cancelled => {
            tracing::info!(job = id, attempt, ended_ms, "job cancelled");
            acker.ack().await.ok();
        }
        Ended::Undelivered => {
            tracing::warn!(job = id, attempt, ended_ms, "job given back");
            acker.ack_with(AckKind::Nak(None)).await.ok();
            shared.broker.client.publish(shared.broker.names.bell(), Bytes::new()).await.ok();
        }
    }
}

/// Ready when the job is cancelled.
async fn cancelled(mut cancellations: tokio::sync::broadcast::Receiver<Arc<str>>, job: &str) {
    loop {
        match cancellations.recv().await {
            Ok(name) if *name == *job => return,
            // Overlooked ones are planned to their end for nothing.
            Ok(_) | Err(tokio::sync::broadcast::error::RecvError::Lagged(_)) => {}
            Err(tokio::sync::broadcast::error::RecvError::Closed) => std::future::pending().await,
        }
    }
}

/// Ready when the worker leaves without waiting.
async fn left(mut leaving: tokio::sync::watch::Receiver<bool>) {
    if leaving.wait_for(|leaving| *leaving).await.is_err() {
        std::future::pending().await
    }
}

async fn work(shared: &Shared, mut posted: Posted, attempt: u64) -> Ended {
    let left = posted.job.left();
    let until = left.and_then(|left| Instant::now().checked_add(left));
    let to =
        Delivery { shared, subject: shared.broker.names.replies(&posted.front, &posted.id), attempt, until };
    if left.is_some_and(|left| left.is_zero()) {
        return to.deliver(Said::Error(Status::deadline_exceeded("the deadline passed in the broker"))).await;
    }
    if let Some(object) = posted.object.take() {
        match requests::get(&shared.broker, &object).await {
            Ok(request) => posted.job.request = request,
            Err(problem) => {
                let status = Status::unavailable(format!("the request's object cannot be read: {problem}"));
                return to.deliver(Said::Error(status)).await;
            }
        }
    }
    for hand in &posted.job.hands {
        // A hand that has just been created may not have arrived here by itself.
        shared.hands.have(hand).await;
    }
    let last = match plan(shared, posted.job, &to).await {
        Ok(last) => last,
        Err(ended) => return ended,
    };
    to.deliver(last).await
}

/// Plans; all replies but the last are delivered on the way.
async fn plan(shared: &Shared, job: Job, to: &Delivery<'_>) -> Result<Said, Ended> {
    let kind = job.kind;
    let mut replies = match shared.engine.submit(job).await {
        Ok(replies) => replies,
        Err(error) => return Ok(Said::Error(refusal(error))),
    };
    while let Some(reply) = replies.next().await {
        let said = match reply {
            Ok(bytes) => Said::Response(bytes),
            Err(error) => Said::Error(refusal(error)),
        };
        if said.is_last(kind) {
            return Ok(said);
        }
        if let ended @ Ended::Undelivered = to.deliver(said).await {
            return Err(ended);
        }
    }
    Ok(Said::End)
}

fn refusal(error: JobError) -> Status {
    match error {
        JobError::Refused(status) => status,
        other => Status::unavailable(other.to_string()),
    }
}

/// Where replies of a job go.
struct Delivery<'a> {
    shared: &'a Shared,
    subject: String,
    attempt: u64,
    until: Option<Instant>,
}

impl Delivery<'_> {
    /// Says it until the front has confirmed that it has heard, nobody is there, or the deadline has passed.
    async fn deliver(&self, said: Said) -> Ended {
        let limit = self.shared.broker.largest_message();
        let said = match said {
            Said::Response(bytes) if bytes.len() > limit => Said::Error(Status::internal(format!(
                "the answer has {} bytes and the broker takes {limit}; raise its max_payload or ask for fewer grasps",
                bytes.len()
            ))),
            said => said,
        };
        let (headers, payload) = Reply { attempt: self.attempt, said }.message();
        loop {
            match self.once(&headers, &payload).await {
                Ok(()) => return Ended::Done,
                // The front is gone, or has lost the broker and has told its callers so.
                Err(RequestErrorKind::NoResponders) => return Ended::Done,
                Err(error) => tracing::warn!(subject = self.subject, %error, "a reply is not confirmed"),
            }
            if self.until.is_some_and(|until| Instant::now() >= until) {
                return Ended::Done;
            }
            self.shared.broker.here().await;
        }
    }

    async fn once(&self, headers: &HeaderMap, payload: &Bytes) -> Result<(), RequestErrorKind> {
        let request =
            Request::new().headers(headers.clone()).payload(payload.clone()).timeout(Some(BROKER_PATIENCE));
        let sent = self.shared.broker.client.send_request(self.subject.clone(), request).await;
        sent.map(drop).map_err(|error| error.kind())
    }
}
