//! Faults of a link on request: what every emulator that answers on a socket or a serial line can be told to do wrong.

use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::io::{AsyncWrite, AsyncWriteExt};
use tokio::sync::watch;

/// What a link does wrong from now on. What is counted befalls the next answers and is gone then.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Misbehaviour {
    /// Writes at most so many bytes at once, with a pause after each part. Sockets of a controller only.
    pub pieces: Option<(usize, Duration)>,
    /// Each answer comes so much later.
    pub delay: Duration,
    /// Swallows everything that it should say.
    pub mute: bool,
    /// Closes new connections at once. Sockets of a controller only.
    pub refuse: bool,
    /// Changes bytes of the next answers.
    pub garble: Option<Garble>,
    /// So many answers are not sent at all.
    pub lose: u32,
    /// Only the first half of so many answers is sent.
    pub halve: u32,
    /// Stray bytes come before so many answers.
    pub noise: u32,
}

/// Wrong bytes in answers to come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Garble {
    /// In so many answers.
    pub packets: u32,
    /// At this place, counted from the start; the last byte where an answer is shorter.
    pub at: usize,
    /// Bits that are turned over.
    pub mask: u8,
}

#[derive(Debug, Default)]
struct Requested {
    now: Misbehaviour,
    hang_up: Option<Duration>,
}

/// A handle on the faults of one link. Clones are the same handle.
#[derive(Debug, Clone)]
pub struct LinkFaults {
    requested: Arc<Mutex<Requested>>,
    /// Counts how often connections were cut.
    cuts: Arc<watch::Sender<u64>>,
}

impl Default for LinkFaults {
    fn default() -> Self {
        Self { requested: Arc::default(), cuts: Arc::new(watch::Sender::new(0)) }
    }
}

/// Takes one from a count; true when there was one.
fn take(count: &mut u32) -> bool {
    let hit = *count > 0;
    *count = count.saturating_sub(1);
    hit
}

impl LinkFaults {
    fn lock(&self) -> MutexGuard<'_, Requested> {
        self.requested.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Misbehaves like that from now on.
    pub fn set(&self, misbehaviour: Misbehaviour) {
        self.lock().now = misbehaviour;
    }

    /// Changes what it does wrong from now on.
    pub fn change(&self, change: impl FnOnce(&mut Misbehaviour)) {
        change(&mut self.lock().now);
    }

    /// Behaves from now on.
    pub fn clear(&self) {
        *self.lock() = Requested::default();
    }

    /// What it does wrong now.
    pub fn current(&self) -> Misbehaviour {
        self.lock().now.clone()
    }

    /// The last byte, part of the check, of the next `answers` is wrong.
    pub fn garble(&self, answers: u32) {
        let garble = Garble { packets: answers, at: usize::MAX, mask: 0x5A };
        self.change(|now| now.garble = (answers > 0).then_some(garble));
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

    /// Hangs up now, and is back after a time. Grippers and buses only.
    pub fn hang_up(&self, away: Duration) {
        self.lock().hang_up = Some(away);
    }

    /// Takes a requested hang-up.
    pub(crate) fn take_hang_up(&self) -> Option<Duration> {
        self.lock().hang_up.take()
    }

    /// How much later answers come.
    pub(crate) fn delay(&self) -> Duration {
        self.lock().now.delay
    }

    /// The answer as it leaves; `None` for one that does not.
    pub(crate) fn befall(&self, mut answer: Vec<u8>) -> Option<Vec<u8>> {
        let now = &mut self.lock().now;
        if take(&mut now.lose) || now.mute {
            return None;
        }
        if let Some(garble) = &mut now.garble
            && let Some(last) = answer.len().checked_sub(1)
        {
            answer[garble.at.min(last)] ^= garble.mask;
            garble.packets = garble.packets.saturating_sub(1);
            if garble.packets == 0 {
                now.garble = None;
            }
        }
        if take(&mut now.halve) {
            answer.truncate(answer.len() / 2);
        }
        if take(&mut now.noise) {
            answer.splice(0..0, [0x00, 0xFF, 0x7E]);
        }
        Some(answer)
    }

    /// Sends an answer over a socket as the faults say.
    ///
    /// # Errors
    /// Those of the link.
    pub async fn send<W: AsyncWrite + Unpin + Send>(&self, to: &mut W, answer: &[u8]) -> io::Result<()> {
        let (delay, pieces) = {
            let now = &self.lock().now;
            (now.delay, now.pieces)
        };
        if !delay.is_zero() {
            tokio::time::sleep(delay).await;
        }
        let Some(answer) = self.befall(answer.to_vec()) else { return Ok(()) };
        let Some((most, pause)) = pieces else { return to.write_all(&answer).await };
        for piece in answer.chunks(most.max(1)) {
            to.write_all(piece).await?;
            to.flush().await?;
            tokio::time::sleep(pause).await;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn answers_are_garbled_as_often_as_asked_and_swallowed_while_mute() {
        let faults = LinkFaults::default();
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

    #[test]
    fn counted_faults_befall_so_many_answers() {
        let faults = LinkFaults::default();
        let answer = || vec![1, 2, 3, 4];
        faults.garble(1);
        faults.change(|now| now.delay = Duration::from_millis(3));
        assert_eq!(faults.befall(answer()), Some(vec![1, 2, 3, 4 ^ 0x5A]));
        assert_eq!((faults.befall(answer()), faults.delay()), (Some(answer()), Duration::from_millis(3)));
        faults.clear();
        faults.change(|now| now.halve = 1);
        assert_eq!(faults.befall(answer()), Some(vec![1, 2]));
        faults.change(|now| now.noise = 1);
        assert_eq!(faults.befall(answer()).map(|bytes| bytes.len()), Some(7));
        faults.change(|now| now.lose = 2);
        assert_eq!((faults.befall(answer()), faults.befall(answer())), (None, None));
        assert_eq!(faults.befall(answer()), Some(answer()));
        faults.hang_up(Duration::from_secs(1));
        assert_eq!(faults.take_hang_up(), Some(Duration::from_secs(1)));
        assert_eq!((faults.take_hang_up(), faults.current()), (None, Misbehaviour::default()));
    }
}
