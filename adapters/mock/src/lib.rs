//! Mock depth cameras, arms and hands that stand in one shared simulated world.
//!
//! A [`SharedWorld`] owns a `graspd_sim::world::World` on a thread of its own; [`MockCamera`], [`MockArm`] and
//! [`MockHand`] are any number of devices in it. They behave as `graspd_adapters_core` promises of every device,
//! and fail on request: see [`Faults`].
//!
//! ```text
//! let shared = SharedWorld::new(world, SharedWorldSettings { speed: 0.0, bins })?;
//! let camera = MockCamera::new(&shared, CameraSettings::default(), Sensor::azure_kinect(), Faults::default())?;
//! let mounted = shared.add_hand(hand, home, coordinates).await?;
//! let arm = MockArm::new(&shared, mounted, ArmSettings::default(), Faults::default())?;
//! let fingers = MockHand::new(&shared, mounted, HandSettings::default(), Faults::default()).await?;
//! ```
//!
//! # Time
//! All device times (frame stamps, latencies, the length of a motion) are on the world's clock. What moves that
//! clock is [`SharedWorldSettings::speed`]; see there for what it means for timeouts and for determinism.

// The world that the devices share.
mod bins;
mod clock;
mod shared;
mod stage;
mod whereabouts;

// What goes wrong.
mod fault_handle;
mod faults;
mod link;

// The devices.
mod arm;
mod camera;
mod grip;
mod hand;
mod motion;

pub use arm::{ArmSettings, MockArm};
pub use bins::{Bin, Delivered};
pub use camera::{CameraSettings, MockCamera, Mount};
pub use fault_handle::FaultHandle;
pub use faults::{After, Faults, FaultsError, MotionFault, Overload, Spell, Stale, StopKind};
pub use hand::{HandSettings, MockHand};
pub use shared::{SettingsError, SharedWorld, SharedWorldSettings, WorldEnded};
pub use whereabouts::{Census, ObjectView};
