//! Who may connect, who may call what, and how much of it: TLS, tokens and certificates, roles, quotas, limits.

mod access;
mod bodies;
mod connections;
mod limits;
mod tls;

pub use access::{Access, Certificate, Role, Token, WrongAccess};
pub use limits::Limits;
pub use tls::{Tls, TlsError};

pub(crate) use access::{Credentials, Identity};
pub(crate) use bodies::{Ending, GuardedBody, ReceivedBody};
pub(crate) use connections::{PeerInfo, accept};
pub(crate) use limits::{Quotas, Use};
pub(crate) use tls::Acceptor;
