//! Emulators of robotic devices: each speaks the device's own protocol, byte for byte, over real sockets and serial
//! lines, so that adapters, and anybody's client software, can be tried without the device.
//!
//! What moves behind the protocol is a *plant*: the small kinematic one that comes with each emulator, or a simulated
//! world that implements the emulator's plant trait. Faults come on request: garbled and cut answers, slow ones,
//! silence, hang-ups, and the device's own.

pub mod dynamixel;
pub mod faults;
pub mod line;
pub mod requests;
pub mod robotiq;
pub mod ur;
