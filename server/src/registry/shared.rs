//! Hands that several servers and workers share: what a store keeps of a hand, and what it tells of hands that come
//! and go elsewhere.

use std::sync::Arc;
use std::time::SystemTime;

use bytes::{Buf as _, Bytes, BytesMut};
use graspd_hands::HandFiles;
use graspd_proto::v1;
use graspd_proto::v1::create_hand_request::Part;
use prost::Message as _;

use super::{Upload, load_files};
use crate::engine::Engine;
use crate::error::ServiceError;
use crate::pool::Flow;

/// A hand as a store keeps it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StoredHand {
    /// Its id.
    pub id: String,
    /// The hash of its files.
    pub revision: String,
    /// When it was created.
    pub created: SystemTime,
    /// Who created it and by which request, where that had a name.
    pub upload: Option<(u64, String)>,
    /// Its files: the messages of the upload, each with its length before it.
    pub files: Bytes,
}

/// Why a store did not do what it was asked.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum StoreError {
    /// There is a hand of that id.
    #[error("there is a hand of that id")]
    Exists,
    /// The store cannot be reached.
    #[error("the store of hands is away: {0}")]
    Away(String),
}

/// Keeps hands for several servers and workers.
#[tonic::async_trait]
pub trait HandStore: std::fmt::Debug + Send + Sync + 'static {
    /// Keeps a hand whose id is free. Of several that do this at the same time one succeeds.
    ///
    /// # Errors
    /// [`StoreError`].
    async fn create(&self, hand: StoredHand) -> Result<(), StoreError>;

    /// Forgets a hand; there may be none.
    ///
    /// # Errors
    /// [`StoreError::Away`].
    async fn delete(&self, id: &str) -> Result<(), StoreError>;
}

impl StoreError {
    pub(crate) fn of(self, id: &str) -> ServiceError {
        match self {
            Self::Exists => ServiceError::HandExists { id: id.to_owned() },
            Self::Away(what) => ServiceError::EngineAway { what },
        }
    }
}

/// Where a store's news of hands goes.
#[derive(Debug, Clone)]
pub struct HandSync {
    engine: Arc<Engine>,
}

impl HandSync {
    pub(crate) fn new(engine: Arc<Engine>) -> Self {
        Self { engine }
    }

    /// The revision of the hand of that id, if there is one.
    pub fn revision(&self, id: &str) -> Option<String> {
        Some(self.engine.registry.get(id).ok()?.hand.revision.clone())
    }

    /// A store has this hand. It is checked as an upload is; one that comes with this server is not replaced.
    ///
    /// # Errors
    /// What is wrong with it, for the log.
    pub async fn stored(&self, hand: StoredHand) -> Result<(), String> {
        if self.revision(&hand.id).is_some_and(|known| known == hand.revision) {
            return Ok(());
        }
        let StoredHand { id, revision, created, upload, files } = hand;
        let files = decode_files(&id, files).map_err(|e| e.to_string())?;
        let own = id.clone();
        let loaded = tokio::task::spawn_blocking(move || load_files(&own, files))
            .await
            .map_err(|e| e.to_string())?
            .map_err(|e| e.to_string())?;
        let found = &loaded.hand.revision;
        if *found != revision {
            return Err(format!("found revision {found}, expected {revision}"));
        }
        let upload = upload.map(|(flow, request)| (Flow(flow), request));
        self.engine.registry.put(loaded.hand, created, upload).map_err(|e| e.to_string())?;
        self.engine.health.hand_created(&id).await;
        tracing::info!(hand = id, revision, "hand loaded from the store");
        Ok(())
    }

    /// A store has a hand of that id no more.
    pub async fn removed(&self, id: &str) {
        // Hands that come with the server stay, and one that is gone already is gone.
        if self.engine.registry.delete(id).is_ok() {
            self.engine.health.hand_deleted(id).await;
            tracing::info!(hand = id, "hand deleted elsewhere");
        }
    }
}

/// Largest piece of a file in a stored upload.
const CHUNK_BYTES: usize = 1 << 20;

/// The files of a hand as an upload brings them.
pub(crate) fn encode_files(id: &str, files: &HandFiles) -> Bytes {
    let mut bytes = BytesMut::new();
    let mut push = |part| {
        let message = v1::CreateHandRequest { part: Some(part) };
        bytes.reserve(message.encoded_len() + 10);
        // A buffer that grows is never too small.
        message.encode_length_delimited(&mut bytes).ok();
    };
    push(Part::Header(v1::CreateHandHeader { hand_id: id.to_owned(), ..Default::default() }));
    for (path, contents) in &files.files {
        let pieces = contents.chunks(CHUNK_BYTES).chain(contents.is_empty().then_some(&[][..]));
        for piece in pieces {
            push(Part::Chunk(v1::FileChunk { path: path.clone(), data: Bytes::copy_from_slice(piece) }));
        }
    }
    bytes.freeze()
}

/// The same read back, by the rules of an upload.
fn decode_files(id: &str, mut bytes: Bytes) -> Result<HandFiles, ServiceError> {
    let mut next = || {
        bytes.has_remaining().then(|| {
            v1::CreateHandRequest::decode_length_delimited(&mut bytes)
                .map_err(|e| ServiceError::MalformedMessage { problem: e.to_string() })
        })
    };
    let mut upload = Upload::begin(next().transpose()?)?;
    if upload.hand_id != id {
        let expected = format!("the files of {id}");
        return Err(ServiceError::BadUpload { field: "header.hand_id".to_owned(), problem: expected });
    }
    while let Some(message) = next() {
        upload.push(message?)?;
    }
    Ok(upload.files)
}

#[cfg(test)]
mod tests {
    use graspd_hands::library;

    use super::*;

    #[test]
    fn files_are_the_same_after_the_store() {
        for id in library::ids() {
            let Some(mut files) = library::files(id) else { panic!("{id} has no files") };
            files.files.insert("empty.stl".to_owned(), Vec::new());
            files.files.insert("large.stl".to_owned(), vec![7; 2 * CHUNK_BYTES + 1]);
            let read = decode_files(id, encode_files(id, &files)).unwrap();
            assert_eq!(read.revision(), files.revision(), "{id}");
        }
    }

    #[test]
    fn a_store_is_not_trusted() {
        let files = HandFiles::new("urdf", "toml");
        let good = encode_files("mine", &files);
        assert!(decode_files("other", good.clone()).is_err());
        for cut in 1..good.len() {
            // A cut between messages leaves fewer files; any other is refused.
            if let Ok(read) = decode_files("mine", good.slice(..cut)) {
                assert!(read.files.len() < files.files.len());
            }
        }
        let mut outside = files.clone();
        outside.files.insert("../outside".to_owned(), vec![1]);
        assert!(matches!(
            decode_files("mine", encode_files("mine", &outside)),
            Err(ServiceError::BadUpload { field, .. }) if field == "chunk.path"
        ));
    }
}
