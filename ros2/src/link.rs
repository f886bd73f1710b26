//! The connection to the server: kept, watched, and made again when it is lost.

use std::sync::Arc;
use std::time::Duration;

use graspd_client::{Client, ClientConfig, ClientError, Code, RetryPolicy};
use tokio::sync::{Notify, watch};

/// Between two looks at a server that answers. A call that fails leads to a look at once.
const LOOK_PERIOD: Duration = Duration::from_secs(5);
/// Between two tries to connect.
const TRY_PERIOD: Duration = Duration::from_secs(1);
/// How long a look may take, and a try to connect.
const PATIENCE: Duration = Duration::from_secs(5);

/// How the server is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LinkState {
    /// It answers.
    Up,
    /// It answers that it does not want to: a hand that it does not have, a caller that it does not know.
    Refuses(String),
    /// Nobody answers; tried again every second.
    Away(String),
}

/// A connection that is taken care of. Clones are of the same one.
#[derive(Debug, Clone)]
pub struct Link {
    states: watch::Receiver<LinkState>,
    clients: watch::Receiver<Option<Client>>,
    look: Arc<Notify>,
}

impl Link {
    /// The connection, and what takes care of it: run that beside everything else, until the end. `hand` (its id) is asked for to
    /// see how the server is.
    pub fn new(config: ClientConfig, hand: &str) -> (Self, impl Future<Output = ()> + Send + use<>) {
        let (state, states) = watch::channel(LinkState::Away("not connected yet".to_owned()));
        let (client, clients) = watch::channel(None);
        let look = Arc::new(Notify::new());
        let keeper = keep(config, format!("hands/{hand}"), state, client, Arc::clone(&look));
        (Self { states, clients, look }, keeper)
    }

    /// How the server is now.
    pub fn state(&self) -> LinkState {
        self.states.borrow().clone()
    }

    /// Waits until that changes.
    pub async fn changed(&mut self) {
        if self.states.changed().await.is_err() {
            // Nobody takes care of it any more.
            std::future::pending::<()>().await;
        }
    }

    /// A client, if the server answers.
    ///
    /// # Errors
    /// What the problem is, if nobody does.
    pub fn client(&self) -> Result<Client, String> {
        match (self.state(), self.clients.borrow().clone()) {
            (LinkState::Up | LinkState::Refuses(_), Some(client)) => Ok(client),
            (LinkState::Away(problem), _) => Err(problem),
            (_, None) => Err("not connected".to_owned()),
        }
    }

    /// A call has failed: looks at the server at once.
    pub fn doubt(&self) {
        self.look.notify_one();
    }
}

async fn keep(
    config: ClientConfig,
    hand: String,
    state: watch::Sender<LinkState>,
    clients: watch::Sender<Option<Client>>,
    look: Arc<Notify>,
) {
    let tell = |new: LinkState| {
        let changed = state.send_if_modified(|old| {
            let changed = *old != new;
            old.clone_from(&new);
            changed
        });
        if changed {
            match &new {
                LinkState::Up => tracing::info!(server = config.endpoint, "the server answers"),
                LinkState::Refuses(problem) => {
                    tracing::warn!(server = config.endpoint, problem, "the server refuses");
                }
                LinkState::Away(problem) => {
                    tracing::warn!(server = config.endpoint, problem, "the server is away")
                }
            }
        }
    };
    loop {
        // Whether to try again is decided here, so that each try's problem can be told.
        let once = ClientConfig {
            connect_timeout: config.connect_timeout.min(PATIENCE),
            retry: RetryPolicy::NONE,
            ..config.clone()
        };
        match tokio::time::timeout(PATIENCE, Client::connect(once)).await {
            Ok(Ok(client)) => {
                clients.send_replace(Some(client.with_retry(config.retry)));
                let looker = client.with_timeout(PATIENCE);
                loop {
                    match looker.get_hand(&hand).await {
                        Ok(_) => tell(LinkState::Up),
                        Err(error) if is_away(&error) => {
                            tell(LinkState::Away(error.to_string()));
                            break;
                        }
                        Err(error) => tell(LinkState::Refuses(error.to_string())),
                    }
                    wait(&look).await;
                }
                clients.send_replace(None);
            }
            Ok(Err(error)) => tell(LinkState::Away(error.to_string())),
            Err(_) => {
                tell(LinkState::Away(format!("{}: no connection within {PATIENCE:?}", config.endpoint)))
            }
        }
        tokio::time::sleep(TRY_PERIOD).await;
    }
}

/// Waits for the next look.
async fn wait(look: &Notify) {
    tokio::select! {
        () = tokio::time::sleep(LOOK_PERIOD) => {}
        () = look.notified() => {}
    }
}

/// True for an error that says that nobody is there.
pub fn is_away(error: &ClientError) -> bool {
    match error {
        ClientError::Connect { .. } => true,
        ClientError::Call(call) => matches!(call.code, Code::Unavailable | Code::DeadlineExceeded),
        ClientError::Protocol(_) => false,
    }
}
