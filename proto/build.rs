//! Compiles the .proto files with protox (pure Rust, no protoc) and keeps the descriptors for reflection.

use std::error::Error;
use std::path::PathBuf;

use prost::Message as _;

const FILES: [&str; 10] = [
    "graspd/v1/geometry.proto",
    "graspd/v1/frame.proto",
    "graspd/v1/options.proto",
    "graspd/v1/grasp.proto",
    "graspd/v1/assignment.proto",
    "graspd/v1/planner_service.proto",
    "graspd/v1/hand_service.proto",
    "graspd/v1/info_service.proto",
    "graspd/v1/recording.proto",
    "graspd/v1/servo_service.proto",
];

/// Fields that can be megabytes: decoded as views into the received message instead of copies.
const BYTES: [&str; 3] =
    [".graspd.v1.DepthFrame.data", ".graspd.v1.LabelImage.data", ".graspd.v1.FileChunk.data"];

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed=graspd");
    let descriptors = protox::compile(FILES, ["."])?;
    let out = PathBuf::from(std::env::var("OUT_DIR")?);
    std::fs::write(out.join("graspd.v1.descriptors.bin"), descriptors.encode_to_vec())?;
    let mut builder = tonic_prost_build::configure().emit_rerun_if_changed(false);
    for field in BYTES {
        builder = builder.bytes(field);
    }
    builder.compile_fds(descriptors)?;
    Ok(())
}
