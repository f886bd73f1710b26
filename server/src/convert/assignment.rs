//! Which arm takes which grasp: the request from the wire, the answer onto it.

use std::collections::BTreeSet;

use graspd_assign::{
    Arm, Assignment, Body, Grasp, KeepOut, ObjectKey, OrientedBox, Problem, Reach, ReachRegion, Settings,
    assign,
};
use graspd_hands::Hand;
use graspd_proto::v1;
use nalgebra::{Isometry3, Point3, Vector3};

use super::geometry::pose;
use super::options::{MOST_KEEP_OUT_BOXES, solid_box};
use super::{HandJob, count_message, join, number_within, positive_up_to, quoted};
use crate::error::FieldError;

/// A checked request for an assignment.
#[derive(Debug, Clone)]
pub(crate) struct AssignmentJob {
    arms: Vec<ArmJob>,
    settings: Settings,
}

/// An arm whose grasps are not planned yet.
#[derive(Debug, Clone)]
struct ArmJob {
    task_id: String,
    region: ReachRegion,
    keep_out: Vec<KeepOut>,
    body: Body,
}

impl AssignmentJob {
    /// Checks a request against the tasks beside it.
    pub(super) fn parse(wire: v1::AssignmentRequest, jobs: &[HandJob]) -> Result<Self, FieldError> {
        const PATH: &str = "assignment";
        let defaults = Settings::default();
        if wire.arms.is_empty() {
            return Err(FieldError::missing(join(PATH, "arms"), "at least one arm"));
        }
        let settings = Settings {
            same_object_m: positive_up_to(
                wire.same_object_m,
                defaults.same_object_m,
                1.0,
                &join(PATH, "same_object_m"),
            )?,
            clearance_m: number_within(
                wire.clearance_m,
                defaults.clearance_m,
                (0.0, 1.0),
                &join(PATH, "clearance_m"),
            )?,
            ..defaults
        };
        let mut seen = BTreeSet::new();
        let mut arms = Vec::with_capacity(wire.arms.len());
        for (i, arm) in wire.arms.into_iter().enumerate() {
            let path = join(PATH, format!("arms[{i}]"));
            let id = join(&path, "task_id");
            let known = jobs.iter().find(|job| job.task_id == arm.task_id);
            let Some(job) = known else {
                return Err(FieldError::value(id, quoted(&arm.task_id), "the task_id of one of the tasks"));
            };
            if !seen.insert(arm.task_id.clone()) {
                return Err(FieldError::value(id, quoted(&arm.task_id), "a task that no other arm has"));
            }
            arms.push(ArmJob::parse(arm, job, &path)?);
        }
        Ok(Self { arms, settings })
    }

    /// The assignment of what was planned: hands and grasps by task.
    pub(crate) fn assign<'a>(
        &self,
        planned: impl Fn(&str) -> Option<(&'a Hand, &'a v1::PlanGraspsResponse)>,
    ) -> v1::Assignment {
        let arms: Vec<Arm> = self.arms.iter().map(|arm| arm.with(planned(&arm.task_id))).collect();
        let problem = Problem { arms: &arms, ..Problem::default() };
        let found = assign(&problem, &self.settings, &mut || false);
        message(&self.arms, &found)
    }
}

impl ArmJob {
    fn parse(wire: v1::AssignmentArm, job: &HandJob, path: &str) -> Result<Self, FieldError> {
        let at = |field: &str| join(path, field);
        let defaults = Body::default();
        let arm_radius_m =
            number_within(wire.arm_radius_m, defaults.arm_radius_m, (0.0, 1.0), &at("arm_radius_m"))?;
        let needs_base =
            arm_radius_m > 0.0 || matches!(wire.reach, Some(v1::assignment_arm::Reach::ReachShell(_)));
        let base = match wire.base_pose {
            None if !needs_base => Isometry3::identity(),
            base => pose(base.as_ref(), &at("base_pose"))?,
        };
        let region = match wire.reach {
            None => ReachRegion::Anywhere,
            Some(v1::assignment_arm::Reach::ReachShell(shell)) => {
                let path = at("reach_shell");
                let (min, max) = (shell.min_radius_m, shell.max_radius_m);
                let min_m = number_within(Some(min), 0.0, (0.0, 100.0), &join(&path, "min_radius_m"))?;
                if !(max.is_finite() && max > min_m && max <= 100.0) {
                    let expected = "more than min_radius_m, at most 100";
                    return Err(FieldError::value(join(&path, "max_radius_m"), max, expected));
                }
                ReachRegion::Shell { middle: Point3::from(base.translation.vector), min_m, max_m: max }
            }
            Some(v1::assignment_arm::Reach::ReachBox(volume)) => {
                let (pose, half_extents_m) =
                    solid_box(volume.pose.as_ref(), volume.half_extents_m, &at("reach_box"))?;
                ReachRegion::Box(OrientedBox { pose, half_extents_m })
            }
        };
        let count = wire.keep_out_boxes.len();
        if count > MOST_KEEP_OUT_BOXES {
            return Err(FieldError::value(
                at("keep_out_boxes"),
                format!("{count} boxes"),
                format!("at most {MOST_KEEP_OUT_BOXES} boxes"),
            ));
        }
        // The task's own boxes need no second look: the planner keeps the hand out of them.
        let keep_out = (wire.keep_out_boxes.iter().enumerate()).map(|(i, b)| {
            let name = format!("keep_out_boxes[{i}]");
            let (pose, half_extents_m) = solid_box(b.pose.as_ref(), b.half_extents_m, &at(&name))?;
            Ok(KeepOut { name, volume: OrientedBox { pose, half_extents_m } })
        });
        let height = number_within(wire.shoulder_height_m, 0.15, (0.0, 3.0), &at("shoulder_height_m"))?;
        Ok(Self {
            task_id: job.task_id.clone(),
            region,
            keep_out: keep_out.collect::<Result<_, FieldError>>()?,
            body: Body {
                shoulder: base * Point3::from(Vector3::z() * height),
                hand_radius_m: positive_up_to(
                    wire.hand_radius_m,
                    defaults.hand_radius_m,
                    1.0,
                    &at("hand_radius_m"),
                )?,
                arm_radius_m,
                lift_m: number_within(wire.lift_m, defaults.lift_m, (0.0, 2.0), &at("lift_m"))?,
                tool_point: Point3::origin(),
            },
        })
    }

    fn with(&self, planned: Option<(&Hand, &v1::PlanGraspsResponse)>) -> Arm {
        let mut arm = Arm::new(&self.task_id, Vec::new());
        (arm.region, arm.keep_out, arm.body) = (self.region.clone(), self.keep_out.clone(), self.body);
        let Some((hand, response)) = planned else { return arm };
        arm.body.tool_point = hand.tool_point;
        arm.opening_m = hand.opening.map(|o| (0.0, o.max_m));
        let labelled = response.grasps.iter().all(|g| g.label.is_some());
        arm.grasps = response.grasps.iter().map(|g| grasp(g, labelled)).collect();
        arm
    }
}

/// A grasp of one's own answer.
fn grasp(wire: &v1::Grasp, labelled: bool) -> Grasp {
    let of = |p: &Option<v1::PoseInFrame>| pose(p.as_ref().and_then(|p| p.pose.as_ref()), "");
    let (pregrasp, grasp) = (of(&wire.pregrasp_pose), of(&wire.wrist_pose));
    let centroid = wire.centroid.unwrap_or_default();
    let object = match wire.label.filter(|_| labelled) {
        Some(label) => ObjectKey::Id(i64::from(label)),
        None => ObjectKey::At(Point3::new(centroid.x, centroid.y, centroid.z)),
    };
    let reach = match (&pregrasp, &grasp) {
        (Ok(_), Ok(_)) => Reach::Unknown,
        _ => Reach::Beyond("the grasp has no pose".to_owned()),
    };
    Grasp {
        world_from_pregrasp: pregrasp.unwrap_or_default(),
        world_from_hand: grasp.unwrap_or_default(),
        score: wire.score,
        object,
        width_m: wire.jaw_width_m,
        reach,
        barred: None,
        corridor: None,
    }
}

fn message(arms: &[ArmJob], found: &Assignment) -> v1::Assignment {
    let decisions = arms.iter().zip(&found.decisions).map(|(arm, decision)| {
        let mut message = v1::ArmDecision {
            task_id: arm.task_id.clone(),
            reason: decision.reason.to_string(),
            ..v1::ArmDecision::default()
        };
        if let Some(chosen) = &decision.chosen {
            message.grasp_index = Some(count_message(chosen.grasp));
            message.value = chosen.value;
            (message.score, message.size, message.reach) =
                (chosen.factors.score, chosen.factors.size, chosen.factors.reach);
        }
        for rejected in &decision.rejected {
            *message.rejected_counts.entry(rejected.cause.name().to_owned()).or_default() += 1;
        }
        message
    });
    v1::Assignment {
        decisions: decisions.collect(),
        value: found.value,
        bound: found.bound,
        optimal: found.optimal,
    }
}
