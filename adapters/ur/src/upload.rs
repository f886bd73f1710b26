//! Uploading the control script, and hearing what the controller says about it.

use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::task::AbortHandle;
use tokio::time::Instant;

use crate::primary::{PrimaryMessage, PrimaryReader};
use crate::script::control_script;
use crate::session::Shared;
use crate::state::RobotState;

/// Words of the primary interface that are kept.
const KEPT_WORDS: usize = 16;

/// The script that was uploaded last.
#[derive(Debug, Default)]
pub(crate) struct Uploaded {
    token: i32,
    listener: Option<AbortHandle>,
}

impl Drop for Uploaded {
    fn drop(&mut self) {
        if let Some(listener) = self.listener.take() {
            listener.abort();
        }
    }
}

impl Uploaded {
    /// True when it runs and takes commands.
    pub(crate) fn runs(&self, state: &RobotState) -> bool {
        let mailbox = state.mailbox;
        let listens = mailbox.ended == 0 && matches!(mailbox.state, 1 | 2);
        self.token != 0 && mailbox.token == self.token && state.program_running && listens
    }

    /// Sends the script, under a new token, and goes on listening to the controller's words about it.
    pub(crate) async fn upload(&mut self, shared: &Arc<Shared>, until: Instant) -> Result<(), String> {
        let config = &shared.config;
        let limit = until.min(Instant::now() + Duration::from_secs_f64(config.connect_timeout_s));
        let address = (config.host.as_str(), config.ports.primary);
        let failed = |why: String| format!("primary interface {}:{}: {why}", address.0, address.1);
        let connecting = tokio::time::timeout_at(limit, TcpStream::connect(address)).await;
        let stream = connecting.map_err(|_| failed("no answer in time".into()))?;
        let mut stream = stream.map_err(|e| failed(e.to_string()))?;
        let clock = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.subsec_nanos());
        // Different from the last one, and from that of a client before: never 0.
        let token = (self.token.wrapping_add((clock >> 3) as i32) & 0x3fff_ffff).max(1);
        self.token = if token == self.token { token + 1 } else { token };
        let text = control_script(config, self.token);
        let sent = tokio::time::timeout_at(limit, stream.write_all(text.as_bytes())).await;
        sent.map_err(|_| failed("takes nothing".into()))?.map_err(|e| failed(e.to_string()))?;
        tracing::info!(arm = config.name, token = self.token, "control script uploaded");
        let listener = tokio::spawn(listen(shared.clone(), stream)).abort_handle();
        if let Some(before) = self.listener.replace(listener) {
            before.abort();
        }
        Ok(())
    }
}

/// Keeps the newest words of the controller until the connection ends.
async fn listen(shared: Arc<Shared>, mut stream: TcpStream) {
    let mut reader = PrimaryReader::default();
    let mut buffer = [0; 4096];
    while let Ok(count) = stream.read(&mut buffer).await {
        if count == 0 {
            return;
        }
        match reader.push(&buffer[..count]) {
            Ok(messages) => {
                for message in messages {
                    let bad =
                        matches!(message, PrimaryMessage::Error { .. } | PrimaryMessage::Exception { .. });
                    tracing::debug!(%message, "controller");
                    if bad {
                        let mut words = shared.words();
                        if words.len() >= KEPT_WORDS {
                            words.pop_front();
                        }
                        words.push_back(message.to_string());
                    }
                }
            }
            Err(error) => {
                tracing::warn!(%error, "no longer listening to the controller's words");
                return;
            }
        }
    }
}
