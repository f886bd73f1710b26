//! Why a server does not start, or ends by itself.

use std::io;
use std::net::SocketAddr;

use crate::pool::PoolError;
use crate::registry::FolderError;
use crate::security::{TlsError, WrongAccess};
use crate::trace::WrongCollector;

/// Why a server does not start or ends by itself.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ServeError {
    /// The address is not a loopback address.
    #[error(
        "refusing to listen on {addr}: other machines could reach it and the connection would not be encrypted; \
         name a certificate, listen on a loopback address such as 127.0.0.1:{port}, or allow it with --insecure-listen",
        port = addr.port()
    )]
    NotLoopback {
        /// The address.
        addr: SocketAddr,
    },
    /// The address is not a loopback address, and anybody could call.
    #[error(
        "refusing to listen on {addr}: anybody who reaches it could call; name access tokens, or require client \
         certificates, or allow it with --insecure-listen"
    )]
    Anybody {
        /// The address.
        addr: SocketAddr,
    },
    /// The certificates cannot be used.
    #[error(transparent)]
    Tls(#[from] TlsError),
    /// The list of who may call is not one.
    #[error(transparent)]
    Access(#[from] WrongAccess),
    /// The address cannot be bound.
    #[error("cannot listen on {addr}")]
    Bind {
        /// The address.
        addr: SocketAddr,
        /// Why.
        source: io::Error,
    },
    /// The folder of hands cannot be read.
    #[error("the folder of hands cannot be read")]
    Hands(#[from] FolderError),
    /// The collector of traces has no address that can be used.
    #[error(transparent)]
    Collector(#[from] WrongCollector),
    /// There can be no live view.
    #[error(transparent)]
    Live(#[from] graspd_live::LiveError),
    /// The recording cannot be kept.
    #[error(transparent)]
    Recording(#[from] graspd_recording::FolderError),
    /// The planning threads cannot be started.
    #[error(transparent)]
    Pool(#[from] PoolError),
    /// The transport failed.
    #[error("the transport failed")]
    Transport(#[from] tonic::transport::Error),
    /// The descriptors for reflection cannot be read.
    #[error("the descriptors for reflection cannot be read")]
    Reflection(#[from] tonic_reflection::server::Error),
    /// The thread that reads hands was lost.
    #[error("loading hands: {0}")]
    Loading(String),
}
