//! CamBoard pico flexx of pmd: through the manufacturer's library Royale, or from a ROS driver that runs already, as a depth
//! camera of a cell.
//!
//! - [`settings`]: what a configuration file says; [`use_case`]: the camera's modes by their names.
//! - `royale`: the library's C interface, looked for at run time. Everything unsafe is in its one file of foreign functions.
//! - [`rosbridge`]: images and point clouds of a ROS driver, over the WebSocket of rosbridge: no ROS is needed here.
//! - [`FlexxCamera`]: either of them to its callers, on a thread of its own.
//!
//! **Never tried on a real camera, and never with the real library**, which cannot be had without registration at its maker.
//! What it was tried against stands in `docs/devices/pico_flexx.md`.

pub mod rosbridge;
pub mod settings;
pub mod use_case;

mod camera;
mod check;
mod live;
mod royale;

pub use camera::FlexxCamera;
pub use graspd_adapters_core::check::{Finding, SettingsError};
pub use royale::ENVIRONMENT;
pub use settings::FlexxSettings;

/// What is known of the camera.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct CameraState {
    /// Where frames come from: the library that was loaded, with its version, or the server's address.
    pub source: Option<String>,
    /// Id of the camera that was opened last.
    pub id: Option<String>,
    /// True while it streams.
    pub streaming: bool,
    /// Use case that it runs, where it says.
    pub use_case: Option<String>,
    /// Exposure time of the last frame, microseconds, where it says.
    pub exposure_us: Option<u32>,
}
