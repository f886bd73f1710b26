//! The dashboard server: power, brakes, modes, unlocking. A connection for each command: nothing to keep alive.

use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

/// Longest line that is read, bytes.
const LONGEST: usize = 4096;

/// Why a command of the dashboard did not do what it should.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DashboardError {
    /// Nobody answers.
    #[error("dashboard: {0}")]
    Link(String),
    /// No answer in time.
    #[error("dashboard: no answer to `{command}` within {after:?}")]
    Timeout {
        /// The command.
        command: String,
        /// The time that was allowed.
        after: Duration,
    },
    /// An answer that is not one.
    #[error("dashboard `{command}`: found {found:?}, expected {expected}")]
    Unexpected {
        /// The command.
        command: String,
        /// Found answer.
        found: String,
        /// What is expected.
        expected: String,
    },
    /// The controller is not in remote control.
    #[error(
        "dashboard `{command}`: not in remote control; expected: a person chooses Remote Control at the top right of \
         the pendant (Settings > System > Remote Control enables it)"
    )]
    NotRemote {
        /// The command.
        command: String,
    },
    /// A protective stop cannot be unlocked yet.
    #[error("dashboard `unlock protective stop`: {0}")]
    TooEarly(String),
}

/// A client of one dashboard server.
#[derive(Debug, Clone)]
pub struct Dashboard {
    host: String,
    port: u16,
    timeout: Duration,
}

/// The first line of what has come, without the white space at its ends; `None` while it has no end yet.
///
/// # Errors
/// What is wrong with it: more bytes than a dashboard says in a line.
pub fn dashboard_line(came: &[u8]) -> Result<Option<String>, String> {
    match came.iter().position(|b| *b == b'\n') {
        Some(end) => Ok(Some(String::from_utf8_lossy(&came[..end]).trim().to_owned())),
        None if came.len() > LONGEST => Err(format!("a line of more than {LONGEST} bytes")),
        None => Ok(None),
    }
}

impl Dashboard {
    /// For a controller; each command is answered within `timeout` or fails.
    pub fn new(host: impl Into<String>, port: u16, timeout: Duration) -> Self {
        Self { host: host.into(), port, timeout }
    }

    /// Sends a line, gives the line that answers.
    ///
    /// # Errors
    /// [`DashboardError::Link`], [`DashboardError::Timeout`], [`DashboardError::Unexpected`].
    pub async fn command(&self, command: &str) -> Result<String, DashboardError> {
        let exchange = async {
            let link = |e: std::io::Error| DashboardError::Link(format!("{}:{}: {e}", self.host, self.port));
            let mut stream = TcpStream::connect((self.host.as_str(), self.port)).await.map_err(link)?;
            let greeting = self.line(&mut stream).await?;
            if !greeting.starts_with("Connected: Universal Robots Dashboard Server") {
                let expected = "the greeting of a dashboard server".into();
                return Err(DashboardError::Unexpected {
                    command: "connect".into(),
                    found: greeting,
                    expected,
                });
            }
            stream.write_all(format!("{command}\n").as_bytes()).await.map_err(link)?;
            self.line(&mut stream).await
        };
        let answer = tokio::time::timeout(self.timeout, exchange)
            .await
            .map_err(|_| DashboardError::Timeout { command: command.to_owned(), after: self.timeout })??;
        tracing::info!(command, answer, host = self.host, "dashboard");
        Ok(answer)
    }

    async fn line(&self, stream: &mut (impl AsyncRead + Unpin)) -> Result<String, DashboardError> {
        let link = |what: String| DashboardError::Link(format!("{}:{}: {what}", self.host, self.port));
        let mut came = Vec::new();
        // Lines are short, and nothing follows one before the next command: read what comes, up to its end.
        let mut buffer = [0; 256];
        loop {
            let count = stream.read(&mut buffer).await.map_err(|e| link(e.to_string()))?;
            if count == 0 {
                return Err(link("closed in the middle of a line".into()));
            }
            came.extend_from_slice(&buffer[..count]);
            if let Some(line) = dashboard_line(&came).map_err(link)? {
                return Ok(line);
            }
        }
    }

    /// A command whose answer must begin so. A refusal is told apart from other answers by asking who is in control.
    async fn expect(&self, command: &str, expected: &str) -> Result<String, DashboardError> {
        let answer = self.command(command).await?;
        if answer.to_lowercase().starts_with(&expected.to_lowercase()) {
            return Ok(answer);
        }
        if self.is_remote().await? == Some(false) {
            return Err(DashboardError::NotRemote { command: command.to_owned() });
        }
        Err(DashboardError::Unexpected {
            command: command.to_owned(),
            found: answer,
            expected: expected.into(),
        })
    }

    /// Whether the network is in control; `None` where the software does not tell (CB3, before 5.6).
    ///
    /// # Errors
    /// [`DashboardError`].
    pub async fn is_remote(&self) -> Result<Option<bool>, DashboardError> {
        Ok(match self.command("is in remote control").await?.as_str() {
            "true" => Some(true),
            "false" => Some(false),
            _ => None,
        })
    }

    /// Mode of the robot, for example `RUNNING`.
    ///
    /// # Errors
    /// [`DashboardError`].
    pub async fn robot_mode(&self) -> Result<String, DashboardError> {
        let answer = self.expect("robotmode", "Robotmode: ").await?;
        Ok(answer.split_once(": ").map_or(String::new(), |(_, mode)| mode.to_owned()))
    }

    /// State of the safety system, for example `NORMAL`.
    ///
    /// # Errors
    /// [`DashboardError`].
    pub async fn safety_status(&self) -> Result<String, DashboardError> {
        let answer = match self.expect("safetystatus", "Safetystatus: ").await {
            // Before 5.4.
            Err(DashboardError::Unexpected { .. }) => self.expect("safetymode", "Safetymode: ").await?,
            answer => answer?,
        };
        Ok(answer.split_once(": ").map_or(String::new(), |(_, status)| status.to_owned()))
    }

    /// Version of the software, as it writes it.
    ///
    /// # Errors
    /// [`DashboardError`].
    pub async fn version(&self) -> Result<String, DashboardError> {
        self.expect("PolyscopeVersion", "URSoftware").await
    }

    /// Model, as the controller writes it (`UR5` for a UR5e); `None` where the software does not tell.
    ///
    /// # Errors
    /// [`DashboardError`].
    pub async fn robot_model(&self) -> Result<Option<String>, DashboardError> {
        Ok(Some(self.command("get robot model").await?).filter(|answer| answer.starts_with("UR")))
    }

    /// Switches power on. Ends when the command is taken.
    ///
    /// # Errors
    /// [`DashboardError`].
    pub async fn power_on(&self) -> Result<(), DashboardError> {
        self.expect("power on", "Powering on").await.map(|_| ())
    }

    /// Switches power off. Ends when the command is taken.
    ///
    /// # Errors
    /// [`DashboardError`].
    pub async fn power_off(&self) -> Result<(), DashboardError> {
        self.expect("power off", "Powering off").await.map(|_| ())
    }

    /// Releases the brakes. Ends when the command is taken.
    ///
    /// # Errors
    /// [`DashboardError`].
    pub async fn release_brakes(&self) -> Result<(), DashboardError> {
        self.expect("brake release", "Brake releasing").await.map(|_| ())
    }

    /// Stops the program that runs.
    ///
    /// # Errors
    /// [`DashboardError`].
    pub async fn stop_program(&self) -> Result<(), DashboardError> {
        self.expect("stop", "Stopped").await.map(|_| ())
    }

    /// Closes the popup of a safety stop.
    ///
    /// # Errors
    /// [`DashboardError`].
    pub async fn close_safety_popup(&self) -> Result<(), DashboardError> {
        self.expect("close safety popup", "closing safety popup").await.map(|_| ())
    }

    /// Unlocks a protective stop.
    ///
    /// # Errors
    /// [`DashboardError::TooEarly`] within five seconds of the stop; others.
    pub async fn unlock_protective_stop(&self) -> Result<(), DashboardError> {
        let answer = self.command("unlock protective stop").await?;
        if answer.starts_with("Protective stop releasing") {
            return Ok(());
        }
        if answer.starts_with("Cannot unlock") {
            return Err(DashboardError::TooEarly(answer));
        }
        let (command, expected) = ("unlock protective stop".into(), "Protective stop releasing".into());
        Err(DashboardError::Unexpected { command, found: answer, expected })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn line(mut bytes: &[u8]) -> Result<String, DashboardError> {
        let dashboard = Dashboard::new("arm", 29999, Duration::from_secs(1));
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        runtime.block_on(dashboard.line(&mut bytes))
    }

    #[test]
    fn a_line_ends_where_it_ends() {
        assert_eq!(line(b"Robotmode: RUNNING\r\nmore").unwrap(), "Robotmode: RUNNING");
        let error = line(b"Robotmode: RUN").unwrap_err().to_string();
        assert_eq!(error, "dashboard: arm:29999: closed in the middle of a line");
        let error = line(&[b'x'; 2 * LONGEST]).unwrap_err().to_string();
        assert_eq!(error, format!("dashboard: arm:29999: a line of more than {LONGEST} bytes"));
    }

    proptest! {
        #[test]
        fn any_bytes_are_survived(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
            let said = line(&bytes);
            prop_assert_eq!(said.is_ok(), bytes.contains(&b'\n'));
        }
    }
}
