//! `graspd.v1.HandService`.

use std::sync::Arc;
use std::time::SystemTime;

use graspd_hands::HandError;
use graspd_proto::v1;
use graspd_proto::v1::hand_service_server::HandService;
use tonic::{Request, Response, Status, Streaming};

use super::{caller, clock};
use crate::convert::{geometry_message, hand_id, hand_message, quoted};
use crate::engine::Engine;
use crate::error::{FieldError, HandProblem, ServiceError};
use crate::pool::{Flow, Order};
use crate::registry::{Entry, Loaded, Origin, StoredHand, Upload, encode_files, is_hand_id, load_files};
use crate::status;

/// Page size when the caller names none.
const DEFAULT_PAGE: usize = 50;
/// Largest page.
const LARGEST_PAGE: usize = 200;
/// At most this many problems of a hand are told at once: error details travel in a header of limited size.
const MOST_PROBLEMS: usize = 6;

/// The service that keeps the hands.
#[derive(Debug, Clone)]
pub(crate) struct HandApi {
    /// What every call shares.
    pub(crate) engine: Arc<Engine>,
}

#[tonic::async_trait]
impl HandService for HandApi {
    async fn list_hands(
        &self,
        request: Request<v1::ListHandsRequest>,
    ) -> Result<Response<v1::ListHandsResponse>, Status> {
        let v1::ListHandsRequest { page_size, page_token } = request.into_inner();
        let limit = match usize::try_from(page_size) {
            Ok(0) => DEFAULT_PAGE,
            Ok(size) => size.min(LARGEST_PAGE),
            Err(_) => {
                let fault = FieldError::value("page_size", page_size, "0 or more");
                return Err(ServiceError::from(fault).into());
            }
        };
        if !page_token.is_empty() && !is_hand_id(&page_token) {
            let fault =
                FieldError::value("page_token", quoted(&page_token), "a next_page_token of this server");
            return Err(ServiceError::from(fault).into());
        }
        let after = Some(page_token.as_str()).filter(|t| !t.is_empty());
        let (entries, more) = self.engine.registry.page(after, limit);
        let next_page_token =
            entries.last().filter(|_| more).map_or_else(String::new, |last| last.hand.id.clone());
        let hands = entries.iter().map(message).collect();
        Ok(Response::new(v1::ListHandsResponse { hands, next_page_token }))
    }

    async fn get_hand(
        &self,
        request: Request<v1::GetHandRequest>,
    ) -> Result<Response<v1::GetHandResponse>, Status> {
        let id = hand_id(&request.into_inner().name, "name").map_err(ServiceError::from)?;
        let hand = message(&self.engine.registry.get(&id)?);
        Ok(Response::new(v1::GetHandResponse { hand: Some(hand) }))
    }

    async fn get_hand_geometry(
        &self,
        request: Request<v1::GetHandGeometryRequest>,
    ) -> Result<Response<v1::GetHandGeometryResponse>, Status> {
        let id = hand_id(&request.into_inner().name, "name").map_err(ServiceError::from)?;
        Ok(Response::new(geometry_message(&self.engine.registry.get(&id)?.hand)))
    }

    async fn create_hand(
        &self,
        request: Request<Streaming<v1::CreateHandRequest>>,
    ) -> Result<Response<v1::CreateHandResponse>, Status> {
        let (clock, caller) = (clock(request.extensions()), caller(request.extensions()));
        let mut messages = request.into_inner();
        let mut upload = Upload::begin(messages.message().await.map_err(translated)?)?;
        let repeatable =
            Some((caller.identity(), upload.request_id.clone())).filter(|(_, id)| !id.is_empty());
        if repeatable.is_none() {
            self.engine.registry.check_free(&upload.hand_id)?;
        }
        while let Some(message) = messages.message().await.map_err(translated)? {
            upload.push(message)?;
        }
        let Upload { hand_id, validate_only, files, .. } = upload;
        let budget = self.engine.budget(&clock);
        let _cancel = budget.cancel_on_drop();
        let ticket = self
            .engine
            .pool
            .submit(&budget, &Order::brief(caller.flow), None, move |_| load_files(&hand_id, files))
            .map_err(|e| ServiceError::of_pool(&e, || clock.elapsed()))?;
        let loaded = self
            .engine
            .finish(&budget, ticket)
            .await
            .map_err(|e| ServiceError::of_pool(&e, || clock.elapsed()))?;
        let mut loaded = loaded.map_err(|e| hand_error(&e))?;
        let proposed_hand_toml = loaded.proposed_toml.take().unwrap_or_default();
        let hand = if validate_only {
            hand_message(&loaded.hand, Origin::Created, None)
        } else {
            let entry = self.create(loaded, repeatable).await?;
            self.engine.health.hand_created(&entry.hand.id).await;
            tracing::info!(hand = entry.hand.id, revision = entry.hand.revision, "hand created");
            message(&entry)
        };
        Ok(Response::new(v1::CreateHandResponse { hand: Some(hand), proposed_hand_toml }))
    }

    async fn delete_hand(
        &self,
        request: Request<v1::DeleteHandRequest>,
    ) -> Result<Response<v1::DeleteHandResponse>, Status> {
        let id = hand_id(&request.into_inner().name, "name").map_err(ServiceError::from)?;
        if let Some(store) = &self.engine.hand_store {
            self.engine.registry.check_deletable(&id)?;
            store.delete(&id).await.map_err(|e| e.of(&id))?;
        }
        match self.engine.registry.delete(&id) {
            // The store's own news may have come first.
            Err(ServiceError::UnknownHand { .. }) if self.engine.hand_store.is_some() => {}
            deleted => deleted?,
        }
        self.engine.health.hand_deleted(&id).await;
        tracing::info!(hand = id, "hand deleted");
        Ok(Response::new(v1::DeleteHandResponse {}))
    }
}

impl HandApi {
    /// Adds a hand, here and in the store that is shared, if there is one.
    async fn create(&self, loaded: Loaded, upload: Option<(Flow, String)>) -> Result<Entry, ServiceError> {
        let Loaded { hand, files, .. } = loaded;
        let registry = &self.engine.registry;
        let Some(store) = &self.engine.hand_store else { return registry.create_by(hand, upload) };
        if let Some(entry) = registry.find_repeated(&hand, upload.as_ref())? {
            return Ok(entry);
        }
        registry.check_free(&hand.id)?;
        let created = SystemTime::now();
        let stored = StoredHand {
            id: hand.id.clone(),
            revision: hand.revision.clone(),
            created,
            upload: upload.clone().map(|(flow, request)| (flow.0, request)),
            files: encode_files(&hand.id, &files),
        };
        store.create(stored).await.map_err(|e| e.of(&hand.id))?;
        registry.put(hand, created, upload)
    }
}

fn message(entry: &Entry) -> v1::Hand {
    hand_message(&entry.hand, entry.origin, entry.created)
}

/// A fault of the stream, in our words.
fn translated(fault: Status) -> Status {
    status::from_transport(&fault).map_or(fault, Status::from)
}

/// What is wrong with a hand's files, file by file.
fn hand_error(error: &HandError) -> ServiceError {
    let file = |name: &str| format!("files[{name:?}]");
    let mut problems: Vec<HandProblem> = match error {
        HandError::MissingFile { file: name } => {
            vec![HandProblem { field: file(name), problem: "found nothing, expected the file".to_owned() }]
        }
        HandError::Invalid(found) => (found.0.iter())
            .map(|p| HandProblem {
                field: file(&p.file),
                problem: format!("{}: found {}, expected {}", p.field, p.found, p.expected),
            })
            .collect(),
        other => vec![HandProblem { field: "files".to_owned(), problem: other.to_string() }],
    };
    let more = problems.len().saturating_sub(MOST_PROBLEMS);
    problems.truncate(MOST_PROBLEMS);
    ServiceError::BadHand { problems, more }
}
