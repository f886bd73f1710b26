//! Hands: list, get, their shapes, create, delete.

use std::collections::BTreeMap;

use graspd_proto::v1::{
    CreateHandHeader, CreateHandRequest, DeleteHandRequest, FileChunk, GetHandGeometryRequest,
    GetHandGeometryResponse, GetHandRequest, Hand, ListHandsRequest, create_hand_request,
};

use crate::client::Client;
use crate::error::ClientError;
use crate::retry::{RetryPolicy, retried};

/// Size of the pieces in which files travel.
const CHUNK_BYTES: usize = 1 << 20;

/// A hand as the server read it.
#[derive(Debug, Clone, PartialEq)]
pub struct CreatedHand {
    /// The hand.
    pub hand: Hand,
    /// The description that the server wrote because the files had no `hand.toml`.
    pub proposed_hand_toml: Option<String>,
}

impl Client {
    /// All hands, in the order of their names.
    ///
    /// # Errors
    /// [`ClientError`].
    pub async fn list_hands(&self) -> Result<Vec<Hand>, ClientError> {
        let mut all = Vec::new();
        let mut page_token = String::new();
        loop {
            let request = ListHandsRequest { page_size: 0, page_token };
            let page = retried(&self.retry, self.call_timeout, |left| {
                let (mut hands, request) = (self.hands.clone(), self.timed(request.clone(), left));
                async move { hands.list_hands(request).await.map(tonic::Response::into_inner) }
            })
            .await?;
            all.extend(page.hands);
            page_token = page.next_page_token;
            if page_token.is_empty() {
                return Ok(all);
            }
        }
    }

    /// One hand by its resource name, for example `hands/leap`.
    ///
    /// # Errors
    /// [`ClientError`].
    pub async fn get_hand(&self, name: &str) -> Result<Hand, ClientError> {
        let answer = retried(&self.retry, self.call_timeout, |left| {
            let (mut hands, request) =
                (self.hands.clone(), self.timed(GetHandRequest { name: name.to_owned() }, left));
            async move { hands.get_hand(request).await.map(tonic::Response::into_inner) }
        })
        .await?;
        answer.hand.ok_or(ClientError::Protocol("an answer of GetHand without a hand"))
    }

    /// The shape of one hand and how its parts move, by its resource name.
    ///
    /// # Errors
    /// [`ClientError`].
    pub async fn get_hand_geometry(&self, name: &str) -> Result<GetHandGeometryResponse, ClientError> {
        retried(&self.retry, self.call_timeout, |left| {
            let request = GetHandGeometryRequest { name: name.to_owned() };
            let (mut hands, request) = (self.hands.clone(), self.timed(request, left));
            async move { hands.get_hand_geometry(request).await.map(tonic::Response::into_inner) }
        })
        .await
    }

    /// Creates a hand from its files (path in the hand's folder → contents), or only checks them. Repeated as plans
    /// are: the server knows a repetition by its name.
    ///
    /// # Errors
    /// [`ClientError`].
    pub async fn create_hand(
        &self,
        hand_id: &str,
        files: &BTreeMap<String, Vec<u8>>,
        validate_only: bool,
    ) -> Result<CreatedHand, ClientError> {
        // The same name in every attempt: a repetition finds the hand that the attempt before has created.
        let (hand_id, request_id) = (hand_id.to_owned(), unique_name());
        let header = CreateHandHeader { hand_id, validate_only, request_id };
        let mut messages = vec![CreateHandRequest { part: Some(create_hand_request::Part::Header(header)) }];
        for (path, contents) in files {
            // An empty file is one empty piece.
            let empty = contents.is_empty().then_some(&[][..]);
            for piece in contents.chunks(CHUNK_BYTES).chain(empty) {
                let chunk = FileChunk { path: path.clone(), data: piece.to_vec().into() };
                messages.push(CreateHandRequest { part: Some(create_hand_request::Part::Chunk(chunk)) });
            }
        }
        let answer = retried(&self.retry, self.call_timeout, |left| {
            let (mut hands, messages) = (self.hands.clone(), messages.clone());
            let request = self.timed(tokio_stream::iter(messages), left);
            async move { hands.create_hand(request).await.map(tonic::Response::into_inner) }
        })
        .await?;
        Ok(CreatedHand {
            hand: answer.hand.ok_or(ClientError::Protocol("an answer of CreateHand without a hand"))?,
            proposed_hand_toml: Some(answer.proposed_hand_toml).filter(|toml| !toml.is_empty()),
        })
    }

    /// Deletes a hand that was created. Not repeated.
    ///
    /// # Errors
    /// [`ClientError`].
    pub async fn delete_hand(&self, name: &str) -> Result<(), ClientError> {
        retried(&RetryPolicy::NONE, self.call_timeout, |left| {
            let (mut hands, request) =
                (self.hands.clone(), self.timed(DeleteHandRequest { name: name.to_owned() }, left));
            async move { hands.delete_hand(request).await.map(drop) }
        })
        .await
    }
}

/// A name that no other request has: two hashes with keys that the system draws.
fn unique_name() -> String {
    use std::hash::{BuildHasher as _, RandomState};

    let hash = |salt: u8| RandomState::new().hash_one((salt, std::process::id(), std::time::Instant::now()));
    format!("{:016x}{:016x}", hash(0), hash(1))
}
