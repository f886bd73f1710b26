//! Dynamic grasp servo (Supplementary Note 7, Task 2): one grasp, carried on from frame to frame while the hand
//! approaches it with a depth camera in its palm.
//!
//! The first frame is planned as usual, with a large batch of few iterations; the best candidate is kept. Each further
//! frame is fused into the [volume](crate::volume::Volume::update), which forgets what has changed and moves along with
//! the target; the features are made anew in a window about the target, the candidate goes on for a few iterations, and
//! the same judge that ranks plans decides whether it is still a grasp. Meanwhile the [stand-off](standoff) shrinks, until
//! the hand goes straight in.
//!
//! A [`Servo`] has no clock and no threads of its own: moments come with the frames. Which frames it gets is the caller's
//! decision (the newest); those that are late, repeated or stand where no camera can have gone are refused and counted.

mod admission;
mod answer;
mod follow;
mod improve;
mod mask;
mod options;
mod perceive;
mod rivals;
mod search;
mod smooth;
mod stages;
pub mod standoff;
mod target;
mod tracker;
mod window;

pub use admission::Refused;
pub use answer::{Answer, Change, Counters, Loss, Replan, State};
pub use options::{Bounds, CameraBounds, Mode, ServoOptions, ServoOptionsError};
pub use standoff::StandoffOptions;
pub use tracker::{HandNow, Servo, ServoFrame};
