//! Servo streams from and to the wire.

use std::time::Duration;

use graspd_hands::Hand;
use graspd_planner::options::Scheme;
use graspd_planner::servo::{Answer, Counters, HandNow, Loss, Mode, Replan, ServoOptions, State};
use graspd_proto::v1;

use super::geometry::{pose, pose_message};
use super::grasp::grasp_message;
use super::options::{plan_options, scene_options};
use super::{EncodedFrame, PlanContext, count, duration_message, hand_id, join, known_enum, number_within};
use crate::calibration::Calibration;
use crate::error::FieldError;

/// Most joints that a hand's posture may have; the hand itself decides how many it must have.
const MOST_JOINTS: usize = 256;

/// A checked configuration.
#[derive(Debug, Clone)]
pub(crate) struct ServoRequest {
    /// The hand's id.
    pub(crate) hand_id: String,
    /// Estimator by name; `None`: the server's default.
    pub(crate) estimator: Option<String>,
    /// How the grasp is followed.
    pub(crate) options: ServoOptions,
}

/// Reads the first message of a stream.
pub(crate) fn servo_config(wire: v1::ServoConfig) -> Result<ServoRequest, FieldError> {
    let at = |name: &str| join("config", name);
    let hand_id = hand_id(&wire.hand, &at("hand"))?;
    let (scene, estimator) = scene_options(wire.scene_options, &at("scene_options"))?;
    let mode = match known_enum(wire.mode, &at("mode"))? {
        v1::ServoMode::Unspecified | v1::ServoMode::Dynamic => Mode::Dynamic,
        v1::ServoMode::Static => Mode::Static,
    };
    let defaults = match mode {
        Mode::Dynamic => ServoOptions::default(),
        Mode::Static => ServoOptions::of_first_frame(),
    };
    let told = wire.options.as_ref();
    let has_batch = told.is_some_and(|o| o.batch_size != 0);
    let has_offset = told.is_some_and(|o| o.pregrasp_offset_m.is_some());
    let asked = plan_options(wire.options, &at("options"))?;
    let mut options = ServoOptions { mode, scene, ..defaults };
    let (batch, scheme): (usize, Scheme) = (options.plan.batch, options.plan.scheme);
    options.plan = asked.options;
    options.plan.trace = false;
    if !has_batch {
        options.plan.batch = batch;
    }
    if !asked.scheme_is_fixed {
        options.plan.scheme = scheme;
    }
    options.iterations =
        count(wire.iterations_per_frame, options.iterations, 100, &at("iterations_per_frame"))?;
    let within = |value, default, range, name: &str| number_within(value, default, range, &at(name));
    let s = options.standoff;
    options.standoff.start_m = within(wire.standoff_start_m, s.start_m, (0.01, 0.5), "standoff_start_m")?;
    let start_m = options.standoff.start_m;
    options.standoff.end_m =
        within(wire.standoff_end_m, s.end_m.min(start_m), (0.0, start_m), "standoff_end_m")?;
    options.standoff.speed_m_s =
        within(wire.standoff_speed_m_s, s.speed_m_s, (0.001, 1.0), "standoff_speed_m_s")?;
    let b = options.bounds;
    options.bounds.translation_m = within(wire.max_change_m, b.translation_m, (0.0001, 0.1), "max_change_m")?;
    options.bounds.rotation_rad =
        within(wire.max_change_rad, b.rotation_rad, (0.001, 3.2), "max_change_rad")?;
    let c = options.camera;
    options.camera.speed_m_s =
        within(wire.camera_max_speed_m_s, c.speed_m_s, (0.01, 100.0), "camera_max_speed_m_s")?;
    options.camera.turn_rad_s =
        within(wire.camera_max_turn_rad_s, c.turn_rad_s, (0.01, 1000.0), "camera_max_turn_rad_s")?;
    if !has_offset {
        options.plan.pregrasp_offset_m = options.standoff.start_m;
    }
    options.hand_from_camera =
        wire.hand_from_camera.as_ref().map(|p| pose(Some(p), &at("hand_from_camera"))).transpose()?;
    // A window is never larger than the volume that it is a part of.
    options.window_voxels = options.window_voxels.min(options.scene.grid.resolution / 8 * 8);
    options.validate().map_err(|e| FieldError::value(at(e.field), e.found, e.expected))?;
    Ok(ServoRequest { hand_id, estimator, options })
}

/// A frame of a stream whose pixels are still encoded.
#[derive(Debug, Clone)]
pub(crate) struct EncodedServoFrame {
    /// Its number.
    pub(crate) sequence: u64,
    /// The frame.
    pub(crate) frame: EncodedFrame,
    /// Where the hand was.
    pub(crate) hand: Option<HandNow>,
}

impl EncodedServoFrame {
    /// Checks a frame.
    pub(crate) fn parse(wire: v1::ServoFrame) -> Result<Self, FieldError> {
        let frame = wire.frame.ok_or_else(|| FieldError::missing("frame.frame", "a depth frame"))?;
        let frame = EncodedFrame::parse(frame, "frame.frame".to_owned())?;
        if frame.world_from_camera.is_none() {
            return Err(FieldError::missing("frame.frame.camera_pose", "a pose on every frame of a servo"));
        }
        let hand = wire.hand.map(hand_now).transpose()?;
        Ok(Self { sequence: wire.sequence, frame, hand })
    }

    /// The frame, if the posture that it tells is one of a hand with so many joints.
    pub(crate) fn of_hand(self, joints: usize) -> Result<Self, FieldError> {
        let told = self.hand.as_ref().map_or(0, |hand| hand.joints.len());
        if told != 0 && told != joints {
            let expected = format!("{joints} positions in the order of Hand.joints, or none");
            return Err(FieldError::value(
                "frame.hand.joint_positions",
                format!("{told} positions"),
                expected,
            ));
        }
        Ok(self)
    }

    /// When it was taken, where it says so: time since the epoch of the caller's clock.
    pub(crate) fn captured(&self) -> Option<Duration> {
        let stamp = self.frame.capture_time?;
        let (seconds, nanos) = (u64::try_from(stamp.seconds).ok()?, u32::try_from(stamp.nanos).ok()?);
        (nanos < 1_000_000_000).then(|| Duration::new(seconds, nanos))
    }
}

fn hand_now(wire: v1::HandPosture) -> Result<HandNow, FieldError> {
    let world_from_hand = pose(wire.wrist_pose.as_ref(), "frame.hand.wrist_pose")?;
    let path = "frame.hand.joint_positions";
    if wire.joint_positions.len() > MOST_JOINTS {
        let found = format!("{} joints", wire.joint_positions.len());
        return Err(FieldError::value(path, found, format!("at most {MOST_JOINTS}")));
    }
    if let Some(bad) = wire.joint_positions.iter().find(|q| !q.is_finite()) {
        return Err(FieldError::value(path, bad, "finite positions"));
    }
    Ok(HandNow { world_from_hand, joints: wire.joint_positions })
}

/// What an answer is made of besides the planner's.
#[derive(Debug)]
pub(crate) struct ServoWords<'a> {
    /// The hand.
    pub(crate) hand: &'a Hand,
    /// Name of the world frame.
    pub(crate) world: &'a str,
    /// Name of the optical frame.
    pub(crate) camera: &'a str,
    /// As sent with the frame.
    pub(crate) capture_time: Option<prost_types::Timestamp>,
    /// Since the frame's arrival.
    pub(crate) age: Duration,
    /// Frames replaced before they were looked at.
    pub(crate) superseded: u64,
    /// Frames that could not be read.
    pub(crate) unreadable: u64,
    /// Frames for which there was no room.
    pub(crate) shed: u64,
    /// Why the last refused frame was.
    pub(crate) refused: String,
    /// What scores become.
    pub(crate) calibration: Option<&'a Calibration>,
}

/// The answer to a frame.
pub(crate) fn servo_answer(answer: &Answer, words: ServoWords<'_>) -> v1::ServoGraspResponse {
    let context = PlanContext {
        hand: words.hand,
        world: words.world,
        camera: words.camera,
        capture_time: words.capture_time,
        estimator: "",
        seed: 0,
        // A stream is no plan whose outcome could be reported.
        plan_id: "",
        calibration: words.calibration,
        stages: &[],
        invalid_pixels: 0,
        queued: Duration::ZERO,
        elapsed: words.age,
    };
    let (state, reason) = state_message(answer.state);
    v1::ServoGraspResponse {
        sequence: answer.sequence,
        capture_time: words.capture_time,
        age: Some(duration_message(words.age)),
        state: state.into(),
        reason: reason.to_owned(),
        grasp: answer.grasp.as_ref().map(|g| grasp_message(g, &context)),
        settled: answer.is_settled,
        change_m: answer.change.translation_m,
        change_rad: answer.change.rotation_rad,
        standoff_m: answer.standoff_m,
        standoff_pose: answer.world_from_standoff.as_ref().map(|p| pose_message(words.world, p)),
        go: answer.go,
        visible_share: answer.visible,
        counters: Some(counters_message(&answer.counters, &words)),
        refused: words.refused,
        stages: answer
            .stages
            .iter()
            .map(|&(name, took)| v1::StageDuration {
                name: name.to_owned(),
                duration: Some(duration_message(took)),
            })
            .collect(),
    }
}

fn state_message(state: State) -> (v1::ServoState, &'static str) {
    match state {
        State::Tracking => (v1::ServoState::Tracking, ""),
        State::Replanning(why) => (v1::ServoState::Replanning, Replan::as_str(why)),
        State::Lost(why) => (v1::ServoState::Lost, Loss::as_str(why)),
    }
}

fn counters_message(counters: &Counters, words: &ServoWords<'_>) -> v1::ServoCounters {
    v1::ServoCounters {
        answered_count: counters.answered,
        superseded_count: words.superseded,
        late_count: counters.late,
        repeated_count: counters.repeated,
        wild_count: counters.wild,
        invalid_count: counters.invalid + words.unreadable,
        shed_count: words.shed,
        replanned_count: counters.replanned,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(edit: impl FnOnce(&mut v1::ServoConfig)) -> Result<ServoRequest, FieldError> {
        let mut wire = v1::ServoConfig { hand: "hands/leap".to_owned(), ..Default::default() };
        edit(&mut wire);
        servo_config(wire)
    }

    #[test]
    fn unset_takes_the_servos_own_defaults() {
        let asked = config(|_| ()).unwrap();
        assert_eq!(asked.options, ServoOptions::default());
        assert_eq!((asked.hand_id.as_str(), asked.estimator), ("leap", None));
        let asked = config(|c| c.mode = v1::ServoMode::Static.into()).unwrap();
        assert_eq!(asked.options, ServoOptions::of_first_frame());
        // What is asked of the plan changes nothing else.
        let asked =
            config(|c| c.options = Some(v1::PlanOptions { batch_size: 7, ..Default::default() })).unwrap();
        let d = ServoOptions::default();
        assert_eq!((asked.options.plan.batch, asked.options.plan.scheme), (7, d.plan.scheme));
        let asked = config(|c| c.standoff_start_m = Some(0.2)).unwrap();
        assert_eq!(asked.options.plan.pregrasp_offset_m, 0.2);
    }

    #[test]
    fn what_is_out_of_range_is_named() {
        type Edit = fn(&mut v1::ServoConfig);
        let cases: [(Edit, &str); 7] = [
            (|c| c.hand.clear(), "config.hand"),
            (|c| c.mode = 9, "config.mode"),
            (|c| c.iterations_per_frame = -1, "config.iterations_per_frame"),
            (|c| c.standoff_end_m = Some(0.3), "config.standoff_end_m"),
            (|c| c.max_change_m = Some(f64::NAN), "config.max_change_m"),
            (|c| c.hand_from_camera = Some(v1::Pose::default()), "config.hand_from_camera.position"),
            (
                |c| c.options = Some(v1::PlanOptions { batch_size: -3, ..Default::default() }),
                "config.options.batch_size",
            ),
        ];
        for (edit, field) in cases {
            assert_eq!(config(edit).unwrap_err().field, field);
        }
        let error = EncodedServoFrame::parse(v1::ServoFrame::default()).unwrap_err();
        assert_eq!(error.field, "frame.frame");
    }
}
