//! What is different between two answers.

use std::fmt;

use graspd_proto::v1;
use graspd_proto::v1::hand_task_result::Outcome;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde::Serialize;

use crate::output::table::Table;

/// How a plan came out again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Verdict {
    /// Bit for bit the same grasps, or the same reason for none.
    Equal,
    /// Something is different.
    Different,
    /// A deadline or a budget had ended the search: it cannot be the same.
    EndedByTime,
    /// There was an error then or now.
    Failed,
}

/// How far apart two sets of grasps are.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct Apart {
    /// From each recorded grasp to the nearest of the new ones: the middle one, and the largest, millimetres.
    pub(super) median_mm: f64,
    /// See `median_mm`.
    pub(super) largest_mm: f64,
    /// Rotation between the same pairs, the largest, degrees.
    pub(super) largest_deg: f64,
    /// Score of the best grasp now less then, uncalibrated.
    pub(super) best_score_change: f64,
}

/// One plan, then and now.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Task {
    /// Number of its call in the recording.
    pub(super) call: usize,
    pub(super) plan_id: String,
    pub(super) task_id: String,
    pub(super) hand: String,
    pub(super) verdict: Verdict,
    /// Grasps then and now.
    pub(super) grasps: (usize, usize),
    pub(super) apart: Option<Apart>,
    /// What else there is to say.
    pub(super) note: String,
    pub(super) server_version: String,
    /// Milliseconds then and now, from arrival to answer.
    pub(super) milliseconds: (f64, f64),
}

impl Task {
    /// Compares an answer with the one of today.
    pub(super) fn new(
        call: usize,
        record: &v1::PlanRecord,
        task_id: &str,
        then: &Outcome,
        now: Option<&Outcome>,
    ) -> Self {
        let mut task = Self {
            call,
            plan_id: String::new(),
            task_id: task_id.to_owned(),
            hand: String::new(),
            verdict: Verdict::Failed,
            grasps: (0, 0),
            apart: None,
            note: String::new(),
            server_version: record.server_version.clone(),
            milliseconds: (0.0, 0.0),
        };
        let said = |outcome: &Outcome| match outcome {
            Outcome::Error(error) => format!("{}: {}", error.reason, error.message),
            Outcome::Response(answer) => format!("{} grasps", answer.grasps.len()),
        };
        let (then, now) = match (then, now) {
            (Outcome::Response(then), Some(Outcome::Response(now))) => (then, now),
            (then, None) => {
                task.note = format!("then {}; now no answer", said(then));
                return task;
            }
            (then, Some(now)) => {
                task.note = format!("then {}; now {}", said(then), said(now));
                return task;
            }
        };
        let stats = then.stats.clone().unwrap_or_default();
        task.plan_id.clone_from(&then.plan_id);
        task.hand = stats.hand.trim_start_matches("hands/").to_owned();
        task.grasps = (then.grasps.len(), now.grasps.len());
        task.milliseconds = (milliseconds(then), milliseconds(now));
        task.verdict = match () {
            () if is_same(then, now) => Verdict::Equal,
            () if stats.budget_exhausted => Verdict::EndedByTime,
            () => Verdict::Different,
        };
        if task.verdict != Verdict::Equal {
            task.apart = apart(&then.grasps, &now.grasps);
            task.note = note(then, now);
        }
        task
    }
}

/// The grasps as the planner made them: scores may have been calibrated by another calibration.
fn bare(grasps: &[v1::Grasp]) -> Vec<v1::Grasp> {
    grasps.iter().map(|g| v1::Grasp { score: g.uncalibrated_score, better_not: false, ..g.clone() }).collect()
}

fn is_same(then: &v1::PlanGraspsResponse, now: &v1::PlanGraspsResponse) -> bool {
    let counts = |answer: &v1::PlanGraspsResponse| {
        let stats = answer.stats.clone().unwrap_or_default();
        (
            stats.rejected_counts,
            stats.focal_contact_count,
            stats.centered_centroid_count,
            stats.candidate_count,
        )
    };
    bare(&then.grasps) == bare(&now.grasps)
        && then.workspace == now.workspace
        && then.no_grasp.as_ref().map(|n| n.reason) == now.no_grasp.as_ref().map(|n| n.reason)
        && counts(then) == counts(now)
}

fn note(then: &v1::PlanGraspsResponse, now: &v1::PlanGraspsResponse) -> String {
    let mut notes = Vec::new();
    let stats = |answer: &v1::PlanGraspsResponse| answer.stats.clone().unwrap_or_default();
    let (old, new) = (stats(then), stats(now));
    if old.hand_revision != new.hand_revision {
        notes.push("another revision of the hand".to_owned());
    }
    if old.estimator != new.estimator {
        notes.push(format!("estimator {} then, {} now", old.estimator, new.estimator));
    }
    if then.workspace != now.workspace {
        notes.push("another workspace".to_owned());
    }
    let reason = |answer: &v1::PlanGraspsResponse| answer.no_grasp.as_ref().map(|n| n.reason());
    if reason(then) != reason(now) {
        let name = |reason: Option<v1::NoGraspReason>| {
            reason.map_or("grasps", |r| r.as_str_name().trim_start_matches("NO_GRASP_REASON_"))
        };
        notes.push(format!("{} then, {} now", name(reason(then)), name(reason(now))));
    }
    notes.join("; ")
}

fn milliseconds(answer: &v1::PlanGraspsResponse) -> f64 {
    let total = answer.stats.as_ref().and_then(|s| s.total_duration);
    total.map_or(0.0, |d| d.seconds as f64 * 1e3 + f64::from(d.nanos) / 1e6)
}

fn apart(then: &[v1::Grasp], now: &[v1::Grasp]) -> Option<Apart> {
    let places: Vec<_> = now.iter().filter_map(place).collect();
    let mut pairs: Vec<(f64, f64)> = then
        .iter()
        .filter_map(place)
        .filter_map(|(p, q)| {
            let distances =
                places.iter().map(|(p2, q2)| ((p - p2).norm() * 1e3, q.angle_to(q2).to_degrees()));
            // A degree at a hand's finger tips, a decimetre from the wrist, is some two millimetres.
            distances.min_by(|a, b| (a.0 + 2.0 * a.1).total_cmp(&(b.0 + 2.0 * b.1)))
        })
        .collect();
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let best = |grasps: &[v1::Grasp]| grasps.first().map(|g| g.uncalibrated_score);
    Some(Apart {
        median_mm: pairs.get(pairs.len() / 2)?.0,
        largest_mm: pairs.last()?.0,
        largest_deg: pairs.iter().map(|p| p.1).fold(0.0, f64::max),
        best_score_change: best(now)? - best(then)?,
    })
}

fn place(grasp: &v1::Grasp) -> Option<(Vector3<f64>, UnitQuaternion<f64>)> {
    let pose = grasp.wrist_pose.as_ref()?.pose.as_ref()?;
    let (p, q) = (pose.position.as_ref()?, pose.orientation.as_ref()?);
    let turn = UnitQuaternion::from_quaternion(Quaternion::new(q.w, q.x, q.y, q.z));
    Some((Vector3::new(p.x, p.y, p.z), turn))
}

/// How many plans came out how.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub(super) struct Summary {
    pub(super) plans: usize,
    pub(super) equal: usize,
    pub(super) different: usize,
    pub(super) ended_by_time: usize,
    pub(super) failed: usize,
}

/// Everything that a replay says.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Report {
    pub(super) summary: Summary,
    /// False where a file has no end: it is being written, or its process was killed.
    pub(super) recording_ended: bool,
    pub(super) plans: Vec<Task>,
}

impl Report {
    pub(super) fn new(plans: Vec<Task>, recording_ended: bool) -> Self {
        let count = |verdict| plans.iter().filter(|task| task.verdict == verdict).count();
        let summary = Summary {
            plans: plans.len(),
            equal: count(Verdict::Equal),
            different: count(Verdict::Different),
            ended_by_time: count(Verdict::EndedByTime),
            failed: count(Verdict::Failed),
        };
        Self { summary, recording_ended, plans }
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let header = [
            "call", "task", "hand", "verdict", "grasps", "apart mm", "max mm", "max deg", "best", "ms",
            "note",
        ];
        let mut table = Table::new(&header, 4);
        for task in &self.plans {
            let verdict = match task.verdict {
                Verdict::Equal => "equal",
                Verdict::Different => "DIFFERENT",
                Verdict::EndedByTime => "ended by time",
                Verdict::Failed => "FAILED",
            };
            let apart =
                |value: fn(&Apart) -> String| task.apart.as_ref().map_or_else(|| "-".to_owned(), value);
            let dash = |text: &str| if text.is_empty() { "-".to_owned() } else { text.to_owned() };
            table.row(vec![
                task.call.to_string(),
                dash(&task.task_id),
                dash(&task.hand),
                verdict.to_owned(),
                format!("{}/{}", task.grasps.0, task.grasps.1),
                apart(|a| format!("{:.2}", a.median_mm)),
                apart(|a| format!("{:.2}", a.largest_mm)),
                apart(|a| format!("{:.2}", a.largest_deg)),
                apart(|a| format!("{:+.3}", a.best_score_change)),
                format!("{:.0}/{:.0}", task.milliseconds.0, task.milliseconds.1),
                task.note.clone(),
            ]);
        }
        write!(f, "{table}")?;
        let Summary { plans, equal, different, ended_by_time, failed } = self.summary;
        writeln!(
            f,
            "\n{plans} plans again: {equal} equal bit for bit, {different} different, {ended_by_time} had been ended \
             by a deadline, {failed} failed (grasps and ms: then/now)"
        )?;
        if !self.recording_ended {
            writeln!(
                f,
                "a file has no end: it is being written, or its server was killed; what is whole was read"
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grasp(x: f64, score: f64) -> v1::Grasp {
        let pose = v1::Pose {
            position: Some(v1::Vector3 { x, y: 0.0, z: 0.0 }),
            orientation: Some(v1::Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }),
        };
        let wrist_pose = Some(v1::PoseInFrame { frame_id: "world".to_owned(), pose: Some(pose) });
        v1::Grasp { wrist_pose, score, uncalibrated_score: score, ..Default::default() }
    }

    fn answer(grasps: Vec<v1::Grasp>, budget_exhausted: bool) -> Outcome {
        let stats = v1::PlanStats { budget_exhausted, hand: "hands/leap".to_owned(), ..Default::default() };
        Outcome::Response(v1::PlanGraspsResponse { grasps, stats: Some(stats), ..Default::default() })
    }

    #[test]
    fn verdicts_are_told_apart() {
        let record = v1::PlanRecord::default();
        let task = |then: &Outcome, now: &Outcome| Task::new(0, &record, "", then, Some(now));
        let then = answer(vec![grasp(0.0, 0.9), grasp(0.1, 0.8)], false);
        assert_eq!(task(&then, &then).verdict, Verdict::Equal);
        // Another calibration is no difference of plans.
        let mut calibrated = grasp(0.0, 0.9);
        calibrated.score = 0.3;
        assert_eq!(task(&then, &answer(vec![calibrated, grasp(0.1, 0.8)], false)).verdict, Verdict::Equal);
        let moved = task(&then, &answer(vec![grasp(0.102, 0.7), grasp(0.001, 0.6)], false));
        assert_eq!((moved.verdict, moved.hand.as_str()), (Verdict::Different, "leap"));
        let apart = moved.apart.unwrap();
        assert!((apart.largest_mm - 2.0).abs() < 1e-9 && (apart.best_score_change + 0.2).abs() < 1e-9);
        let late = answer(vec![grasp(0.0, 0.9)], true);
        assert_eq!(task(&late, &then).verdict, Verdict::EndedByTime);
        let error =
            Outcome::Error(v1::TaskError { reason: "HAND_NOT_FOUND".to_owned(), ..Default::default() });
        let failed = task(&then, &error);
        assert_eq!(failed.verdict, Verdict::Failed);
        assert!(failed.note.contains("HAND_NOT_FOUND"), "{}", failed.note);
        let report = Report::new(vec![failed, moved], true);
        assert_eq!(report.summary, Summary { plans: 2, different: 1, failed: 1, ..Summary::default() });
        assert!(report.to_string().contains("1 different"));
    }
}
