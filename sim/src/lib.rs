//! A physics world to grasp in: objects that settle into clutter, depth cameras that see it with a sensor's
//! faults, hands that close and lift with physics deciding what succeeds.
//!
//! It serves three users: mock devices (cells and load tests without hardware), the contact dataset, and the
//! project's own measure of grasp quality. Everything is seeded: same input, same world.
//!
//! Frames: the *world* has z up and the table top at z = 0. Lengths are metres, masses kilograms, angles radians,
//! times seconds, forces newtons. Images follow the optical convention: x right, y down, z forward.

// What things are.
pub mod camera;
pub mod mesh;
pub mod object;
pub mod solid;

// What happens to them.
pub mod clutter;
pub mod execute;
pub mod world;

// What is seen of them.
pub mod render;
pub mod sensor;

// Files.
pub mod scene;

mod convert;
mod hull;
