//! What the broker keeps: made where it is not there, after a start and after every loss of the broker.

use async_nats::jetstream::consumer::{AckPolicy, PullConsumer, pull};
use async_nats::jetstream::stream::{DiscardPolicy, RetentionPolicy, StorageType};
use async_nats::jetstream::{kv, object_store, stream};
use graspd_server::pool::Priority;

use crate::connection::Broker;
use crate::settings::{ACK_WAIT, MAX_AGE, MAX_DELIVER};

/// A worker that has not said for so long that it is there is not.
const WORKER_AGE: std::time::Duration = std::time::Duration::from_secs(15);

/// Makes the stream of jobs, its consumers and the buckets, where they are not there.
pub(crate) async fn ensure(broker: &Broker) -> Result<(), String> {
    let (jetstream, names) = (&broker.jetstream, &broker.names);
    let jobs = stream::Config {
        name: names.stream(),
        subjects: vec![names.jobs("*", "*")],
        retention: RetentionPolicy::WorkQueue,
        // A job that is older than its deadline is worth nothing: it need not survive the broker.
        storage: StorageType::Memory,
        discard: DiscardPolicy::New,
        max_messages: i64::try_from(broker.queue).unwrap_or(i64::MAX),
        max_age: MAX_AGE,
        duplicate_window: MAX_AGE.min(std::time::Duration::from_secs(120)),
        num_replicas: 1,
        ..Default::default()
    };
    if broker.decides {
        jetstream.create_or_update_stream(jobs).await.map(drop).map_err(|e| e.to_string())?;
    } else {
        jetstream.get_or_create_stream(jobs).await.map(drop).map_err(|e| e.to_string())?;
    }
    for priority in Priority::ALL {
        consumer(broker, priority).await?;
    }
    for (bucket, storage, max_age) in [
        (names.hands(), StorageType::File, std::time::Duration::ZERO),
        (names.leases(), StorageType::File, std::time::Duration::ZERO),
        (names.workers(), StorageType::Memory, WORKER_AGE),
    ] {
        if jetstream.get_key_value(&bucket).await.is_err() {
            let config = kv::Config { bucket, storage, max_age, history: 1, ..Default::default() };
            jetstream.create_key_value(config).await.map_err(|e| e.to_string())?;
        }
    }
    for (bucket, storage, max_age) in [
        (names.hand_files(), StorageType::File, std::time::Duration::ZERO),
        (names.requests(), StorageType::Memory, MAX_AGE),
    ] {
        if jetstream.get_object_store(&bucket).await.is_err() {
            let config = object_store::Config { bucket, storage, max_age, ..Default::default() };
            jetstream.create_object_store(config).await.map_err(|e| e.to_string())?;
        }
    }
    Ok(())
}

/// The consumer of the jobs of a priority, which all workers share.
pub(crate) async fn consumer(broker: &Broker, priority: Priority) -> Result<PullConsumer, String> {
    let names = &broker.names;
    let stream = broker.jetstream.get_stream_no_info(names.stream()).await.map_err(|e| e.to_string())?;
    let config = pull::Config {
        durable_name: Some(priority.name().to_owned()),
        filter_subject: names.jobs(priority.name(), "*"),
        ack_policy: AckPolicy::Explicit,
        ack_wait: ACK_WAIT,
        max_deliver: MAX_DELIVER as i64,
        // As many as there are workers; the broker's own limit would hold jobs back.
        max_ack_pending: 100_000,
        memory_storage: true,
        ..Default::default()
    };
    stream.create_consumer(config).await.map_err(|e| e.to_string())
}
