//! Leases of things that several cells or arms want: who has one, for how long, and a number that grows with every
//! change of hands.
//!
//! A lease says who works on a thing, not where anybody's arm is. One that has expired can be taken by somebody else;
//! whoever had it finds out when it renews, or by the number: what a holder does to the thing is refused by whoever
//! has seen a larger one.

use std::time::Duration;

use async_nats::jetstream::kv::{CreateErrorKind, Operation, Store, UpdateErrorKind};
use bytes::Bytes;
use futures_util::StreamExt as _;
use serde::{Deserialize, Serialize};

use crate::clock;
use crate::connection::Broker;
use crate::presence::WorkerCard;

/// Longest name of a thing or a holder, bytes.
const LONGEST: usize = 64;

/// What the bucket has of a lease: it ends so long after the broker has written this.
#[derive(Debug, Serialize, Deserialize)]
struct Record {
    holder: String,
    lasts_ms: u64,
}

/// A thing that somebody has.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Lease {
    /// The thing.
    pub thing: String,
    /// Who has it.
    pub holder: String,
    /// Larger than that of every lease of this thing before.
    pub token: u64,
    /// How long it lasts from now; zero for one that has expired.
    pub left: Duration,
}

/// Why a lease is not had.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum LeaseError {
    /// Somebody has it.
    #[error("{thing}: {holder} has it for {left:?} more")]
    Held {
        /// The thing.
        thing: String,
        /// Who.
        holder: String,
        /// For how long.
        left: Duration,
    },
    /// It is not this holder's any more.
    #[error("{thing}: the lease {token} is lost")]
    Lost {
        /// The thing.
        thing: String,
        /// The number that it had.
        token: u64,
    },
    /// A name that things and holders cannot have.
    #[error("found {found:?}, expected a name of 1 to {LONGEST} letters, digits, - and _")]
    Name {
        /// As given.
        found: String,
    },
    /// The broker cannot be reached.
    #[error("the broker is away: {0}")]
    Away(String),
}

/// The leases of an installation.
#[derive(Debug)]
pub struct Leases {
    bucket: Store,
    clock_offset_us: i64,
}

fn away(error: impl std::fmt::Display) -> LeaseError {
    LeaseError::Away(error.to_string())
}

fn check(name: &str) -> Result<(), LeaseError> {
    let in_order = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    if name.is_empty() || name.len() > LONGEST || !name.chars().all(in_order) {
        return Err(LeaseError::Name { found: name.chars().take(LONGEST).collect() });
    }
    Ok(())
}

fn value(holder: &str, lasts: Duration) -> Result<Bytes, LeaseError> {
    let lasts_ms = u64::try_from(lasts.as_millis()).unwrap_or(u64::MAX);
    let record = Record { holder: holder.to_owned(), lasts_ms };
    serde_json::to_vec(&record).map(Bytes::from).map_err(away)
}

impl Leases {
    /// The leases of a broker.
    ///
    /// # Errors
    /// [`LeaseError::Away`].
    pub async fn open(broker: &Broker) -> Result<Self, LeaseError> {
        let bucket = broker.jetstream.get_key_value(broker.names.leases()).await.map_err(away)?;
        let clock_offset_us =
            clock::offset_us(broker, &broker.unique(), &WorkerCard::own(0)).await.map_err(away)?;
        Ok(Self { bucket, clock_offset_us })
    }

    /// Takes a thing that nobody has. Of several that try at the same time one gets it.
    ///
    /// # Errors
    /// [`LeaseError::Held`], [`LeaseError::Name`], [`LeaseError::Away`].
    pub async fn take(&self, thing: &str, holder: &str, lasts: Duration) -> Result<Lease, LeaseError> {
        check(thing)?;
        check(holder)?;
        let value = value(holder, lasts)?;
        let taken = match self.read(thing).await? {
            Some(lease) if !lease.left.is_zero() => return Err(held(lease)),
            // Expired: the number that was read is the one that is replaced, or nothing is.
            Some(lease) => match self.bucket.update(thing, value, lease.token).await {
                Ok(token) => Some(token),
                Err(error) if error.kind() == UpdateErrorKind::WrongLastRevision => None,
                Err(error) => return Err(away(error)),
            },
            None => match self.bucket.create(thing, value).await {
                Ok(token) => Some(token),
                Err(error) if error.kind() == CreateErrorKind::AlreadyExists => None,
                Err(error) => return Err(away(error)),
            },
        };
        match taken {
            Some(token) => {
                Ok(Lease { thing: thing.to_owned(), holder: holder.to_owned(), token, left: lasts })
            }
            // Somebody was quicker.
            None => match self.read(thing).await? {
                Some(lease) => Err(held(lease)),
                None => Err(LeaseError::Held {
                    thing: thing.to_owned(),
                    holder: "somebody".to_owned(),
                    left: Duration::ZERO,
                }),
            },
        }
    }

    /// Keeps a lease for so long from now. One that has expired is kept if nobody has taken it since.
    ///
    /// # Errors
    /// [`LeaseError::Lost`], [`LeaseError::Away`].
    pub async fn renew(&self, lease: &Lease, lasts: Duration) -> Result<Lease, LeaseError> {
        check(&lease.thing)?;
        match self.bucket.update(&lease.thing, value(&lease.holder, lasts)?, lease.token).await {
            Ok(token) => Ok(Lease { token, left: lasts, ..lease.clone() }),
            Err(error) if error.kind() == UpdateErrorKind::WrongLastRevision => Err(lost(lease)),
            Err(error) => Err(away(error)),
        }
    }

    /// Gives a lease back.
    ///
    /// # Errors
    /// [`LeaseError::Lost`], [`LeaseError::Away`].
    pub async fn give(&self, lease: &Lease) -> Result<(), LeaseError> {
        check(&lease.thing)?;
        let Err(error) = self.bucket.delete_expect_revision(&lease.thing, Some(lease.token)).await else {
            return Ok(());
        };
        // The store does not say which of both it was.
        match self.read(&lease.thing).await? {
            Some(now) if now.token == lease.token => Err(away(error)),
            _ => Err(lost(lease)),
        }
    }

    /// All leases, those that have expired and were not taken since too.
    ///
    /// # Errors
    /// [`LeaseError::Away`].
    pub async fn list(&self) -> Result<Vec<Lease>, LeaseError> {
        let mut leases = Vec::new();
        let mut keys = self.bucket.keys().await.map_err(away)?;
        while let Some(key) = keys.next().await {
            leases.extend(self.read(&key.map_err(away)?).await?);
        }
        leases.sort_by(|a, b| a.thing.cmp(&b.thing));
        Ok(leases)
    }

    async fn read(&self, thing: &str) -> Result<Option<Lease>, LeaseError> {
        let Some(entry) = self.bucket.entry(thing).await.map_err(away)? else { return Ok(None) };
        if entry.operation != Operation::Put {
            return Ok(None);
        }
        let record: Record = serde_json::from_slice(&entry.value).map_err(away)?;
        let age = clock::age(entry.created.unix_timestamp_nanos(), self.clock_offset_us);
        let left = Duration::from_millis(record.lasts_ms).saturating_sub(age);
        Ok(Some(Lease { thing: thing.to_owned(), holder: record.holder, token: entry.revision, left }))
    }
}

fn held(lease: Lease) -> LeaseError {
    LeaseError::Held { thing: lease.thing, holder: lease.holder, left: lease.left }
}

fn lost(lease: &Lease) -> LeaseError {
    LeaseError::Lost { thing: lease.thing.clone(), token: lease.token }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_cannot_reach_other_keys() {
        for good in ["bin-3", "A_1", "x"] {
            check(good).unwrap();
        }
        for wrong in ["", "a.b", "*", ">", "a b", "ä", &"x".repeat(65)] {
            assert!(check(wrong).is_err(), "{wrong:?}");
        }
    }
}
