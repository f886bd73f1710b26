//! Where the broker is, what things are called there, and how long everybody waits.

use std::path::PathBuf;
use std::time::Duration;

use async_nats::ServerAddr;

/// A worker that has been silent for so long is taken for lost, and its job goes to another one.
pub(crate) const ACK_WAIT: Duration = Duration::from_millis(400);
/// A worker says so often that it is still at a job.
pub(crate) const PROGRESS: Duration = Duration::from_millis(100);
/// A job is given to so many workers before it is given up.
pub(crate) const MAX_DELIVER: usize = 3;
/// Nothing stays longer than this in the broker: the longest deadline, and the time of a call that names none.
pub(crate) const MAX_AGE: Duration = Duration::from_secs(600);
/// The broker answers within this or is away.
pub(crate) const BROKER_PATIENCE: Duration = Duration::from_secs(1);
/// A silent connection is asked so often whether the broker is there; two silences are the end of it.
pub(crate) const PING: Duration = Duration::from_secs(1);
/// Where nothing waited, a worker looks again after this, if nobody has rung the bell before.
pub(crate) const IDLE_POLL: Duration = Duration::from_millis(250);
/// The least that the broker must take in one message: headers, and replies with many grasps.
pub(crate) const LEAST_PAYLOAD: usize = 256 << 10;
/// What the broker should take in one message, so that frames need no detour.
pub(crate) const GOOD_PAYLOAD: usize = 8 << 20;
/// Room for headers in a message.
pub(crate) const HEADER_ROOM: usize = 16 << 10;

/// Certificates for the connection to the broker.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct BrokerTls {
    /// PEM of roots besides those of the system.
    pub roots: Option<PathBuf>,
    /// PEM of this process's certificate and its key, where the broker asks for one.
    pub certificate: Option<(PathBuf, PathBuf)>,
}

/// How the broker is reached and used.
#[derive(Debug, Clone)]
pub struct NatsConfig {
    /// `nats://` or `tls://`, user and password or a token before the host; several addresses with commas between.
    pub url: String,
    /// Installations that share a broker are told apart by this: 1 to 32 lower-case letters, digits and hyphens.
    pub name: String,
    /// Jobs that may wait or run in the whole installation; more are refused. The front that starts last decides.
    pub queue: usize,
    /// Allows a broker on another machine without encryption.
    pub insecure: bool,
    /// Certificates.
    pub tls: BrokerTls,
}

impl NatsConfig {
    /// The defaults for a broker.
    pub fn new(url: impl Into<String>) -> Self {
        Self {
            url: url.into(),
            name: "graspd".to_owned(),
            queue: 64,
            insecure: false,
            tls: BrokerTls::default(),
        }
    }

    /// The addresses of the broker.
    ///
    /// # Errors
    /// [`WrongUrl`], which never shows a password.
    pub(crate) fn servers(&self) -> Result<Vec<ServerAddr>, WrongUrl> {
        let in_order = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
        if self.name.is_empty() || self.name.len() > 32 || !self.name.chars().all(in_order) {
            return Err(WrongUrl::Name { found: self.name.clone() });
        }
        let mut servers = Vec::new();
        for text in self.url.split(',').map(str::trim) {
            // The text may have a password in it, so it is not shown.
            let server: ServerAddr = text.parse().map_err(|_| WrongUrl::Malformed)?;
            let known = matches!(server.scheme(), "nats" | "tls");
            if !known || !text.contains("://") || server.host().is_empty() {
                return Err(WrongUrl::Malformed);
            }
            let near = server.host() == "localhost"
                || server
                    .host()
                    .trim_matches(['[', ']'])
                    .parse()
                    .is_ok_and(|ip: std::net::IpAddr| ip.is_loopback());
            if !near && !server.tls_required() && !self.insecure {
                return Err(WrongUrl::Plain { host: server.host().to_owned() });
            }
            servers.push(server);
        }
        Ok(servers)
    }

    /// The broker's addresses without what is secret.
    pub(crate) fn shown(servers: &[ServerAddr]) -> String {
        let shown: Vec<_> =
            servers.iter().map(|s| format!("{}://{}:{}", s.scheme(), s.host(), s.port())).collect();
        shown.join(",")
    }
}

/// An address that cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum WrongUrl {
    /// It is none.
    #[error("found something else, expected an address such as nats://127.0.0.1:4222 or tls://broker:4222")]
    Malformed,
    /// Frames would travel without encryption.
    #[error(
        "refusing nats://{host}: it is on another machine and the connection would not be encrypted; \
         use tls://{host}, or allow it with --insecure-engine"
    )]
    Plain {
        /// The host.
        host: String,
    },
    /// The installation's name is none.
    #[error("--engine-name: found {found:?}, expected 1 to 32 lower-case letters, digits and hyphens")]
    Name {
        /// As given.
        found: String,
    },
}

/// What things of an installation are called in the broker.
#[derive(Debug, Clone)]
pub(crate) struct Names {
    name: String,
}

impl Names {
    pub(crate) fn new(name: &str) -> Self {
        Self { name: name.to_owned() }
    }

    /// The stream of jobs.
    pub(crate) fn stream(&self) -> String {
        format!("{}-jobs", self.name)
    }

    /// Subject of a job of that priority; `*` for all.
    pub(crate) fn jobs(&self, priority: &str, hand: &str) -> String {
        format!("{}.jobs.{priority}.{hand}", self.name)
    }

    /// Subject of replies to a front; `*` for all jobs.
    pub(crate) fn replies(&self, front: &str, job: &str) -> String {
        format!("{}.replies.{front}.{job}", self.name)
    }

    /// Subject of a job's cancellation; `*` for all.
    pub(crate) fn cancel(&self, job: &str) -> String {
        format!("{}.cancel.{job}", self.name)
    }

    /// Rung when there is a new job.
    pub(crate) fn bell(&self) -> String {
        format!("{}.bell", self.name)
    }

    /// The broker's news of jobs that were delivered too often.
    pub(crate) fn given_up(&self) -> String {
        format!("$JS.EVENT.ADVISORY.CONSUMER.MAX_DELIVERIES.{}.*", self.stream())
    }

    /// Object store of requests that are too large for a message.
    pub(crate) fn requests(&self) -> String {
        format!("{}-requests", self.name)
    }

    /// Key-value bucket of hands.
    pub(crate) fn hands(&self) -> String {
        format!("{}-hands", self.name)
    }

    /// Object store of hands' files.
    pub(crate) fn hand_files(&self) -> String {
        format!("{}-hand-files", self.name)
    }

    /// Key-value bucket of leases.
    pub(crate) fn leases(&self) -> String {
        format!("{}-leases", self.name)
    }

    /// Key-value bucket of workers that are there.
    pub(crate) fn workers(&self) -> String {
        format!("{}-workers", self.name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn servers(url: &str) -> Result<String, WrongUrl> {
        NatsConfig::new(url).servers().map(|servers| NatsConfig::shown(&servers))
    }

    #[test]
    fn addresses_are_near_or_encrypted_and_secrets_are_not_shown() {
        assert_eq!(servers("nats://127.0.0.1:4222").unwrap(), "nats://127.0.0.1:4222");
        assert_eq!(
            servers("nats://me:secret@localhost:1, tls://b").unwrap(),
            "nats://localhost:1,tls://b:4222"
        );
        assert_eq!(servers("nats://[::1]:4222").unwrap(), "nats://[::1]:4222");
        let plain = servers("nats://me:secret@broker:4222").unwrap_err().to_string();
        assert!(plain.contains("tls://broker") && !plain.contains("secret"), "{plain}");
        for wrong in ["", "127.0.0.1:4222", "http://127.0.0.1", "nats://", "nats://a:b:c"] {
            assert_eq!(servers(wrong).unwrap_err(), WrongUrl::Malformed, "{wrong:?}");
        }
        let named = NatsConfig { name: "two.words".to_owned(), ..NatsConfig::new("nats://localhost") };
        assert!(named.servers().unwrap_err().to_string().contains("two.words"));
        let allowed = NatsConfig { insecure: true, ..NatsConfig::new("nats://broker") };
        assert_eq!(allowed.servers().unwrap().len(), 1);
    }
}
