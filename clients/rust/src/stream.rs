//! Answers that come in several messages, bounded by the call's deadline.

use graspd_proto::v1::{
    HandTaskResult, MultiHandSummary, PlanGraspsResponse, PlanMultiHandResponse, StreamGraspsResponse,
    plan_multi_hand_response, stream_grasps_response,
};
use tokio::time::Instant;
use tonic::Streaming;

use crate::error::{CallError, ClientError};

/// What a stream of grasps tells.
#[derive(Debug, Clone, PartialEq)]
pub enum GraspEvent {
    /// The work is queued behind this many jobs.
    Accepted {
        /// Jobs before it.
        queue_position: i32,
    },
    /// A better set.
    Improved(PlanGraspsResponse),
    /// The last word.
    Finished(PlanGraspsResponse),
}

/// What a plan for several hands tells.
#[derive(Debug, Clone, PartialEq)]
pub enum MultiHandEvent {
    /// One task is done.
    Result(Box<HandTaskResult>),
    /// All tasks are done; the last message.
    Summary(MultiHandSummary),
}

/// Messages until the deadline.
#[derive(Debug)]
struct Bounded<T> {
    messages: Streaming<T>,
    deadline: Instant,
}

impl<T> Bounded<T> {
    async fn next(&mut self) -> Result<Option<T>, ClientError> {
        match tokio::time::timeout_at(self.deadline, self.messages.message()).await {
            Ok(message) => Ok(message?),
            Err(_) => Err(CallError::late().into()),
        }
    }
}

/// Grasps as they are found. Dropping it cancels the work.
#[derive(Debug)]
pub struct GraspStream(Bounded<StreamGraspsResponse>);

impl GraspStream {
    pub(crate) fn new(messages: Streaming<StreamGraspsResponse>, deadline: Instant) -> Self {
        Self(Bounded { messages, deadline })
    }

    /// The next event; `None` after the last.
    ///
    /// # Errors
    /// [`ClientError`] when the call ended with an error, or its deadline passed.
    pub async fn next(&mut self) -> Result<Option<GraspEvent>, ClientError> {
        let Some(message) = self.0.next().await? else { return Ok(None) };
        match message.event {
            Some(stream_grasps_response::Event::Accepted(a)) => {
                Ok(Some(GraspEvent::Accepted { queue_position: a.queue_position }))
            }
            Some(stream_grasps_response::Event::Improved(r)) => Ok(Some(GraspEvent::Improved(r))),
            Some(stream_grasps_response::Event::Finished(r)) => Ok(Some(GraspEvent::Finished(r))),
            None => Err(ClientError::Protocol("a message of StreamGrasps without an event")),
        }
    }
}

/// Answers of several hands as they are ready. Dropping it cancels the work.
#[derive(Debug)]
pub struct MultiHandStream(Bounded<PlanMultiHandResponse>);

impl MultiHandStream {
    pub(crate) fn new(messages: Streaming<PlanMultiHandResponse>, deadline: Instant) -> Self {
        Self(Bounded { messages, deadline })
    }

    /// The next event; `None` after the last.
    ///
    /// # Errors
    /// As [`GraspStream::next`].
    pub async fn next(&mut self) -> Result<Option<MultiHandEvent>, ClientError> {
        let Some(message) = self.0.next().await? else { return Ok(None) };
        match message.event {
            Some(plan_multi_hand_response::Event::Result(r)) => Ok(Some(MultiHandEvent::Result(Box::new(r)))),
            Some(plan_multi_hand_response::Event::Summary(s)) => Ok(Some(MultiHandEvent::Summary(s))),
            None => Err(ClientError::Protocol("a message of PlanMultiHand without an event")),
        }
    }
}
