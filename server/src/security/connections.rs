//! Connections: how many there may be, and how long each may take to say something sensible.

use std::collections::HashMap;
use std::future::Future as _;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use tokio::time::Sleep;
use tokio_rustls::server::TlsStream;
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::server::Connected;

use super::{Acceptor, Limits, tls};

/// Bytes with which every HTTP/2 client begins, and the head of the frame after them.
const FIRST_BYTES: usize = 24 + 9;

/// Who is at the other end of a connection.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PeerInfo {
    pub(crate) addr: SocketAddr,
    /// SHA-256 of the client's certificate, if it showed one that is good.
    pub(crate) certificate: Option<[u8; 32]>,
}

enum Stream {
    Plain(TcpStream),
    Tls(Box<TlsStream<TcpStream>>),
}

/// A connection that is being served.
pub(crate) struct Connection {
    stream: Stream,
    peer: PeerInfo,
    /// Bytes that must come before the timer is let go.
    first_bytes: usize,
    hurry: Option<Pin<Box<Sleep>>>,
    _places: (OwnedSemaphorePermit, Place),
}

impl Connected for Connection {
    type ConnectInfo = PeerInfo;

    fn connect_info(&self) -> PeerInfo {
        self.peer
    }
}

/// Connections by address.
#[derive(Debug, Clone, Default)]
struct Places(Arc<Mutex<HashMap<IpAddr, usize>>>);

/// A connection's place among those of its address.
struct Place {
    places: Places,
    addr: IpAddr,
}

impl Places {
    fn take(&self, addr: IpAddr, limit: usize) -> Option<Place> {
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let count = all.entry(addr).or_default();
        // Everybody on this machine has the same address.
        if *count >= limit && !addr.is_loopback() {
            return None;
        }
        *count += 1;
        Some(Place { places: self.clone(), addr })
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut all = self.places.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(count) = all.get_mut(&self.addr) {
            *count -= 1;
            if *count == 0 {
                all.remove(&self.addr);
            }
        }
    }
}

/// Accepts connections until nobody takes them any more. Those over a limit are closed at once.
pub(crate) fn accept(
    listener: TcpListener,
    tls: Option<Acceptor>,
    limits: Limits,
) -> ReceiverStream<io::Result<Connection>> {
    let (sender, receiver) = mpsc::channel(16);
    tokio::spawn(async move {
        let all = Arc::new(Semaphore::new(limits.connections.max(1)));
        let places = Places::default();
        loop {
            let (stream, addr) = tokio::select! {
                () = sender.closed() => return,
                accepted = listener.accept() => match accepted {
                    Ok(accepted) => accepted,
                    // Out of file descriptors, or a peer that is gone already: neither ends the server.
                    Err(error) => {
                        tracing::warn!(%error, "a connection could not be accepted");
                        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
                        continue;
                    }
                },
            };
            let permit = Arc::clone(&all).try_acquire_owned().ok();
            let place = places.take(addr.ip(), limits.connections_per_address);
            let (Some(permit), Some(place)) = (permit, place) else {
                tracing::warn!(%addr, "too many connections; this one is closed");
                continue;
            };
            stream.set_nodelay(true).ok();
            let (sender, tls) = (sender.clone(), tls.clone());
            tokio::spawn(async move {
                let shaken = tokio::time::timeout(limits.handshake, shake(stream, addr, tls)).await;
                match shaken {
                    Ok(Ok((stream, peer))) => {
                        let connection = Connection {
                            stream,
                            peer,
                            first_bytes: FIRST_BYTES,
                            hurry: Some(Box::pin(tokio::time::sleep(limits.handshake))),
                            _places: (permit, place),
                        };
                        sender.send(Ok(connection)).await.ok();
                    }
                    Ok(Err(error)) => tracing::info!(%addr, %error, "no TLS connection came about"),
                    Err(_) => tracing::info!(%addr, "the TLS handshake took too long"),
                }
            });
        }
    });
    ReceiverStream::new(receiver)
}

async fn shake(stream: TcpStream, addr: SocketAddr, tls: Option<Acceptor>) -> io::Result<(Stream, PeerInfo)> {
    let Some(tls) = tls else { return Ok((Stream::Plain(stream), PeerInfo { addr, certificate: None })) };
    let stream = tls.now().accept(stream).await?;
    let shown = stream.get_ref().1.peer_certificates().and_then(|all| all.first());
    let certificate = shown.map(tls::fingerprint);
    Ok((Stream::Tls(Box::new(stream)), PeerInfo { addr, certificate }))
}

impl AsyncRead for Connection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        let polled = match &mut self.stream {
            Stream::Plain(stream) => Pin::new(stream).poll_read(context, buffer),
            Stream::Tls(stream) => Pin::new(stream.as_mut()).poll_read(context, buffer),
        };
        let Some(hurry) = self.hurry.as_mut() else { return polled };
        if polled.is_pending() && hurry.as_mut().poll(context).is_ready() {
            return Poll::Ready(Err(io::Error::new(io::ErrorKind::TimedOut, "nothing was asked in time")));
        }
        let read = buffer.filled().len() - before;
        self.first_bytes = self.first_bytes.saturating_sub(read);
        if self.first_bytes == 0 {
            self.hurry = None;
        }
        polled
    }
}

impl AsyncWrite for Connection {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        match &mut self.stream {
            Stream::Plain(stream) => Pin::new(stream).poll_write(context, bytes),
            Stream::Tls(stream) => Pin::new(stream.as_mut()).poll_write(context, bytes),
        }
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        match &mut self.stream {
            Stream::Plain(stream) => Pin::new(stream).poll_flush(context),
            Stream::Tls(stream) => Pin::new(stream.as_mut()).poll_flush(context),
        }
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        match &mut self.stream {
            Stream::Plain(stream) => Pin::new(stream).poll_shutdown(context),
            Stream::Tls(stream) => Pin::new(stream.as_mut()).poll_shutdown(context),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Places;

    #[test]
    fn an_address_has_as_many_connections_as_it_may_and_this_machine_as_many_as_it_wants() {
        let places = Places::default();
        let (one, other, here) =
            ("192.0.2.1".parse().unwrap(), "2001:db8::1".parse().unwrap(), "::1".parse().unwrap());
        let first = places.take(one, 2).unwrap();
        let second = places.take(one, 2).unwrap();
        assert!(places.take(one, 2).is_none());
        let _another = places.take(other, 2).unwrap();
        // The place of one that has gone is free, and nothing is left of addresses that have gone.
        drop(first);
        let third = places.take(one, 2).unwrap();
        assert!(places.take(one, 2).is_none());
        let _here: Vec<_> = (0..5).map(|_| places.take(here, 2).unwrap()).collect();
        drop((third, second));
        assert_eq!(places.0.lock().unwrap().len(), 2);
    }
}
