//! The connection to the broker: whether it is there, said at once, and what its clock says.

use std::sync::Arc;
use std::time::Duration;

use async_nats::connection::State;
use async_nats::jetstream::{self, context::ContextBuilder};
use async_nats::{Client, ConnectOptions, Event};
use tokio::sync::watch;

use crate::settings::{
    BROKER_PATIENCE, GOOD_PAYLOAD, HEADER_ROOM, LEAST_PAYLOAD, Names, NatsConfig, PING, WrongUrl,
};
use crate::setup;

/// Why there is no connection to the broker.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConnectError {
    /// The address cannot be used.
    #[error("the broker's address: {0}")]
    Url(#[from] WrongUrl),
    /// Nobody answers there, or not as a broker, or it refuses.
    #[error("the broker at {url} cannot be reached: {problem}")]
    Unreachable {
        /// Its address, without what is secret.
        url: String,
        /// Why.
        problem: String,
    },
    /// The broker takes only small messages.
    #[error(
        "the broker takes messages of at most {found} bytes and {LEAST_PAYLOAD} are the least; set max_payload: 8MB in \
         its configuration, so that frames fit too"
    )]
    SmallPayload {
        /// Its limit.
        found: usize,
    },
    /// The broker does not keep what is needed.
    #[error("the broker's JetStream: {problem}; start it with -js, or see jetstream in its configuration")]
    JetStream {
        /// What it says.
        problem: String,
    },
}

/// What a process is in an installation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Node {
    /// Takes calls.
    Front,
    /// Plans.
    Worker,
    /// Asks something once.
    Visitor,
}

impl Node {
    /// Its name in the broker's own lists of connections.
    fn name(self) -> &'static str {
        match self {
            Self::Front => "front",
            Self::Worker => "worker",
            Self::Visitor => "visitor",
        }
    }
}

/// A broker that answers. Clones are the same connection.
#[derive(Clone)]
pub struct Broker {
    pub(crate) client: Client,
    pub(crate) jetstream: jetstream::Context,
    pub(crate) names: Arc<Names>,
    pub(crate) queue: usize,
    /// This process says how many jobs may wait: a front.
    pub(crate) decides: bool,
    /// Counts losses and returns of the connection; odd while it is lost.
    changes: watch::Receiver<u64>,
    url: Arc<str>,
}

impl std::fmt::Debug for Broker {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Broker").field("url", &self.url).field("here", &self.is_here()).finish()
    }
}

impl Broker {
    /// Connects, and makes what is not there yet: the stream of jobs, its consumers, buckets. A front says how long the
    /// queue is.
    ///
    /// # Errors
    /// [`ConnectError`].
    pub async fn connect(config: &NatsConfig, kind: Node) -> Result<Self, ConnectError> {
        let servers = config.servers()?;
        let url: Arc<str> = NatsConfig::shown(&servers).into();
        let (sender, changes) = watch::channel(0);
        let heard = move |event: Event| {
            match &event {
                Event::Connected => sender.send_if_modified(|n| (*n % 2 == 1).then(|| *n += 1).is_some()),
                Event::Disconnected | Event::Closed => {
                    sender.send_if_modified(|n| (*n % 2 == 0).then(|| *n += 1).is_some())
                }
                _ => false,
            };
            match event {
                // Every attempt to connect again is one.
                Event::ClientError(_) => tracing::debug!(%event, "broker"),
                event => tracing::info!(%event, "broker"),
            }
            std::future::ready(())
        };
        let mut options = ConnectOptions::new()
            .name(format!("graspd {} {}", kind.name(), std::process::id()))
            .event_callback(heard)
            .ping_interval(PING)
            .connection_timeout(BROKER_PATIENCE * 2)
            .request_timeout(Some(BROKER_PATIENCE))
            // For ever: a service recovers by itself.
            .max_reconnects(None)
            .reconnect_delay_callback(|attempt| Duration::from_millis(50 * attempt.min(10) as u64))
            // A reply that waits for a slow reader is not lost.
            .subscription_capacity(16_384);
        if let Some(roots) = &config.tls.roots {
            options = options.add_root_certificates(roots.clone());
        }
        if let Some((certificate, key)) = &config.tls.certificate {
            options = options.add_client_certificate(certificate.clone(), key.clone());
        }
        let client = options
            .connect(servers)
            .await
            .map_err(|e| ConnectError::Unreachable { url: url.to_string(), problem: e.to_string() })?;
        let found = client.max_payload();
        if found < LEAST_PAYLOAD {
            return Err(ConnectError::SmallPayload { found });
        }
        if found < GOOD_PAYLOAD {
            tracing::warn!(
                max_payload = found,
                "requests larger than this go through the broker's object store, which is slower; \
                 max_payload: 8MB in its configuration takes most frames"
            );
        }
        let jetstream = ContextBuilder::new().timeout(BROKER_PATIENCE).build(client.clone());
        let names = Arc::new(Names::new(&config.name));
        let decides = kind == Node::Front;
        let broker = Self { client, jetstream, names, queue: config.queue.max(1), decides, changes, url };
        setup::ensure(&broker).await.map_err(|problem| ConnectError::JetStream { problem })?;
        tracing::info!(broker = %broker.url, max_payload = found, "connected");
        Ok(broker)
    }

    /// True while the broker can be talked to.
    pub fn is_here(&self) -> bool {
        self.client.connection_state() == State::Connected && self.changes.borrow().is_multiple_of(2)
    }

    /// How often it was lost and found again.
    pub(crate) fn reconnects(&self) -> u64 {
        *self.changes.borrow() / 2
    }

    /// Ready when it was lost, or found again.
    pub(crate) async fn changed(&self) {
        let mut changes = self.changes.clone();
        changes.mark_unchanged();
        if changes.changed().await.is_err() {
            std::future::pending().await
        }
    }

    /// Its address, without what is secret.
    pub fn url(&self) -> &str {
        &self.url
    }

    /// A name that nobody else has: letters and digits.
    pub(crate) fn unique(&self) -> String {
        // The client's own names are unique in all clients of all brokers.
        let inbox = self.client.new_inbox();
        inbox.rsplit('.').next().unwrap_or(&inbox).to_owned()
    }

    /// The largest request that travels in the message itself.
    pub(crate) fn largest_message(&self) -> usize {
        self.client.max_payload().saturating_sub(HEADER_ROOM)
    }

    /// To be noticed by: see [`Losses`].
    pub(crate) fn losses(&self) -> Losses {
        let seen = *self.changes.borrow();
        Losses { changes: self.changes.clone(), seen }
    }

    /// Ready when the connection is there.
    pub(crate) async fn here(&self) {
        let mut changes = self.changes.clone();
        // The sender lives as long as the client.
        changes.wait_for(|n| n.is_multiple_of(2)).await.ok();
    }
}

/// Notices that the connection was lost since this was made, even if it is back.
#[derive(Debug)]
pub(crate) struct Losses {
    changes: watch::Receiver<u64>,
    seen: u64,
}

impl Losses {
    /// Ready when it was lost.
    pub(crate) async fn lost(&mut self) {
        let seen = self.seen;
        self.changes.wait_for(|n| *n > seen && !(seen % 2 == 1 && *n == seen + 1)).await.ok();
    }

    /// Ready when it was lost and is back; then it notices the next loss.
    pub(crate) async fn recovered(&mut self) {
        self.lost().await;
        if let Ok(now) = self.changes.wait_for(|n| n.is_multiple_of(2)).await {
            self.seen = *now;
        }
    }
}
