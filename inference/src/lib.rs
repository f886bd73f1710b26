//! Runs graspd's contact networks on a CPU: a volume in, a contact field out, no other runtime needed.
//!
//! [`Network::from_bytes`] reads an ONNX file of `graspd_train.export`, checks that it is whole and that it is one of
//! ours, and folds every sum and activation into the convolution before it; [`Network::run`] then computes direct
//! convolutions on the rayon pool it is called in. The kernels are compiled for several instruction sets, of which the
//! machine's widest is used.
//!
//! Why not a general runtime: `docs/inference.md` of the repository has the figures.

mod compile;
mod error;
mod kernel;
mod layer;
mod network;
mod onnx;
mod tensor;

pub use error::{ModelError, RunError};
pub use network::{Info, Network, OrientationKind, Orientations, Output, VolumeInput};

/// Largest accepted file, bytes.
pub const MAX_BYTES: usize = 64 << 20;
