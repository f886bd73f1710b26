//! A servo stream over gRPC.

use std::time::Duration;

use async_trait::async_trait;
use graspd_client::{Client, ServoStream, wire};
use prost_types::Timestamp;

use super::client::{broken, error, grasp, plan_options, pose, pose_message, request, scene_options};
use super::servo::{GraspServo, ServoAnswer, ServoFrame, ServoQuestion, ServoState};
use super::{PlannerError, Question};
use crate::config::{ServoConfig, ServoMode};
use crate::pose::PoseRecord;

/// A stream to a server.
#[derive(Debug)]
pub(super) struct RemoteServo {
    stream: ServoStream,
    question: Question,
}

impl RemoteServo {
    pub(super) async fn begin(client: &Client, asked: &ServoQuestion) -> Result<Self, PlannerError> {
        let stream = client.servo_grasp(config(asked)).await.map_err(error)?;
        Ok(Self { stream, question: asked.question.clone() })
    }
}

#[async_trait]
impl GraspServo for RemoteServo {
    async fn send(&mut self, frame: ServoFrame<'_>) -> Result<(), PlannerError> {
        let mut frames = request(frame.frame, &self.question)?.frames;
        let mut message = frames.pop().ok_or_else(|| broken("no frame to send"))?;
        message.capture_time = frame.captured.map(|at| Timestamp {
            seconds: i64::try_from(at.as_secs()).unwrap_or(i64::MAX),
            nanos: i32::try_from(at.subsec_nanos()).unwrap_or(0),
        });
        let hand = wire::HandPosture {
            wrist_pose: Some(pose_message(&PoseRecord::from(frame.world_from_hand))),
            joint_positions: frame.joints.to_vec(),
        };
        let message = wire::ServoFrame { sequence: frame.sequence, frame: Some(message), hand: Some(hand) };
        match self.stream.send(message).await {
            Ok(()) => Ok(()),
            // Why it has ended is told on the other side.
            Err(_) => match self.stream.next().await {
                Err(why) => Err(error(why)),
                Ok(_) => Err(PlannerError::Away("the servo stream has ended".to_owned())),
            },
        }
    }

    async fn next(&mut self) -> Result<ServoAnswer, PlannerError> {
        match self.stream.next().await {
            Ok(Some(response)) => answer(response),
            Ok(None) => Err(PlannerError::Away("the servo stream has ended".to_owned())),
            Err(why) => Err(error(why)),
        }
    }
}

fn config(asked: &ServoQuestion) -> wire::ServoConfig {
    let ServoConfig {
        mode,
        iterations,
        standoff_start_m,
        standoff_end_m,
        standoff_speed_m_s,
        hand_from_camera,
        ..
    } = &asked.servo;
    let mode = match mode {
        ServoMode::Dynamic => wire::ServoMode::Dynamic,
        ServoMode::Static => wire::ServoMode::Static,
    };
    wire::ServoConfig {
        hand: format!("hands/{}", asked.question.hand),
        scene_options: Some(scene_options(&asked.question)),
        options: Some(plan_options(&asked.question)),
        mode: mode.into(),
        iterations_per_frame: i32::try_from(*iterations).unwrap_or(i32::MAX),
        standoff_start_m: Some(*standoff_start_m),
        standoff_end_m: Some(*standoff_end_m),
        standoff_speed_m_s: Some(*standoff_speed_m_s),
        hand_from_camera: hand_from_camera.as_ref().map(pose_message),
        ..wire::ServoConfig::default()
    }
}

fn answer(response: wire::ServoGraspResponse) -> Result<ServoAnswer, PlannerError> {
    let state = match response.state() {
        wire::ServoState::Tracking => ServoState::Tracking,
        wire::ServoState::Replanning => ServoState::Replanning,
        wire::ServoState::Lost => ServoState::Lost,
        wire::ServoState::Unspecified => return Err(broken("a servo's answer without a state")),
    };
    let open_joints = response.grasp.as_ref().and_then(|g| g.joints.as_ref()).map(|j| j.open.clone());
    let standoff = response.standoff_pose.as_ref().map(|p| pose(Some(p), "standoff_pose")).transpose()?;
    let age = response.age.map_or(Duration::ZERO, |age| {
        Duration::new(u64::try_from(age.seconds).unwrap_or(0), u32::try_from(age.nanos).unwrap_or(0))
    });
    let c = response.counters.unwrap_or_default();
    Ok(ServoAnswer {
        sequence: response.sequence,
        age,
        state,
        reason: response.reason,
        grasp: response.grasp.as_ref().map(grasp).transpose()?,
        open_joints: open_joints.unwrap_or_default(),
        world_from_standoff: standoff,
        standoff_m: response.standoff_m,
        go: response.go,
        replanned: c.replanned_count,
        unanswered: c.superseded_count
            + c.late_count
            + c.repeated_count
            + c.wild_count
            + c.invalid_count
            + c.shed_count,
        refused: response.refused,
    })
}
