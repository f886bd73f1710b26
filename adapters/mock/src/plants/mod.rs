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

use graspd_adapters_core::check::{SettingsError, require};

use crate::shared::SharedWorld;

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
