//! What became of grasps: the last report for each, and how many succeeded.

use std::collections::BTreeMap;
use std::fmt;

use graspd_proto::v1;
use graspd_recording::Recording;
use serde::Serialize;

use crate::output::table::Table;

/// What is known of one grasp that was reported.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Reported {
    pub(crate) plan_id: String,
    pub(crate) grasp_index: i32,
    pub(crate) hand: String,
    /// In lower case, for example `lost_lifting`.
    pub(crate) outcome: String,
    /// None: it says nothing about the grasp.
    pub(crate) succeeded: Option<bool>,
    pub(crate) uncalibrated_score: f64,
    pub(crate) score: f64,
    pub(crate) calibration: String,
    pub(crate) note: String,
    /// Its plan is in the recording.
    pub(crate) plan_is_recorded: bool,
}

/// The last report for each grasp, in the order of the first reports.
pub(crate) fn listed(recording: &Recording) -> Vec<Reported> {
    let mut recorded = std::collections::BTreeSet::new();
    for result in recording.plans.iter().flat_map(|plan| &plan.results) {
        if let Some(v1::hand_task_result::Outcome::Response(answer)) = &result.outcome {
            recorded.insert(answer.plan_id.as_str());
        }
    }
    let mut at: BTreeMap<(String, i32), usize> = BTreeMap::new();
    let mut listed: Vec<Reported> = Vec::new();
    for outcome in &recording.outcomes {
        let Some(report) = &outcome.report else { continue };
        let name = report.outcome().as_str_name().trim_start_matches("GRASP_OUTCOME_").to_lowercase();
        let reported = Reported {
            plan_id: report.plan_id.clone(),
            grasp_index: report.grasp_index,
            hand: outcome.hand.trim_start_matches("hands/").to_owned(),
            outcome: name,
            succeeded: match report.outcome() {
                v1::GraspOutcome::Success => Some(true),
                v1::GraspOutcome::Unspecified | v1::GraspOutcome::NotExecuted => None,
                _ => Some(false),
            },
            uncalibrated_score: outcome.uncalibrated_score,
            score: outcome.score,
            calibration: outcome.calibration.clone(),
            note: report.note.clone(),
            plan_is_recorded: recorded.contains(report.plan_id.as_str()),
        };
        let key = (report.plan_id.clone(), report.grasp_index);
        match at.get(&key).and_then(|&i| listed.get_mut(i)) {
            Some(earlier) => *earlier = reported,
            None => {
                at.insert(key, listed.len());
                listed.push(reported);
            }
        }
    }
    listed
}

/// The list for people.
pub(crate) struct Text<'a>(pub(crate) &'a [Reported]);

impl fmt::Display for Text<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.is_empty() {
            return writeln!(f, "no outcomes were reported");
        }
        let mut table = Table::new(&["plan", "hand", "outcome", "grasp", "score", "uncalibrated", "note"], 3);
        for r in self.0 {
            let plan = if r.plan_is_recorded { r.plan_id.clone() } else { format!("({})", r.plan_id) };
            table.row(vec![
                plan,
                r.hand.clone(),
                r.outcome.clone(),
                r.grasp_index.to_string(),
                format!("{:.3}", r.score),
                format!("{:.3}", r.uncalibrated_score),
                r.note.escape_debug().to_string(),
            ]);
        }
        write!(f, "{table}")?;
        let mut hands: BTreeMap<&str, (usize, usize)> = BTreeMap::new();
        for r in self.0 {
            let (tried, succeeded) = hands.entry(&r.hand).or_default();
            *tried += usize::from(r.succeeded.is_some());
            *succeeded += usize::from(r.succeeded == Some(true));
        }
        writeln!(f)?;
        for (hand, (tried, succeeded)) in hands {
            writeln!(f, "{hand}: {succeeded} of {tried} executed grasps succeeded")?;
        }
        if self.0.iter().any(|r| !r.plan_is_recorded) {
            writeln!(f, "(plan): it is not, or not any more, in the recording")?;
        }
        Ok(())
    }
}
