//! Mock depth cameras, arms and hands that stand in one shared simulated world.
//!
//! A [`SharedWorld`] owns a `graspd_sim::world::World` on a thread of its own; [`MockCamera`], [`MockArm`] and
//! [`MockHand`] are any number of devices in it. They behave as `graspd_adapters_core` promises of every device,
//! and fail on request: see [`Faults`].
//!
//! ```
//! use std::{sync::Arc, time::Duration};
//! use graspd_adapters_core::{DepthCamera, Hand};
//! use graspd_adapters_mock::*;
//! use graspd_sim::{camera::look_at, sensor::Sensor, world::{Tray, World, WorldSettings}};
//! use nalgebra::{Isometry3, Point3, Vector3};
//!
//! # #[tokio::main(flavor = "current_thread")] async fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let world = World::new(WorldSettings { tray: Some(Tray::default()), ..WorldSettings::default() });
//! let shared = SharedWorld::new(world, SharedWorldSettings::default())?;
//! let world_from_camera = look_at(&Point3::new(0.0, -0.25, 0.75), &Point3::origin(), &Vector3::z());
//! let camera = MockCamera::new(
//!     &shared,
//!     CameraSettings::default(),
//!     Sensor::azure_kinect(),
//!     Mount::Fixed { world_from_camera },
//!     Faults { latency_s: 0.03, drop_share: 0.01, ..Faults::default() },
//! )?;
//! let hand = Arc::new(graspd_hands::library::hand("leap").ok_or("no such hand")?.clone());
//! let mounted = shared.add_hand(hand, Isometry3::translation(0.4, 0.0, 0.5), None).await?;
//! let arm = MockArm::new(&shared, mounted, ArmSettings::default(), Faults::default())?;
//! let fingers = MockHand::new(&shared, mounted, HandSettings::default(), Faults::default()).await?;
//!
//! let frame = camera.capture(Duration::from_millis(200), Duration::from_secs(1)).await?;
//! assert_eq!(frame.depth_m.len(), 640 * 576);
//! assert_eq!(fingers.info().actuators.len(), 16);
//! // In the middle of a run: the next motion ends in a protective stop.
//! let kind = StopKind::Protective;
//! arm.faults().update(|f| f.motion = Some(MotionFault { after: After::Metres(0.05), kind }))?;
//! # Ok(()) }
//! ```
//!
//! # Time
//! All device times (frame stamps, latencies, the length of a motion) are on the world's clock. What moves that
//! clock is [`SharedWorldSettings::speed`]; see there for what it means for timeouts and for determinism.

// The world that the devices share.
mod bins;
mod clock;
mod course;
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
mod follow;
mod grip;
mod hand;
mod motion;

// The world behind the wires of emulated devices.
pub mod plants;

pub use arm::{ArmSettings, MockArm};
pub use bins::{Bin, Delivered};
pub use camera::{CameraSettings, MockCamera, Mount};
pub use fault_handle::FaultHandle;
pub use faults::{After, Faults, FaultsError, MotionFault, Overload, Spell, Stale, StopKind};
pub use hand::{HandSettings, MockHand};
pub use shared::{Hold, SharedWorld, SharedWorldSettings, WorldEnded};
pub use whereabouts::{Census, ObjectView};
