//! Exchanges with a gripper: status bytes are read, request bytes are written, over whichever link.

mod counted;
mod modbus;
mod socket;

use std::time::Duration;

use modbus::ModbusLink;
use socket::SocketLink;
pub use socket::socket_status;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::time::{Instant, sleep_until};

use crate::settings::{LinkSettings, RobotiqSettings};

/// Why an exchange failed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LinkError {
    /// The port or connection cannot be opened.
    #[error("{place}: {detail}")]
    Open {
        /// Port or address.
        place: String,
        /// What the system said.
        detail: String,
    },
    /// The link broke.
    #[error("the link broke: {detail}")]
    Lost {
        /// What the system said.
        detail: String,
    },
    /// No whole answer in time.
    #[error("no answer within {after:?}; {bytes} bytes of no valid frame came")]
    NoReply {
        /// Time that was given.
        after: Duration,
        /// Bytes that came: 0 for a silent gripper, more for a garbled or cut answer.
        bytes: u64,
    },
    /// The gripper refused.
    #[error("registers {first} and on: the gripper refuses: {exception}")]
    Refused {
        /// First register.
        first: u16,
        /// Its reason.
        exception: String,
    },
    /// The gripper answered something else than it was asked.
    #[error("{field}: found {found}, expected {expected}")]
    Answer {
        /// What was asked.
        field: String,
        /// What came.
        found: String,
        /// What was expected.
        expected: String,
    },
    /// The arm's gripper software cannot reach the gripper.
    #[error("{variable}: the gripper cannot be reached by the arm: emergency stop, no power, or not scanned")]
    Unavailable {
        /// What was asked.
        variable: String,
    },
}

#[derive(Debug)]
enum Kind {
    Modbus(ModbusLink),
    Socket(SocketLink),
}

/// An open link.
#[derive(Debug)]
pub struct Link {
    kind: Kind,
    gap: Duration,
    /// When the next exchange may begin: grippers want some silence between frames.
    free: Instant,
}

impl Link {
    /// Opens the link that the settings say. Nothing is asked yet.
    ///
    /// # Errors
    /// [`LinkError::Open`].
    pub async fn open(settings: &RobotiqSettings) -> Result<Self, LinkError> {
        let kind = match &settings.link {
            LinkSettings::Socket { address } => Kind::Socket(SocketLink::open(address, settings).await?),
            _ => Kind::Modbus(ModbusLink::open(settings).await?),
        };
        Ok(Self { kind, gap: Duration::from_millis(settings.gap_ms), free: Instant::now() })
    }

    /// A Modbus link over a stream that is open already, for lines that somebody else opens: frames are those of the link
    /// that the settings name.
    pub fn attach<T>(stream: T, settings: &RobotiqSettings) -> Self
    where
        T: AsyncRead + AsyncWrite + std::fmt::Debug + Unpin + Send + 'static,
    {
        let kind = Kind::Modbus(ModbusLink::attach(stream, settings));
        Self { kind, gap: Duration::from_millis(settings.gap_ms), free: Instant::now() }
    }

    /// Status bytes of the gripper.
    ///
    /// # Errors
    /// Any [`LinkError`]; the link should be opened again after any but [`LinkError::Unavailable`] and
    /// [`LinkError::Refused`].
    pub async fn read(&mut self) -> Result<Vec<u8>, LinkError> {
        sleep_until(self.free).await;
        let read = match &mut self.kind {
            Kind::Modbus(link) => link.read().await,
            Kind::Socket(link) => link.read().await,
        };
        self.free = Instant::now() + self.gap;
        read
    }

    /// Writes request bytes.
    ///
    /// # Errors
    /// As [`Link::read`].
    pub async fn write(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        sleep_until(self.free).await;
        let written = match &mut self.kind {
            Kind::Modbus(link) => link.write(bytes).await,
            Kind::Socket(link) => link.write(bytes).await,
        };
        self.free = Instant::now() + self.gap;
        written
    }
}
