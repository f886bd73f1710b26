//! Plans on several machines: jobs, answers and hands through a NATS JetStream broker.
//!
//! A front is `graspd serve` with a [`NatsEngine`]: it takes calls and publishes each as a job. A [`Worker`] is a
//! process that fetches jobs, one for each of its slots, and plans them with the engine of its own process. The
//! broker holds what waits; nothing is prefetched, so that an idle worker always gets the next job.
//!
//! What makes every call end exactly once:
//! - A job stays in the broker until a worker acknowledges it, and a worker does that when the front has confirmed
//!   the last reply. Who plans says so every 100 ms; after 400 ms of silence another worker gets the job.
//! - A front takes one end of each job; what comes after it is confirmed and dropped.
//! - A job that has lost three workers is given up, and its caller is told.
//! - A front that loses the broker tells its callers so at once, and takes no calls until it has the broker again.

mod cancelled;
mod clock;
mod connection;
mod front;
mod hands;
mod leases;
mod pending;
mod presence;
mod requests;
mod running;
mod settings;
mod setup;
mod wire;
mod worker;

pub use connection::{Broker, ConnectError, Node};
pub use front::NatsEngine;
pub use hands::NatsHands;
pub use leases::{Lease, LeaseError, Leases};
pub use settings::{BrokerTls, NatsConfig, WrongUrl};
pub use worker::{Worker, WorkerConfig};
