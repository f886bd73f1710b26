//! RTDE, protocol version 2: codec, recipes, and a link that negotiates.

mod link;
mod package;
mod value;

pub use link::{Recipe, RtdeLink, Version};
pub use package::{MAX_PACKAGE, Package, PackageReader, TextLevel, TextMessage};
pub use value::{Kind, Value};

/// What is wrong with what the other side of RTDE says.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum RtdeError {
    /// Bytes that are no package.
    #[error("RTDE {field}: found {found}, expected {expected}")]
    Malformed {
        /// Which part of which package.
        field: String,
        /// Found value.
        found: String,
        /// What is expected.
        expected: String,
    },
    /// The controller does not know a field.
    #[error("RTDE field {field}: not known to this controller, expected software that has it")]
    UnknownField {
        /// The field.
        field: String,
    },
    /// Something else writes an input field already.
    #[error(
        "RTDE field {field}: in use by another RTDE client or a fieldbus (EtherNet/IP, PROFINET, MODBUS); end that \
         client or switch the fieldbus off on the pendant"
    )]
    FieldInUse {
        /// The field.
        field: String,
    },
    /// The controller says no.
    #[error("RTDE {request}: refused by the controller{detail}")]
    Refused {
        /// What was asked.
        request: &'static str,
        /// What it said beside that; empty, or starts with a colon.
        detail: String,
    },
    /// The connection broke or did not come about.
    #[error("RTDE: {0}")]
    Link(String),
}

impl From<std::io::Error> for RtdeError {
    fn from(error: std::io::Error) -> Self {
        Self::Link(error.to_string())
    }
}
