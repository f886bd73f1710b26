//! Counting attempts.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::outcome::{FailureClass, Outcome};
use crate::record::AttemptRecord;

/// Everything counted. Attempts are `successes + failures + not_executed + unknown`, always.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tally {
    /// Attempts that ended.
    pub attempts: u32,
    /// Grasp trials: attempts whose straight approach began (Supplementary Note 7: grasp execution times).
    pub trials: u32,
    /// Objects picked from the tray and dropped at the targeted place, one for each such trial.
    pub successes: u32,
    /// Trials in which the hand felt the object at the drop pose.
    pub felt: u32,
    /// Failed trials by class.
    pub failures: BTreeMap<FailureClass, u32>,
    /// Attempts that executed nothing.
    pub not_executed: u32,
    /// Attempts of which nobody knows how they ended.
    pub unknown: u32,
    /// Failed trials since the last success.
    pub failures_in_a_row: u32,
    /// Objects that a witness saw arrive; and that lie elsewhere, in the tray and in the hand at the end. The four sum to
    /// the objects of the run.
    pub delivered: Option<u32>,
    /// See [`Tally::delivered`].
    pub lost: Option<u32>,
    /// See [`Tally::delivered`].
    pub in_tray: Option<u32>,
    /// See [`Tally::delivered`].
    #[serde(default)]
    pub in_hand: Option<u32>,
    /// Names of the objects that lie in the tray at the end, where a witness knows them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub remaining: Vec<String>,
    /// Planning time of each answer, as the server measured it, seconds.
    pub plan_s: Vec<f64>,
    /// Trouble met and mended.
    pub troubles: u32,
    /// Grasps that were left out before anything moved, because the arm does not reach them.
    #[serde(default)]
    pub out_of_reach: u32,
    /// Why the last of them was: the motion that the arm would refuse, and its words.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub last_out_of_reach: Option<String>,
    /// The last failure.
    pub last_failure: Option<String>,
}

impl Tally {
    /// Counts an attempt that ended.
    pub fn add(&mut self, record: &AttemptRecord) {
        self.attempts += 1;
        self.trials += u32::from(record.trial);
        self.felt += u32::from(record.felt);
        self.troubles += record.steps.iter().map(|s| s.troubles.len() as u32).sum::<u32>();
        self.out_of_reach += u32::try_from(record.out_of_reach.len()).unwrap_or(u32::MAX);
        if let Some(last) = record.out_of_reach.last() {
            self.last_out_of_reach = Some(format!("to its {}: {}", last.to, last.why));
        }
        self.plan_s.extend(record.answer.iter().map(|a| a.plan_s));
        if let Some(seen) = &record.witnessed {
            *self.delivered.get_or_insert(0) += seen.delivered;
            self.lost = Some(seen.lost);
            self.in_tray = Some(seen.in_tray);
            self.in_hand = Some(seen.in_hand);
            self.remaining.clone_from(&seen.remaining);
        }
        match &record.outcome {
            Outcome::Success => {
                self.successes += 1;
                self.failures_in_a_row = 0;
            }
            Outcome::Failed { class, why } => {
                *self.failures.entry(*class).or_default() += 1;
                self.failures_in_a_row += 1;
                self.last_failure = Some(format!("{}: {why}", class.name()));
            }
            // An empty tray is no failure; a run that ends without a grasp says why in its end.
            Outcome::NotExecuted { .. } => self.not_executed += 1,
            Outcome::Unknown { why } => {
                self.unknown += 1;
                self.last_failure = Some(why.clone());
            }
        }
    }

    /// Success rate: successful grasps / grasp trials (Supplementary Note 7); `None` without a trial.
    pub fn rate(&self) -> Option<f64> {
        (self.trials > 0).then(|| f64::from(self.successes) / f64::from(self.trials))
    }

    /// Median planning time, seconds.
    pub fn median_plan_s(&self) -> Option<f64> {
        let mut sorted = self.plan_s.clone();
        sorted.sort_by(f64::total_cmp);
        sorted.get(sorted.len() / 2).copied()
    }
}
