//! Which frames a servo looks at: newer than what it has seen, and from where a camera can be.

use std::time::Duration;

use nalgebra::Isometry3;

use super::answer::Counters;
use super::options::CameraBounds;
use crate::budget::Stop;
use crate::frame::FrameError;
use crate::scene::SceneError;

/// So many wild poses in a row that agree with each other are where the camera is.
const CONVINCING: usize = 4;
/// What a pose may be off whatever the time between frames, metres and radians.
const SLACK: (f64, f64) = (0.02, 0.05);
/// Frames further apart than this say nothing about each other's poses.
const FORGOTTEN: Duration = Duration::from_secs(2);

/// Why a frame has no answer.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Refused {
    /// It came before.
    #[error("frame {sequence} came before")]
    Repeated {
        /// Its number.
        sequence: u64,
    },
    /// A newer one was answered.
    #[error("frame {sequence} is older than {answered}, which was answered")]
    Late {
        /// Its number.
        sequence: u64,
        /// The newest that was answered.
        answered: u64,
    },
    /// The camera cannot have gone there.
    #[error(
        "world_from_camera: {moved_m:.3} m and {turned_rad:.2} rad from the frame before, within {within:?}"
    )]
    WildPose {
        /// Metres from the frame before.
        moved_m: f64,
        /// Radians.
        turned_rad: f64,
        /// Time since the frame before.
        within: Duration,
    },
    /// It has no pose.
    #[error("world_from_camera: missing, expected a pose on every frame of a servo")]
    MissingPose,
    /// It cannot be read.
    #[error("{0}")]
    Frame(#[from] FrameError),
    /// The scene cannot be read.
    #[error("{0}")]
    Scene(SceneError),
    /// Work had to stop.
    #[error("stopped: {0:?}")]
    Stopped(Stop),
}

/// The frame that was admitted last.
#[derive(Debug, Clone, Copy)]
struct Last {
    sequence: u64,
    captured: Duration,
    world_from_camera: Isometry3<f64>,
}

/// Judges frames by number, time and pose, and counts those that it refuses.
#[derive(Debug, Clone)]
pub(super) struct Admission {
    bounds: CameraBounds,
    last: Option<Last>,
    /// The last wild one, and how many in a row agree with it.
    wild: Option<(Last, usize)>,
}

impl Admission {
    pub(super) fn new(bounds: CameraBounds) -> Self {
        Self { bounds, last: None, wild: None }
    }

    /// Admits a frame; true where the camera turns out to stand somewhere else than it can have gone.
    pub(super) fn admit(
        &mut self,
        sequence: u64,
        captured: Duration,
        world_from_camera: &Isometry3<f64>,
        counters: &mut Counters,
    ) -> Result<bool, Refused> {
        let this = Last { sequence, captured, world_from_camera: *world_from_camera };
        let Some(last) = self.last else {
            self.last = Some(this);
            return Ok(false);
        };
        if sequence == last.sequence {
            counters.repeated += 1;
            return Err(Refused::Repeated { sequence });
        }
        if sequence < last.sequence || captured < last.captured {
            counters.late += 1;
            return Err(Refused::Late { sequence, answered: last.sequence });
        }
        if let Some((moved_m, turned_rad)) = self.exceeds(&last, &this) {
            let agreeing = match self.wild {
                Some((before, count)) if self.exceeds(&before, &this).is_none() => count + 1,
                _ => 1,
            };
            if agreeing < CONVINCING {
                self.wild = Some((this, agreeing));
                counters.wild += 1;
                return Err(Refused::WildPose {
                    moved_m,
                    turned_rad,
                    within: captured.saturating_sub(last.captured),
                });
            }
            self.wild = None;
            self.last = Some(this);
            return Ok(true);
        }
        self.wild = None;
        self.last = Some(this);
        Ok(false)
    }

    /// How far apart two poses are, if that is further than a camera goes in between.
    fn exceeds(&self, before: &Last, after: &Last) -> Option<(f64, f64)> {
        let within = after.captured.saturating_sub(before.captured);
        if within > FORGOTTEN {
            return None;
        }
        let apart = before.world_from_camera.inverse() * after.world_from_camera;
        let (moved, turned) = (apart.translation.vector.norm(), apart.rotation.angle());
        let seconds = within.as_secs_f64();
        let is_wild = moved > SLACK.0 + self.bounds.speed_m_s * seconds
            || turned > SLACK.1 + self.bounds.turn_rad_s * seconds;
        is_wild.then_some((moved, turned))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64) -> Isometry3<f64> {
        Isometry3::translation(x, 0.0, 0.4)
    }

    fn admission() -> (Admission, Counters) {
        (Admission::new(CameraBounds { speed_m_s: 1.0, turn_rad_s: 2.0 }), Counters::default())
    }

    const FRAME: Duration = Duration::from_millis(33);

    #[test]
    fn late_and_repeated_frames_are_refused_and_counted() {
        let (mut admission, mut counters) = admission();
        assert_eq!(admission.admit(5, 5 * FRAME, &at(0.0), &mut counters), Ok(false));
        assert_eq!(
            admission.admit(5, 5 * FRAME, &at(0.0), &mut counters),
            Err(Refused::Repeated { sequence: 5 })
        );
        let late = Err(Refused::Late { sequence: 4, answered: 5 });
        assert_eq!(admission.admit(4, 4 * FRAME, &at(0.0), &mut counters), late);
        // A number that goes on with a clock that goes back is late too.
        assert!(admission.admit(6, 4 * FRAME, &at(0.0), &mut counters).is_err());
        assert_eq!(admission.admit(9, 9 * FRAME, &at(0.05), &mut counters), Ok(false), "some may be missing");
        assert_eq!((counters.late, counters.repeated, counters.wild), (2, 1, 0));
    }

    #[test]
    fn a_wild_pose_is_refused_unless_it_stays() {
        let (mut admission, mut counters) = admission();
        admission.admit(0, Duration::ZERO, &at(0.0), &mut counters).unwrap();
        assert!(matches!(
            admission.admit(1, FRAME, &at(3.0), &mut counters),
            Err(Refused::WildPose { moved_m, .. }) if (moved_m - 3.0).abs() < 1e-9
        ));
        assert_eq!(admission.admit(2, 2 * FRAME, &at(0.01), &mut counters), Ok(false), "one was a slip");
        let answers: Vec<_> =
            (3..8).map(|k| admission.admit(k, k as u32 * FRAME, &at(1.0), &mut counters)).collect();
        assert!(answers[..3].iter().all(Result::is_err));
        assert_eq!(answers[3..], [Ok(true), Ok(false)], "it does stand there");
        assert_eq!(counters.wild, 4);
    }
}
