//! How the broker and its workers are, for readiness, metrics and how many jobs a front hands on.

use std::collections::HashMap;
use std::time::Duration;

use async_nats::jetstream::kv;
use futures_util::StreamExt as _;
use graspd_server::jobs::Presence;
use graspd_server::pool::Priority;
use serde::{Deserialize, Serialize};

use crate::connection::Broker;
use crate::settings::BROKER_PATIENCE;

/// The broker is asked so often how many jobs and workers there are.
pub(crate) const ASKED_EVERY: Duration = Duration::from_secs(1);
/// Most workers that are counted.
const MOST: usize = 4096;

/// What a worker says of itself, again and again.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct WorkerCard {
    /// Process number, for people.
    #[serde(default)]
    pub(crate) pid: u32,
    /// Version of the program, for people.
    #[serde(default)]
    pub(crate) version: String,
    /// Jobs that it plans at the same time; 0 for who only compares clocks and is no worker.
    #[serde(default = "one")]
    pub(crate) slots: usize,
}

/// What a worker has that does not say how many.
fn one() -> usize {
    1
}

impl WorkerCard {
    /// That of this process.
    pub(crate) fn own(slots: usize) -> Self {
        Self { pid: std::process::id(), version: env!("CARGO_PKG_VERSION").to_owned(), slots }
    }

    /// As it is kept.
    pub(crate) fn bytes(&self) -> Vec<u8> {
        serde_json::to_vec(self).unwrap_or_default()
    }

    /// Reads it; one that says nothing sensible is a worker with one slot.
    fn read(bytes: &[u8]) -> Self {
        let card: Option<Self> = serde_json::from_slice(bytes).ok();
        let card = card.unwrap_or_else(|| Self { pid: 0, version: String::new(), slots: one() });
        Self { slots: card.slots.min(MOST), ..card }
    }
}

/// Workers that are there, and the jobs that they plan at the same time. `known` has what workers said before: of one that
/// goes on, nothing is asked again.
pub(crate) async fn workers(
    broker: &Broker,
    known: &mut HashMap<String, WorkerCard>,
) -> Result<(usize, usize), String> {
    let bucket: kv::Store =
        broker.jetstream.get_key_value(broker.names.workers()).await.map_err(|e| e.to_string())?;
    let mut keys = bucket.keys().await.map_err(|e| e.to_string())?;
    let mut there = HashMap::new();
    while let Some(key) = keys.next().await {
        let key = key.map_err(|e| e.to_string())?;
        if there.len() >= MOST {
            break;
        }
        let card = match known.remove(&key) {
            Some(card) => card,
            None => match bucket.get(key.as_str()).await.map_err(|e| e.to_string())? {
                Some(bytes) => WorkerCard::read(&bytes),
                None => continue,
            },
        };
        there.insert(key, card);
    }
    let slots = there.values().map(|card| card.slots).sum();
    let workers = there.values().filter(|card| card.slots > 0).count();
    *known = there;
    Ok((workers, slots))
}

/// Jobs that wait in the broker, and jobs that workers are at, by priority.
pub(crate) async fn jobs(broker: &Broker) -> Result<([usize; 4], [usize; 4]), String> {
    let stream =
        broker.jetstream.get_stream_no_info(broker.names.stream()).await.map_err(|e| e.to_string())?;
    let (mut waiting, mut running) = ([0; 4], [0; 4]);
    for (i, priority) in Priority::ALL.into_iter().enumerate() {
        let info = stream.consumer_info(priority.name()).await.map_err(|e| e.to_string())?;
        if let (Some(waiting), Some(running)) = (waiting.get_mut(i), running.get_mut(i)) {
            (*waiting, *running) =
                (usize::try_from(info.num_pending).unwrap_or(usize::MAX), info.num_ack_pending);
        }
    }
    Ok((waiting, running))
}

/// Looks at workers and jobs, where the broker is there and answers; else all that is known stays.
pub(crate) async fn look(broker: &Broker, known: &mut HashMap<String, WorkerCard>, presence: &mut Presence) {
    presence.is_here = broker.is_here();
    presence.reconnects = broker.reconnects();
    if !presence.is_here {
        return;
    }
    let asked = async { Ok::<_, String>((workers(broker, known).await?, jobs(broker).await?)) };
    match tokio::time::timeout(2 * BROKER_PATIENCE, asked).await {
        Ok(Ok(((workers, slots), (waiting, running)))) => {
            (presence.workers, presence.slots) = (workers, slots);
            (presence.waiting, presence.running) = (waiting, running);
        }
        Ok(Err(problem)) => tracing::debug!(problem, "workers and jobs are not known"),
        Err(_) => tracing::debug!("the broker does not say how many workers and jobs there are"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_worker_says_its_slots_and_an_older_one_has_one() {
        let card = WorkerCard::own(3);
        assert_eq!(WorkerCard::read(&card.bytes()), card);
        for (text, slots) in [(r#"{"pid":1,"version":"0"}"#, 1), ("", 1), ("[]", 1), (r#"{"slots":0}"#, 0)] {
            assert_eq!(WorkerCard::read(text.as_bytes()).slots, slots, "{text:?}");
        }
        assert_eq!(WorkerCard::read(br#"{"slots":999999999}"#).slots, MOST);
    }
}
