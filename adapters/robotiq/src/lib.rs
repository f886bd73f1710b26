//! Robotiq grippers as hands of a cell: 2F-85, 2F-140 and 3-Finger.
//!
//! One task owns the link, whichever it is: Modbus RTU on a serial port, Modbus TCP, RTU over TCP through an arm's tool
//! port, or the text protocol of the wrist socket. It looks at the gripper's status some fifty times a second while the
//! fingers move, and a few times a second else, so that the gripper knows that somebody is there. Calls send it orders
//! and wait; a call that is given up stops the fingers, not the task.
//!
//! - [`settings`]: the settings, as a table that a configuration file can hold.
//! - [`wire`]: requests and status as bytes of the gripper's registers; faults by name.
//! - [`calibration`]: counts of the gripper, metres and radians of our descriptions.
//! - [`link`]: exchanges over any of the links.
//! - `driver`: the task; [`RobotiqHand`]: its callers.
//!
//! A gripper that is not talked to goes on with what it was told and keeps its grip: that is how these devices are
//! made. What is bounded is therefore what it is told: position, speed and force of each request.
//!
//! **Never tried on a real gripper.** It was tried against the emulated grippers of `graspd-adapters-emulators`, which
//! independent client libraries accept as well, and against an independent Modbus slave.

pub mod calibration;
mod driver;
mod hand;
pub mod link;
mod report;
pub mod settings;
pub mod wire;

pub use hand::RobotiqHand;
pub use report::{AxisReport, GripperReport};
pub use settings::{Model, RobotiqSettings};
