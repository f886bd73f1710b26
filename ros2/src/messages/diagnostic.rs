//! `diagnostic_msgs`.

use serde::{Deserialize, Serialize};

use super::Header;

/// Values of [`DiagnosticStatus::level`].
pub mod level {
    /// All is well.
    pub const OK: u8 = 0;
    /// Worth a look.
    pub const WARN: u8 = 1;
    /// It does not work.
    pub const ERROR: u8 = 2;
}

/// `diagnostic_msgs/KeyValue`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct KeyValue {
    /// What it is.
    pub key: String,
    /// Its value.
    pub value: String,
}

/// `diagnostic_msgs/DiagnosticStatus`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct DiagnosticStatus {
    /// One of [`level`].
    pub level: u8,
    /// Node and part, `graspd: server`.
    pub name: String,
    /// For people.
    pub message: String,
    /// What it is about.
    pub hardware_id: String,
    /// Figures.
    pub values: Vec<KeyValue>,
}

/// `diagnostic_msgs/DiagnosticArray`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct DiagnosticArray {
    /// Header.
    pub header: Header,
    /// One for each part.
    pub status: Vec<DiagnosticStatus>,
}
