//! The graspd.v1 protocol: the .proto files beside this crate and the code generated from them.
//!
//! These types stop at the edge of the server and of clients; the comments in `graspd/v1/*.proto` are the
//! reference for every field's unit, frame and default.

/// Messages and services of the package `graspd.v1`.
#[allow(missing_docs, missing_debug_implementations, unreachable_pub)]
#[allow(clippy::all, clippy::pedantic, clippy::unwrap_used, clippy::uninlined_format_args)]
pub mod v1 {
    tonic::include_proto!("graspd.v1");
}

/// The descriptors of every file of the package with its imports and comments, encoded, for gRPC reflection.
pub const FILE_DESCRIPTOR_SET: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/graspd.v1.descriptors.bin"));
