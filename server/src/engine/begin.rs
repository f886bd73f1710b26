//! Where a call's plans begin: in this process's pool, or with the engine that the server was given.

use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;

use super::{Answer, Call, Engine, OnBetter, Task, Wire};
use crate::error::ServiceError;

/// An answer that is on its way.
pub(crate) type Answering = Pin<Box<dyn Future<Output = Answer> + Send>>;
/// Begins one hand's share of a call when it is called, if it has not begun.
pub(crate) type Planning = Box<dyn FnOnce() -> Answering + Send>;

/// A plan for one hand that has begun.
pub(crate) struct Begun {
    /// Jobs before it, where that is known.
    pub(crate) position: usize,
    /// Its answer.
    pub(crate) answer: Answering,
}

impl Engine {
    /// Begins to plan for one hand. `on_better` gets each better answer.
    pub(crate) fn begin_single(
        self: &Arc<Self>,
        call: &Call,
        task: &Task,
        wire: Option<Wire>,
        on_better: Option<OnBetter>,
    ) -> Result<Begun, ServiceError> {
        let (engine, call, task) = (Arc::clone(self), call.clone(), task.clone());
        let Some((elsewhere, wire)) = self.elsewhere.clone().zip(wire) else {
            let ticket = self.submit_single(&call, &task, on_better)?;
            let position = ticket.position;
            let answer = Box::pin(async move { engine.answer(&call, &task, ticket).await });
            return Ok(Begun { position, answer });
        };
        self.begin_single_elsewhere(call, task, elsewhere, wire, on_better)
    }

    /// Begins to plan for several hands in one scene; ready when the scene is read, or will not be in time. With
    /// `at_once` every hand's search is queued then, in this order; else when it is asked for.
    pub(crate) async fn begin_hands(
        self: &Arc<Self>,
        call: &Call,
        mut tasks: Vec<Task>,
        wire: Option<Wire>,
        at_once: bool,
    ) -> Result<Vec<(Task, Planning)>, ServiceError> {
        if let Some((elsewhere, wire)) = self.elsewhere.as_ref().zip(wire) {
            return self.begin_hands_elsewhere(call, tasks, elsewhere.as_ref(), wire).await;
        }
        let ticket = self.submit_scene(call, &tasks)?;
        // A frame that cannot be read is an error of the call, so the stream begins when the scene is there.
        let read = match self.scene(call, ticket).await {
            Ok(read) => Ok(read),
            Err(late @ ServiceError::Deadline { .. }) => Err(late),
            Err(error) => return Err(error),
        };
        self.quickest_first(&mut tasks);
        let plannings = tasks.into_iter().map(|task| {
            let (engine, call, read) = (Arc::clone(self), call.clone(), read.clone());
            // What may have an answer already is only queued if it has none.
            let queued = match &read {
                Ok(read) if at_once => Some(engine.submit_hand(&call, read, &task)),
                _ => None,
            };
            let own = task.clone();
            let planning: Planning = Box::new(move || {
                Box::pin(async move {
                    // From here on the scene lives as long as the jobs that need it.
                    let ticket = match (queued, read) {
                        (Some(queued), _) => queued?,
                        (None, Ok(read)) => engine.submit_hand(&call, &read, &own)?,
                        (None, Err(late)) => return call.without_scene(late, &own),
                    };
                    engine.answer(&call, &own, ticket).await
                })
            });
            (task, planning)
        });
        Ok(plannings.collect())
    }
}
