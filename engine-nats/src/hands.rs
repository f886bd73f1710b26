//! Hands of all fronts and workers: what is known of each in a key-value bucket, its files in an object store.

use std::sync::Arc;
use std::time::{Duration, UNIX_EPOCH};

use async_nats::jetstream::kv::{CreateErrorKind, Entry, Operation, Store};
use bytes::Bytes;
use futures_util::StreamExt as _;
use graspd_server::jobs::HandRef;
use graspd_server::registry::{HandStore, HandSync, StoreError, StoredHand};
use serde::{Deserialize, Serialize};
use tokio::sync::OnceCell;

use crate::connection::Broker;
use crate::requests;

/// After a fault the hands are read again after this.
const AGAIN: Duration = Duration::from_millis(500);
/// The hands that there are at a start arrive within this.
const FIRST_LOOK: Duration = Duration::from_secs(30);

/// What the bucket has of a hand.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct Record {
    revision: String,
    created_ms: u64,
    upload: Option<(u64, String)>,
    /// Name of the object with its files.
    files: String,
}

/// The hands of an installation.
#[derive(Debug)]
pub struct NatsHands {
    broker: Broker,
    /// Where news goes, once somebody wants it.
    sync: OnceCell<HandSync>,
}

impl NatsHands {
    /// The hands of a broker.
    pub fn new(broker: &Broker) -> Arc<Self> {
        Arc::new(Self { broker: broker.clone(), sync: OnceCell::new() })
    }

    /// Loads what there is, and from then on what comes and goes, for as long as the process lives.
    ///
    /// # Errors
    /// When the hands that there are cannot be listed now.
    pub async fn follow(self: &Arc<Self>, sync: HandSync) -> Result<(), String> {
        self.sync.set(sync).map_err(|_| "the hands are followed already".to_owned())?;
        let first = tokio::time::timeout(FIRST_LOOK, self.load_all()).await;
        first.map_err(|_| "the hands do not arrive".to_owned())??;
        let following = Arc::clone(self);
        tokio::spawn(async move {
            loop {
                let ended = following.watch().await;
                tracing::debug!(ended = ended.err(), "watching hands anew");
                tokio::time::sleep(AGAIN).await;
                following.broker.here().await;
            }
        });
        Ok(())
    }

    /// Loads a hand that is not here, or not in this revision, where the store has it.
    pub(crate) async fn have(&self, hand: &HandRef) {
        let Some(sync) = self.sync.get() else { return };
        if sync.revision(&hand.id).is_some_and(|known| known == hand.revision) {
            return;
        }
        let looked = async {
            let entry = self.bucket().await?.entry(hand.id.clone()).await.map_err(|e| e.to_string())?;
            match entry {
                Some(entry) => self.apply(sync, &entry).await,
                None => Ok(()),
            }
        };
        if let Err(problem) = looked.await {
            // The job's own answer says that the hand is not there.
            tracing::warn!(hand = hand.id, problem, "a hand cannot be loaded from the store");
        }
    }

    async fn bucket(&self) -> Result<Store, String> {
        self.broker.jetstream.get_key_value(self.broker.names.hands()).await.map_err(|e| e.to_string())
    }

    async fn load_all(&self) -> Result<(), String> {
        let Some(sync) = self.sync.get() else { return Ok(()) };
        let bucket = self.bucket().await?;
        let mut keys = bucket.keys().await.map_err(|e| e.to_string())?;
        while let Some(key) = keys.next().await {
            let key = key.map_err(|e| e.to_string())?;
            let Some(entry) = bucket.entry(key).await.map_err(|e| e.to_string())? else { continue };
            if let Err(problem) = self.apply(sync, &entry).await {
                tracing::error!(hand = entry.key, problem, "a stored hand cannot be loaded");
            }
        }
        Ok(())
    }

    /// Applies every change, those that are there already too, until the broker is lost.
    async fn watch(&self) -> Result<(), String> {
        let Some(sync) = self.sync.get() else { return Ok(()) };
        let bucket = self.bucket().await?;
        let mut losses = self.broker.losses();
        // With the last change of each hand: what happened while nobody watched.
        let mut changes = bucket.watch_with_history(">").await.map_err(|e| e.to_string())?;
        loop {
            let change = tokio::select! {
                change = changes.next() => change,
                () = losses.lost() => return Err("the broker was lost".to_owned()),
            };
            let Some(entry) = change else { return Err("the watch ended".to_owned()) };
            let entry = entry.map_err(|e| e.to_string())?;
            if let Err(problem) = self.apply(sync, &entry).await {
                tracing::error!(hand = entry.key, problem, "a change of a hand cannot be applied");
            }
        }
    }

    async fn apply(&self, sync: &HandSync, entry: &Entry) -> Result<(), String> {
        if entry.operation != Operation::Put {
            sync.removed(&entry.key).await;
            return Ok(());
        }
        let record: Record = serde_json::from_slice(&entry.value).map_err(|e| e.to_string())?;
        if sync.revision(&entry.key).is_some_and(|known| known == record.revision) {
            return Ok(());
        }
        let store = requests::store(&self.broker, self.broker.names.hand_files()).await?;
        let files = requests::get_from(&store, &record.files).await?;
        let created = UNIX_EPOCH + Duration::from_millis(record.created_ms);
        let Record { revision, upload, .. } = record;
        sync.stored(StoredHand { id: entry.key.clone(), revision, created, upload, files }).await
    }

    async fn create_in_store(&self, hand: StoredHand) -> Result<(), StoreError> {
        let away = StoreError::Away;
        let bucket = self.bucket().await.map_err(away)?;
        let StoredHand { id, revision, created, upload, files } = hand;
        let created_ms = created.duration_since(UNIX_EPOCH).unwrap_or_default().as_millis();
        // A name of its own: of two that create the same hand, the one that is too late deletes only its own files.
        let object = format!("{id}-{revision}-{}", self.broker.unique());
        let store = requests::store(&self.broker, self.broker.names.hand_files()).await.map_err(away)?;
        requests::put_in(&store, &object, files).await.map_err(away)?;
        let created_ms = u64::try_from(created_ms).unwrap_or_default();
        let record = Record { revision, created_ms, upload, files: object.clone() };
        let value = serde_json::to_vec(&record).map_err(|e| away(e.to_string()))?;
        let created = bucket.create(&id, Bytes::from(value)).await;
        let Err(error) = created else { return Ok(()) };
        store.delete(&object).await.ok();
        match error.kind() {
            CreateErrorKind::AlreadyExists => Err(StoreError::Exists),
            _ => Err(away(error.to_string())),
        }
    }

    async fn delete_from_store(&self, id: &str) -> Result<(), String> {
        let bucket = self.bucket().await?;
        let entry = bucket.entry(id).await.map_err(|e| e.to_string())?;
        bucket.delete(id).await.map_err(|e| e.to_string())?;
        let record = entry.and_then(|entry| serde_json::from_slice::<Record>(&entry.value).ok());
        if let Some(record) = record {
            let store = requests::store(&self.broker, self.broker.names.hand_files()).await?;
            // A worker that is reading them now sees a hand that is deleted.
            store.delete(&record.files).await.ok();
        }
        Ok(())
    }

    /// Work with the broker that is said to be away at once where it is.
    async fn while_here<T>(
        &self,
        work: impl Future<Output = Result<T, StoreError>>,
    ) -> Result<T, StoreError> {
        let away = || StoreError::Away(format!("no connection to the broker at {}", self.broker.url()));
        let mut losses = self.broker.losses();
        if !self.broker.is_here() {
            return Err(away());
        }
        tokio::select! {
            done = work => done,
            () = losses.lost() => Err(away()),
        }
    }
}

#[tonic::async_trait]
impl HandStore for NatsHands {
    async fn create(&self, hand: StoredHand) -> Result<(), StoreError> {
        self.while_here(self.create_in_store(hand)).await
    }

    async fn delete(&self, id: &str) -> Result<(), StoreError> {
        self.while_here(async { self.delete_from_store(id).await.map_err(StoreError::Away) }).await
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_is_read_as_it_is_written() {
        let record = Record {
            revision: "0123456789abcdef".to_owned(),
            created_ms: 1_700_000_000_000,
            upload: Some((7, "id".to_owned())),
            files: "mine-0123456789abcdef-x".to_owned(),
        };
        let text = serde_json::to_string(&record).unwrap();
        assert_eq!(serde_json::from_str::<Record>(&text).unwrap(), record);
        assert!(serde_json::from_str::<Record>("{}").is_err());
    }
}
