//! Answers by request id: a call that is repeated gets the answer of the first, or waits for it.
//!
//! The first call with an id leads: it plans as any other. Those that come while it does wait; if it ends without
//! an answer (its caller is gone, or its deadline came first) one of them leads in its place. Answers are kept for
//! [`KEPT`], a limited number of them, each caller's apart. Errors are not kept: a repetition is to be a new try.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use graspd_proto::v1::PlanGraspsResponse;
use tokio::sync::watch;

use crate::pool::Flow;

/// How long an answer is kept.
const KEPT: Duration = Duration::from_secs(60);
/// At most so many answers are kept.
const MOST: usize = 512;

/// Whose request it is, its id, and which of its tasks.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct RequestKey {
    /// The caller.
    pub(crate) caller: Flow,
    /// As the caller chose it.
    pub(crate) request_id: String,
    /// The task of a request for several hands; empty for a request with one.
    pub(crate) task_id: String,
}

/// Answers that are kept, and those that are awaited.
#[derive(Debug, Default)]
pub(crate) struct Answers(Mutex<Kept>);

#[derive(Debug, Default)]
struct Kept {
    by_key: BTreeMap<RequestKey, Entry>,
    /// In the order of their ends.
    ended: VecDeque<(Instant, RequestKey)>,
}

#[derive(Debug)]
struct Entry {
    /// What was asked: a hash of the request.
    asked: u64,
    state: State,
}

#[derive(Debug)]
enum State {
    /// The receiver's channel closes when the leader has ended.
    Awaited(watch::Receiver<()>),
    Answered(Arc<PlanGraspsResponse>),
}

/// What a call with an id is to do.
#[derive(Debug)]
pub(crate) enum Joined {
    /// Plan.
    Lead(Leader),
    /// Wait until the channel closes, then ask again.
    Follow(watch::Receiver<()>),
    /// This was the answer.
    Answered(Arc<PlanGraspsResponse>),
    /// The id was used for another request.
    Reused,
}

impl Answers {
    /// Joins the calls with this id; `asked` is a hash of the request.
    pub(crate) fn join(self: &Arc<Self>, key: &RequestKey, asked: u64) -> Joined {
        let mut kept = self.lock();
        kept.forget(Instant::now());
        match kept.by_key.get(key) {
            Some(entry) if entry.asked != asked => Joined::Reused,
            Some(Entry { state: State::Answered(answer), .. }) => Joined::Answered(Arc::clone(answer)),
            Some(Entry { state: State::Awaited(ended), .. }) => Joined::Follow(ended.clone()),
            None => {
                let (end, ended) = watch::channel(());
                kept.by_key.insert(key.clone(), Entry { asked, state: State::Awaited(ended) });
                Joined::Lead(Leader {
                    answers: Arc::clone(self),
                    key: key.clone(),
                    answered: false,
                    _end: end,
                })
            }
        }
    }

    fn lock(&self) -> MutexGuard<'_, Kept> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Kept {
    fn forget(&mut self, now: Instant) {
        while let Some((at, _)) = self.ended.front() {
            if self.ended.len() <= MOST && now.saturating_duration_since(*at) <= KEPT {
                return;
            }
            if let Some((_, key)) = self.ended.pop_front() {
                self.by_key.remove(&key);
            }
        }
    }
}

/// The call that plans for all with its id. Dropped without an answer, it lets another lead.
#[derive(Debug)]
pub(crate) struct Leader {
    answers: Arc<Answers>,
    key: RequestKey,
    answered: bool,
    /// Closes when this is dropped, after the entry is in order.
    _end: watch::Sender<()>,
}

impl Leader {
    /// This is the answer.
    pub(crate) fn answer(mut self, answer: &PlanGraspsResponse) {
        let mut kept = self.answers.lock();
        if let Some(entry) = kept.by_key.get_mut(&self.key) {
            entry.state = State::Answered(Arc::new(answer.clone()));
            kept.ended.push_back((Instant::now(), self.key.clone()));
        }
        drop(kept);
        self.answered = true;
    }
}

impl Drop for Leader {
    fn drop(&mut self) {
        if !self.answered {
            self.answers.lock().by_key.remove(&self.key);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(caller: u64, id: &str) -> RequestKey {
        RequestKey { caller: Flow(caller), request_id: id.to_owned(), task_id: String::new() }
    }

    #[tokio::test]
    async fn the_first_leads_others_follow_and_an_answer_is_kept() {
        let answers = Arc::new(Answers::default());
        let Joined::Lead(leader) = answers.join(&key(1, "a"), 7) else { panic!("expected to lead") };
        assert!(matches!(answers.join(&key(2, "a"), 8), Joined::Lead(_)), "callers are apart");
        assert!(matches!(answers.join(&key(1, "a"), 9), Joined::Reused));
        let Joined::Follow(mut ended) = answers.join(&key(1, "a"), 7) else { panic!("expected to follow") };
        drop(leader);
        assert!(ended.changed().await.is_err());
        let Joined::Lead(leader) = answers.join(&key(1, "a"), 7) else { panic!("expected to lead") };
        leader.answer(&PlanGraspsResponse::default());
        assert!(matches!(answers.join(&key(1, "a"), 7), Joined::Answered(_)));
        assert!(matches!(answers.join(&key(1, "a"), 9), Joined::Reused));
    }

    #[test]
    fn answers_are_forgotten_by_time_and_by_number() {
        let answers = Arc::new(Answers::default());
        for i in 0..MOST + 20 {
            let Joined::Lead(leader) = answers.join(&key(1, &i.to_string()), 0) else {
                panic!("expected to lead")
            };
            leader.answer(&PlanGraspsResponse::default());
        }
        assert!(answers.lock().by_key.len() <= MOST + 1);
        assert!(matches!(answers.join(&key(1, "0"), 0), Joined::Lead(_)));
        answers.lock().forget(Instant::now() + KEPT * 2);
        assert_eq!(answers.lock().ended.len(), 0);
        assert!(answers.lock().by_key.is_empty());
    }
}
