//! One plan, from a frame to what is said of it. It is dropped to cancel it, and the server's work with it.

use std::collections::HashMap;
use std::sync::Arc;

use graspd_client::{Client, ClientError, Code, GraspEvent, PlanGraspsRequest, PlanGraspsResponse};
use tokio::sync::{Mutex, mpsc};

use crate::depth::{self, Lens};
use crate::hand::HandModel;
use crate::link;
use crate::pairing::Exposure;

/// What a call tells while it goes on.
#[derive(Debug, Clone, PartialEq)]
pub enum Progress {
    /// It is in the server's queue, behind so many jobs.
    Accepted(i32),
    /// A better set has been found.
    Improved {
        /// Its size.
        grasps: usize,
        /// Its best score.
        best_score: f64,
    },
}

/// What a call ended with.
#[derive(Debug, Clone, PartialEq)]
pub struct Planned {
    /// The server's answer.
    pub response: PlanGraspsResponse,
    /// The hand's shape, if the server told it.
    pub model: Option<Arc<HandModel>>,
}

/// Why there is no answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Failure {
    /// The request itself is at fault: repeating it would not help.
    pub refused: bool,
    /// Machine-readable.
    pub reason: String,
    /// For people.
    pub message: String,
    /// Nobody answers there.
    pub away: bool,
}

impl From<ClientError> for Failure {
    fn from(error: ClientError) -> Self {
        let away = link::is_away(&error) && error.call().is_none_or(|call| call.code == Code::Unavailable);
        let (refused, reason) = match &error {
            ClientError::Connect { .. } => (false, "SERVER_AWAY".to_owned()),
            ClientError::Protocol(_) => (false, "PROTOCOL".to_owned()),
            ClientError::Call(call) => {
                let refused = matches!(
                    call.code,
                    Code::InvalidArgument
                        | Code::NotFound
                        | Code::FailedPrecondition
                        | Code::PermissionDenied
                        | Code::Unauthenticated
                        | Code::OutOfRange
                        | Code::Unimplemented
                );
                let reason = match call.reason.as_str() {
                    _ if away => "SERVER_AWAY".to_owned(),
                    "" => format!("{:?}", call.code),
                    reason => reason.to_owned(),
                };
                (refused, reason)
            }
        };
        let mut message = error.to_string();
        for violation in error.call().map(|call| call.violations.as_slice()).unwrap_or_default() {
            message = format!("{message}; {}: {}", violation.field, violation.description);
        }
        Self { refused, reason, message, away }
    }
}

/// Hands' shapes, asked for once for each revision.
#[derive(Debug, Default)]
pub struct Models(Mutex<HashMap<String, Arc<HandModel>>>);

impl Models {
    /// The hand's shape. Planning does not depend on it: where it cannot be had, that is logged and there is none.
    async fn get(&self, client: &Client, hand: &str, revision: &str) -> Option<Arc<HandModel>> {
        if let Some(model) = self.0.lock().await.get(hand).filter(|m| m.revision == revision) {
            return Some(Arc::clone(model));
        }
        let both = async { Ok((client.get_hand(hand).await?, client.get_hand_geometry(hand).await?)) };
        let model = match both.await {
            Ok((description, geometry)) => Arc::new(HandModel::new(&description, &geometry)),
            Err(error) => {
                let error: ClientError = error;
                tracing::warn!(hand, %error, "the hand's shape cannot be had: markers are without it");
                return None;
            }
        };
        self.0.lock().await.insert(hand.to_owned(), Arc::clone(&model));
        Some(model)
    }
}

/// Plans on an exposure.
///
/// # Errors
/// [`Failure`]. No grasp is an answer.
pub async fn plan(
    client: Client,
    exposure: Exposure,
    lens: Lens,
    mut request: PlanGraspsRequest,
    models: Arc<Models>,
    progress: mpsc::UnboundedSender<Progress>,
) -> Result<Planned, Failure> {
    let frame = depth::frame(&exposure.image, &exposure.info, exposure.labels.as_deref(), lens);
    let frame = frame.map_err(|error| Failure {
        refused: true,
        reason: "INVALID_FRAME".to_owned(),
        message: error.to_string(),
        away: false,
    })?;
    request.frames = vec![frame];
    let mut stream = client.stream_grasps(&request).await?;
    while let Some(event) = stream.next().await? {
        // Who does not listen any more has cancelled.
        match event {
            GraspEvent::Accepted { queue_position } => {
                drop(progress.send(Progress::Accepted(queue_position)))
            }
            GraspEvent::Improved(response) => {
                let best_score = response.grasps.first().map_or(0.0, |g| g.score);
                drop(progress.send(Progress::Improved { grasps: response.grasps.len(), best_score }));
            }
            GraspEvent::Finished(response) => {
                let revision = response.stats.as_ref().map(|s| s.hand_revision.clone()).unwrap_or_default();
                let model = models.get(&client, &request.hand, &revision).await;
                return Ok(Planned { response, model });
            }
        }
    }
    Err(ClientError::Protocol("a stream of grasps that ends without its last message").into())
}
