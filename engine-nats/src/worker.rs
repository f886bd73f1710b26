//! A worker: fetches one job for each of its slots, the most urgent first, and plans them with an engine of its own.

use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, PoisonError};
use std::time::Duration;

use async_nats::jetstream::Message;
use async_nats::jetstream::consumer::PullConsumer;
use futures_util::StreamExt as _;
use graspd_server::jobs::JobEngine;
use graspd_server::pool::Priority;
use tokio::sync::{Notify, broadcast, watch};
use tokio::task::JoinSet;

use crate::clock;
use crate::connection::Broker;
use crate::hands::NatsHands;
use crate::presence::WorkerCard;
use crate::running::{Shared, run};
use crate::settings::{BROKER_PATIENCE, IDLE_POLL};
use crate::setup;

/// A worker says so often that it is there, and compares clocks.
const HEARTBEAT: Duration = Duration::from_secs(5);

/// How a worker is set up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WorkerConfig {
    /// Jobs at the same time: no more than the engine has slots.
    pub slots: usize,
    /// How long running jobs may take to finish at the end; then they are given back.
    pub drain_grace: Duration,
}

/// Plans the jobs of a broker.
pub struct Worker {
    shared: Arc<Shared>,
    config: WorkerConfig,
    /// Its name among workers.
    name: String,
    /// Rung when there may be a job.
    bell: Arc<Notify>,
    listening: JoinSet<()>,
}

impl std::fmt::Debug for Worker {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Worker").field("broker", &self.shared.broker).field("config", &self.config).finish()
    }
}

impl Worker {
    /// Begins to hear of jobs and cancellations; [`Worker::run_until`] fetches them.
    ///
    /// # Errors
    /// When the broker does not take the subscriptions.
    pub async fn start(
        broker: &Broker,
        engine: Arc<dyn JobEngine>,
        hands: Arc<NatsHands>,
        config: WorkerConfig,
    ) -> Result<Self, String> {
        let (cancellations, _) = broadcast::channel(256);
        let shared = Arc::new(Shared {
            broker: broker.clone(),
            engine,
            hands,
            cancelled: Default::default(),
            cancellations,
            clock_offset_us: AtomicI64::new(0),
        });
        let bell = Arc::new(Notify::new());
        let mut listening = JoinSet::new();
        let names = &broker.names;
        let mut rung = broker.client.subscribe(names.bell()).await.map_err(|e| e.to_string())?;
        let ring = Arc::clone(&bell);
        listening.spawn(async move {
            while rung.next().await.is_some() {
                // Every idle slot looks: which of them gets the job, the broker decides.
                ring.notify_waiters();
            }
        });
        let mut cancels = broker.client.subscribe(names.cancel("*")).await.map_err(|e| e.to_string())?;
        let told = Arc::clone(&shared);
        listening.spawn(async move {
            while let Some(message) = cancels.next().await {
                let Some(job) = message.subject.rsplit('.').next() else { continue };
                told.cancelled.lock().unwrap_or_else(PoisonError::into_inner).insert(job);
                // Nobody may be at a job now.
                told.cancellations.send(job.into()).ok();
            }
        });
        let beating = Arc::clone(&shared);
        let name = broker.unique();
        let card = WorkerCard::own(config.slots.max(1));
        let own = name.clone();
        if let Err(problem) = heartbeat(&shared, &name, &card).await {
            tracing::warn!(problem, "the broker's clock is not known");
        }
        listening.spawn(async move {
            loop {
                tokio::time::sleep(HEARTBEAT).await;
                beating.broker.here().await;
                if let Err(problem) = heartbeat(&beating, &name, &card).await {
                    tracing::debug!(problem, "heartbeat");
                }
            }
        });
        Ok(Self { shared, config, name: own, bell, listening })
    }

    /// Plans jobs until `shutdown` is ready; then fetches none, and finishes those that it has.
    pub async fn run_until(mut self, shutdown: impl Future<Output = ()>) {
        let (stop, stopped) = watch::channel(false);
        let (leave, leaving) = watch::channel(false);
        let mut slots = JoinSet::new();
        for _ in 0..self.config.slots.max(1) {
            slots.spawn(slot(
                Arc::clone(&self.shared),
                Arc::clone(&self.bell),
                stopped.clone(),
                leaving.clone(),
            ));
        }
        shutdown.await;
        tracing::info!(grace_s = self.config.drain_grace.as_secs_f64(), "draining");
        stop.send(true).ok();
        let drained = async { while slots.join_next().await.is_some() {} };
        if tokio::time::timeout(self.config.drain_grace, drained).await.is_err() {
            tracing::warn!("jobs are still running after the grace period and are given back");
            leave.send(true).ok();
            let given_back = async { while slots.join_next().await.is_some() {} };
            tokio::time::timeout(BROKER_PATIENCE, given_back).await.ok();
        }
        self.listening.shutdown().await;
        // Fronts hand on less from now on, not only when it has been silent for long.
        let names = &self.shared.broker.names;
        let forget = async {
            if let Ok(bucket) = self.shared.broker.jetstream.get_key_value(names.workers()).await {
                bucket.purge(&self.name).await.ok();
            }
        };
        tokio::time::timeout(BROKER_PATIENCE, forget).await.ok();
        self.shared.broker.client.flush().await.ok();
    }
}

/// Says that the worker is there, and learns how the broker's clock differs from this machine's.
async fn heartbeat(shared: &Shared, worker: &str, card: &WorkerCard) -> Result<(), String> {
    let offset = clock::offset_us(&shared.broker, worker, card).await?;
    shared.clock_offset_us.store(offset, Ordering::Relaxed);
    Ok(())
}

/// One slot: a job at a time.
async fn slot(
    shared: Arc<Shared>,
    bell: Arc<Notify>,
    mut stopped: watch::Receiver<bool>,
    leaving: watch::Receiver<bool>,
) {
    let mut consumers: Vec<PullConsumer> = Vec::new();
    let mut losses = shared.broker.losses();
    loop {
        // Taken before the look, so that a bell during it is not missed.
        let rung = bell.notified();
        let next = async {
            shared.broker.here().await;
            fetch(&shared.broker, &mut consumers).await
        };
        let fetched = tokio::select! {
            biased;
            // A job that is on its way now is delivered again, to somebody else.
            _ = stopped.wait_for(|stopped| *stopped) => return,
            () = losses.recovered() => Err("the broker was away".to_owned()),
            fetched = next => fetched,
        };
        match fetched {
            Ok(Some(message)) => run(&shared, message, leaving.clone()).await,
            Ok(None) => {
                tokio::select! {
                    _ = stopped.wait_for(|stopped| *stopped) => return,
                    () = rung => {}
                    () = tokio::time::sleep(IDLE_POLL) => {}
                }
            }
            Err(problem) => {
                tracing::warn!(problem, "no jobs can be fetched; trying again");
                consumers.clear();
                tokio::time::sleep(IDLE_POLL).await;
                if shared.broker.is_here() {
                    // What was in the broker's memory may be gone.
                    setup::ensure(&shared.broker).await.ok();
                }
            }
        }
    }
}

/// The most urgent job that waits, if one does.
async fn fetch(broker: &Broker, consumers: &mut Vec<PullConsumer>) -> Result<Option<Message>, String> {
    if consumers.is_empty() {
        for priority in Priority::ALL.into_iter().rev() {
            consumers.push(setup::consumer(broker, priority).await?);
        }
    }
    for consumer in consumers.iter() {
        let asked = async {
            // Answered at once, with a job or with none.
            let mut batch = consumer.fetch().max_messages(1).messages().await.map_err(|e| e.to_string())?;
            batch.next().await.transpose().map_err(|e| e.to_string())
        };
        match tokio::time::timeout(BROKER_PATIENCE, asked).await {
            Ok(Ok(None)) => {}
            Ok(found) => return found,
            Err(_) => return Err("the broker does not answer".to_owned()),
        }
    }
    Ok(None)
}
