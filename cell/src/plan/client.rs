//! The planner over gRPC: the only place that knows the protocol's messages.

use std::time::Duration;

use async_trait::async_trait;
use graspd_client::{
    CameraIntrinsics, Client, ClientConfig, ClientError, Code, HandTask, MultiHandEvent, PlanGraspsRequest,
    PlanMultiHandRequest, PlanOptions, SceneOptions, depth_frame_u16, wire,
};
use nalgebra::{Unit, Vector3};
use tokio::sync::Mutex;

use super::servo_client::RemoteServo;
use super::{
    ActuatorFacts, Answer, BoxRecord, EmptyReason, GraspPlanner, GraspServo, HandFacts, NoGrasp,
    PlannedGrasp, PlannerError, Question, ReachingChoice, ServoQuestion,
};
use crate::frame::{DEPTH_SCALE_M, Frame};
use crate::pose::PoseRecord;

/// How long one try to connect may take.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(2);

/// A planner at an address. It connects with the first question, and again whenever the connection was lost.
#[derive(Debug)]
pub struct PlannerClient {
    config: ClientConfig,
    client: Mutex<Option<Client>>,
}

impl PlannerClient {
    /// A planner at an endpoint, for example `http://127.0.0.1:50051`.
    pub fn new(endpoint: &str) -> Self {
        let endpoint =
            if endpoint.contains("://") { endpoint.to_owned() } else { format!("http://{endpoint}") };
        let config = ClientConfig { connect_timeout: CONNECT_TIMEOUT, ..ClientConfig::new(endpoint) };
        Self { config, client: Mutex::default() }
    }

    async fn client(&self, timeout: Duration) -> Result<Client, PlannerError> {
        let mut slot = self.client.lock().await;
        if let Some(client) = &*slot {
            return Ok(client.with_timeout(timeout));
        }
        let connecting = Client::connect(self.config.clone());
        let client = tokio::time::timeout(timeout, connecting)
            .await
            .map_err(|_| PlannerError::Away(format!("no connection to {}", self.config.endpoint)))?
            .map_err(|e| PlannerError::Away(e.to_string()))?;
        *slot = Some(client.clone());
        Ok(client.with_timeout(timeout))
    }
}

#[async_trait]
impl GraspPlanner for PlannerClient {
    async fn hand(&self, id: &str, timeout: Duration) -> Result<HandFacts, PlannerError> {
        let hand = self.client(timeout).await?.get_hand(&format!("hands/{id}")).await.map_err(error)?;
        let approach = Unit::try_new(vector(hand.approach.as_ref(), "approach")?, 1e-6)
            .ok_or_else(|| broken("a hand whose approach has no length"))?;
        Ok(HandFacts {
            id: id.to_owned(),
            revision: hand.revision.clone(),
            approach,
            lateral: vector(hand.lateral_axis.as_ref(), "lateral_axis")?,
            tool_point: vector(hand.tool_point.as_ref(), "tool_point")?,
            actuators: hand
                .actuators
                .iter()
                .map(|a| ActuatorFacts {
                    name: a.name.clone(),
                    open: a.open_position,
                    closed: a.closed_position,
                    limits: [a.min_position, a.max_position],
                })
                .collect(),
            fingers: hand.fingers.len(),
        })
    }

    async fn plan(
        &self,
        frame: &Frame,
        question: &Question,
        timeout: Duration,
    ) -> Result<Answer, PlannerError> {
        let request = request(frame, question)?;
        let response = self.client(timeout).await?.plan_grasps(&request).await.map_err(error)?;
        answer(response)
    }

    async fn servo(
        &self,
        asked: &ServoQuestion,
        timeout: Duration,
    ) -> Result<Box<dyn GraspServo>, PlannerError> {
        let client = self.client(timeout).await?;
        Ok(Box::new(RemoteServo::begin(&client, asked).await?))
    }

    async fn plan_together(
        &self,
        frame: &Frame,
        questions: &[Question],
        timeout: Duration,
    ) -> Result<Vec<Answer>, PlannerError> {
        let Some(first) = questions.first() else { return Ok(Vec::new()) };
        let alike = |q: &Question| {
            (&q.workspace, &q.region, &q.estimator) == (&first.workspace, &first.region, &first.estimator)
        };
        if !questions.iter().all(alike) {
            return Err(PlannerError::Refused("questions that read the scene differently".to_owned()));
        }
        let PlanGraspsRequest { frames, scene_options, .. } = request(frame, first)?;
        let task = |(i, question): (usize, &Question)| HandTask {
            task_id: i.to_string(),
            hand: format!("hands/{}", question.hand),
            options: Some(plan_options(question)),
        };
        let tasks = questions.iter().enumerate().map(task).collect();
        let request =
            PlanMultiHandRequest { frames, scene_options, tasks, ..PlanMultiHandRequest::default() };
        let mut stream = self.client(timeout).await?.plan_multi_hand(&request).await.map_err(error)?;
        let mut answers: Vec<Option<Answer>> = vec![None; questions.len()];
        while let Some(event) = stream.next().await.map_err(error)? {
            let MultiHandEvent::Result(result) = event else { break };
            let slot = result.task_id.parse().ok().and_then(|i: usize| answers.get_mut(i));
            let slot = slot.ok_or_else(|| broken("a task that nobody asked for"))?;
            *slot = Some(match result.outcome {
                Some(wire::hand_task_result::Outcome::Response(response)) => answer(response)?,
                Some(wire::hand_task_result::Outcome::Error(e)) => return Err(task_error(&e)),
                None => return Err(broken("a task without an outcome")),
            });
        }
        answers.into_iter().collect::<Option<_>>().ok_or_else(|| broken("not every hand"))
    }
}

/// What a failed task means for all.
fn task_error(error: &wire::TaskError) -> PlannerError {
    let text = format!("{}: {}", error.reason, error.message);
    match Code::from(error.code) {
        Code::Unavailable | Code::ResourceExhausted | Code::Cancelled => PlannerError::Away(text),
        Code::InvalidArgument | Code::NotFound | Code::FailedPrecondition | Code::OutOfRange => {
            PlannerError::Refused(text)
        }
        _ => PlannerError::Failed(text),
    }
}

pub(super) fn error(error: ClientError) -> PlannerError {
    let text = error.to_string();
    match error.call().map(|call| call.code) {
        None => PlannerError::Away(text),
        // A connection that breaks under a call has many names.
        Some(Code::Unavailable | Code::ResourceExhausted | Code::Cancelled | Code::Unknown) => {
            PlannerError::Away(text)
        }
        Some(
            Code::InvalidArgument
            | Code::NotFound
            | Code::FailedPrecondition
            | Code::Unimplemented
            | Code::PermissionDenied
            | Code::Unauthenticated
            | Code::OutOfRange,
        ) => PlannerError::Refused(text),
        Some(_) => PlannerError::Failed(text),
    }
}

pub(super) fn broken(what: &str) -> PlannerError {
    PlannerError::Failed(format!("the server answered {what}"))
}

fn vector(v: Option<&wire::Vector3>, field: &str) -> Result<Vector3<f64>, PlannerError> {
    v.map(|v| Vector3::new(v.x, v.y, v.z)).ok_or_else(|| broken(&format!("without {field}")))
}

fn vector_message(v: [f64; 3]) -> wire::Vector3 {
    wire::Vector3 { x: v[0], y: v[1], z: v[2] }
}

pub(super) fn pose_message(pose: &PoseRecord) -> wire::Pose {
    let [x, y, z, w] = pose.orientation_xyzw;
    wire::Pose {
        position: Some(vector_message(pose.position_m)),
        orientation: Some(wire::Quaternion { x, y, z, w }),
    }
}

pub(super) fn request(frame: &Frame, question: &Question) -> Result<PlanGraspsRequest, PlannerError> {
    let info = &frame.info;
    let rectified = info.distortion == [0.0; 8];
    let intrinsics = CameraIntrinsics {
        fx_px: info.fx,
        fy_px: info.fy,
        cx_px: info.cx,
        cy_px: info.cy,
        distortion: if rectified { Vec::new() } else { info.distortion.to_vec() },
    };
    let pose = frame.world_from_camera().map_err(|e| PlannerError::Refused(e.to_string()))?;
    let side = |n: u32| i32::try_from(n).unwrap_or(i32::MAX);
    let mut message =
        depth_frame_u16(side(info.width), side(info.height), DEPTH_SCALE_M, &frame.millimetres, intrinsics);
    message.camera_pose = Some(wire::PoseInFrame {
        frame_id: "world".to_owned(),
        pose: Some(pose_message(&PoseRecord::from(&pose))),
    });
    Ok(PlanGraspsRequest {
        hand: format!("hands/{}", question.hand),
        frames: vec![message],
        scene_options: Some(scene_options(question)),
        options: Some(plan_options(question)),
        ..PlanGraspsRequest::default()
    })
}

pub(super) fn scene_options(question: &Question) -> SceneOptions {
    SceneOptions {
        estimator: question.estimator.clone(),
        workspace: Some(wire::WorkspacePlacement {
            pose: Some(pose_message(&question.workspace.pose)),
            table_height_m: question.workspace.table_height_m,
        }),
        volume_size_m: Some(question.workspace.size_m),
        grasp_region: question.region.as_ref().map(|region| wire::GraspRegion {
            pose: Some(pose_message(&region.pose)),
            half_extents_m: Some(vector_message(region.half_extents_m)),
        }),
        ..SceneOptions::default()
    }
}

pub(super) fn plan_options(question: &Question) -> PlanOptions {
    let count = |n: u32| i32::try_from(n).unwrap_or(i32::MAX);
    let reaching = match question.reaching {
        ReachingChoice::TopDown => wire::Reaching::TopDown,
        ReachingChoice::CameraRay => wire::Reaching::CameraRay,
        ReachingChoice::Free => wire::Reaching::Free,
    };
    PlanOptions {
        batch_size: count(question.batch),
        scheme: Some(wire::Scheme {
            iteration_count: count(question.scheme[0]),
            penetration_iteration_count: count(question.scheme[1]),
        }),
        reaching: reaching.into(),
        keep_out_boxes: question.keep_out.iter().map(keep_out).collect(),
        orientation_limits: question
            .max_tilt_rad
            .map(|angle| wire::OrientationLimits { max_tilt_rad: Some(angle), roll: None }),
        seed: question.seed,
        max_grasp_count: count(question.max_grasps),
        min_score: Some(question.min_score),
        friction: Some(question.friction),
        pregrasp_offset_m: Some(question.pregrasp_offset_m),
        ..PlanOptions::default()
    }
}

fn keep_out(record: &BoxRecord) -> wire::KeepOutBox {
    wire::KeepOutBox {
        pose: Some(pose_message(&record.pose)),
        half_extents_m: Some(vector_message(record.half_extents_m)),
    }
}

fn answer(response: wire::PlanGraspsResponse) -> Result<Answer, PlannerError> {
    let stats = response.stats.ok_or_else(|| broken("without stats"))?;
    let grasps = response.grasps.iter().map(grasp).collect::<Result<Vec<_>, _>>()?;
    let no_grasp =
        response.no_grasp.map(|why| NoGrasp { reason: reason(why.reason()), nearest_fix: why.nearest_fix });
    if grasps.is_empty() == no_grasp.is_none() {
        return Err(broken("neither grasps nor why there is none"));
    }
    let plan_s = stats.total_duration.map_or(0.0, |d| d.seconds as f64 + f64::from(d.nanos) * 1e-9);
    Ok(Answer {
        grasps,
        no_grasp,
        rejected: stats.rejected_counts.into_iter().collect(),
        plan_s,
        hand_revision: stats.hand_revision,
        estimator: stats.estimator,
    })
}

fn reason(reason: wire::NoGraspReason) -> EmptyReason {
    use wire::NoGraspReason as R;
    match reason {
        R::NothingSeen => EmptyReason::NothingSeen,
        R::EmptyTable => EmptyReason::EmptyTable,
        R::NoContacts => EmptyReason::NoContacts,
        R::NoCentroid => EmptyReason::NoCentroid,
        R::TargetNotFound => EmptyReason::TargetNotFound,
        R::HandTooSmall => EmptyReason::HandTooSmall,
        R::HandTooLarge => EmptyReason::HandTooLarge,
        R::AllRejected => EmptyReason::AllRejected,
        R::OutOfTime => EmptyReason::OutOfTime,
        R::Unspecified => EmptyReason::Other,
    }
}

pub(super) fn grasp(grasp: &wire::Grasp) -> Result<PlannedGrasp, PlannerError> {
    let actuators = grasp.actuators.as_ref().ok_or_else(|| broken("a grasp without actuators"))?;
    let centroid = vector(grasp.centroid.as_ref(), "centroid")?;
    Ok(PlannedGrasp {
        world_from_pregrasp: pose(grasp.pregrasp_pose.as_ref(), "pregrasp_pose")?,
        world_from_hand: pose(grasp.wrist_pose.as_ref(), "wrist_pose")?,
        actuators: actuators.names.clone(),
        open: actuators.open.clone(),
        contact: actuators.contact.clone(),
        squeezed: actuators.squeezed.clone(),
        centroid_m: centroid.into(),
        score: grasp.score,
        epsilon: grasp.epsilon,
        clearance_m: grasp.clearance_m,
    })
}

pub(super) fn pose(message: Option<&wire::PoseInFrame>, field: &str) -> Result<PoseRecord, PlannerError> {
    let missing = || broken(&format!("a grasp without {field}"));
    let pose = message.and_then(|m| m.pose.as_ref()).ok_or_else(missing)?;
    let q = pose.orientation.as_ref().ok_or_else(missing)?;
    let position = vector(pose.position.as_ref(), field)?;
    // What an arm is sent must be a pose.
    let norm = (q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w).sqrt();
    let unit = (norm - 1.0).abs() < 1e-3;
    if !unit || !position.iter().all(|x| x.is_finite()) {
        return Err(broken(&format!("a grasp whose {field} is no pose")));
    }
    Ok(PoseRecord {
        position_m: position.into(),
        orientation_xyzw: [q.x / norm, q.y / norm, q.z / norm, q.w / norm],
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::TrayConfig;

    fn question() -> Question {
        let tray = TrayConfig { yaw_rad: 0.3, ..TrayConfig::default() };
        Question {
            hand: "leap".to_owned(),
            seed: 7,
            reaching: ReachingChoice::TopDown,
            max_tilt_rad: None,
            workspace: tray.workspace(),
            region: Some(tray.region()),
            keep_out: tray.walls(),
            estimator: String::new(),
            batch: 48,
            scheme: [200, 40],
            max_grasps: 10,
            min_score: 0.0,
            friction: 0.5,
            pregrasp_offset_m: 0.1,
        }
    }

    #[test]
    fn the_planner_is_told_of_every_wall() {
        let question = question();
        let boxes = plan_options(&question).keep_out_boxes;
        assert_eq!(boxes.len(), 4);
        for (message, record) in boxes.iter().zip(&question.keep_out) {
            assert_eq!(message.pose, Some(pose_message(&record.pose)));
            let half = message.half_extents_m.as_ref().unwrap();
            assert_eq!([half.x, half.y, half.z], record.half_extents_m);
            assert!(record.half_extents_m.iter().all(|x| *x > 0.0));
        }
    }

    #[test]
    fn a_record_of_an_older_run_has_no_walls_and_is_read() {
        let mut old = serde_json::to_value(question()).unwrap();
        old.as_object_mut().unwrap().remove("keep_out");
        let read: Question = serde_json::from_value(old).unwrap();
        assert_eq!(read, Question { keep_out: Vec::new(), ..question() });
        let again = question().as_recorded().unwrap();
        assert_eq!(again.as_recorded().unwrap(), again);
    }
}
