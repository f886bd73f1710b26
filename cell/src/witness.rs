//! The truth about what became of objects, where somebody knows it: a simulation, a scale, a second camera.

use async_trait::async_trait;
use serde::{Deserialize, Serialize};

/// What a witness saw since it was asked last.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Witnessed {
    /// Objects that arrived at the dropping place.
    pub delivered: u32,
    /// Objects that left the tray and arrived elsewhere.
    pub lost: u32,
    /// Objects that are in the tray now.
    pub in_tray: u32,
    /// Objects that are in the hand now: wedged between its fingers, where it has opened.
    #[serde(default)]
    pub in_hand: u32,
    /// Names of the objects that are in the tray now, where the witness knows them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub remaining: Vec<String>,
}

/// Somebody who sees what the cell cannot feel.
#[async_trait]
pub trait Witness: Send + Sync + std::fmt::Debug {
    /// What became of the objects since the last call; asked once after every attempt.
    async fn outcome(&self, attempt: u32) -> Witnessed;
}
