//! Who calls: a name for logs and metrics, a number for the scheduler.

use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::net::SocketAddr;
use std::sync::Arc;

use crate::pool::{Flow, Priority};

/// Somebody who calls.
#[derive(Debug, Clone)]
pub(crate) struct Caller {
    /// Name: of a token or a certificate, or the address of somebody anonymous.
    pub(crate) name: Arc<str>,
    /// Who has a share of the time: whoever has that name, or one connection of somebody anonymous.
    pub(crate) flow: Flow,
    /// The most urgent priority that they may ask for.
    pub(crate) most_urgent: Priority,
}

impl Caller {
    /// A caller by name.
    pub(crate) fn named(name: &str) -> Self {
        Self { name: name.into(), flow: Self::number(name), most_urgent: Priority::Servo }
    }

    /// Somebody anonymous at an address.
    pub(crate) fn anonymous(peer: Option<SocketAddr>) -> Self {
        let Some(peer) = peer else { return Self::named("unknown") };
        Self { flow: Self::number(&peer.to_string()), ..Self::named(&peer.ip().to_string()) }
    }

    /// The same number for all connections of this caller: whose request ids these are.
    pub(crate) fn identity(&self) -> Flow {
        Self::number(&self.name)
    }

    /// A number for a name, the same in every process. Flow 0 is for what belongs to nobody.
    pub(crate) fn number(name: &str) -> Flow {
        let mut hasher = DefaultHasher::new();
        name.hash(&mut hasher);
        Flow(hasher.finish().max(1))
    }
}
