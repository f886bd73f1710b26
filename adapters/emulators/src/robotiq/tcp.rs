//! Servers on TCP: connections, faults of theirs, and Modbus TCP frames.

use std::io;
use std::net::SocketAddr;
use std::time::{Duration, Instant};

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{sleep, sleep_until, timeout};

use super::device::Gripper;
use super::modbus;
use crate::faults::LinkFaults;
use crate::line::Reply;

/// How often a connection looks for a requested hang-up.
const LOOK_UP: Duration = Duration::from_millis(20);
/// Connections at a time.
const MOST: usize = 64;

/// One client's conversation.
pub(super) trait Talker: Send + 'static {
    /// Takes bytes in any pieces, and says what is sent back.
    fn receive(&mut self, bytes: &[u8], now: Instant) -> Vec<Reply>;
}

/// A server. Ends, with all its connections, when dropped.
#[derive(Debug)]
pub struct Server {
    address: SocketAddr,
    faults: LinkFaults,
    _alive: watch::Sender<()>,
}

impl Server {
    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Faults of its connections; a hang-up closes all, and new ones are closed at once while it lasts.
    pub fn faults(&self) -> &LinkFaults {
        &self.faults
    }
}

pub(super) async fn serve<T: Talker>(
    address: SocketAddr,
    talker: impl Fn() -> T + Send + Sync + 'static,
) -> io::Result<Server> {
    let listener = TcpListener::bind(address).await?;
    let address = listener.local_addr()?;
    let faults = LinkFaults::default();
    let (alive, gone) = watch::channel(());
    tokio::spawn(accept(listener, talker, faults.clone(), gone));
    Ok(Server { address, faults, _alive: alive })
}

async fn accept<T: Talker>(
    listener: TcpListener,
    talker: impl Fn() -> T,
    faults: LinkFaults,
    mut gone: watch::Receiver<()>,
) {
    let mut talks = JoinSet::new();
    let mut away_until = Instant::now();
    loop {
        tokio::select! {
            // The sender is dropped with the server.
            _ = gone.changed() => return,
            () = sleep(LOOK_UP) => {
                if let Some(away) = faults.take_hang_up() {
                    away_until = Instant::now() + away;
                    talks.abort_all();
                }
                while talks.try_join_next().is_some() {}
            }
            accepted = listener.accept() => match accepted {
                Ok((stream, _)) if Instant::now() >= away_until && talks.len() < MOST => {
                    talks.spawn(talk(stream, talker(), faults.clone()));
                }
                Ok(_) => {}
                Err(error) => {
                    tracing::warn!(%error, "a connection could not be accepted");
                    sleep(LOOK_UP).await;
                }
            },
        }
    }
}

async fn talk<T: Talker>(mut stream: TcpStream, mut talker: T, faults: LinkFaults) {
    // Answers are short and awaited.
    let _slower = stream.set_nodelay(true);
    let mut buffer = [0u8; 1024];
    loop {
        let Ok(n) = stream.read(&mut buffer).await else { return };
        if n == 0 {
            return;
        }
        let heard = tokio::time::Instant::now();
        for reply in talker.receive(&buffer[..n], heard.into_std()) {
            let late = faults.delay();
            let Some(bytes) = faults.befall(reply.bytes) else { continue };
            sleep_until(heard + reply.after + late).await;
            // A client that takes nothing does not hold the server.
            if !matches!(timeout(Duration::from_secs(5), stream.write_all(&bytes)).await, Ok(Ok(()))) {
                return;
            }
        }
    }
}

/// Modbus TCP: transaction, protocol, length, unit, request.
pub(super) struct ModbusTcp {
    gripper: Gripper,
    bytes: Vec<u8>,
}

impl ModbusTcp {
    pub(super) fn new(gripper: Gripper) -> Self {
        Self { gripper, bytes: Vec::new() }
    }
}

impl Talker for ModbusTcp {
    fn receive(&mut self, bytes: &[u8], now: Instant) -> Vec<Reply> {
        self.bytes.extend_from_slice(bytes);
        let mut answers = Vec::new();
        while let [t0, t1, p0, p1, l0, l1, unit, ..] = self.bytes[..] {
            let length = usize::from(u16::from_be_bytes([l0, l1]));
            if (p0, p1) != (0, 0) || !(2..=254).contains(&length) {
                // No Modbus: there is no way to find the next frame.
                self.bytes.clear();
                break;
            }
            if self.bytes.len() < 6 + length {
                break;
            }
            let frame: Vec<u8> = self.bytes.drain(..6 + length).collect();
            let pdu = modbus::answer(&self.gripper, &frame[7..], true, now);
            let [l0, l1] = u16::try_from(pdu.len() + 1).unwrap_or(u16::MAX).to_be_bytes();
            let mut answer = vec![t0, t1, 0, 0, l0, l1, unit];
            answer.extend(pdu);
            answers.push(Reply { bytes: answer, after: Duration::ZERO });
        }
        answers
    }
}
