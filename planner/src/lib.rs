//! From depth frames to ranked grasps: the planning pipeline as pure functions.
//!
//! Data flows one way, and each stage is a module:
//!
//! [`frame`] → [`volume`] (placed by [`workspace`]) → [`estimator`] gives a [`contact_field`] → [`refine`]
//! gives features → initialization, optimization and ranking give grasps.
//!
//! [`servo`] carries one grasp on from frame to frame while the hand approaches it.
//!
//! No sockets, no files, no clock: time and cancellation come in through a [`budget::Budget`] that is
//! asked. Everything random is seeded; the same input gives the same output on any number of threads.
//!
//! Frames of reference: `world` (the caller's), `camera` (optical: x right, y down, z forward), `volume`
//! (origin at the cube's corner, z up), `hand` (the URDF's root link). `a_from_b` takes coordinates in b
//! to coordinates in a. Units are SI.

mod balance;
pub mod budget;
mod configuration;
pub mod contact_field;
pub mod estimator;
pub mod frame;
pub mod grasp;
pub mod grid;
mod hand_model;
mod init;
pub mod objective;
pub mod optimize;
pub mod options;
mod orientation;
pub mod plan;
#[cfg(test)]
mod random_hand;
mod rank;
pub mod refine;
pub mod scene;
pub mod servo;
pub mod volume;
pub mod workspace;
