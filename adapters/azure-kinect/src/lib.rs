//! Azure Kinect: a live device, or a recording of one, as a depth camera of a cell.
//!
//! - [`settings`]: what a configuration file says.
//! - [`mode`], [`calibration`], [`lens`]: depth modes, the factory calibration, pixels to points and back.
//! - [`mkv`], [`recording`]: recordings, read without the manufacturer's library.
//! - `playback`, `live`: the two sources of frames, each on its own thread; [`KinectCamera`]: their callers.
//! - `sdk`: the manufacturer's library, looked for at run time. Everything unsafe is in its one file of foreign functions.
//!
//! **Never tried on a real device.** What it was tried against stands in `docs/devices/azure_kinect.md`.

pub mod calibration;
pub mod lens;
pub mod mkv;
pub mod mode;
pub mod recording;
pub mod settings;

mod camera;
mod check;
mod frames;
mod live;
mod playback;
mod sdk;

pub use camera::{KinectCamera, OpenError};
pub use graspd_adapters_core::check::{Finding, SettingsError};
pub use live::DeviceState;
pub use sdk::ENVIRONMENT;
pub use settings::KinectSettings;
