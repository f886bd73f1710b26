//! What a calibration prints: each hand's curve, and how true stated probabilities are on trays it was not fitted on.

use graspd_hands::Confidence;
use graspd_planner::grasp::BETTER_NOT;
use serde::{Deserialize, Serialize};

use super::collect::Sample;
use super::fit::{fit_hands, fit_together};
use super::reliability::{Reliability, reliability};
use crate::evaluate::statistics::wilson;
use crate::evaluate::table::Table;

/// Bins of the curve over all hands.
const BINS: usize = 10;
/// Bins of one hand's curve: there are fewer grasps.
const BINS_OF_A_HAND: usize = 5;

/// One hand's curve and what came of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct HandFit {
    /// Id of the hand; `None` for all hands together.
    pub hand: Option<String>,
    /// Log-odds per unit of figure; absent where there was too little to fit.
    pub slope: Option<f64>,
    /// Log-odds of a figure of 0.
    pub intercept: Option<f64>,
    /// Grasps that the curve was fitted on.
    pub fitted_on: usize,
    /// Share of grasps that held, on the trays that it is checked on.
    pub held: f64,
    /// How true the stated probabilities are there.
    pub reliability: Reliability,
}

/// A calibration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CalibrationReport {
    /// What was measured, and how.
    pub conditions: Vec<String>,
    /// Each hand with a curve of its own.
    pub hands: Vec<HandFit>,
    /// One curve for all hands, for hands that have none of their own.
    pub generic: HandFit,
    /// Every hand's grasps judged by its own curve, all together.
    pub together: Reliability,
    /// The probabilities that this build of graspd states, all hands together.
    pub stated: Reliability,
    /// Of checked grasps under the threshold of advice: how many, and how many held.
    pub better_not: [usize; 2],
    /// Of checked grasps at or above it.
    pub advised: [usize; 2],
}

impl CalibrationReport {
    /// Fits on one set of executions and checks on another.
    pub fn new(conditions: Vec<String>, fitted: &[Sample], checked: &[Sample]) -> Self {
        let mut ids: Vec<&str> = Vec::new();
        for sample in fitted.iter().chain(checked) {
            if !ids.contains(&sample.hand.as_str()) {
                ids.push(&sample.hand);
            }
        }
        let generic_curve = fit_together(fitted);
        let curves = fit_hands(fitted);
        let mut together = Vec::new();
        let hands = ids
            .iter()
            .map(|&id| {
                let fitted_on = fitted.iter().filter(|s| s.hand == id).count();
                let unseen: Vec<&Sample> = checked.iter().filter(|s| s.hand == id).collect();
                let curve = curves.get(id).copied();
                let outcomes = outcomes(&unseen, curve.or(generic_curve));
                together.extend_from_slice(&outcomes);
                hand_fit(Some(id.to_owned()), curve, fitted_on, &outcomes, BINS_OF_A_HAND)
            })
            .collect();
        let all: Vec<&Sample> = checked.iter().collect();
        let generic = hand_fit(None, generic_curve, fitted.len(), &outcomes(&all, generic_curve), BINS);
        let stated: Vec<(f64, bool)> = checked.iter().map(|s| (s.score, s.held())).collect();
        let count = |low: bool| {
            let of: Vec<&(f64, bool)> = together.iter().filter(|o| (o.0 < BETTER_NOT) == low).collect();
            [of.len(), of.iter().filter(|o| o.1).count()]
        };
        Self {
            conditions,
            hands,
            generic,
            stated: reliability(&stated, BINS),
            better_not: count(true),
            advised: count(false),
            together: reliability(&together, BINS),
        }
    }

    /// What is to be put into the `hand.toml` of a hand.
    pub fn toml(&self, hand: &str) -> Option<String> {
        let own = self.hands.iter().find(|h| h.hand.as_deref() == Some(hand))?;
        Some(format!("[confidence]\nslope = {:.2}\nintercept = {:.2}\n", own.slope?, own.intercept?))
    }

    /// The tables as plain text.
    pub fn text(&self) -> String {
        let mut out: String = self.conditions.iter().map(|c| format!("{c}\n")).collect();
        for (title, table) in self.tables() {
            out += &format!("\n{title}\n\n{}", table.text());
        }
        out + "\n" + &self.advice()
    }

    /// The tables as Markdown.
    pub fn markdown(&self) -> String {
        let mut out: String = self.conditions.iter().map(|c| format!("- {c}\n")).collect();
        for (title, table) in self.tables() {
            out += &format!("\n{title}:\n\n{}", table.markdown());
        }
        out + "\n" + &self.advice()
    }

    fn advice(&self) -> String {
        let share =
            |[n, held]: [usize; 2]| format!("{held} of {n} held ({:.1} %)", 100.0 * wilson(held, n).rate);
        format!(
            "Under {BETTER_NOT}, \"better not\": {}. From there on: {}.\n",
            share(self.better_not),
            share(self.advised)
        )
    }

    fn tables(&self) -> [(String, Table); 2] {
        let number = |v: Option<f64>| v.map_or_else(|| "–".to_owned(), |v| format!("{v:.2}"));
        let mut curves = Table::new([
            "hand",
            "fitted on",
            "slope",
            "intercept",
            "checked on",
            "held",
            "ECE",
            "ECE by chance",
            "Brier",
        ]);
        for fit in self.hands.iter().chain([&self.generic]) {
            let r = &fit.reliability;
            curves.row([
                fit.hand.clone().unwrap_or_else(|| "all, one curve".to_owned()),
                fit.fitted_on.to_string(),
                number(fit.slope),
                number(fit.intercept),
                r.bins.iter().map(|b| b.count).sum::<usize>().to_string(),
                format!("{:.1}%", 100.0 * fit.held),
                format!("{:.3}", r.error),
                format!("{:.3}", r.by_chance),
                format!("{:.3}", r.brier),
            ]);
        }
        for (name, r) in [("all, own curves", &self.together), ("all, as this build states", &self.stated)] {
            let n: usize = r.bins.iter().map(|b| b.count).sum();
            let held: f64 = r.bins.iter().map(|b| b.held.rate * b.count as f64).sum();
            curves.row([
                name.to_owned(),
                String::new(),
                String::new(),
                String::new(),
                n.to_string(),
                format!("{:.1}%", 100.0 * held / n.max(1) as f64),
                format!("{:.3}", r.error),
                format!("{:.3}", r.by_chance),
                format!("{:.3}", r.brier),
            ]);
        }
        let mut bins = Table::new(["stated (mean)", "grasps", "held", "95 %"]);
        for bin in &self.together.bins {
            bins.row([
                format!("{:.3}", bin.stated),
                bin.count.to_string(),
                format!("{:.1}%", 100.0 * bin.held.rate),
                format!("{:.1}–{:.1}%", 100.0 * bin.held.low, 100.0 * bin.held.high),
            ]);
        }
        [
            ("Curves, checked on other trays with other objects".to_owned(), curves),
            ("Reliability, every hand by its own curve".to_owned(), bins),
        ]
    }
}

fn outcomes(samples: &[&Sample], curve: Option<Confidence>) -> Vec<(f64, bool)> {
    samples.iter().map(|s| (curve.map_or(s.score, |c| c.probability(s.figure)), s.held())).collect()
}

fn hand_fit(
    hand: Option<String>,
    curve: Option<Confidence>,
    fitted_on: usize,
    outcomes: &[(f64, bool)],
    bins: usize,
) -> HandFit {
    let held = outcomes.iter().filter(|o| o.1).count() as f64 / outcomes.len().max(1) as f64;
    HandFit {
        hand,
        slope: curve.map(|c| c.slope),
        intercept: curve.map(|c| c.intercept),
        fitted_on,
        held,
        reliability: reliability(outcomes, bins),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::{Class, Setup};

    /// Of a hand that holds as often as its figure says, shifted.
    fn of(hand: &str, offset: usize, shift: f64) -> Vec<Sample> {
        let golden = 0.618_033_988_749_894_9;
        (0..400)
            .map(|i| {
                let figure = i as f64 / 400.0;
                let chance = ((i + offset) as f64 * golden).fract();
                let held = chance < Confidence { slope: 8.0, intercept: shift }.probability(figure);
                let class = if held { Class::Success } else { Class::LostClosing };
                let (hand, setup) = (hand.to_owned(), Setup::Clutter);
                Sample { hand, setup, run: i / 10, rank: i % 10, figure, score: figure, class }
            })
            .collect()
    }

    #[test]
    fn every_hand_gets_its_own_curve_and_true_probabilities() {
        let fitted = [of("easy", 0, 0.0), of("hard", 7, -4.0)].concat();
        let checked = [of("easy", 31, 0.0), of("hard", 53, -4.0)].concat();
        let report = CalibrationReport::new(vec!["test".into()], &fitted, &checked);
        assert!(report.hands[0].intercept > report.hands[1].intercept);
        assert!(report.together.error < 0.03, "{:?}", report.together);
        assert!(report.stated.error > 0.1, "the figure itself is no probability");
        let toml = report.toml("hard").unwrap();
        assert!(toml.starts_with("[confidence]\nslope = ") && report.toml("nobody").is_none(), "{toml}");
        let [n, held] = report.better_not;
        assert!(held * 2 < n && report.advised[0] + n == checked.len());
        assert!(report.text().contains("all, own curves") && report.markdown().contains("| easy"));
    }

    #[test]
    fn a_hand_without_samples_to_fit_is_judged_by_the_curve_of_all() {
        let report = CalibrationReport::new(vec![], &of("known", 0, -4.0), &of("new", 3, -4.0));
        let new = report.hands.iter().find(|h| h.hand.as_deref() == Some("new")).unwrap();
        assert!(new.slope.is_none() && report.toml("new").is_none());
        assert!(new.reliability.error < 0.05, "{:?}", new.reliability);
    }
}
