//! What is published of a plan: poses, the best grasp's joints, and everything as JSON. Poses are those of the hand's root link,
//! best first, in the frame of the image and with its stamp.

use std::time::Duration;

use graspd_client::wire::{self, NoGraspReason, Postures};
use graspd_client::{Grasp, PlanGraspsResponse};
use nalgebra::{Isometry3, Point3};
use serde_json::{Map, Value, json};

use crate::hand::HandModel;
use crate::messages::{
    Header, JointState, JointTrajectory, JointTrajectoryPoint, Pose, PoseArray, PoseStamped,
};
use crate::poses;

/// The messages of one plan but for its markers.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Answer {
    /// Grasps; empty where there is none.
    pub grasps: PoseArray,
    /// Poses before the approach, in the same order.
    pub pregrasps: PoseArray,
    /// The best grasp.
    pub best: Option<BestGrasp>,
}

/// The best grasp's own messages.
#[derive(Debug, Clone, PartialEq)]
pub struct BestGrasp {
    /// Its pose.
    pub pose: PoseStamped,
    /// Joints when the pads touch.
    pub joints: JointState,
    /// Joints from open over contact to squeezed.
    pub trajectory: JointTrajectory,
}

/// The messages of a plan. `step` is the time from one posture to the next.
pub fn answer(header: &Header, response: &PlanGraspsResponse, step: Duration) -> Answer {
    let all = |pose: fn(&Grasp) -> Option<Isometry3<f64>>| PoseArray {
        header: header.clone(),
        // A pose that is none would shift all behind it: it is the identity, which nobody takes for a grasp.
        poses: response.grasps.iter().map(|g| message(pose(g))).collect(),
    };
    let best = response.grasps.first().map(|grasp| {
        let joints = grasp.joints.clone().unwrap_or_default();
        BestGrasp {
            pose: PoseStamped { header: header.clone(), pose: message(at(grasp)) },
            joints: JointState {
                header: header.clone(),
                name: joints.names.clone(),
                position: joints.contact.clone(),
                ..JointState::default()
            },
            trajectory: trajectory(&joints, step),
        }
    });
    Answer { grasps: all(at), pregrasps: all(before), best }
}

fn message(pose: Option<Isometry3<f64>>) -> Pose {
    poses::message(&pose.unwrap_or_else(Isometry3::identity))
}

fn at(grasp: &Grasp) -> Option<Isometry3<f64>> {
    poses::of_wire(grasp.wrist_pose_in_camera.as_ref()?.pose.as_ref())
}

fn before(grasp: &Grasp) -> Option<Isometry3<f64>> {
    poses::of_wire(grasp.pregrasp_pose_in_camera.as_ref()?.pose.as_ref())
}

/// Open, contact, squeezed. Its stamp is 0: controllers begin when it comes, whenever the image was taken.
fn trajectory(joints: &Postures, step: Duration) -> JointTrajectory {
    let postures = [&joints.open, &joints.contact, &joints.squeezed];
    let points = (1u32..).zip(postures).map(|(n, positions)| JointTrajectoryPoint {
        positions: positions.clone(),
        time_from_start: (step * n).into(),
        ..JointTrajectoryPoint::default()
    });
    JointTrajectory {
        joint_names: joints.names.clone(),
        points: points.collect(),
        ..JointTrajectory::default()
    }
}

/// Everything that the planner said, as JSON: SI units, the frame of the image.
pub fn report(header: &Header, response: &PlanGraspsResponse, model: Option<&HandModel>) -> Value {
    let stats = response.stats.clone().unwrap_or_default();
    let no_grasp = response.no_grasp.as_ref().map(|no| {
        let name = no.reason().as_str_name();
        let name = name.strip_prefix("NO_GRASP_REASON_").unwrap_or(name);
        json!({ "reason": name, "nearest_fix": no.nearest_fix })
    });
    let wrist = response.grasps.first().map(|g| g.wrist_link.clone());
    let stages: Map<String, Value> =
        (stats.stages.iter()).map(|s| (s.name.clone(), json!(milliseconds(s.duration.as_ref())))).collect();
    json!({
        "frame_id": header.frame_id,
        "stamp": header.stamp,
        "plan_id": response.plan_id,
        "recorded": response.recorded,
        "hand_revision": stats.hand_revision,
        "wrist_link": wrist.or_else(|| model.map(|m| m.wrist_link.clone())),
        "tool_point": model.map(|m| poses::point(&m.tool_point)),
        "approach": model.map(|m| poses::point(&Point3::from(m.approach))),
        "grasps": response.grasps.iter().map(|g| grasp(g, model)).collect::<Vec<_>>(),
        "no_grasp": no_grasp,
        "calibration": response.calibration.as_ref().map(|c| &c.name),
        "stats": {
            "estimator": stats.estimator,
            "seed": stats.seed,
            "focal_contacts": stats.focal_contact_count,
            "focal_centroids": stats.focal_centroid_count,
            "centered_centroids": stats.centered_centroid_count,
            "candidates": stats.candidate_count,
            "iterations": stats.iteration_count,
            "rejected": stats.rejected_counts.iter().collect::<std::collections::BTreeMap<_, _>>(),
            "invalid_pixels": stats.invalid_pixel_count,
            "budget_exhausted": stats.budget_exhausted,
            "stages_ms": stages,
            "queue_ms": milliseconds(stats.queue_duration.as_ref()),
            "total_ms": milliseconds(stats.total_duration.as_ref()),
        },
    })
}

/// Why there is no grasp, for people; empty where there is one.
pub fn no_grasp(response: &PlanGraspsResponse) -> String {
    let Some(no) = &response.no_grasp else { return String::new() };
    match no.reason() {
        NoGraspReason::Unspecified => no.nearest_fix.clone(),
        reason => {
            let name = reason.as_str_name();
            let name = name.strip_prefix("NO_GRASP_REASON_").unwrap_or(name).to_lowercase().replace('_', " ");
            if no.nearest_fix.is_empty() { name } else { format!("{name}: {}", no.nearest_fix) }
        }
    }
}

fn milliseconds(duration: Option<&prost_types::Duration>) -> f64 {
    duration.map_or(0.0, |d| d.seconds as f64 * 1e3 + f64::from(d.nanos) * 1e-6)
}

fn grasp(grasp: &Grasp, model: Option<&HandModel>) -> Value {
    let parts = grasp.score_parts.unwrap_or_default();
    let contacts: Vec<Value> = (grasp.contacts.iter())
        .map(|c| {
            json!({
                "point": poses::point(&poses::vector(c.point.as_ref())),
                "normal": poses::point(&poses::vector(c.normal.as_ref())),
                "pad": c.pad,
                "finger": c.finger,
                "link": c.link,
                "certainty": c.certainty,
            })
        })
        .collect();
    let tool = model.zip(at(grasp)).map(|(m, at)| poses::point(&(at * m.tool_point)));
    json!({
        "pose": at(grasp).map(|p| poses::message(&p)),
        "pregrasp_pose": before(grasp).map(|p| poses::message(&p)),
        "tool_point": tool,
        "wrist_link": grasp.wrist_link,
        "score": grasp.score,
        "uncalibrated_score": grasp.uncalibrated_score,
        "better_not": grasp.better_not,
        "score_parts": {
            "objective": parts.objective,
            "force_closure": parts.force_closure,
            "clearance": parts.clearance,
            "certainty": parts.certainty,
        },
        "joints": postures(grasp.joints.as_ref()),
        "actuators": postures(grasp.actuators.as_ref()),
        "contacts": contacts,
        "jaw_width_m": grasp.jaw_width_m,
        "epsilon": grasp.epsilon,
        "clearance_m": grasp.clearance_m,
        "centroid": poses::point(&poses::vector(grasp.centroid.as_ref())),
        "label": grasp.label,
    })
}

fn postures(postures: Option<&wire::Postures>) -> Value {
    let Some(p) = postures else { return Value::Null };
    json!({ "names": p.names, "open": p.open, "contact": p.contact, "squeezed": p.squeezed })
}

#[cfg(test)]
pub(crate) mod tests {
    use graspd_client::wire::{Contact, NoGrasp, PoseInFrame, Quaternion, ScoreParts, Vector3};

    use super::*;
    use crate::hand::tests::{geometry, hand};
    use crate::messages::Stamp;

    /// A grasp one metre before the camera, turned by half a turn about x; its pre-grasp is 0.1 m behind it.
    pub(crate) fn grasp(score: f64) -> Grasp {
        let pose = |z| {
            let (position, orientation) =
                (Vector3 { x: 0.0, y: 0.0, z }, Quaternion { x: 1.0, ..Quaternion::default() });
            let pose = wire::Pose { position: Some(position), orientation: Some(orientation) };
            Some(PoseInFrame { frame_id: "optical".into(), pose: Some(pose) })
        };
        Grasp {
            wrist_link: "palm".into(),
            wrist_pose_in_camera: pose(1.0),
            pregrasp_pose_in_camera: pose(0.9),
            joints: Some(Postures {
                names: vec!["turn".into(), "slide".into()],
                open: vec![0.0, 0.1],
                contact: vec![0.5, 0.2],
                squeezed: vec![0.6, 0.3],
            }),
            contacts: vec![Contact { pad: "tip".into(), ..Contact::default() }],
            score,
            score_parts: Some(ScoreParts {
                objective: 0.1,
                force_closure: 0.2,
                clearance: 0.3,
                certainty: 0.4,
            }),
            ..Grasp::default()
        }
    }

    fn header() -> Header {
        Header { stamp: Stamp { sec: 3, nanosec: 4 }, frame_id: "optical".into() }
    }

    fn response(grasps: Vec<Grasp>) -> PlanGraspsResponse {
        PlanGraspsResponse { grasps, plan_id: "p1".into(), ..PlanGraspsResponse::default() }
    }

    #[test]
    fn poses_keep_order_frame_and_stamp() {
        let found = answer(&header(), &response(vec![grasp(0.9), grasp(0.4)]), Duration::from_millis(1500));
        assert_eq!((&found.grasps.header, &found.pregrasps.header), (&header(), &header()));
        assert_eq!(found.grasps.poses.len(), 2);
        assert_eq!((found.grasps.poses[0].position.z, found.pregrasps.poses[0].position.z), (1.0, 0.9));
        assert_eq!(found.grasps.poses[0].orientation.x, 1.0);
        let best = found.best.unwrap();
        assert_eq!(
            (best.joints.name, best.joints.position),
            (vec!["turn".to_owned(), "slide".into()], vec![0.5, 0.2])
        );
        assert_eq!(best.joints.header, header());
        assert_eq!(best.trajectory.header, Header::default());
        let times: Vec<_> = (best.trajectory.points.iter())
            .map(|p| (p.time_from_start.sec, p.time_from_start.nanosec, p.positions[0]))
            .collect();
        assert_eq!(times, [(1, 500_000_000, 0.0), (3, 0, 0.5), (4, 500_000_000, 0.6)]);
    }

    #[test]
    fn the_report_has_everything() {
        let model = HandModel::new(&hand(), &geometry());
        let value = report(&header(), &response(vec![grasp(0.9)]), Some(&model));
        assert_eq!(value["stamp"], json!({ "sec": 3, "nanosec": 4 }));
        assert_eq!((&value["plan_id"], &value["wrist_link"]), (&json!("p1"), &json!("palm")));
        assert_eq!(value["tool_point"]["z"], json!(0.15));
        let best = &value["grasps"][0];
        assert_eq!(best["pose"]["position"], json!({ "x": 0.0, "y": 0.0, "z": 1.0 }));
        // The tool point is 0.15 m along the hand's z, which looks back at the camera here.
        assert!((best["tool_point"]["z"].as_f64().unwrap() - 0.85).abs() < 1e-12);
        assert_eq!(best["score_parts"]["clearance"], json!(0.3));
        assert_eq!(best["joints"]["squeezed"], json!([0.6, 0.3]));
        assert_eq!(value["no_grasp"], Value::Null);
    }

    #[test]
    fn no_grasp_is_an_answer_with_a_reason() {
        let mut none = response(Vec::new());
        let reason = NoGraspReason::HandTooSmall.into();
        none.no_grasp = Some(NoGrasp { reason, nearest_fix: "a wider hand".into() });
        let found = answer(&header(), &none, Duration::from_secs(1));
        assert_eq!((found.grasps.poses.len(), found.best), (0, None));
        assert_eq!(found.grasps.header, header());
        assert_eq!(no_grasp(&none), "hand too small: a wider hand");
        assert_eq!(report(&header(), &none, None)["no_grasp"]["reason"], json!("HAND_TOO_SMALL"));
        assert_eq!(no_grasp(&response(vec![grasp(1.0)])), "");
    }
}
