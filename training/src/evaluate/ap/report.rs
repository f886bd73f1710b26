//! What a measurement of average precision found, as numbers and as tables.

use graspd_planner::grasp::PlanStats;
use graspd_planner::options::VolumeKind;
use serde::{Deserialize, Serialize};

use super::jaw::Verdict;
use super::precision::Precision;
use crate::evaluate::statistics::{mean, quantile};
use crate::evaluate::table::Table;

/// What one kind of volume gave.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VolumeResult {
    /// `tsdf` or `occupancy`.
    pub volume: String,
    /// AP.
    pub precision: Precision,
    /// Grasps that were scored, mean over views.
    pub grasps: f64,
    /// Scored grasps that collide, are empty, have no force closure at any friction, and that hold at some;
    /// shares of the scored.
    pub shares: [f64; 4],
    /// From the frame to the grasps, on one thread, median, milliseconds.
    pub planning_median_ms: f64,
    /// What the refinement left, and what the optimization took.
    pub figures: ViewFigures,
}

/// Figures of the planning of one view, or their means over views.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ViewFigures {
    /// `N_fc`.
    pub focal_contacts: f64,
    /// `N_fe`.
    pub focal_centroids: f64,
    /// `N_ee`.
    pub centered_centroids: f64,
    /// `T_time`: the optimization's time for every 100 iterations, on one thread, milliseconds; 0 where nothing was
    /// optimized.
    pub per_100_iterations_ms: f64,
}

impl ViewFigures {
    /// Of one plan.
    pub(super) fn of(stats: &PlanStats) -> Self {
        let optimize = stats.stages.iter().find(|(stage, _)| *stage == "optimize");
        let hundreds = stats.iterations as f64 / 100.0;
        Self {
            focal_contacts: stats.focal_contacts as f64,
            focal_centroids: stats.focal_centroids as f64,
            centered_centroids: stats.centered_centroids as f64,
            per_100_iterations_ms: optimize
                .map_or(0.0, |(_, time)| time.as_secs_f64() * 1e3 / hundreds.max(0.01)),
        }
    }

    fn mean(all: &[Self]) -> Self {
        let of = |figure: fn(&Self) -> f64| mean(&all.iter().map(figure).collect::<Vec<_>>()).unwrap_or(0.0);
        Self {
            focal_contacts: of(|f| f.focal_contacts),
            focal_centroids: of(|f| f.focal_centroids),
            centered_centroids: of(|f| f.centered_centroids),
            per_100_iterations_ms: of(|f| f.per_100_iterations_ms),
        }
    }
}

/// All kinds of volumes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ApReport {
    /// What was measured, one condition a line.
    pub conditions: Vec<String>,
    /// One entry for each kind of volume.
    pub volumes: Vec<VolumeResult>,
}

impl VolumeResult {
    /// From the verdicts and the planning times (milliseconds) of all views with one kind of volume.
    pub(super) fn of(
        kind: VolumeKind,
        verdicts: &[Vec<Verdict>],
        times_ms: &[f64],
        figures: &[ViewFigures],
    ) -> Self {
        let all: Vec<Verdict> = verdicts.concat();
        let share =
            |is: fn(&Verdict) -> bool| all.iter().filter(|v| is(v)).count() as f64 / all.len().max(1) as f64;
        let counts: Vec<f64> = verdicts.iter().map(|v| v.len() as f64).collect();
        Self {
            volume: name(kind).to_owned(),
            precision: Precision::of(verdicts),
            grasps: mean(&counts).unwrap_or(0.0),
            shares: [
                share(|v| matches!(v, Verdict::Collision)),
                share(|v| matches!(v, Verdict::Empty)),
                share(|v| matches!(v, Verdict::NoClosure)),
                share(|v| matches!(v, Verdict::Holds { .. })),
            ],
            planning_median_ms: quantile(times_ms, 0.5).unwrap_or(0.0),
            figures: ViewFigures::mean(figures),
        }
    }
}

pub(super) fn name(kind: VolumeKind) -> &'static str {
    match kind {
        VolumeKind::Tsdf => "tsdf",
        VolumeKind::Occupancy => "occupancy",
    }
}

impl ApReport {
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
        let frictions = self.volumes.first().map_or_else(Vec::new, |v| v.precision.by_friction.clone());
        let header = ["volume".to_owned()]
            .into_iter()
            .chain(frictions.iter().map(|(mu, _)| format!("AP_{mu:.1}")))
            .chain(["AP (0.2–1.0)", "AP (0.2–1.2)"].map(str::to_owned));
        let mut precision = Table::new(header);
        let mut why = Table::new([
            "volume",
            "grasps scored",
            "collision",
            "empty",
            "no closure",
            "holds at some µ",
            "planning median ms",
        ]);
        for v in &self.volumes {
            let values = v.precision.by_friction.iter().map(|(_, ap)| format!("{ap:.2}"));
            let averages = [v.precision.ap, v.precision.ap_six].map(|ap| format!("{ap:.2}"));
            precision.row(std::iter::once(v.volume.clone()).chain(values).chain(averages));
            let shares = v.shares.map(|s| format!("{:.1}%", 100.0 * s));
            let row = [v.volume.clone(), format!("{:.1}", v.grasps)];
            let time = [format!("{:.0}", v.planning_median_ms)];
            why.row(row.into_iter().chain(shares).chain(time));
        }
        out += &format!("\n{}\n{}", table(&precision), table(&why));
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_of_all_scored_grasps_and_tables_name_every_friction() {
        let views =
            [vec![Verdict::Collision, Verdict::Holds { friction: 0.2 }], vec![Verdict::Empty], vec![]];
        let result = VolumeResult::of(VolumeKind::Occupancy, &views, &[30.0, 10.0, 20.0], &[]);
        assert_eq!((result.grasps, result.planning_median_ms), (1.0, 20.0));
        let third = 1.0 / 3.0;
        assert_eq!(result.shares, [third, third, 0.0, third]);
        let report = ApReport { conditions: vec!["how".into()], volumes: vec![result] };
        assert!(report.text().starts_with("how\n") && report.markdown().starts_with("- how\n"));
        for column in ["AP_0.2", "AP_1.2", "AP (0.2–1.0)", "no closure", "occupancy"] {
            assert!(report.text().contains(column), "{column}");
        }
    }
}
