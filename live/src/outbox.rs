//! What is on its way to one viewer: words of the protocol in their order, and of each subscription and layer the newest
//! messages alone.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bytes::Bytes;
use tokio::sync::Notify;

use crate::Layer;
use crate::counts::{Counters, add};

/// Words that may wait; a viewer that takes none of so many is put out.
const MOST_WORDS: usize = 256;

/// What is sent next.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Next {
    /// A JSON message.
    Words(String),
    /// A message of a subscription: its number, the time in nanoseconds, the message.
    Data(u32, u64, Bytes),
    /// The viewer does not keep up.
    Overflow,
}

#[derive(Debug)]
struct Group {
    subscription: u32,
    layer: Layer,
    time_ns: u64,
    /// Messages of one picture: they belong together, and go together.
    messages: VecDeque<Bytes>,
}

#[derive(Debug, Default)]
struct State {
    words: VecDeque<String>,
    groups: VecDeque<Group>,
    overflown: bool,
}

/// Filled by the hub, emptied by the connection.
#[derive(Debug, Default)]
pub(crate) struct Outbox {
    state: Mutex<State>,
    changed: Notify,
    counters: Arc<Counters>,
}

impl Outbox {
    pub(crate) fn new(counters: Arc<Counters>) -> Self {
        Self { counters, ..Self::default() }
    }

    /// Says something; never waits.
    pub(crate) fn say(&self, words: String) {
        let mut state = self.lock();
        if state.words.len() < MOST_WORDS {
            state.words.push_back(words);
        } else {
            state.overflown = true;
        }
        drop(state);
        self.changed.notify_one();
    }

    /// The newest messages of a subscription in a layer, in the place of those that nobody has taken; never waits.
    pub(crate) fn put(&self, subscription: u32, layer: Layer, time_ns: u64, messages: &[Bytes]) {
        let group = Group { subscription, layer, time_ns, messages: messages.iter().cloned().collect() };
        let mut state = self.lock();
        let mut groups = state.groups.iter_mut();
        match groups.find(|g| (g.subscription, g.layer) == (subscription, layer)) {
            Some(before) => {
                add(&self.counters.dropped, before.messages.len());
                *before = group;
            }
            None => state.groups.push_back(group),
        }
        drop(state);
        self.changed.notify_one();
    }

    /// A subscription has ended: nothing of it is sent any more.
    pub(crate) fn forget(&self, subscription: u32) {
        self.lock().groups.retain(|g| g.subscription != subscription);
    }

    /// What is to be sent, when there is something. Words come first: a channel is known before its messages.
    pub(crate) async fn take(&self) -> Next {
        loop {
            if let Some(next) = self.poll() {
                return next;
            }
            self.changed.notified().await;
        }
    }

    fn poll(&self) -> Option<Next> {
        let mut state = self.lock();
        if state.overflown {
            return Some(Next::Overflow);
        }
        if let Some(words) = state.words.pop_front() {
            return Some(Next::Words(words));
        }
        while let Some(first) = state.groups.front_mut() {
            if let Some(message) = first.messages.pop_front() {
                let (subscription, time_ns) = (first.subscription, first.time_ns);
                if first.messages.is_empty() {
                    state.groups.pop_front();
                }
                return Some(Next::Data(subscription, time_ns, message));
            }
            state.groups.pop_front();
        }
        None
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bytes(all: &[&'static str]) -> Vec<Bytes> {
        all.iter().map(|text| Bytes::from_static(text.as_bytes())).collect()
    }

    #[tokio::test]
    async fn the_newest_picture_wins_and_stays_together() {
        let counters: Arc<Counters> = Arc::default();
        let outbox = Outbox::new(Arc::clone(&counters));
        outbox.put(1, Layer::Plan, 10, &bytes(&["old left", "old right"]));
        outbox.put(2, Layer::Plan, 10, &bytes(&["points"]));
        outbox.put(1, Layer::Servo, 11, &bytes(&["palm"]));
        outbox.put(1, Layer::Plan, 20, &bytes(&["left", "right"]));
        outbox.say("channels".to_owned());
        assert_eq!(outbox.take().await, Next::Words("channels".to_owned()));
        assert_eq!(outbox.take().await, Next::Data(1, 20, Bytes::from_static(b"left")));
        assert_eq!(outbox.take().await, Next::Data(1, 20, Bytes::from_static(b"right")));
        assert_eq!(outbox.take().await, Next::Data(2, 10, Bytes::from_static(b"points")));
        assert_eq!(outbox.take().await, Next::Data(1, 11, Bytes::from_static(b"palm")));
        assert_eq!(outbox.poll(), None);
        assert_eq!(counters.read().dropped, 2);
        outbox.put(3, Layer::Plan, 1, &bytes(&["x"]));
        outbox.forget(3);
        assert_eq!(outbox.poll(), None);
    }

    #[tokio::test]
    async fn who_takes_no_words_overflows() {
        let outbox = Outbox::new(Arc::default());
        for n in 0..MOST_WORDS {
            outbox.say(n.to_string());
        }
        assert_eq!(outbox.take().await, Next::Words("0".to_owned()));
        outbox.say("the last that fits".to_owned());
        outbox.say("one more".to_owned());
        assert_eq!(outbox.take().await, Next::Overflow);
    }
}
