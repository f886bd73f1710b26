//! What a packet can be wrong about.

/// Why bytes are not the packet that was expected.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PacketError {
    /// The check does not match: a garbled line.
    #[error("CRC: found {found:#06x}, expected {expected:#06x}")]
    Crc {
        /// The check in the packet.
        found: u16,
        /// The check of its bytes.
        expected: u16,
    },
    /// The length field says what no packet has.
    #[error("LENGTH: found {found}, expected {least} to {most}")]
    Length {
        /// Found length.
        found: usize,
        /// Shortest length.
        least: usize,
        /// Longest length.
        most: usize,
    },
    /// Parameters are fewer or more than the instruction has.
    #[error("{field}: found {found} bytes, expected {expected}")]
    Parameters {
        /// What the bytes are for.
        field: &'static str,
        /// Found bytes.
        found: usize,
        /// What is expected.
        expected: String,
    },
    /// An instruction code that is not known.
    #[error("INSTRUCTION: found {found:#04x}, expected a code of protocol 2.0")]
    Instruction {
        /// Found code.
        found: u8,
    },
    /// The address field says what no device has.
    #[error("ID: found {found}, expected {expected}")]
    Id {
        /// Found address.
        found: u8,
        /// What is expected.
        expected: String,
    },
}
