//! What can go wrong on a line, on request.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::Reply;

#[derive(Debug, Default)]
struct Requested {
    garble: u32,
    cut: u32,
    mute: u32,
    noise: u32,
    slower: Duration,
    hang_up: Option<Duration>,
}

/// Faults of one line; clones are handles to the same line. Counted faults befall the next answers and are gone then.
#[derive(Debug, Clone, Default)]
pub struct LineFaults(Arc<Mutex<Requested>>);

impl LineFaults {
    fn lock(&self) -> MutexGuard<'_, Requested> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The last byte, part of the check, of the next `answers` is wrong.
    pub fn garble(&self, answers: u32) {
        self.lock().garble = answers;
    }

    /// Only the first half of the next `answers` is sent.
    pub fn cut(&self, answers: u32) {
        self.lock().cut = answers;
    }

    /// The next `answers` are not sent at all.
    pub fn mute(&self, answers: u32) {
        self.lock().mute = answers;
    }

    /// Stray bytes come before the next `answers`.
    pub fn noise(&self, answers: u32) {
        self.lock().noise = answers;
    }

    /// Every answer comes so much later, until set to zero.
    pub fn slow(&self, by: Duration) {
        self.lock().slower = by;
    }

    /// Hangs up now, and is back after a time.
    pub fn hang_up(&self, away: Duration) {
        self.lock().hang_up = Some(away);
    }

    /// No fault any more.
    pub fn clear(&self) {
        *self.lock() = Requested::default();
    }

    /// Takes a requested hang-up.
    pub(crate) fn take_hang_up(&self) -> Option<Duration> {
        self.lock().hang_up.take()
    }

    /// The answer as it leaves, `None` for one that does not.
    pub(crate) fn befall(&self, mut reply: Reply) -> Option<Reply> {
        let take = |count: &mut u32| {
            let hit = *count > 0;
            *count = count.saturating_sub(1);
            hit
        };
        let mut requested = self.lock();
        if take(&mut requested.mute) {
            return None;
        }
        reply.after += requested.slower;
        if take(&mut requested.garble)
            && let Some(last) = reply.bytes.last_mut()
        {
            *last ^= 0x5A;
        }
        if take(&mut requested.cut) {
            reply.bytes.truncate(reply.bytes.len() / 2);
        }
        if take(&mut requested.noise) {
            reply.bytes.splice(0..0, [0x00, 0xFF, 0x7E]);
        }
        Some(reply)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counted_faults_befall_so_many_answers() {
        let faults = LineFaults::default();
        let reply = || Reply { bytes: vec![1, 2, 3, 4], after: Duration::ZERO };
        faults.garble(1);
        faults.slow(Duration::from_millis(3));
        let befallen = faults.befall(reply()).unwrap();
        assert_eq!((befallen.bytes, befallen.after), (vec![1, 2, 3, 4 ^ 0x5A], Duration::from_millis(3)));
        faults.clear();
        faults.cut(1);
        assert_eq!(faults.befall(reply()).unwrap().bytes, [1, 2]);
        faults.noise(1);
        assert_eq!(faults.befall(reply()).unwrap().bytes.len(), 7);
        faults.mute(2);
        assert_eq!((faults.befall(reply()), faults.befall(reply())), (None, None));
        assert_eq!(faults.befall(reply()), Some(reply()));
        faults.hang_up(Duration::from_secs(1));
        assert_eq!(faults.take_hang_up(), Some(Duration::from_secs(1)));
        assert_eq!(faults.take_hang_up(), None);
    }
}
