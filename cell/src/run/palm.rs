//! A frame of the camera in the palm, and where hand and camera were when it was exposed.

use std::sync::Arc;
use std::time::Duration;

use graspd_adapters_core::{Arm, DepthCamera, DepthFrame};
use nalgebra::Isometry3;
use tokio::time::Instant;

use super::calls::{Problem, Who, bounded, seconds};
use crate::config::CellConfig;
use crate::frame::Frame;

/// A frame that a hand has carried its camera to.
#[derive(Debug)]
pub(super) struct PalmFrame {
    pub(super) frame: Frame,
    /// Number of the exposure.
    pub(super) exposure: u64,
    /// Time of exposure on the camera's clock; none where it has no clock.
    pub(super) captured: Option<Duration>,
    /// Pose of the hand's root link then, world frame.
    pub(super) world_from_hand: Isometry3<f64>,
}

/// The devices that it takes, and how they are asked.
#[derive(Debug, Clone)]
pub(super) struct Palm {
    camera: Arc<dyn DepthCamera>,
    arm: Arc<dyn Arm>,
    hand_from_camera: Isometry3<f64>,
    max_age: Duration,
    capture: Duration,
    state: Duration,
    patience: f64,
}

impl Palm {
    pub(super) fn new(
        camera: &Arc<dyn DepthCamera>,
        arm: &Arc<dyn Arm>,
        hand_from_camera: Isometry3<f64>,
        config: &CellConfig,
    ) -> Self {
        Self {
            camera: camera.clone(),
            arm: arm.clone(),
            hand_from_camera,
            max_age: seconds(config.camera.max_age_s),
            capture: seconds(config.timeouts.capture_s),
            state: seconds(config.timeouts.state_s),
            patience: config.timeouts.patience,
        }
    }

    /// The next frame. A camera that does not know its pose has the one that the arm says, between its poses before and
    /// after the frame.
    pub(super) async fn look(self) -> Result<PalmFrame, Problem> {
        let name = self.camera.info().name;
        let before = (self.flange().await?, Instant::now());
        let call = self.camera.capture(self.max_age, self.capture);
        let seen = bounded(Who::Camera, &name, "capture", self.capture, self.patience, call).await?;
        let came = Instant::now();
        let world_from_camera = match seen.world_from_camera {
            Some(pose) => pose,
            None => {
                let after = (self.flange().await?, Instant::now());
                between(before, after, came.checked_sub(seen.age).unwrap_or(before.1)) * self.hand_from_camera
            }
        };
        let frame = Frame::of(&seen, &world_from_camera).map_err(|e| Problem::broken(Who::Camera, e))?;
        let DepthFrame { sequence: exposure, stamp, .. } = seen;
        let captured = (stamp > Duration::ZERO).then_some(stamp);
        let world_from_hand = world_from_camera * self.hand_from_camera.inverse();
        Ok(PalmFrame { frame, exposure, captured, world_from_hand })
    }

    async fn flange(&self) -> Result<Isometry3<f64>, Problem> {
        let name = self.arm.info().name;
        let call = self.arm.state(self.state);
        let state = bounded(Who::Arm, &name, "state", self.state, self.patience, call).await?;
        Ok(state.world_from_flange)
    }
}

/// Where something was at a moment between two looks at it.
fn between(
    (a, at_a): (Isometry3<f64>, Instant),
    (b, at_b): (Isometry3<f64>, Instant),
    at: Instant,
) -> Isometry3<f64> {
    let all = at_b.saturating_duration_since(at_a).as_secs_f64();
    let share = if all > 0.0 { at.saturating_duration_since(at_a).as_secs_f64() / all } else { 1.0 };
    a.try_lerp_slerp(&b, share.clamp(0.0, 1.0), 1e-9).unwrap_or(b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn a_pose_between_two_looks_is_between_them() {
        let (a, b) = (Isometry3::translation(0.0, 0.0, 0.4), Isometry3::translation(0.1, 0.0, 0.4));
        let begin = Instant::now();
        let at = |ms: u64| begin + Duration::from_millis(ms);
        let x = |ms: u64| between((a, at(100)), (b, at(200)), at(ms)).translation.x;
        assert!((x(150) - 0.05).abs() < 1e-12 && (x(125) - 0.025).abs() < 1e-12);
        assert_eq!((x(0), x(300)), (0.0, 0.1), "never beyond what was seen");
        assert_eq!(between((a, at(5)), (b, at(5)), at(5)), b);
    }
}
