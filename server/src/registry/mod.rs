//! The hands of a server by id: those that are compiled in, those of a folder, and those that were created.

mod folder;
mod shared;
mod source;
mod upload;

pub use folder::{FolderError, read_hand_dir};
pub(crate) use shared::encode_files;
pub use shared::{HandStore, HandSync, StoreError, StoredHand};
pub(crate) use source::{Loaded, load_files};
pub(crate) use upload::Upload;

use std::collections::BTreeMap;
use std::ops::Bound;
use std::path::Path;
use std::sync::{Arc, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};
use std::time::SystemTime;

use graspd_hands::Hand;

use crate::convert::hand_name;
use crate::error::ServiceError;
use crate::pool::Flow;

/// At most this many hands are kept besides those that come with the server.
const MOST_CREATED: usize = 256;

/// Where a hand comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// Compiled in.
    Library,
    /// From the server's folder of hands.
    Folder,
    /// Created by a caller; lives as long as the server.
    Created,
}

/// A hand of the registry.
#[derive(Debug, Clone)]
pub struct Entry {
    /// The hand.
    pub hand: Arc<Hand>,
    /// Where it comes from.
    pub origin: Origin,
    /// When it was created; `None` for hands that come with the server.
    pub created: Option<SystemTime>,
    /// Who created it, and by which request, where that had a name.
    pub(crate) upload: Option<(Flow, String)>,
}

/// The hands of a server. Reading never waits for parsing: a hand enters when it is complete.
#[derive(Debug, Default)]
pub struct Registry {
    hands: RwLock<BTreeMap<String, Entry>>,
}

impl Registry {
    /// The hands that are compiled in.
    pub fn with_library() -> Self {
        let hands = source::library()
            .map(|hand| {
                (hand.id.clone(), Entry { hand, origin: Origin::Library, created: None, upload: None })
            })
            .collect();
        Self { hands: RwLock::new(hands) }
    }

    /// Adds every hand of a folder: each subfolder is a hand, named by its id. Returns how many.
    ///
    /// # Errors
    /// [`FolderError`] when the folder cannot be read, or a subfolder does not make a hand or takes a name
    /// that is taken.
    pub fn add_folder(&self, path: &Path) -> Result<usize, FolderError> {
        let found = folder::read_all(path)?;
        let count = found.len();
        let mut hands = self.write();
        for hand in found {
            let id = hand.id.clone();
            if hands.contains_key(&id) {
                return Err(FolderError::Taken { path: path.join(&id), id });
            }
            let hand = Arc::new(hand);
            hands.insert(id, Entry { hand, origin: Origin::Folder, created: None, upload: None });
        }
        Ok(count)
    }

    /// The hand of that id.
    ///
    /// # Errors
    /// [`ServiceError::UnknownHand`].
    pub fn get(&self, id: &str) -> Result<Entry, ServiceError> {
        self.read().get(id).cloned().ok_or_else(|| ServiceError::UnknownHand { name: hand_name(id) })
    }

    /// At most `limit` hands in the order of their ids, after `after` if given; and whether there are more.
    pub fn page(&self, after: Option<&str>, limit: usize) -> (Vec<Entry>, bool) {
        let hands = self.read();
        let from = after.map_or(Bound::Unbounded, Bound::Excluded);
        let mut rest = hands.range::<str, _>((from, Bound::Unbounded)).map(|(_, entry)| entry.clone());
        let page: Vec<Entry> = rest.by_ref().take(limit).collect();
        (page, rest.next().is_some())
    }

    /// The ids of all hands, in order.
    pub(crate) fn ids(&self) -> Vec<String> {
        self.read().keys().cloned().collect()
    }

    /// Says whether a hand of that id could be created.
    ///
    /// # Errors
    /// As [`Registry::create`].
    pub fn check_free(&self, id: &str) -> Result<(), ServiceError> {
        check_room(&self.read(), id)
    }

    /// Adds a hand.
    ///
    /// # Errors
    /// [`ServiceError::HandExists`], or [`ServiceError::TooManyHands`].
    pub fn create(&self, hand: Hand) -> Result<Entry, ServiceError> {
        self.create_by(hand, None)
    }

    /// Adds a hand, or finds it where the same upload has created it: whose it is, and its name.
    ///
    /// # Errors
    /// As [`Registry::create`]; [`ServiceError::RequestIdReused`] for other files under that name.
    pub(crate) fn create_by(
        &self,
        hand: Hand,
        upload: Option<(Flow, String)>,
    ) -> Result<Entry, ServiceError> {
        let mut hands = self.write();
        if let Some(entry) = repeated(&hands, &hand, upload.as_ref()) {
            return entry;
        }
        check_room(&hands, &hand.id)?;
        let id = hand.id.clone();
        let created = Some(SystemTime::now());
        let entry = Entry { hand: Arc::new(hand), origin: Origin::Created, created, upload };
        hands.insert(id, entry.clone());
        Ok(entry)
    }

    /// The hand that the same upload has created, if it has.
    ///
    /// # Errors
    /// [`ServiceError::RequestIdReused`] for other files under that name.
    pub(crate) fn find_repeated(
        &self,
        hand: &Hand,
        upload: Option<&(Flow, String)>,
    ) -> Result<Option<Entry>, ServiceError> {
        repeated(&self.read(), hand, upload).transpose()
    }

    /// Adds a hand that was created elsewhere, or puts it in the place of one that was.
    ///
    /// # Errors
    /// [`ServiceError::HandProtected`] for one that comes with the server, or [`ServiceError::TooManyHands`].
    pub(crate) fn put(
        &self,
        hand: Hand,
        created: SystemTime,
        upload: Option<(Flow, String)>,
    ) -> Result<Entry, ServiceError> {
        let mut hands = self.write();
        match hands.get(&hand.id).map(|entry| entry.origin) {
            Some(Origin::Library | Origin::Folder) => {
                return Err(ServiceError::HandProtected { id: hand.id });
            }
            Some(Origin::Created) => {}
            None => check_room(&hands, &hand.id)?,
        }
        let id = hand.id.clone();
        let entry = Entry { hand: Arc::new(hand), origin: Origin::Created, created: Some(created), upload };
        hands.insert(id, entry.clone());
        Ok(entry)
    }

    /// Says whether a hand of that id may be deleted.
    ///
    /// # Errors
    /// As [`Registry::delete`].
    pub(crate) fn check_deletable(&self, id: &str) -> Result<(), ServiceError> {
        match self.get(id)?.origin {
            Origin::Created => Ok(()),
            Origin::Library | Origin::Folder => Err(ServiceError::HandProtected { id: id.to_owned() }),
        }
    }

    /// Removes a hand that was created. Work in progress keeps its own reference and ends normally.
    ///
    /// # Errors
    /// [`ServiceError::UnknownHand`], or [`ServiceError::HandProtected`].
    pub fn delete(&self, id: &str) -> Result<(), ServiceError> {
        let mut hands = self.write();
        match hands.get(id).map(|entry| entry.origin) {
            None => Err(ServiceError::UnknownHand { name: hand_name(id) }),
            Some(Origin::Created) => {
                hands.remove(id);
                Ok(())
            }
            Some(Origin::Library | Origin::Folder) => Err(ServiceError::HandProtected { id: id.to_owned() }),
        }
    }

    // A panic cannot leave the map half changed: every change is one insertion or removal.
    fn read(&self) -> RwLockReadGuard<'_, BTreeMap<String, Entry>> {
        self.hands.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self) -> RwLockWriteGuard<'_, BTreeMap<String, Entry>> {
        self.hands.write().unwrap_or_else(PoisonError::into_inner)
    }
}

fn repeated(
    hands: &BTreeMap<String, Entry>,
    hand: &Hand,
    upload: Option<&(Flow, String)>,
) -> Option<Result<Entry, ServiceError>> {
    let entry = hands.get(&hand.id).filter(|entry| upload.is_some() && entry.upload.as_ref() == upload)?;
    let same = entry.hand.revision == hand.revision;
    Some(if same { Ok(entry.clone()) } else { Err(ServiceError::RequestIdReused) })
}

fn check_room(hands: &BTreeMap<String, Entry>, id: &str) -> Result<(), ServiceError> {
    if hands.contains_key(id) {
        return Err(ServiceError::HandExists { id: id.to_owned() });
    }
    let count = hands.values().filter(|e| e.origin == Origin::Created).count();
    if count >= MOST_CREATED {
        return Err(ServiceError::TooManyHands { count, limit: MOST_CREATED });
    }
    Ok(())
}

/// True for `[a-z][a-z0-9-]{0,62}`.
pub fn is_hand_id(id: &str) -> bool {
    id.len() <= 63
        && id.starts_with(|c: char| c.is_ascii_lowercase())
        && id.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'-')
}

#[cfg(test)]
mod tests;
