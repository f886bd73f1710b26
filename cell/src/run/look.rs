//! Looking into the tray and asking for grasps.

use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::calls::{Pace, Problem, Who, answered, seconds};
use super::{Next, Run};
use crate::frame::Frame;
use crate::outcome::{Holding, Outcome};
use crate::steps::{Step, Trouble};

impl Run<'_> {
    /// Out of the camera's view. The first time over the dropping place, where the hand opens: whatever an earlier run
    /// left in it lands there, and a drop pose out of reach is found before anything is grasped.
    pub(super) async fn clear_view(&mut self) -> Result<Next, Problem> {
        self.raise_empty(Pace::Travel).await?;
        if !self.prepared {
            self.through_air(&self.places.drop, Pace::Carry).await?;
            self.open_wide().await?;
            self.holding = Holding::Nothing;
            self.prepared = true;
        }
        let look = self.config.servo.as_ref().filter(|_| !self.led).map(|servo| self.first_look(servo));
        if look.is_some() {
            // A camera in the palm looks out between open fingers.
            self.open_wide().await?;
        }
        self.through_air(look.as_ref().unwrap_or(&self.places.wait), Pace::Travel).await?;
        Ok(Next::Go(Step::Capture))
    }

    pub(super) async fn capture(&mut self) -> Result<Next, Problem> {
        if let Some(servo) = self.config.servo.clone() {
            let palm = self.palm_frame(&servo).await?;
            self.keep(palm.frame.clone());
            self.attempt.palm = Some(palm);
            return Ok(Next::Go(Step::Plan));
        }
        let device = self.capture_frame().await?;
        self.last_exposure = Some(device.sequence);
        let camera = &self.config.camera;
        let frame = Frame::of(&device, &looking(&camera.position_m, &camera.looks_at_m))
            .map_err(|e| Problem::broken(Who::Camera, e))?;
        self.keep(frame);
        Ok(Next::Go(Step::Plan))
    }

    /// The frame that is planned from.
    fn keep(&mut self, frame: Frame) {
        if let Some(recorder) = &self.recorder {
            // Small and rare: a thread of its own would cost more than it saves.
            let kept = recorder.frame(self.attempt.number, &frame);
            self.note(kept);
        }
        self.attempt.frame = Some(frame);
    }

    pub(super) async fn plan(&mut self) -> Result<Next, Problem> {
        if let Some(servo) = self.config.servo.clone() {
            return self.servo_plan(&servo).await;
        }
        if self.attempt.question.is_none() {
            let question = self.question().as_recorded().map_err(|e| Problem::broken(Who::Planner, e))?;
            self.attempt.question = Some(question);
        }
        let (Some(frame), Some(question)) = (&self.attempt.frame, &self.attempt.question) else {
            return Err(Problem::broken(Who::Camera, "no frame to plan from"));
        };
        let limit = seconds(self.config.timeouts.plan_s);
        let answer = answered(limit, self.cell.planner.plan(frame, question, limit)).await?;
        let (why, rejections) = (answer.no_grasp.clone(), answer.rejections());
        let out_of_reach = self.out_of_reach(&answer);
        self.attempt.take(answer, out_of_reach, &self.failed_poses);
        let Some(why) = why else {
            self.empty_frames = 0;
            return self.some_in_reach().map(|()| Next::Go(Step::Open));
        };
        if why.reason.is_empty_tray() {
            self.empty_frames += 1;
            return Ok(Next::Finished(Outcome::NotExecuted { why: why.reason.name().to_owned() }));
        }
        self.empty_frames = 0;
        let rejections = if rejections.is_empty() { rejections } else { format!(" ({rejections})") };
        let text = format!("{}: {}{rejections}", why.reason.name(), why.nearest_fix);
        Err(Problem { who: Who::Planner, trouble: Trouble::NoGrasp, text })
    }
}

/// Pose of an optical frame at `position` that looks at `target`, its upper edge up (along world y when looking
/// straight down).
pub(crate) fn looking(position: &[f64; 3], target: &[f64; 3]) -> Isometry3<f64> {
    let eye = Vector3::from(*position);
    let z = (Vector3::from(*target) - eye).try_normalize(1e-9).unwrap_or_else(|| -Vector3::z());
    let x = z.cross(&Vector3::z()).try_normalize(1e-6).or_else(|| z.cross(&Vector3::y()).try_normalize(1e-6));
    let x = x.unwrap_or_else(Vector3::x);
    let axes = Matrix3::from_columns(&[x, z.cross(&x), z]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    Isometry3::from_parts(eye.into(), rotation)
}
