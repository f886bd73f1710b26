//! The LEAP Hand, and other hands of Dynamixel motors, as a hand of a cell.
//!
//! One task owns the serial line. It reads all motors in one exchange and tells all their goals in another, some hundred
//! times a second, which also feeds the motors' own watchdog: when this process is gone, the fingers stop by themselves.
//! Calls send it orders and wait; a call that is given up stops the fingers, not the task.
//!
//! - [`joints`]: names, addresses and limits of the joints; radians to pulses.
//! - [`settings`]: the settings, as a table that a configuration file can hold.
//! - [`bus`]: exchanges with motors, their retries and their errors.
//! - `motion`: where the fingers are told to go from moment to moment; no I/O.
//! - `driver`: the task; [`LeapHand`]: its callers.
//!
//! **Never tried on a real hand.** It was tried against the emulated bus of `graspd-adapters-emulators`, which the motor
//! manufacturer's own SDK accepts as well.

pub mod bus;
mod driver;
mod hand;
pub mod joints;
mod motion;
mod report;
pub mod settings;

pub use hand::LeapHand;
pub use report::JointReport;
pub use settings::LeapSettings;
