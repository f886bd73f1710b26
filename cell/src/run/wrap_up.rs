//! Ending attempts and the run: counted once, recorded once.

use std::fmt::Display;

use super::Run;
use super::attempt::Attempt;
use super::calls::{Problem, Who, seconds};
use crate::observer::Event;
use crate::outcome::{End, FailureClass, Holding, Outcome};
use crate::record::AttemptRecord;
use crate::report::Report;
use crate::witness::Witnessed;

impl Run<'_> {
    /// Counts and records the attempt; what it means for the run.
    pub(super) async fn finish_attempt(&mut self, outcome: Outcome) -> Option<End> {
        let record = self.count(outcome).await;
        let rules = &self.config.recovery;
        match record.outcome {
            Outcome::Success => {
                self.failed_poses.clear();
                self.idle_since_success = 0;
            }
            Outcome::Failed { .. } => {
                self.failed_poses.extend(record.chosen.iter().map(|c| c.grasp.world_from_hand.isometry()));
            }
            Outcome::NotExecuted { ref why } if self.empty_frames == 0 => {
                self.idle_attempts += 1;
                self.idle_since_success = self.idle_since_success.saturating_add(1);
                if self.idle_attempts >= rules.no_grasp_frames {
                    return Some(End::NoGrasp { why: why.clone() });
                }
            }
            Outcome::NotExecuted { .. } | Outcome::Unknown { .. } => {}
        }
        if self.empty_frames >= rules.empty_frames {
            return Some(End::Empty);
        }
        if self.tally.failures_in_a_row >= rules.failures_in_a_row {
            let last = self.tally.last_failure.clone().unwrap_or_default();
            return Some(End::Failures { last });
        }
        None
    }

    async fn count(&mut self, outcome: Outcome) -> AttemptRecord {
        let next = Attempt::new(self.attempt.number);
        let attempt = std::mem::replace(&mut self.attempt, next);
        let witnessed = self.ask_witness(attempt.number).await;
        let outcome = with_witness(outcome, attempt.trial, witnessed.as_ref());
        let record = attempt.record(outcome, witnessed);
        self.tally.add(&record);
        if let Some(mut recorder) = self.recorder.take() {
            let kept = recorder.attempt(&record);
            self.recorder = Some(recorder);
            self.note(kept);
        }
        self.observer.on(&Event::AttemptEnded { record: &record, tally: &self.tally });
        record
    }

    async fn ask_witness(&self, attempt: u32) -> Option<Witnessed> {
        let witness = self.cell.witness.as_ref()?;
        // A witness may let its world come to rest first; one that never answers saw nothing.
        tokio::time::timeout(seconds(self.config.timeouts.move_s), witness.outcome(attempt)).await.ok()?
    }

    /// Ends the run: no attempt stays uncounted, and what is in the hand is told.
    pub(super) async fn end(mut self, end: End) -> Report {
        self.close_step(false);
        if end.needs_person() {
            // Where it stands; an arm that cannot be stopped is one of the reasons to be here.
            let _ = self.stop_arm().await;
        }
        if self.holding != Holding::Nothing
            && let Ok(feels) = self.feels().await
        {
            self.holding = if feels { Holding::Object } else { Holding::Nothing };
        }
        if !self.attempt.steps.is_empty() {
            let outcome = self.cut_short(&end);
            self.count(outcome).await;
        }
        let report = Report {
            hand: self.facts.id.clone(),
            hand_revision: self.facts.revision.clone(),
            end,
            holding: self.holding,
            tally: self.tally.clone(),
            duration_s: self.began.elapsed().as_secs_f64(),
            record_trouble: self.record_trouble.clone(),
        };
        if let Some(recorder) = self.recorder.take() {
            let kept = recorder.finish(&report);
            self.note(kept);
        }
        let report = Report { record_trouble: self.record_trouble.clone(), ..report };
        self.observer.on(&Event::Ended(&report));
        report
    }

    /// Counts an attempt that an end has cut short, for an arm that comes back from it.
    pub(super) async fn count_cut_short(&mut self) {
        self.close_step(false);
        if !self.attempt.steps.is_empty() {
            let outcome = self.cut_short(&End::Asked);
            let number = self.attempt.number;
            self.count(outcome).await;
            self.attempt = Attempt::new(number + 1);
        }
    }

    /// Clears the faults of arm and hand.
    pub(super) async fn clear_faults(&mut self) -> Result<(), Problem> {
        self.clear_fault(Who::Arm).await?;
        self.clear_fault(Who::Hand).await
    }

    /// The outcome of an attempt that the end of the run cut short.
    fn cut_short(&mut self, end: &End) -> Outcome {
        let why = end.to_string();
        match self.attempt.failed.take() {
            _ if !self.attempt.trial => Outcome::NotExecuted { why },
            _ if self.holding != Holding::Nothing => Outcome::Unknown { why },
            Some((class, why)) => Outcome::Failed { class, why },
            None => Outcome::Failed { class: FailureClass::Device, why },
        }
    }

    /// Trouble with the record is told and does not stop the arm: the objects matter more.
    pub(super) fn note<E: Display>(&mut self, kept: Result<(), E>) {
        if let Err(error) = kept {
            tracing::warn!(%error, "the record is incomplete");
            self.record_trouble.get_or_insert_with(|| error.to_string());
        }
    }
}

/// A witness's word stands above what the hand felt (Supplementary Note 7: a trial is successful when an object is
/// picked from the tray and dropped to the targeted place).
fn with_witness(outcome: Outcome, trial: bool, witnessed: Option<&Witnessed>) -> Outcome {
    match (outcome, witnessed) {
        (Outcome::Success, Some(seen)) if seen.delivered == 0 => Outcome::Failed {
            class: FailureClass::NotDelivered,
            why: "the hand felt an object to the end, but none arrived".to_owned(),
        },
        (Outcome::Failed { .. }, Some(seen)) if trial && seen.delivered > 0 => Outcome::Success,
        (outcome, _) => outcome,
    }
}
