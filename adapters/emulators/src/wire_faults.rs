//! Faults of a link on request: what every emulator that answers on a wire can be told to do wrong.

use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::io::{AsyncWrite, AsyncWriteExt};
use tokio::sync::watch;

/// What a link does wrong from now on.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Misbehaviour {
    /// Writes at most so many bytes at once, with a pause after each part.
    pub pieces: Option<(usize, Duration)>,
    /// Waits so long before each answer.
    pub delay: Duration,
    /// Swallows everything that it should say.
    pub mute: bool,
    /// Closes new connections at once.
    pub refuse: bool,
    /// Changes bytes of the next packets.
    pub garble: Option<Garble>,
}

/// Wrong bytes in packets to come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Garble {
    /// In so many packets.
    pub packets: u32,
    /// At this place, counted from the start; the last byte where a packet is shorter.
    pub at: usize,
    /// Bits that are turned over.
    pub mask: u8,
}

/// A handle on the faults of one link. Clones are the same handle.
#[derive(Debug, Clone)]
pub struct WireFaults {
    state: Arc<Mutex<Misbehaviour>>,
    /// Counts how often connections were cut.
    cuts: Arc<watch::Sender<u64>>,
}

impl Default for WireFaults {
    fn default() -> Self {
        Self { state: Arc::default(), cuts: Arc::new(watch::Sender::new(0)) }
    }
}

impl WireFaults {
    fn state(&self) -> MutexGuard<'_, Misbehaviour> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Misbehaves like that from now on.
    pub fn set(&self, misbehaviour: Misbehaviour) {
        *self.state() = misbehaviour;
    }

    /// Behaves from now on.
    pub fn clear(&self) {
        self.set(Misbehaviour::default());
    }

    /// What it does wrong now.
    pub fn current(&self) -> Misbehaviour {
        self.state().clone()
    }

    /// Cuts every connection that is open.
    pub fn cut(&self) {
        self.cuts.send_modify(|count| *count += 1);
    }

    /// Ends when connections are cut. Made when a connection begins.
    pub fn until_cut(&self) -> impl Future<Output = ()> + Send + use<> {
        let mut cuts = self.cuts.subscribe();
        async move {
            if cuts.changed().await.is_err() {
                std::future::pending().await
            }
        }
    }

    /// Sends a packet as the faults say.
    ///
    /// # Errors
    /// Those of the link.
    pub async fn send<W: AsyncWrite + Unpin + Send>(&self, to: &mut W, packet: &[u8]) -> io::Result<()> {
        let (delay, pieces, mute) = {
            let state = self.state();
            (state.delay, state.pieces, state.mute)
        };
        if !delay.is_zero() {
            tokio::time::sleep(delay).await;
        }
        if mute {
            return Ok(());
        }
        let garbled = self.garbled(packet);
        let packet = garbled.as_deref().unwrap_or(packet);
        let Some((most, pause)) = pieces else { return to.write_all(packet).await };
        for piece in packet.chunks(most.max(1)) {
            to.write_all(piece).await?;
            to.flush().await?;
            tokio::time::sleep(pause).await;
        }
        Ok(())
    }

    fn garbled(&self, packet: &[u8]) -> Option<Vec<u8>> {
        let mut state = self.state();
        let garble = state.garble.as_mut()?;
        let (at, mask) = (garble.at, garble.mask);
        garble.packets = garble.packets.saturating_sub(1);
        if garble.packets == 0 {
            state.garble = None;
        }
        let mut packet = packet.to_vec();
        let last = packet.len().checked_sub(1)?;
        packet[at.min(last)] ^= mask;
        Some(packet)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn packets_are_garbled_as_often_as_asked_and_swallowed_while_mute() {
        let faults = WireFaults::default();
        faults.set(Misbehaviour {
            garble: Some(Garble { packets: 1, at: 9, mask: 0xff }),
            pieces: Some((1, Duration::ZERO)),
            ..Misbehaviour::default()
        });
        let mut sent = Vec::new();
        faults.send(&mut sent, &[1, 2]).await.unwrap();
        faults.send(&mut sent, &[3, 4]).await.unwrap();
        assert_eq!(sent, [1, 0xfd, 3, 4]);
        faults.set(Misbehaviour { mute: true, ..Misbehaviour::default() });
        faults.send(&mut sent, &[5]).await.unwrap();
        assert_eq!(sent.len(), 4);
        let cut = faults.until_cut();
        faults.cut();
        cut.await;
    }
}
