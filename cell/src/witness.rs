//! The truth about what became of objects, where somebody knows it: a simulation, a scale, a second camera.

use async_trait::async_trait;
use serde::{Deserialize, Serialize};

/// What a witness saw. The objects of a run are those that were not beside the tray when it began, and those
/// that have come from there into tray, hand or dropping place since: all `delivered` so far, `lost`, `in_tray` and `in_hand` sum to them.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Witnessed {
    /// Objects that arrived at the dropping place since the witness was asked last.
    pub delivered: u32,
    /// Objects that are elsewhere now: neither delivered nor in the tray nor in the hand. One that is picked up after all
    /// is no longer lost. Those that have been there since before the run are not counted.
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
    /// What became of the objects since the last call (since the begin of the run, the first time); asked once after
    /// every attempt. `None` when it cannot tell: then what the hand felt decides.
    async fn outcome(&self, attempt: u32) -> Option<Witnessed>;
}
