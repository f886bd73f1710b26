//! Robotic hands: descriptions, URDF loading, kinematics, actuation, contact pads, collision geometry.
//!
//! A hand is two files, `hand.urdf` and `hand.toml` (and meshes where the URDF names them). This crate
//! turns their *contents* into a validated, immutable [`Hand`]; it never touches a file system: callers
//! hand over bytes as [`HandFiles`]. The paper's hands and a few more are compiled in, see [`library`].
//!
//! Frames: the *hand frame* is the URDF's root link. Lengths are metres, angles radians.

// What a hand is.
mod actuation;
mod collision;
mod confidence;
mod error;
mod files;
mod hand;
mod kinematics;
mod pad;

// How files become a hand.
mod coupling;
mod description;
mod geometry;
mod joint_limits;
mod load;
mod mesh_files;
mod pads;
mod urdf;
mod xml_guard;

// What is derived from a hand's shapes and motion.
mod groups;
mod opening;
mod self_collision;
mod set_cover;
mod solid;
mod spheres;

// Tools for people who bring a hand.
mod check;
mod init;

pub mod library;
pub mod mesh;

pub use actuation::{Actuation, Coordinate, CoordinateKind, JointRow, SoftCoupling};
pub use check::{Report, check};
pub use collision::{CollisionShape, CollisionSphere, Shape};
pub use confidence::Confidence;
pub use error::{HandError, Problem, Problems};
pub use files::HandFiles;
pub use hand::{Finger, Hand, Opening};
pub use init::propose;
pub use kinematics::{Body, Joint, JointKind, Link, Tree};
pub use pad::{ContactCandidate, Pad};
