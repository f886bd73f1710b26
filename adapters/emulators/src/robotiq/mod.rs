//! Robotiq grippers: 2F-85, 2F-140 and 3-Finger, over Modbus RTU on a serial line, Modbus TCP, RTU over TCP (the tool
//! port of a robot arm) and the text protocol of the wrist socket.
//!
//! One [`Gripper`] stands behind any number of servers. It keeps to the device's registers: activation, requests that
//! count only after the gripper has taken them, object detection, faults. The parsers are this emulator's own.

mod device;
mod encode;
mod gripper;
mod modbus;
mod plant;
mod rtu;
mod socket;
mod tcp;
#[cfg(test)]
mod tests;

pub use device::{Gripper, GripperConfig, Model};
pub use plant::{AxisCommand, AxisState, Contact, KinematicPlant, Objects, Plant};
pub use tcp::Server;
