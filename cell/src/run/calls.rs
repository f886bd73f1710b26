//! Calls to devices: every one bounded here too, every failure sorted for the table of recoveries.

use std::future::Future;
use std::time::Duration;

use graspd_adapters_core::{CloseCommand, DeviceError, GripCommand, HandInfo, HandState, Limits, Reached};
use nalgebra::Isometry3;

use super::Run;
pub(crate) use crate::config::seconds;
use crate::outcome::End;
use crate::plan::{PlannedGrasp, PlannerError};
use crate::pose::raised_to;
use crate::steps::Trouble;

/// Added to every wait: answers take a moment on their way.
const GRACE: Duration = Duration::from_millis(500);
/// The actuator of a hand without touch is held when it stays this share of its way from its target.
const HELD_SHARE: f64 = 0.03;

/// Whose trouble it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Who {
    Camera,
    Arm,
    Hand,
    Planner,
}

/// A step that did not work.
#[derive(Debug)]
pub(super) struct Problem {
    pub(super) who: Who,
    pub(super) trouble: Trouble,
    pub(super) text: String,
}

impl Problem {
    pub(super) fn of(who: Who, error: &DeviceError) -> Self {
        Self { who, trouble: Trouble::from(error), text: error.to_string() }
    }

    pub(super) fn broken(who: Who, text: impl ToString) -> Self {
        Self { who, trouble: Trouble::Broken, text: text.to_string() }
    }

    /// The end of the run that this problem makes.
    pub(super) fn end(self) -> End {
        let why = self.text;
        match (self.trouble, self.who) {
            (Trouble::Emergency, _) => End::EmergencyStop { why },
            (Trouble::NoGrasp, _) => End::NoGrasp { why },
            (Trouble::PlannerRefused, _) => End::PlannerRefused { why },
            (_, Who::Planner) => End::PlannerLost { why },
            (_, Who::Camera) => End::CameraLost { why },
            (_, Who::Arm) => End::ArmLost { why },
            (_, Who::Hand) => End::HandLost { why },
        }
    }
}

impl From<PlannerError> for Problem {
    fn from(error: PlannerError) -> Self {
        Self { who: Who::Planner, trouble: error.trouble(), text: error.to_string() }
    }
}

/// Waits for a planner, a little longer than it was allowed.
pub(crate) async fn answered<T>(
    limit: Duration,
    call: impl Future<Output = Result<T, PlannerError>>,
) -> Result<T, PlannerError> {
    let late = |_| PlannerError::Failed(format!("no answer within {limit:?}"));
    tokio::time::timeout(limit + GRACE, call).await.map_err(late)?
}

/// Waits for a device, so many times longer than it was allowed.
pub(super) async fn bounded<T>(
    who: Who,
    device: &str,
    operation: &'static str,
    limit: Duration,
    patience: f64,
    call: impl Future<Output = Result<T, DeviceError>>,
) -> Result<T, Problem> {
    let after = limit.mul_f64(patience) + GRACE;
    match tokio::time::timeout(after, call).await {
        Ok(done) => done.map_err(|e| Problem::of(who, &e)),
        Err(_) => {
            let error = DeviceError::Timeout { device: device.to_owned(), operation, after };
            Err(Problem::of(who, &error))
        }
    }
}

/// Positions of actuators by name in the order of a hand.
fn in_order(hand: &HandInfo, names: &[String], positions: &[f64]) -> Result<Vec<f64>, Problem> {
    let of = |name: &String| names.iter().position(|n| n == name).and_then(|i| positions.get(i).copied());
    hand.actuators.iter().map(of).collect::<Option<_>>().ok_or_else(|| {
        let text = format!("actuators of a grasp: found {names:?}, expected {:?}", hand.actuators);
        Problem::broken(Who::Planner, text)
    })
}

/// How fast.
#[derive(Debug, Clone, Copy)]
pub(super) enum Pace {
    /// Through the air, empty.
    Travel,
    /// Among objects.
    Approach,
    /// Straight up with an object.
    Lift,
    /// With an object.
    Carry,
}

impl Run<'_> {
    /// Waits for a device; not for ever, whatever the device does.
    pub(super) async fn within<T>(
        &self,
        who: Who,
        device: &str,
        operation: &'static str,
        limit: Duration,
        call: impl Future<Output = Result<T, DeviceError>>,
    ) -> Result<T, Problem> {
        bounded(who, device, operation, limit, self.config.timeouts.patience, call).await
    }

    pub(super) fn limits(&self, pace: Pace) -> Limits {
        let arm = &self.config.arm;
        let speed_m_s = match pace {
            Pace::Travel => arm.speed_m_s,
            Pace::Approach => arm.approach_speed_m_s,
            Pace::Lift => arm.lift_speed_m_s,
            Pace::Carry => arm.carry_speed_m_s,
        };
        Limits { speed_m_s, acceleration_m_s2: arm.acceleration_m_s2 }
    }

    pub(super) async fn capture_frame(&self) -> Result<graspd_adapters_core::DepthFrame, Problem> {
        let (camera, limit) = (&self.cell.camera, seconds(self.config.timeouts.capture_s));
        let max_age = seconds(self.config.camera.max_age_s);
        let name = camera.info().name;
        let frame = self.within(Who::Camera, &name, "capture", limit, camera.capture(max_age, limit)).await?;
        let text = if frame.age > max_age {
            format!("{name}: a frame {:?} old, expected at most {max_age:?}", frame.age)
        } else if self.last_exposure == Some(frame.sequence) {
            format!("{name}: the exposure {} again, expected a new one", frame.sequence)
        } else {
            return Ok(frame);
        };
        Err(Problem { who: Who::Camera, trouble: Trouble::NoAnswer, text })
    }

    pub(super) async fn move_to(&self, pose: &Isometry3<f64>, pace: Pace) -> Result<(), Problem> {
        let (arm, limit) = (&self.cell.arm, seconds(self.config.timeouts.move_s));
        let call = arm.move_to(pose, self.limits(pace), limit);
        self.within(Who::Arm, &arm.info().name, "move_to", limit, call).await
    }

    pub(super) async fn move_linear(&self, pose: &Isometry3<f64>, pace: Pace) -> Result<(), Problem> {
        let (arm, limit) = (&self.cell.arm, seconds(self.config.timeouts.move_s));
        let call = arm.move_linear(pose, self.limits(pace), limit);
        self.within(Who::Arm, &arm.info().name, "move_linear", limit, call).await
    }

    /// Through the air, at the height of travel, to a pose. An arm among others goes on the straight lines that are reserved
    /// for it: over the pose, then down to it. Where there is none, as next to a singularity, it goes as its joints do: so does an
    /// arm by itself.
    pub(super) async fn through_air(&self, pose: &Isometry3<f64>, pace: Pace) -> Result<(), Problem> {
        if !self.led {
            return self.move_to(pose, pace).await;
        }
        let over = raised_to(pose, &self.facts.tool_point, self.places.travel_m);
        let is_over = (over.translation.vector - pose.translation.vector).norm() < 1e-3;
        for at in [Some(&over), (!is_over).then_some(pose)].into_iter().flatten() {
            match self.move_linear(at, pace).await {
                Err(problem) if problem.trouble == Trouble::OutOfReach => {
                    tracing::info!(text = problem.text, "no straight line: as the joints go");
                    self.move_to(at, pace).await?;
                }
                done => done?,
            }
        }
        Ok(())
    }

    /// Straight to a pose, or until the hand meets something.
    pub(super) async fn move_until_contact(&self, pose: &Isometry3<f64>) -> Result<Reached, Problem> {
        let (arm, limit) = (&self.cell.arm, seconds(self.config.timeouts.move_s));
        let force_n = self.config.motion.contact_force_n;
        let call = arm.move_until_contact(pose, self.limits(Pace::Approach), force_n, limit);
        self.within(Who::Arm, &arm.info().name, "move_until_contact", limit, call).await
    }

    /// Where the hand is.
    pub(super) async fn flange(&self) -> Result<Isometry3<f64>, Problem> {
        let (arm, limit) = (&self.cell.arm, seconds(self.config.timeouts.state_s));
        let state = self.within(Who::Arm, &arm.info().name, "state", limit, arm.state(limit)).await?;
        Ok(state.world_from_flange)
    }

    /// Straight up to the height of travel with an empty hand; not at all where that is out of reach.
    pub(super) async fn raise_empty(&self, pace: Pace) -> Result<(), Problem> {
        match self.raise(pace).await {
            Err(problem) if problem.trouble == Trouble::OutOfReach => Ok(()),
            done => done,
        }
    }

    /// Straight up to the height of travel.
    pub(super) async fn raise(&self, pace: Pace) -> Result<(), Problem> {
        let here = self.flange().await?;
        let up = raised_to(&here, &self.facts.tool_point, self.places.travel_m);
        if (up.translation.vector.z - here.translation.vector.z) < 1e-3 {
            return Ok(());
        }
        self.move_linear(&up, pace).await
    }

    pub(super) async fn stop_arm(&self) -> Result<(), Problem> {
        let (arm, limit) = (&self.cell.arm, seconds(self.config.timeouts.clear_s));
        self.within(Who::Arm, &arm.info().name, "stop", limit, arm.stop(limit)).await
    }

    /// Clears the fault of a device; those without one have nothing to clear.
    pub(super) async fn clear_fault(&self, who: Who) -> Result<(), Problem> {
        let limit = seconds(self.config.timeouts.clear_s);
        let (arm, hand) = (&self.cell.arm, &self.cell.hand);
        match who {
            Who::Arm => {
                self.within(who, &arm.info().name, "clear_fault", limit, arm.clear_fault(limit)).await
            }
            Who::Hand => {
                self.within(who, &hand.info().name, "clear_fault", limit, hand.clear_fault(limit)).await
            }
            Who::Camera | Who::Planner => Ok(()),
        }
    }

    /// Moves the fingers; `positions` are in the order of `names`.
    pub(super) async fn grip(&self, names: &[String], positions: &[f64]) -> Result<HandState, Problem> {
        let (hand, limit) = (&self.cell.hand, seconds(self.config.timeouts.grip_s));
        let info = hand.info();
        let actuators = in_order(&info, names, positions)?;
        let command = GripCommand { actuators, speed: self.config.hand.speed, force: self.config.hand.force };
        self.within(Who::Hand, &info.name, "grip", limit, hand.grip(&command, limit)).await
    }

    /// Moves the fingers where they may meet things: a hand that answers, and whose fingers only do not come to rest
    /// in time, has done what it could. What it holds is asked in another step.
    pub(super) async fn grip_against(
        &self,
        names: &[String],
        positions: &[f64],
    ) -> Result<HandState, Problem> {
        let gripped = self.grip(names, positions).await;
        self.or_answers(gripped).await
    }

    /// Closes the fingers on an object; see [`Run::grip_against`] for what is no trouble.
    pub(super) async fn close_hand(
        &self,
        grasp: &PlannedGrasp,
        squeezed: &[f64],
        farthest: &[f64],
    ) -> Result<HandState, Problem> {
        let (hand, limit) = (&self.cell.hand, seconds(self.config.timeouts.grip_s));
        let (info, settings) = (hand.info(), &self.config.hand);
        let list = |positions| in_order(&info, &grasp.actuators, positions);
        let command = CloseCommand {
            contact: list(&grasp.contact)?,
            squeezed: list(squeezed)?,
            farthest: list(farthest)?,
            meet: seconds(settings.meet_s),
            speed: settings.speed,
            force: settings.force,
        };
        let closed = self.within(Who::Hand, &info.name, "close", limit, hand.close(&command, limit)).await;
        self.or_answers(closed).await
    }

    async fn or_answers(&self, done: Result<HandState, Problem>) -> Result<HandState, Problem> {
        let problem = match done {
            Err(problem) if problem.trouble == Trouble::NoAnswer => problem,
            done => return done,
        };
        match self.hand_state().await {
            Ok(state) => {
                tracing::info!(text = problem.text, "the hand answers; going on");
                Ok(state)
            }
            Err(_) => Err(problem),
        }
    }

    pub(super) async fn hand_state(&self) -> Result<HandState, Problem> {
        let (hand, limit) = (&self.cell.hand, seconds(self.config.timeouts.state_s));
        self.within(Who::Hand, &hand.info().name, "state", limit, hand.state(limit)).await
    }

    /// Opens the hand as wide as it goes. A grasp may ask for less among objects, and fingers so far closed may not let
    /// go of what they hold.
    pub(super) async fn open_wide(&self) -> Result<HandState, Problem> {
        let (names, open) = self.wide_posture();
        self.grip(&names, &open).await
    }

    fn wide_posture(&self) -> (Vec<String>, Vec<f64>) {
        self.facts.actuators.iter().map(|a| (a.name.clone(), a.open)).unzip()
    }

    /// As the grasp asks, or wide where there is no grasp.
    pub(super) fn open_posture(&self) -> (Vec<String>, Vec<f64>) {
        match self.attempt.grasp() {
            Some((_, grasp)) => (grasp.actuators.clone(), grasp.open.clone()),
            None => self.wide_posture(),
        }
    }

    /// True when the hand feels an object. A hand without touch, or with fingers that still move, tells by fingers that
    /// are short of where they were told to go.
    pub(super) async fn feels(&self) -> Result<bool, Problem> {
        let info = self.cell.hand.info();
        let state = self.hand_state().await?;
        // Fingers that move or creep cannot say yet what holds them.
        if info.feels_contact && (state.settled || state.feels_object()) {
            return Ok(state.feels_object());
        }
        let Some((_, grasp)) = self.attempt.grasp() else { return Ok(false) };
        let told = self.attempt.told.as_ref().unwrap_or(&grasp.squeezed);
        Ok(info.actuators.iter().zip(&state.actuators).any(|(name, &found)| {
            let at = grasp.actuators.iter().position(|n| n == name);
            at.and_then(|i| Some((*grasp.open.get(i)?, *told.get(i)?))).is_some_and(|(open, told)| {
                let way = (told - open).abs();
                way > 1e-6 && (told - found).abs() > HELD_SHARE * way
            })
        }))
    }

    /// Sleeps, in slices, so that a request to end is heard.
    pub(super) async fn pause(&self, wait: Duration) {
        let until = tokio::time::Instant::now() + wait;
        while tokio::time::Instant::now() < until && !self.observer.wants_end() {
            let slice = tokio::time::Instant::now() + Duration::from_millis(250);
            tokio::time::sleep_until(slice.min(until)).await;
        }
    }
}
