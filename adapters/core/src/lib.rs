//! What a depth camera, a robot arm and a robotic hand are to a robot cell: three traits and one error.
//!
//! # What every implementor guarantees
//! - **Shared.** Methods take `&self`; calls from several tasks are safe. A second motion while one runs replaces it
//!   where the capability says so, else it is refused with [`DeviceError::Busy`].
//! - **Bounded.** Each call ends within its `timeout` with an answer or [`DeviceError::Timeout`]. A device that does
//!   not answer never hangs its caller.
//! - **Cancel-safe.** Dropping a future leaves the device usable. Dropping the future of a *motion* stops the motion
//!   as [`Arm::stop`] does; dropping a query loses nothing but its answer.
//! - **Honest.** An `Ok` means that the device said so. What was commanded is never reported as what was reached.
//! - **Typed.** Every failure is a [`DeviceError`] that says what was asked, what was found, what was expected.
//!
//! Beside the traits stands what several cameras share: [`feed`] (frames from a camera's thread to its callers), [`stamps`]
//! (a device's clock against ours), [`streaming`] (a thread that streams while somebody looks, and reaches a lost device
//! again) and [`library`] (where a vendor's library is looked for).
//! [`follow`] is what arms share that are sent to poses which change while they go.
//! [`check`] is what all adapters say of wrong settings and of devices that are not as they should be; [`task`] what hands
//! share whose line is owned by one task.
//!
//! SI units; poses as `world_from_x`, unit quaternions.

mod arm;
mod camera;
pub mod check;
mod closing;
mod error;
pub mod feed;
pub mod follow;
mod hand;
pub mod library;
pub mod stamps;
pub mod streaming;
pub mod task;
#[cfg(feature = "testing")]
pub mod testing;

pub use arm::{Arm, ArmInfo, ArmMode, ArmState, Leg, Limits, Reach, Reached};
pub use async_trait::async_trait;
pub use camera::{CameraInfo, DepthCamera, DepthFrame, Lens};
pub use error::{DeviceError, FaultKind};
pub use hand::{CloseCommand, GripCommand, Hand, HandInfo, HandState};
