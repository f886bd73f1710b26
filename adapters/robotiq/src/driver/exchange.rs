//! Exchanges with their retries, and their failures in a caller's words.

use std::time::Duration;

use graspd_adapters_core::DeviceError;
use tokio::time::{Instant, sleep};

use super::Driver;
use crate::link::{Link, LinkError};
use crate::wire::{Request, Status};

impl Driver {
    /// Reads the status.
    pub(super) async fn look(&mut self) -> Result<Status, DeviceError> {
        let bytes = self.exchange(None).await?;
        let status = match self.settings.model.decode(&bytes) {
            Ok(status) => status,
            Err(error) => {
                return Err(DeviceError::Protocol { device: self.device(), detail: error.to_string() });
            }
        };
        self.looked = Instant::now();
        self.status = Some(status.clone());
        Ok(status)
    }

    /// Writes a request.
    pub(super) async fn write(&mut self, request: Request) -> Result<(), DeviceError> {
        let bytes = self.settings.model.encode(&request);
        self.exchange(Some(&bytes)).await?;
        self.request = request;
        Ok(())
    }

    /// Reads, or writes and reads nothing. What failed is tried again, on a link that was opened again: an answer that
    /// comes late must not be taken for the next one. Both are safe to repeat.
    async fn exchange(&mut self, write: Option<&[u8]>) -> Result<Vec<u8>, DeviceError> {
        let mut tries = 0;
        loop {
            tries += 1;
            let error = match self.attempt(write).await {
                Ok(bytes) => return Ok(bytes),
                Err(error) => error,
            };
            let refused = matches!(error, LinkError::Refused { .. } | LinkError::Unavailable { .. });
            if !refused {
                self.link = None;
            }
            // A port that is not there will not be there a moment later.
            if refused || tries >= self.settings.attempts || matches!(error, LinkError::Open { .. }) {
                return Err(self.explain(&error));
            }
            tracing::debug!(device = self.settings.name, %error, tries, "tried again");
            sleep(Duration::from_millis(self.settings.gap_ms)).await;
        }
    }

    async fn attempt(&mut self, write: Option<&[u8]>) -> Result<Vec<u8>, LinkError> {
        if self.link.is_none() {
            self.link = Some(Link::open(&self.settings).await?);
        }
        let Some(link) = &mut self.link else {
            return Err(LinkError::Lost { detail: "it closed".into() });
        };
        match write {
            Some(bytes) => link.write(bytes).await.map(|()| Vec::new()),
            None => link.read().await,
        }
    }

    fn explain(&self, error: &LinkError) -> DeviceError {
        let device = self.device();
        let detail = match error {
            LinkError::NoReply { bytes: 0, .. } => {
                format!(
                    "{error}: power, cable, address {}, or another master on the line?",
                    self.settings.slave
                )
            }
            LinkError::NoReply { .. } => {
                format!("{error}: a garbled line: grounding, baud rate, two masters?")
            }
            _ => error.to_string(),
        };
        match error {
            LinkError::Refused { .. } | LinkError::Answer { .. } => DeviceError::Protocol { device, detail },
            _ => DeviceError::Disconnected { device, detail },
        }
    }
}
