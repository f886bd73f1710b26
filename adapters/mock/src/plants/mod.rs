//! A shared world behind the wires of emulated devices: what moves when an emulated controller, gripper or bus of motors
//! is told to move is the same hand in the same world that a [`crate::MockArm`] or [`crate::MockHand`] would move.
//!
//! Emulated devices live on the wall clock, so the world must run at a speed ([`crate::SharedWorldSettings::speed`], 1
//! for one that keeps up). A plant never waits for the world: it leaves its orders where the world's thread finds them
//! after the next step, and reads what was measured last. When the world's thread has ended, an arm reports a protective
//! stop, fingers do not move any more.

mod fingers;
mod gripper;
mod motors;
mod wrist;

pub use gripper::GripperPlant;
pub use motors::MotorPlant;
pub use wrist::{WristMount, WristPlant};

use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use graspd_adapters_core::check::{SettingsError, require};

use crate::shared::SharedWorld;

/// What a device's thread and the world's thread tell each other. Neither keeps the other waiting for longer than it takes
/// to copy what it says.
#[derive(Debug)]
struct Line<T>(Arc<Mutex<T>>);

/// The world's end of a line: it does not keep the line, which ends with the device.
#[derive(Debug)]
struct FarEnd<T>(Weak<Mutex<T>>);

impl<T> Line<T> {
    fn new(said: T) -> Self {
        Self(Arc::new(Mutex::new(said)))
    }

    fn lock(&self) -> MutexGuard<'_, T> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn far_end(&self) -> FarEnd<T> {
        FarEnd(Arc::downgrade(&self.0))
    }
}

impl<T> FarEnd<T> {
    /// The line; `None` once the device is gone.
    fn line(&self) -> Option<Line<T>> {
        self.0.upgrade().map(Line)
    }
}

/// Refuses a world that stands still while nobody waits for it.
fn require_speed(shared: &SharedWorld) -> Result<(), SettingsError> {
    require("speed", 0, shared.is_paced(), "a speed above 0: emulated devices live on the wall clock")
}

fn require_hand<T>(found: Option<T>) -> Result<T, SettingsError> {
    found.ok_or_else(|| SettingsError {
        field: "hand".into(),
        found: "none".into(),
        expected: "a hand that is in the world".into(),
    })
}
