//! Requests that are too large for a message of the broker, as objects in its store.

use async_nats::jetstream::object_store::ObjectStore;
use bytes::Bytes;
use tokio::io::AsyncReadExt as _;

use crate::connection::Broker;

/// No request is larger than the largest message of a server.
const MOST_BYTES: u64 = 1 << 30;

/// Keeps a request under the name of its job.
pub(crate) async fn put(broker: &Broker, job: &str, request: Bytes) -> Result<(), String> {
    put_in(&store(broker, broker.names.requests()).await?, job, request).await
}

/// The request of a job.
pub(crate) async fn get(broker: &Broker, job: &str) -> Result<Bytes, String> {
    get_from(&store(broker, broker.names.requests()).await?, job).await
}

/// Forgets a request; what cannot be deleted now ends by its age.
pub(crate) async fn delete(broker: &Broker, job: &str) {
    if let Ok(store) = store(broker, broker.names.requests()).await {
        store.delete(job).await.ok();
    }
}

/// A store by its name.
pub(crate) async fn store(broker: &Broker, name: String) -> Result<ObjectStore, String> {
    broker.jetstream.get_object_store(name).await.map_err(|e| e.to_string())
}

/// Keeps bytes under a name.
pub(crate) async fn put_in(store: &ObjectStore, name: &str, bytes: Bytes) -> Result<(), String> {
    store.put(name, &mut bytes.as_ref()).await.map(drop).map_err(|e| e.to_string())
}

/// The bytes under a name.
pub(crate) async fn get_from(store: &ObjectStore, name: &str) -> Result<Bytes, String> {
    let object = store.get(name).await.map_err(|e| e.to_string())?;
    let mut bytes = Vec::new();
    object.take(MOST_BYTES).read_to_end(&mut bytes).await.map_err(|e| e.to_string())?;
    Ok(bytes.into())
}
