//! What is asked for: a goal in JSON, checked by field, as a request of the protocol.

use std::time::Duration;

use graspd_client::wire::{Reaching, TargetPoint, Vector3, VolumeKind, plan_options::Target};
use graspd_client::{PlanGraspsRequest, PlanOptions, SceneOptions};
use serde::{Deserialize, Serialize};

use crate::messages::PointStamped;

/// Longest id of a goal, bytes.
const MAX_ID: usize = 128;
/// Radius about a target point where none is given, metres.
const TARGET_RADIUS_M: f64 = 0.05;

/// A goal as it is written on the topic `goal`. Every field may be left out; an empty text is a goal too.
///
/// Lengths are metres; points are in the frame of the camera's image.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Goal {
    /// Chosen by the caller: results and feedback carry it, and it is cancelled by it. One is given where it is empty.
    pub id: String,
    /// The hand, for example `leap`; the bridge's first one where it is empty.
    pub hand: String,
    /// Grasp only what is near this point.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target_point: Option<[f64; 3]>,
    /// How near; 0.05 where it is left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target_radius_m: Option<f64>,
    /// The frame that the caller thinks the point is in: another one than the image's is refused.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame_id: Option<String>,
    /// Grasp only the object with this label, 1 to 255, in the label image.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target_label: Option<u8>,
    /// At most this many grasps; the bridge's setting where it is left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_grasps: Option<i32>,
    /// Leave out grasps that score less, 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min_score: Option<f64>,
    /// Stop after so many milliseconds and answer with the best so far.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub budget_ms: Option<u64>,
    /// Same seed, same image: same answer.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// `top-down`, `camera` or `free`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reaching: Option<String>,
    /// Largest angle between the hand's approach and the reaching direction, degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cone_deg: Option<f64>,
    /// Coulomb friction.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub friction: Option<f64>,
    /// Distance of the pre-grasp from the grasp, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pregrasp_offset_m: Option<f64>,
    /// Candidates that are optimized together.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub batch: Option<i32>,
    /// Iterations, the last 40 of which avoid penetration (all, where there are fewer).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iterations: Option<i32>,
    /// Contact estimator by name.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub estimator: Option<String>,
    /// `tsdf` or `occupancy`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub volume: Option<String>,
}

/// A goal that is none.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("goal{field}: found {found}, expected {expected}")]
pub struct GoalError {
    /// The goal's id, where it could be read.
    pub id: String,
    /// The field with a dot before it; empty for the text as a whole.
    pub field: String,
    /// What it holds.
    pub found: String,
    /// What it should hold.
    pub expected: String,
}

impl Goal {
    /// Reads a goal.
    ///
    /// # Errors
    /// For what is no JSON object of these fields.
    pub fn parse(text: &str) -> Result<Self, GoalError> {
        if text.trim().is_empty() {
            return Ok(Self::default());
        }
        let goal: Self = serde_json::from_str(text).map_err(|error| {
            // The caller waits for an answer under its own id.
            let id = serde_json::from_str::<serde_json::Value>(text).ok();
            let id = id.and_then(|v| v.get("id")?.as_str().map(str::to_owned)).unwrap_or_default();
            GoalError { id, field: String::new(), found: error.to_string(), expected: "a JSON object".into() }
        })?;
        goal.check()?;
        Ok(goal)
    }

    /// Whatever is near a point, as RViz's tool "Publish Point" sends it.
    pub fn near(point: &PointStamped) -> Self {
        let p = point.point;
        Self {
            target_point: Some([p.x, p.y, p.z]),
            frame_id: Some(point.header.frame_id.clone()),
            ..Self::default()
        }
    }

    fn refused(&self, field: &str, found: impl std::fmt::Debug, expected: &str) -> GoalError {
        let (id, field) = (self.id.clone(), format!(".{field}"));
        GoalError { id, field, found: format!("{found:?}"), expected: expected.into() }
    }

    /// What can be told without a server; it checks the rest.
    fn check(&self) -> Result<(), GoalError> {
        if self.id.len() > MAX_ID {
            return Err(self.refused("id", format!("{} bytes", self.id.len()), "at most 128 bytes"));
        }
        if self.target_point.is_some() && self.target_label.is_some() {
            return Err(self.refused("target_label", self.target_label, "a point or a label, not both"));
        }
        if self.target_label == Some(0) {
            return Err(self.refused("target_label", 0, "1 to 255"));
        }
        if let Some(point) = self.target_point
            && !point.iter().all(|v| v.is_finite())
        {
            return Err(self.refused("target_point", point, "three finite numbers"));
        }
        if self.target_radius_m.is_some_and(|r| !(r.is_finite() && r > 0.0)) {
            return Err(self.refused("target_radius_m", self.target_radius_m, "more than 0"));
        }
        if self.budget_ms == Some(0) {
            return Err(self.refused("budget_ms", 0, "more than 0"));
        }
        self.reaching()?;
        self.volume()?;
        Ok(())
    }

    fn reaching(&self) -> Result<Reaching, GoalError> {
        match self.reaching.as_deref() {
            None | Some("") => Ok(Reaching::Unspecified),
            Some("top-down") => Ok(Reaching::TopDown),
            Some("camera") => Ok(Reaching::CameraRay),
            Some("free") => Ok(Reaching::Free),
            Some(other) => Err(self.refused("reaching", other, "top-down, camera or free")),
        }
    }

    fn volume(&self) -> Result<VolumeKind, GoalError> {
        match self.volume.as_deref() {
            None | Some("") => Ok(VolumeKind::Unspecified),
            Some("tsdf") => Ok(VolumeKind::Tsdf),
            Some("occupancy") => Ok(VolumeKind::Occupancy),
            Some(other) => Err(self.refused("volume", other, "tsdf or occupancy")),
        }
    }

    /// The request for this goal but for its frames.
    ///
    /// # Errors
    /// As [`Goal::parse`].
    pub fn request(&self, hand: &str, max_grasps: u32) -> Result<PlanGraspsRequest, GoalError> {
        self.check()?;
        let target = match (self.target_point, self.target_label) {
            (Some([x, y, z]), _) => Some(Target::TargetPoint(TargetPoint {
                point: Some(Vector3 { x, y, z }),
                radius_m: self.target_radius_m.unwrap_or(TARGET_RADIUS_M),
            })),
            (None, Some(label)) => Some(Target::TargetLabel(label.into())),
            (None, None) => None,
        };
        let scheme = self.iterations.map(|all| graspd_client::wire::Scheme {
            iteration_count: all,
            penetration_iteration_count: all.clamp(0, 40),
        });
        let limits = self.cone_deg.map(|degrees| graspd_client::wire::OrientationLimits {
            max_tilt_rad: Some(degrees.to_radians()),
            roll: None,
        });
        let budget = self.budget_ms.map(|ms| {
            // Milliseconds of 64 bits are seconds of 63.
            prost_types::Duration::try_from(Duration::from_millis(ms)).unwrap_or_default()
        });
        Ok(PlanGraspsRequest {
            hand: format!("hands/{hand}"),
            scene_options: Some(SceneOptions {
                volume_kind: self.volume()?.into(),
                estimator: self.estimator.clone().unwrap_or_default(),
                ..SceneOptions::default()
            }),
            options: Some(PlanOptions {
                batch_size: self.batch.unwrap_or(0),
                scheme,
                reaching: self.reaching()?.into(),
                orientation_limits: limits,
                target,
                seed: self.seed.unwrap_or(0),
                budget,
                max_grasp_count: self.max_grasps.unwrap_or_else(|| i32::try_from(max_grasps).unwrap_or(0)),
                min_score: self.min_score,
                friction: self.friction,
                pregrasp_offset_m: self.pregrasp_offset_m,
                ..PlanOptions::default()
            }),
            ..PlanGraspsRequest::default()
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::messages::{Header, Point};

    #[test]
    fn nothing_is_a_goal() {
        for text in ["", "  \n", "{}"] {
            assert_eq!(Goal::parse(text).unwrap(), Goal::default());
        }
        let request = Goal::default().request("leap", 7).unwrap();
        assert_eq!(request.hand, "hands/leap");
        assert_eq!(request.options.unwrap().max_grasp_count, 7);
    }

    #[test]
    fn everything_reaches_the_request() {
        let goal = Goal::parse(
            r#"{"id": "a", "hand": "leap", "target_point": [1, 2, 3], "target_radius_m": 0.1, "max_grasps": 3,
                "min_score": 0.25, "budget_ms": 1500, "seed": 9, "reaching": "camera", "cone_deg": 180,
                "friction": 0.7, "pregrasp_offset_m": 0.2, "batch": 64, "iterations": 100, "estimator": "learned",
                "volume": "occupancy", "frame_id": "optical"}"#,
        )
        .unwrap();
        let request = goal.request("leap", 7).unwrap();
        let (scene, options) = (request.scene_options.unwrap(), request.options.unwrap());
        assert_eq!((scene.estimator.as_str(), scene.volume_kind()), ("learned", VolumeKind::Occupancy));
        let point = Some(Vector3 { x: 1.0, y: 2.0, z: 3.0 });
        assert_eq!(options.target, Some(Target::TargetPoint(TargetPoint { point, radius_m: 0.1 })));
        assert_eq!((options.max_grasp_count, options.min_score, options.seed), (3, Some(0.25), 9));
        assert_eq!(options.budget, Some(prost_types::Duration { seconds: 1, nanos: 500_000_000 }));
        assert_eq!((options.reaching(), options.batch_size), (Reaching::CameraRay, 64));
        assert_eq!(options.orientation_limits.unwrap().max_tilt_rad, Some(std::f64::consts::PI));
        assert_eq!((options.friction, options.pregrasp_offset_m), (Some(0.7), Some(0.2)));
        let scheme = options.scheme.unwrap();
        assert_eq!((scheme.iteration_count, scheme.penetration_iteration_count), (100, 40));
        let labelled = Goal::parse(r#"{"target_label": 4}"#).unwrap().request("leap", 7).unwrap();
        assert_eq!(labelled.options.unwrap().target, Some(Target::TargetLabel(4)));
    }

    #[test]
    fn what_is_wrong_is_named() {
        let wrong = [
            (r#"{"id": "a", "hnad": "leap"}"#, "", "unknown field `hnad`"),
            (r#"{"id": "a", "hand": 3}"#, "", "invalid type"),
            (r#"{"id": "a", "target_label": 0}"#, ".target_label", "0"),
            (r#"{"id": "a", "target_label": 256}"#, "", "invalid value"),
            (r#"{"id": "a", "target_label": 1, "target_point": [1, 2, 3]}"#, ".target_label", "Some(1)"),
            (r#"{"id": "a", "target_radius_m": -1}"#, ".target_radius_m", "-1"),
            (r#"{"id": "a", "budget_ms": 0}"#, ".budget_ms", "0"),
            (r#"{"id": "a", "reaching": "up"}"#, ".reaching", "\"up\""),
            (r#"{"id": "a", "volume": "points"}"#, ".volume", "\"points\""),
        ];
        for (text, field, found) in wrong {
            let error = Goal::parse(text).unwrap_err();
            assert_eq!((error.id.as_str(), error.field.as_str()), ("a", field), "{text}");
            assert!(error.found.contains(found), "{error}");
        }
        assert_eq!(Goal::parse("[1]").unwrap_err().id, "");
        assert!(Goal::parse(&format!(r#"{{"id": "{}"}}"#, "x".repeat(129))).is_err());
    }

    #[test]
    fn a_clicked_point_is_a_goal_in_its_frame() {
        let header = Header { frame_id: "optical".into(), ..Header::default() };
        let goal = Goal::near(&PointStamped { header, point: Point { x: 1.0, y: 2.0, z: 3.0 } });
        assert_eq!((goal.target_point, goal.frame_id.as_deref()), (Some([1.0, 2.0, 3.0]), Some("optical")));
        let point = Point { x: f64::NAN, ..Point::default() };
        let nowhere = Goal::near(&PointStamped { header: Header::default(), point });
        assert_eq!(nowhere.request("leap", 1).unwrap_err().field, ".target_point");
    }

    proptest! {
        #[test]
        fn no_text_panics(text in ".{0,80}", cut in 0usize..60) {
            drop(Goal::parse(&text));
            let whole = r#"{"id": "a", "target_point": [1.0, 2.0, 3.0], "budget_ms": 12}"#;
            prop_assert!(Goal::parse(&whole[..cut.min(whole.len() - 1)]).is_err() || cut == 0);
        }
    }
}
