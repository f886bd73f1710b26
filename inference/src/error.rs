//! What is wrong with a model file, and why a run gave nothing.

/// Why a file is not a network that can be run.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ModelError {
    /// The bytes are no ONNX file, or one that was cut off.
    #[error("model: found {found}, expected an ONNX file ({bytes} bytes were read)")]
    NotOnnx {
        /// What the decoder met.
        found: String,
        /// Length of the file.
        bytes: usize,
    },
    /// The file is larger than any model of this service.
    #[error("model: found {found} bytes, expected at most {}", crate::MAX_BYTES)]
    TooLarge {
        /// Length of the file.
        found: usize,
    },
    /// An ONNX file of somebody else, without the metadata that says what it computes.
    #[error("model: found no metadata `{key}`, expected a file exported by graspd_train")]
    Foreign {
        /// The first entry that is missing.
        key: &'static str,
    },
    /// The file changed since it was written.
    #[error("model: found checksum {found:08x}, expected {expected:08x}: the file is damaged")]
    Damaged {
        /// CRC-32 of the bytes.
        found: u32,
        /// CRC-32 that the file says it has.
        expected: u32,
    },
    /// An entry of the metadata has a value that means nothing here.
    #[error("model.{key}: found `{found}`, expected {expected}")]
    Metadata {
        /// Name of the entry.
        key: &'static str,
        /// Its value.
        found: String,
        /// Values that mean something.
        expected: &'static str,
    },
    /// The graph holds an operator, or an arrangement of operators, that this inference does not know.
    #[error("model, node `{node}`: found {found}, expected {expected}")]
    Operator {
        /// Name of the node.
        node: String,
        /// What it is.
        found: String,
        /// What could stand there.
        expected: String,
    },
    /// The graph gives no such output.
    #[error("model: found no output `{output}`, expected `certainty`, `orientation` and `centroid`")]
    Output {
        /// Name of the output.
        output: &'static str,
    },
}

/// Why a run gave no answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum RunError {
    /// The volume has not one value per voxel.
    #[error("volume: found {found} values, expected {side}³ = {expected}")]
    Size {
        /// Found values.
        found: usize,
        /// Expected values.
        expected: usize,
        /// Voxels along an edge.
        side: usize,
    },
    /// The caller wanted no more.
    #[error("stopped")]
    Stopped,
}
