//! What people see of a run while it lasts, and the sum of it.

use std::time::Duration;

use tokio::time::Instant;

use super::{ArmState, Lead};
use crate::outcome::{End, Holding};
use crate::record::RecordError;
use crate::sort::report::{ArmReport, SortReport};
use crate::sort::table::{Row, SortEvent, Table};
use crate::sort::worker::Order;

/// Reports of workers are waited for at most so long at the end.
const LAST_WORDS: Duration = Duration::from_secs(120);

impl Lead<'_> {
    pub(super) fn table(&self) -> Table {
        let row = |(i, arm): (usize, &ArmState)| Row {
            arm: self.names[i].clone(),
            hand: self.config.arms[i].hand.id.clone(),
            doing: arm.doing.clone(),
            leased: self.space.holds(i),
            delivered: arm.delivered,
            trials: arm.trials,
        };
        let waiting = self.look.as_ref().map_or(0, |l| l.objects.iter().filter(|o| o.waits).count());
        let rows = self.arms.iter().enumerate().map(row).collect();
        Table { time_s: self.cell.clock.now_s() - self.began_s, rows, looks: self.looks, waiting }
    }

    pub(super) fn show(&mut self) {
        let table = self.table();
        self.observer.on(&SortEvent::Table(&table));
    }

    pub(super) fn note(&mut self, kept: Result<(), RecordError>) {
        if let Err(error) = kept {
            tracing::warn!(%error, "the record is incomplete");
            self.record_trouble.get_or_insert_with(|| error.to_string());
        }
    }

    /// Ends every arm's run and sums up.
    pub(super) async fn end(mut self, end: End) -> SortReport {
        for arm in 0..self.arms.len() {
            self.order(arm, Order::End(end.clone()));
        }
        let deadline = Instant::now() + LAST_WORDS;
        while self.arms.iter().any(|a| a.report.is_none()) {
            match tokio::time::timeout_at(deadline, self.notices.recv()).await {
                Ok(Some((arm, notice))) => self.on(arm, notice),
                _ => break,
            }
        }
        self.workers.shutdown().await;
        let truth = match &self.cell.witness {
            Some(witness) => witness.truth().await,
            None => None,
        };
        let arms = (self.names.iter().zip(&mut self.arms).zip(&self.stations))
            .map(|((name, arm), station)| ArmReport {
                arm: name.clone(),
                report: arm.report.take().unwrap_or_else(|| crate::report::Report {
                    hand: station.facts.id.clone(),
                    hand_revision: station.facts.revision.clone(),
                    end: End::ArmLost { why: "it said no last word".to_owned() },
                    holding: Holding::Unknown,
                    tally: crate::report::Tally::default(),
                    duration_s: self.began.elapsed().as_secs_f64(),
                    record_trouble: None,
                }),
                time: arm.time,
                lost: arm.lost,
                came_back: arm.came_back,
            })
            .collect();
        let mut report = SortReport {
            end,
            arms,
            looks: self.looks,
            looks_past_arms: self.looks_past_arms,
            over_tray_s: std::mem::take(&mut self.over_tray_s),
            assignments: self.assignments,
            together: self.together,
            plan_s: std::mem::take(&mut self.plan_s),
            assign_s: std::mem::take(&mut self.assign_s),
            duration_s: self.began.elapsed().as_secs_f64(),
            truth,
            record_trouble: None,
        };
        let kept = self.recorder.as_ref().map_or(Ok(()), |r| r.finish(&report));
        self.note(kept);
        report.record_trouble.clone_from(&self.record_trouble);
        report
    }
}
