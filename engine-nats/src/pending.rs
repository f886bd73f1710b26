//! Jobs of a front that have not ended, by name: where what workers say of them goes.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use graspd_server::jobs::JobKind;
use tokio::sync::mpsc;

use crate::wire::{Reply, Said};

/// Something that ends a job from the broker's side.
#[derive(Debug)]
pub(crate) enum Heard {
    /// A worker says something.
    Said(Said),
    /// The broker has given it up.
    GivenUp,
}

/// Jobs that have not ended.
#[derive(Debug, Default)]
pub(crate) struct Pending {
    jobs: Mutex<HashMap<String, Entry>>,
    /// Jobs of which more than one worker has said something, or a later one.
    redelivered: AtomicU64,
}

#[derive(Debug)]
struct Entry {
    sender: mpsc::UnboundedSender<Heard>,
    /// Its number in the stream, once the broker has said it.
    sequence: Option<u64>,
    /// Better answers come from the first worker alone: those of the next one begin from nothing again.
    first_attempt: Option<u64>,
    /// It is counted as one that another worker had to begin again.
    is_counted: bool,
    /// Replies of a stream in which a later one replaces the one before.
    is_stream: bool,
}

impl Pending {
    /// A job begins. What is heard of it comes through the receiver, until [`Pending::remove`].
    pub(crate) fn insert(&self, job: &str, is_stream: bool) -> mpsc::UnboundedReceiver<Heard> {
        // Not bounded: who reads it decodes at once, and a worker waits for the confirmation of each reply.
        let (sender, receiver) = mpsc::unbounded_channel();
        let entry = Entry { sender, sequence: None, first_attempt: None, is_counted: false, is_stream };
        self.lock().insert(job.to_owned(), entry);
        receiver
    }

    /// The job's number in the stream.
    pub(crate) fn stored(&self, job: &str, sequence: u64) {
        if let Some(entry) = self.lock().get_mut(job) {
            entry.sequence = Some(sequence);
        }
    }

    /// A worker said something. After the job's end nobody hears it.
    pub(crate) fn say(&self, job: &str, reply: Reply) {
        let mut jobs = self.lock();
        let Some(entry) = jobs.get_mut(job) else { return };
        if reply.attempt > 1 && !std::mem::replace(&mut entry.is_counted, true) {
            self.redelivered.fetch_add(1, Ordering::Relaxed);
        }
        let first = *entry.first_attempt.get_or_insert(reply.attempt);
        let is_intermediate = matches!(reply.said, Said::Response(_)) && entry.is_stream;
        if is_intermediate && reply.attempt != first && !reply.said.is_last(JobKind::StreamGrasps) {
            return;
        }
        entry.sender.send(Heard::Said(reply.said)).ok();
    }

    /// The broker has given up the job of that number.
    pub(crate) fn give_up(&self, sequence: u64) {
        let jobs = self.lock();
        if let Some(entry) = jobs.values().find(|entry| entry.sequence == Some(sequence)) {
            entry.sender.send(Heard::GivenUp).ok();
        }
    }

    /// Jobs that another worker had to begin again.
    pub(crate) fn redelivered(&self) -> u64 {
        self.redelivered.load(Ordering::Relaxed)
    }

    /// A job has ended.
    pub(crate) fn remove(&self, job: &str) {
        self.lock().remove(job);
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<String, Entry>> {
        self.jobs.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use bytes::Bytes;

    use super::*;

    fn reply(attempt: u64, first_byte: u8) -> Reply {
        Reply { attempt, said: Said::Response(Bytes::from(vec![first_byte, 0])) }
    }

    fn heard(receiver: &mut mpsc::UnboundedReceiver<Heard>) -> Vec<u8> {
        let mut all = Vec::new();
        while let Ok(heard) = receiver.try_recv() {
            match heard {
                Heard::Said(Said::Response(bytes)) => all.push(bytes[0]),
                other => panic!("{other:?}"),
            }
        }
        all
    }

    #[test]
    fn better_answers_come_from_one_worker_and_the_last_from_any() {
        const IMPROVED: u8 = 2 << 3 | 2;
        const FINISHED: u8 = 3 << 3 | 2;
        let pending = Pending::default();
        let mut stream = pending.insert("a", true);
        for (attempt, kind) in [(1, IMPROVED), (2, IMPROVED), (1, IMPROVED), (2, FINISHED)] {
            pending.say("a", reply(attempt, kind));
        }
        assert_eq!(heard(&mut stream), [IMPROVED, IMPROVED, FINISHED]);
        assert_eq!(pending.redelivered(), 1);
        // Results for several hands: whoever has one.
        let mut hands = pending.insert("b", false);
        for attempt in [1, 2] {
            pending.say("b", reply(attempt, IMPROVED));
        }
        assert_eq!(heard(&mut hands).len(), 2);
    }

    #[test]
    fn after_the_end_nobody_hears_and_what_is_given_up_is_found_by_its_number() {
        let pending = Pending::default();
        let (mut one, mut two) = (pending.insert("1", false), pending.insert("2", false));
        pending.stored("2", 7);
        pending.give_up(7);
        pending.give_up(8);
        assert!(one.try_recv().is_err());
        assert!(matches!(two.try_recv(), Ok(Heard::GivenUp)));
        pending.remove("1");
        pending.say("1", reply(1, 0));
        assert!(one.try_recv().is_err());
    }
}
