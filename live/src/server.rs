//! The server of the live view: where it listens, how many may look, and how it ends.

use std::io;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use tokio::net::TcpListener;
use tokio::sync::{Semaphore, mpsc, watch};
use tokio::task::JoinSet;

use crate::client::{self, House};
use crate::counts::{Counters, Counts};
use crate::hub::Hub;
use crate::news::News;
use crate::{Layer, Picture};

/// Connections that may be in their handshake, beside the viewers.
const MOST_HANDSHAKES: usize = 32;
/// Viewers have this long to be told that the server ends.
const GOODBYE: Duration = Duration::from_secs(1);

/// How the live view is set up.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LiveConfig {
    /// Address to listen on; loopback alone, port 0 takes a free one.
    pub listen: SocketAddr,
    /// Origins of pages elsewhere that may look, for example `https://app.foxglove.dev`. Default: none.
    pub origins: Vec<String>,
    /// Viewers at the same time. Default 8.
    pub clients: usize,
    /// A viewer that takes nothing for so long is put out. Default 10 s.
    pub patience: Duration,
}

impl LiveConfig {
    /// The defaults, at this address.
    pub fn at(listen: SocketAddr) -> Self {
        Self { listen, origins: Vec::new(), clients: 8, patience: Duration::from_secs(10) }
    }
}

/// Why there is no live view.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LiveError {
    /// The address is not a loopback address.
    #[error(
        "live view: refusing to listen on {addr}: viewers send no tokens, and it shows what every caller's cameras see; \
         expected a loopback address such as 127.0.0.1:{port}, to which `ssh -L {port}:127.0.0.1:{port} HOST` leads from \
         elsewhere",
        port = addr.port()
    )]
    NotLoopback {
        /// The address.
        addr: SocketAddr,
    },
    /// The address cannot be bound.
    #[error("live view: cannot listen on {addr}")]
    Bind {
        /// The address.
        addr: SocketAddr,
        /// Why.
        source: io::Error,
    },
}

/// A live view that is bound; it is served until it is closed or dropped.
#[derive(Debug)]
pub struct Live {
    addr: SocketAddr,
    news: Arc<News>,
    counters: Arc<Counters>,
    stop: watch::Sender<bool>,
    /// The accepting task; taken when it is waited for.
    accepting: Mutex<Option<tokio::task::JoinHandle<()>>>,
}

impl Live {
    /// Binds the address and serves from now on. `name` is what viewers show as the server's name.
    ///
    /// # Errors
    /// [`LiveError`] for an address that others can reach, or that cannot be had.
    pub async fn start(config: LiveConfig, name: &str) -> Result<Self, LiveError> {
        let addr = config.listen;
        if !addr.ip().is_loopback() {
            return Err(LiveError::NotLoopback { addr });
        }
        let fault = |source| LiveError::Bind { addr, source };
        let listener = TcpListener::bind(addr).await.map_err(fault)?;
        let addr = listener.local_addr().map_err(fault)?;
        let (news, counters): (Arc<News>, Arc<Counters>) = Default::default();
        let (events, heard) = mpsc::channel(64);
        let (stop, stopped) = watch::channel(false);
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let house = House {
            name: name.to_owned(),
            session: since.as_nanos().to_string(),
            origins: config.origins,
            patience: config.patience,
            places: Arc::new(Semaphore::new(config.clients)),
            counters: Arc::clone(&counters),
            events,
        };
        tokio::spawn(Hub::new(Arc::clone(&news), Arc::clone(&counters)).run(heard));
        let most = config.clients.saturating_add(MOST_HANDSHAKES);
        let accepting = Mutex::new(Some(tokio::spawn(accept(listener, Arc::new(house), stopped, most))));
        tracing::info!(%addr, "the live view is at ws://{addr}");
        Ok(Self { addr, news, counters, stop, accepting })
    }

    /// Where it listens, with the real port.
    pub fn local_addr(&self) -> SocketAddr {
        self.addr
    }

    /// Shows a picture in the place of the one before. Never waits: what it costs is a pointer.
    pub fn show(&self, layer: Layer, picture: Arc<dyn Picture>) {
        self.news.put(layer, picture, &self.counters);
    }

    /// What has happened so far.
    pub fn counts(&self) -> Counts {
        self.counters.read()
    }

    /// Tells viewers that it ends; returns when they know, or after a second.
    pub async fn close(&self) {
        self.stop.send(true).ok();
        let accepting = self.accepting.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(accepting) = accepting {
            tokio::time::timeout(GOODBYE, accepting).await.ok();
        }
    }
}

/// Takes connections until the server ends, and waits for those that there are then.
async fn accept(listener: TcpListener, house: Arc<House>, mut stopped: watch::Receiver<bool>, most: usize) {
    let mut connections = JoinSet::new();
    for id in 0.. {
        let stream = loop {
            tokio::select! {
                () = client::ended(&mut stopped) => {
                    drop(listener);
                    while connections.join_next().await.is_some() {}
                    return;
                }
                Some(_) = connections.join_next() => {}
                accepted = listener.accept(), if connections.len() < most => match accepted {
                    Ok((stream, _)) => break stream,
                    // No more files, for example: others may end meanwhile.
                    Err(_) => tokio::time::sleep(Duration::from_millis(50)).await,
                },
            }
        };
        connections.spawn(client::serve(Arc::clone(&house), id, stream, stopped.clone()));
    }
}
