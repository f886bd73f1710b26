//! The dynamic grasp servo against static grasping, in dense clutter (Supplementary Note 7, Task 2): a hand with a depth
//! camera in its palm looks, plans, comes nearer while every frame refines the grasp, grips, lifts.
//!
//! Both modes see the same trays, the same first frames and the same noise; they differ in what becomes of the frames
//! after the first.

mod approach;
mod paired;
mod palm;
mod report;
mod run;
mod settings;

pub use paired::{Pair, pairs_with_servo};
pub use palm::{PalmCamera, hand_from_camera};
pub use report::{Row, ServoReport};
pub use run::{ServoAttempt, ServoEnd, ServoObserver, ServoTray, clear_with_servo};
pub use settings::{Group, Nudge, ServoSettings};
