//! The front: publishes jobs, hears what workers say of them, and cancels what nobody waits for.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use async_nats::jetstream::context::PublishErrorKind;
use async_nats::jetstream::{self, ErrorCode, message::PublishMessage};
use bytes::Bytes;
use futures_util::StreamExt as _;
use graspd_server::jobs::{Job, JobEngine, JobError, JobKind, Presence, Replies};
use tokio::sync::{mpsc, watch};

use crate::connection::{Broker, Losses};
use crate::pending::{Heard, Pending};
use crate::settings::{MAX_AGE, MAX_DELIVER};
use crate::wire::{Posted, Reply, Said, is_last};
use crate::{presence, requests, setup};

/// Where the queue was full, a place is likely to be free after this.
const RETRY_AFTER: Duration = Duration::from_millis(250);

/// Plans on the workers of a broker.
#[derive(Debug)]
pub struct NatsEngine {
    broker: Broker,
    /// This front's name in subjects.
    front: String,
    pending: Arc<Pending>,
    presence: watch::Receiver<Presence>,
}

impl NatsEngine {
    /// Begins to hear replies. Comes back by itself when the broker was away.
    ///
    /// # Errors
    /// When the broker does not take the subscriptions.
    pub async fn start(broker: &Broker) -> Result<Arc<Self>, String> {
        let front = broker.unique();
        let pending: Arc<Pending> = Arc::default();
        let client = &broker.client;
        // The client renews its subscriptions when the broker is back.
        let mut replies =
            client.subscribe(broker.names.replies(&front, "*")).await.map_err(|e| e.to_string())?;
        let mut given_up = client.subscribe(broker.names.given_up()).await.map_err(|e| e.to_string())?;
        let (heard, answering) = (Arc::clone(&pending), broker.clone());
        tokio::spawn(async move {
            while let Some(message) = replies.next().await {
                hear(&heard, &answering, message).await;
            }
        });
        let heard = Arc::clone(&pending);
        tokio::spawn(async move {
            while let Some(message) = given_up.next().await {
                let news: Option<GivenUp> = serde_json::from_slice(&message.payload).ok();
                if let Some(news) = news {
                    heard.give_up(news.stream_seq);
                }
            }
        });
        let mut losses = broker.losses();
        let renewed = broker.clone();
        tokio::spawn(async move {
            loop {
                losses.recovered().await;
                // What was in the broker's memory is gone if it was started anew.
                while let Err(problem) = setup::ensure(&renewed).await {
                    tracing::warn!(problem, "the broker is back and not ready");
                    tokio::time::sleep(RETRY_AFTER).await;
                }
                tracing::info!("the broker is back");
            }
        });
        let mut known = HashMap::new();
        let mut now = Presence::default();
        presence::look(broker, &mut known, &mut now).await;
        let (tell, presence) = watch::channel(now.clone());
        let (looked_at, counted) = (broker.clone(), Arc::clone(&pending));
        tokio::spawn(async move {
            while !tell.is_closed() {
                tokio::select! {
                    () = looked_at.changed() => {}
                    () = tokio::time::sleep(presence::ASKED_EVERY) => {}
                }
                presence::look(&looked_at, &mut known, &mut now).await;
                now.redelivered = counted.redelivered();
                tell.send_if_modified(|told| {
                    let is_news = *told != now;
                    told.clone_from(&now);
                    is_news
                });
            }
        });
        Ok(Arc::new(Self { broker: broker.clone(), front, pending, presence }))
    }

    /// Publishes the job; the number that the stream gave it.
    async fn publish(&self, posted: &Posted) -> Result<u64, JobError> {
        let job = &posted.job;
        let hand = match job.hands.as_slice() {
            [hand] => hand.id.as_str(),
            _ => "several",
        };
        let subject = self.broker.names.jobs(job.priority.name(), hand);
        let payload = if posted.object.is_some() { Bytes::new() } else { job.request.clone() };
        let message =
            PublishMessage::build().payload(payload).headers(posted.headers()).message_id(&posted.id);
        let acked = match self.broker.jetstream.send_publish(subject, message).await {
            Ok(acked) => acked.await,
            Err(error) => Err(error),
        };
        match acked {
            Ok(ack) => Ok(ack.sequence),
            Err(error) if is_full(&error) => {
                Err(JobError::Full { limit: self.broker.queue, retry_after: RETRY_AFTER })
            }
            Err(error) => {
                if error.kind() == PublishErrorKind::StreamNotFound {
                    // Somebody has deleted it: made again for the next call.
                    setup::ensure(&self.broker).await.ok();
                }
                Err(JobError::Away(error.to_string()))
            }
        }
    }
}

/// The broker's news of a job that was delivered too often.
#[derive(Debug, serde::Deserialize)]
struct GivenUp {
    stream_seq: u64,
}

/// What a worker says goes to whoever waits for the job; then the worker hears that it has arrived.
async fn hear(pending: &Pending, broker: &Broker, message: async_nats::Message) {
    let Some(job) = message.subject.rsplit('.').next() else { return };
    match message.headers.as_ref().map(|headers| Reply::read(headers, message.payload.clone())) {
        Some(Ok(reply)) => pending.say(job, reply),
        Some(Err(error)) => tracing::warn!(job, %error, "a reply that is none"),
        None => tracing::warn!(job, "a reply without headers"),
    }
    if let Some(to) = message.reply {
        // Where this is lost the worker says it again.
        broker.client.publish(to, Bytes::from_static(b"heard")).await.ok();
    }
}

/// True where the stream holds as many jobs as it may.
fn is_full(error: &jetstream::context::PublishError) -> bool {
    let source = std::error::Error::source(error);
    let said = source.and_then(|source| source.downcast_ref::<jetstream::Error>());
    said.is_some_and(|said| said.error_code() == ErrorCode::STREAM_STORE_FAILED)
}

#[tonic::async_trait]
impl JobEngine for NatsEngine {
    async fn submit(&self, mut job: Job) -> Result<Replies, JobError> {
        let away = || JobError::Away(format!("no connection to the broker at {}", self.broker.url()));
        let mut losses = self.broker.losses();
        if !self.broker.is_here() {
            return Err(away());
        }
        let id = self.broker.unique();
        // A job that nobody bounds would be forgotten by the broker without a word.
        let left = job.left().unwrap_or(MAX_AGE).min(MAX_AGE);
        job.timeout = Some(job.age + left);
        let kind = job.kind;
        let heard = self.pending.insert(&id, kind == JobKind::StreamGrasps);
        // From here on whoever drops this cancels the job.
        let engine = Handle { broker: self.broker.clone(), pending: Arc::clone(&self.pending) };
        let mut ending = Ending { id: id.clone(), kind, engine, sequence: None, object: false, done: false };
        let too_large = job.request.len() > self.broker.largest_message();
        let posted = Posted { object: too_large.then(|| id.clone()), front: self.front.clone(), id, job };
        let post = async {
            if too_large {
                ending.object = true;
                requests::put(&self.broker, &posted.id, posted.job.request.clone())
                    .await
                    .map_err(JobError::Away)?;
            }
            self.publish(&posted).await
        };
        let posting = tokio::select! {
            biased;
            posted = post => posted,
            () = losses.lost() => Err(away()),
        };
        let sequence = posting?;
        ending.sequence = Some(sequence);
        self.pending.stored(&posted.id, sequence);
        // Whoever is idle looks at once; whoever is not will.
        self.broker.client.publish(self.broker.names.bell(), Bytes::new()).await.ok();
        let until = tokio::time::Instant::now() + left + RETRY_AFTER;
        Ok(Waiting { heard, losses, ending, until, away: away() }.replies())
    }

    fn presence(&self) -> Option<watch::Receiver<Presence>> {
        Some(self.presence.clone())
    }
}

/// What is needed of the engine after a call's end.
#[derive(Debug, Clone)]
struct Handle {
    broker: Broker,
    pending: Arc<Pending>,
}

/// The end of a job on this side: nobody waits any more, and if the job has not ended, it is cancelled.
#[derive(Debug)]
struct Ending {
    id: String,
    kind: JobKind,
    engine: Handle,
    sequence: Option<u64>,
    /// Its request is in the object store.
    object: bool,
    /// It has ended by itself.
    done: bool,
}

impl Drop for Ending {
    fn drop(&mut self) {
        self.engine.pending.remove(&self.id);
        let (done, object) = (self.done, self.object);
        if (done && !object) || tokio::runtime::Handle::try_current().is_err() {
            return;
        }
        let (broker, id, sequence) = (self.engine.broker.clone(), self.id.clone(), self.sequence);
        tokio::spawn(async move {
            if !done {
                // Whoever plans it stops; whoever gets it later drops it.
                broker.client.publish(broker.names.cancel(&id), Bytes::new()).await.ok();
                // It leaves the queue now, so that it takes no place in it.
                if let (Some(sequence), Ok(stream)) =
                    (sequence, broker.jetstream.get_stream_no_info(broker.names.stream()).await)
                {
                    stream.delete_message(sequence).await.ok();
                }
            }
            if object {
                requests::delete(&broker, &id).await;
            }
        });
    }
}

/// A job's replies, until its end or the loss of the broker.
struct Waiting {
    heard: mpsc::UnboundedReceiver<Heard>,
    losses: Losses,
    ending: Ending,
    until: tokio::time::Instant,
    away: JobError,
}

impl Waiting {
    fn replies(self) -> Replies {
        Box::pin(futures_util::stream::unfold(Some(self), async |waiting| waiting?.next().await))
    }

    /// The next reply, and what is waited for then: nothing after an error.
    async fn next(mut self) -> Option<(Result<Bytes, JobError>, Option<Self>)> {
        let heard = tokio::select! {
            biased;
            heard = self.heard.recv() => heard,
            () = self.losses.lost() => return Some((Err(self.away.clone()), None)),
            // Whoever called knows its own deadline and is gone by then.
            () = tokio::time::sleep_until(self.until) => None,
        };
        match heard {
            Some(Heard::Said(Said::Response(bytes))) => {
                self.ending.done |= is_last(self.ending.kind, &bytes);
                Some((Ok(bytes), Some(self)))
            }
            Some(Heard::Said(Said::End)) => {
                self.ending.done = true;
                None
            }
            Some(Heard::Said(Said::Error(status))) => {
                self.ending.done = true;
                Some((Err(JobError::Refused(status)), None))
            }
            // Dropping this takes the job out of the queue.
            Some(Heard::GivenUp) => Some((Err(JobError::Lost { workers: MAX_DELIVER }), None)),
            None => {
                let late = tonic::Status::deadline_exceeded("no worker has answered in time");
                Some((Err(JobError::Refused(late)), None))
            }
        }
    }
}
