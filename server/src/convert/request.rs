//! Whole requests from the wire: one scene, and one job for each hand.

use std::collections::BTreeSet;
use std::time::Duration;

use graspd_planner::options::{PlanOptions, SceneOptions, Target};
use graspd_proto::v1;

use super::options::{Asked, plan_options, scene_options};
use super::{AssignmentJob, EncodedFrame, hand_id, join, known_enum, quoted};
use crate::decode::MAX_PIXELS;
use crate::error::{FieldError, FieldReason};
use crate::pool::Priority;

/// At most this many frames make a scene.
const MOST_FRAMES: usize = 16;
/// At most this many hands in a request.
const MOST_TASKS: usize = 16;

/// A checked scene whose pixels are still encoded.
#[derive(Debug, Clone)]
pub(crate) struct SceneRequest {
    /// Where the scene is in the request: empty, or for example `plan`.
    path: String,
    /// One or several frames of one moment.
    pub(crate) frames: Vec<EncodedFrame>,
    /// How they are read.
    pub(crate) options: SceneOptions,
    /// Estimator by name; `None`: the server's default.
    pub(crate) estimator: Option<String>,
}

/// What to do for one hand.
#[derive(Debug, Clone)]
pub(crate) struct HandJob {
    /// The caller's name for it; empty for a request with one hand.
    pub(crate) task_id: String,
    /// The hand's id.
    pub(crate) hand_id: String,
    /// How grasps are searched.
    pub(crate) options: PlanOptions,
    /// Stop after this.
    pub(crate) budget: Option<Duration>,
    /// The caller named the scheme; else the deadline picks one.
    pub(crate) scheme_is_fixed: bool,
    /// Less than the whole search is no answer.
    pub(crate) require_complete: bool,
    /// How urgent it is.
    pub(crate) priority: Priority,
}

impl HandJob {
    fn new(task_id: String, hand_id: String, asked: Asked) -> Self {
        let Asked { options, budget, scheme_is_fixed, require_complete, priority } = asked;
        Self { task_id, hand_id, options, budget, scheme_is_fixed, require_complete, priority }
    }
}

/// Longest id of a request, bytes.
const LONGEST_REQUEST_ID: usize = 128;

/// The id of a request at `path`, if it has one.
fn request_id(id: String, path: &str) -> Result<Option<String>, FieldError> {
    if id.len() > LONGEST_REQUEST_ID {
        let expected = format!("at most {LONGEST_REQUEST_ID} bytes");
        return Err(FieldError::value(join(path, "request_id"), quoted(&id), expected));
    }
    Ok(Some(id).filter(|id| !id.is_empty()))
}

/// Voxels of a scene of the default size: 80 along each edge.
const VOXELS_OF_A_ROOM: usize = 80 * 80 * 80;
/// Pixels that take about as much memory while they are read as a scene of the default size.
const PIXELS_OF_A_ROOM: usize = 2 << 20;

impl SceneRequest {
    /// Room that the scene takes in memory, in scenes of the default size.
    pub(crate) fn room(&self) -> usize {
        let voxels = self.options.grid.len();
        voxels.div_ceil(VOXELS_OF_A_ROOM) + self.pixel_count() / PIXELS_OF_A_ROOM
    }

    /// True if both make the same scene: what only names things (frames of reference, times) does not count.
    pub(crate) fn is_same_scene(&self, other: &Self) -> bool {
        self.options == other.options
            && self.frames.len() == other.frames.len()
            && self.frames.iter().zip(&other.frames).all(|(a, b)| a.is_same_view(b))
    }

    /// Pixels of all frames.
    pub(crate) fn pixel_count(&self) -> usize {
        self.frames.iter().map(EncodedFrame::pixel_count).sum()
    }

    fn parse(
        frames: Vec<v1::DepthFrame>,
        options: Option<v1::SceneOptions>,
        path: &str,
    ) -> Result<Self, FieldError> {
        let frames_path = join(path, "frames");
        if frames.is_empty() {
            return Err(FieldError::missing(frames_path, "at least one depth frame"));
        }
        if frames.len() > MOST_FRAMES {
            return Err(FieldError::value(
                frames_path,
                format!("{} frames", frames.len()),
                format!("at most {MOST_FRAMES} frames"),
            ));
        }
        let frames = (frames.into_iter().enumerate())
            .map(|(i, frame)| EncodedFrame::parse(frame, format!("{frames_path}[{i}]")))
            .collect::<Result<Vec<_>, _>>()?;
        check_pixel_count(&frames)?;
        check_one_world(&frames, &frames_path)?;
        let (options, estimator) = scene_options(options, &join(path, "scene_options"))?;
        Ok(Self { path: path.to_owned(), frames, options, estimator })
    }

    /// Full path of a field of the scene.
    pub(crate) fn field(&self, name: &str) -> String {
        join(&self.path, name)
    }

    /// Name of the optical frame of the first camera.
    pub(crate) fn camera_frame_id(&self) -> &str {
        self.frames.first().map_or("camera", |f| f.camera_frame_id.as_str())
    }

    /// Name of the world frame: the first camera's own when the caller gave no pose.
    pub(crate) fn world_frame_id(&self) -> &str {
        self.frames
            .first()
            .and_then(|f| f.world_frame_id.as_deref())
            .unwrap_or_else(|| self.camera_frame_id())
    }

    /// When the first frame was taken, as sent.
    pub(crate) fn capture_time(&self) -> Option<prost_types::Timestamp> {
        self.frames.first().and_then(|f| f.capture_time)
    }
}

/// All images together must stay within what one may have.
fn check_pixel_count(frames: &[EncodedFrame]) -> Result<(), FieldError> {
    let mut pixel_count = 0;
    for frame in frames {
        pixel_count += frame.pixel_count();
        if pixel_count > MAX_PIXELS {
            return Err(FieldError::new(
                FieldReason::Image,
                frame.path.clone(),
                format!("{pixel_count} pixels in the frames up to this one"),
                format!("at most {MAX_PIXELS} pixels in all frames together"),
            ));
        }
    }
    Ok(())
}

/// Several frames need poses in one world.
fn check_one_world(frames: &[EncodedFrame], path: &str) -> Result<(), FieldError> {
    let [first, rest @ ..] = frames else { return Ok(()) };
    for (i, frame) in frames.iter().enumerate() {
        if !rest.is_empty() && frame.world_from_camera.is_none() {
            return Err(FieldError::missing(
                format!("{path}[{i}].camera_pose"),
                "a pose for each of several frames",
            ));
        }
        if frame.world_frame_id != first.world_frame_id {
            return Err(FieldError::value(
                format!("{path}[{i}].camera_pose.frame_id"),
                quoted(frame.world_frame_id.as_deref().unwrap_or_default()),
                format!("{}, as in {path}[0]", quoted(first.world_frame_id.as_deref().unwrap_or_default())),
            ));
        }
    }
    Ok(())
}

/// A target label needs labelled frames.
fn check_target(scene: &SceneRequest, options: &PlanOptions, path: &str) -> Result<(), FieldError> {
    if matches!(options.target, Some(Target::Label(_))) && !scene.frames.iter().any(EncodedFrame::has_labels)
    {
        return Err(FieldError::value(
            join(path, "target_label"),
            "a label",
            "none unless a frame has labels; use target_point instead",
        ));
    }
    Ok(())
}

/// A whole request, checked.
#[derive(Debug, Clone)]
pub(crate) struct Parsed<J> {
    /// The scene.
    pub(crate) scene: SceneRequest,
    /// What to do in it.
    pub(crate) jobs: J,
    /// The caller's name for the request.
    pub(crate) request_id: Option<String>,
}

/// What to do for several hands.
#[derive(Debug, Clone)]
pub(crate) struct HandJobs {
    /// One for each hand.
    pub(crate) jobs: Vec<HandJob>,
    /// Who takes which grasp, where that is asked.
    pub(crate) assignment: Option<AssignmentJob>,
}

/// A request for one hand; `path` is empty, or the field that holds the request.
pub(crate) fn plan_grasps(wire: v1::PlanGraspsRequest, path: &str) -> Result<Parsed<HandJob>, FieldError> {
    let hand_id = hand_id(&wire.hand, &join(path, "hand"))?;
    let scene = SceneRequest::parse(wire.frames, wire.scene_options, path)?;
    let options_path = join(path, "options");
    let asked = plan_options(wire.options, &options_path)?;
    check_target(&scene, &asked.options, &options_path)?;
    let request_id = request_id(wire.request_id, path)?;
    Ok(Parsed { scene, jobs: HandJob::new(String::new(), hand_id, asked), request_id })
}

/// A request for several hands.
pub(crate) fn multi_hand(wire: v1::PlanMultiHandRequest) -> Result<Parsed<HandJobs>, FieldError> {
    if wire.tasks.is_empty() {
        return Err(FieldError::missing("tasks", "at least one task"));
    }
    if wire.tasks.len() > MOST_TASKS {
        return Err(FieldError::value(
            "tasks",
            format!("{} tasks", wire.tasks.len()),
            format!("at most {MOST_TASKS} tasks"),
        ));
    }
    let scene = SceneRequest::parse(wire.frames, wire.scene_options, "")?;
    let mut seen = BTreeSet::new();
    let mut jobs = Vec::with_capacity(wire.tasks.len());
    for (i, task) in wire.tasks.into_iter().enumerate() {
        let path = format!("tasks[{i}]");
        let id_path = join(&path, "task_id");
        if task.task_id.is_empty() {
            return Err(FieldError::missing(id_path, "a name for the task"));
        }
        if task.task_id.len() > 256 {
            return Err(FieldError::value(id_path, quoted(&task.task_id), "at most 256 bytes"));
        }
        if !seen.insert(task.task_id.clone()) {
            return Err(FieldError::value(id_path, quoted(&task.task_id), "a name that no other task has"));
        }
        let hand_id = hand_id(&task.hand, &join(&path, "hand"))?;
        let options_path = join(&path, "options");
        let asked = plan_options(task.options, &options_path)?;
        check_target(&scene, &asked.options, &options_path)?;
        jobs.push(HandJob::new(task.task_id, hand_id, asked));
    }
    let assignment = wire.assignment.map(|asked| AssignmentJob::parse(asked, &jobs)).transpose()?;
    let request_id = request_id(wire.request_id, "")?;
    Ok(Parsed { scene, jobs: HandJobs { jobs, assignment }, request_id })
}

/// Points of a frame that a caller may ask for.
const MOST_POINTS: i32 = 1_000_000;

/// A request for a scene alone, and how many points of each frame are asked for.
pub(crate) fn read_scene(wire: v1::ReadSceneRequest) -> Result<(SceneRequest, usize), FieldError> {
    let points = match usize::try_from(wire.max_point_count) {
        Ok(points) if wire.max_point_count <= MOST_POINTS => points,
        _ => {
            let expected = format!("0 to {MOST_POINTS}");
            return Err(FieldError::value("max_point_count", wire.max_point_count, expected));
        }
    };
    Ok((SceneRequest::parse(wire.frames, wire.scene_options, "")?, points))
}

/// Longest note of an outcome, bytes.
const LONGEST_NOTE: usize = 1024;

/// A report of an outcome, checked as far as it can be without its plan.
pub(crate) fn report_outcome(wire: v1::ReportOutcomeRequest) -> Result<v1::ReportOutcomeRequest, FieldError> {
    if wire.plan_id.is_empty() {
        return Err(FieldError::missing("plan_id", "PlanGraspsResponse.plan_id"));
    }
    match known_enum(wire.outcome, "outcome")? {
        v1::GraspOutcome::Unspecified => {
            return Err(FieldError::missing("outcome", "what became of the grasp"));
        }
        _ if wire.note.len() > LONGEST_NOTE => {
            let found = format!("{} bytes", wire.note.len());
            return Err(FieldError::value("note", found, format!("at most {LONGEST_NOTE} bytes")));
        }
        _ => {}
    }
    Ok(wire)
}
