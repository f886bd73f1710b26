//! The thresholds of the refinement by grid search, laid out as Supplementary Table 1 is.

use graspd_planner::estimator::ContactEstimator;
use graspd_planner::options::VolumeKind;
use serde::{Deserialize, Serialize};

use super::report::{VolumeResult, name};
use super::run::{ApSettings, average};
use crate::evaluate::EvaluationError;
use crate::evaluate::table::Table;

/// `T_fc` of Supplementary Note 3.
pub const FOCAL_CONTACT: [f64; 4] = [0.5, 0.6, 0.7, 0.8];
/// `T_fe` of Supplementary Note 3.
pub const FOCAL_CENTROID: [f64; 6] = [0.80, 0.90, 0.94, 0.95, 0.96, 0.97];

/// One pair of thresholds with one kind of volume.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ThresholdCell {
    /// `T_fc`.
    pub focal_contact: f64,
    /// `T_fe`.
    pub focal_centroid: f64,
    /// What was measured with them.
    pub result: VolumeResult,
}

/// The grid of both kinds of volume.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ThresholdReport {
    /// What was measured, one condition a line.
    pub conditions: Vec<String>,
    /// Every pair.
    pub cells: Vec<ThresholdCell>,
}

/// Measures AP for every pair of thresholds, on the same scenes; those of `settings` are not looked at. `seen` is told
/// after each view how many of how many are done; it is called from several threads.
///
/// # Errors
/// As [`average`], and for a grid without a threshold.
pub fn thresholds(
    settings: &ApSettings,
    focal_contact: &[f64],
    focal_centroid: &[f64],
    estimator: &dyn ContactEstimator,
    conditions: Vec<String>,
    seen: &(dyn Fn(usize, usize) + Sync),
) -> Result<ThresholdReport, EvaluationError> {
    for (field, values) in [("t_fc", focal_contact), ("t_fe", focal_centroid)] {
        let wrong = values.iter().find(|v| !(0.0..=1.0).contains(*v));
        if wrong.is_some() || values.is_empty() {
            let found = wrong.map_or_else(|| "no value".to_owned(), f64::to_string);
            return Err(EvaluationError::Setting { field, found, expected: "shares from 0 to 1".into() });
        }
    }
    let pairs = focal_contact.len() * focal_centroid.len();
    let mut cells = Vec::new();
    for &contact in focal_contact {
        for &centroid in focal_centroid {
            let before = cells.len() / settings.volumes.len().max(1);
            let told = |done: usize, all: usize| seen(before * all + done, pairs * all);
            let here = ApSettings { thresholds: [contact, centroid], ..settings.clone() };
            let report = average(&here, estimator, Vec::new(), &told)?;
            cells.extend(report.volumes.into_iter().map(|result| ThresholdCell {
                focal_contact: contact,
                focal_centroid: centroid,
                result,
            }));
        }
    }
    Ok(ThresholdReport { conditions, cells })
}

impl ThresholdReport {
    /// For people at a terminal.
    pub fn text(&self) -> String {
        self.render(Table::text, "")
    }

    /// For the documentation.
    pub fn markdown(&self) -> String {
        self.render(Table::markdown, "- ")
    }

    fn render(&self, table: fn(&Table) -> String, bullet: &str) -> String {
        let mut out: String = self.conditions.iter().map(|c| format!("{bullet}{c}\n")).collect();
        for kind in [VolumeKind::Tsdf, VolumeKind::Occupancy] {
            let cells: Vec<&ThresholdCell> =
                self.cells.iter().filter(|c| c.result.volume == name(kind)).collect();
            if !cells.is_empty() {
                out += &format!("\nVolumetric type: {}\n\n{}", name(kind), table(&grid(&cells)));
            }
        }
        out
    }
}

/// `T_fc` across, `T_fe` down with its means of `N_fe/N_ee`; above them `N_fc` and the optimization's time.
fn grid(cells: &[&ThresholdCell]) -> Table {
    let distinct = |value: fn(&ThresholdCell) -> f64| {
        let mut values: Vec<f64> = cells.iter().map(|c| value(c)).collect();
        values.sort_by(f64::total_cmp);
        values.dedup();
        values
    };
    let (across, down) = (distinct(|c| c.focal_contact), distinct(|c| c.focal_centroid));
    let mean = |of: &dyn Fn(&ThresholdCell) -> Option<f64>| {
        let values: Vec<f64> = cells.iter().filter_map(|c| of(c)).collect();
        values.iter().sum::<f64>() / values.len().max(1) as f64
    };
    let mut table = Table::new(
        std::iter::once("T_fe (N_fe/N_ee) \\ T_fc".to_owned()).chain(across.iter().map(f64::to_string)),
    );
    let of_column = |figure: fn(&ThresholdCell) -> f64| {
        across.iter().map(move |&t| mean(&|c| (c.focal_contact == t).then(|| figure(c)))).collect::<Vec<_>>()
    };
    let row = |head: &str, values: Vec<f64>, digits: usize| {
        std::iter::once(head.to_owned())
            .chain(values.into_iter().map(|v| format!("{v:.digits$}")))
            .collect::<Vec<_>>()
    };
    table.row(row("N_fc", of_column(|c| c.result.figures.focal_contacts), 1));
    table.row(row("T_time (ms per 100)", of_column(|c| c.result.figures.per_100_iterations_ms), 1));
    for &t in &down {
        let of_row =
            |figure: fn(&ThresholdCell) -> f64| mean(&|c| (c.focal_centroid == t).then(|| figure(c)));
        let head = format!(
            "{t} ({:.1}/{:.1})",
            of_row(|c| c.result.figures.focal_centroids),
            of_row(|c| c.result.figures.centered_centroids)
        );
        let precision = across.iter().map(|&a| {
            let here = |c: &ThresholdCell| c.focal_contact == a && c.focal_centroid == t;
            mean(&|c| here(c).then_some(c.result.precision.ap))
        });
        table.row(row(&head, precision.collect(), 2));
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::ap::{Verdict, ViewFigures};

    fn cell(contact: f64, centroid: f64, verdict: Verdict) -> ThresholdCell {
        let figures = ViewFigures {
            focal_contacts: 1000.0 * contact,
            focal_centroids: 100.0 * centroid,
            centered_centroids: 3.0,
            per_100_iterations_ms: 40.0,
        };
        let result = VolumeResult::of(VolumeKind::Tsdf, &[vec![verdict; 50]], &[1.0], &[figures]);
        ThresholdCell { focal_contact: contact, focal_centroid: centroid, result }
    }

    #[test]
    fn every_pair_stands_in_its_row_and_column() {
        let holds = Verdict::Holds { friction: 0.2 };
        let cells = vec![
            cell(0.5, 0.8, holds),
            cell(0.5, 0.95, Verdict::Empty),
            cell(0.7, 0.8, Verdict::Empty),
            cell(0.7, 0.95, holds),
        ];
        let report = ThresholdReport { conditions: vec!["how".into()], cells };
        let text = report.text();
        let words = |head: &str| -> Vec<String> {
            let line = text.lines().find(|l| l.starts_with(head)).unwrap();
            line.split_whitespace().rev().take(2).map(str::to_owned).collect()
        };
        assert_eq!(words("N_fc"), ["700.0", "500.0"]);
        assert_eq!(words("0.8 (80.0/3.0)"), ["0.00", "100.00"]);
        assert_eq!(words("0.95 (95.0/3.0)"), ["100.00", "0.00"]);
        assert!(text.contains("Volumetric type: tsdf") && !text.contains("occupancy"), "{text}");
    }
}
