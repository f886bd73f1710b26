//! `graspd.v1.ServoService`.

use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use graspd_planner::servo::Servo;
use graspd_proto::v1;
use graspd_proto::v1::servo_grasp_request::Message;
use graspd_proto::v1::servo_service_server::ServoService;
use tokio::sync::mpsc;
use tokio_stream::Stream;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status, Streaming};

use super::{caller, clock};
use crate::convert;
use crate::engine::Engine;
use crate::error::{FieldError, ServiceError};
use crate::security::Limits;
use crate::servo::{ServoStream, Streams};
use crate::status;

/// The servo service.
#[derive(Debug, Clone)]
pub(crate) struct ServoApi {
    engine: Arc<Engine>,
    streams: Arc<Streams>,
    idle: Duration,
}

impl ServoApi {
    pub(crate) fn new(engine: Arc<Engine>, limits: &Limits) -> Self {
        Self { engine, streams: Streams::new(limits.servo_streams), idle: limits.servo_idle }
    }
}

#[tonic::async_trait]
impl ServoService for ServoApi {
    type ServoGraspStream = Pin<Box<dyn Stream<Item = Result<v1::ServoGraspResponse, Status>> + Send>>;

    async fn servo_grasp(
        &self,
        request: Request<Streaming<v1::ServoGraspRequest>>,
    ) -> Result<Response<Self::ServoGraspStream>, Status> {
        let (clock, caller) = (clock(request.extensions()), caller(request.extensions()));
        let room = self.streams.enter(&self.engine.metrics)?;
        let mut messages = request.into_inner();
        let idle = || ServiceError::Idle { what: "no configuration came", limit: self.idle };
        let first = tokio::time::timeout(self.idle, messages.message()).await.map_err(|_| idle())?;
        let in_our_words =
            |s: Status| status::from_transport(&s).map_or(s, |error: ServiceError| Status::from(error));
        let first = first.map_err(in_our_words)?;
        let Some(Message::Config(config)) = first.and_then(|m| m.message) else {
            return Err(ServiceError::from(FieldError::missing("config", "a configuration first")).into());
        };
        let asked = convert::servo_config(config).map_err(ServiceError::from)?;
        let hand = self.engine.registry.get(&asked.hand_id)?.hand;
        let estimator = self.engine.estimators.get(asked.estimator.as_deref())?;
        let servo = Servo::new(Arc::clone(&hand), asked.options, estimator).map_err(|e| {
            ServiceError::from(FieldError::value(format!("config.{}", e.field), e.found, e.expected))
        })?;
        let budget = self.engine.budget(&clock);
        let (sender, receiver) = mpsc::channel(1);
        let stream = ServoStream {
            engine: Arc::clone(&self.engine),
            clock,
            caller: caller.flow,
            hand,
            servo,
            budget,
            idle: self.idle,
            room,
        };
        tokio::spawn(stream.run(messages, sender));
        Ok(Response::new(Box::pin(ReceiverStream::new(receiver))))
    }
}
