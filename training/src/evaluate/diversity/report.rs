//! What a measurement of diversity prints: Supplementary Table 3, and how far two sources' grasps agree.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::pattern::Pattern;
use super::run::HandPatterns;
use super::spread::{directions_share, reached_m3, same_directions, same_places};
use crate::evaluate::table::Table;

/// A mean with what it may be off by: 1.96 standard errors, scenes taken as independent and grasps of one scene not.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Mean {
    /// The mean of all grasps.
    pub mean: f64,
    /// 1.96 standard errors.
    pub within: f64,
}

impl Mean {
    fn of(patterns: &[Pattern], value: impl Fn(&Pattern) -> f64) -> Self {
        let mut scenes: BTreeMap<usize, (f64, f64)> = BTreeMap::new();
        for pattern in patterns {
            let sum = scenes.entry(pattern.scene).or_default();
            *sum = (sum.0 + value(pattern), sum.1 + 1.0);
        }
        let count = patterns.len().max(1) as f64;
        let mean = patterns.iter().map(&value).sum::<f64>() / count;
        // Variance of a ratio of sums over scenes.
        let n = scenes.len() as f64;
        let spread: f64 = scenes.values().map(|(sum, k)| (sum - mean * k).powi(2)).sum();
        let variance = if n > 1.0 { spread * n / (n - 1.0) / (count * count) } else { f64::NAN };
        Self { mean, within: 1.96 * variance.sqrt() }
    }

    fn text(&self, digits: usize) -> String {
        if self.within.is_finite() {
            format!("{:.digits$} ± {:.digits$}", self.mean, self.within)
        } else {
            format!("{:.digits$}", self.mean)
        }
    }
}

/// How much of the simulated geometry's touches a source's grasps have as well, in other scenes. For the simulated
/// geometry itself: how much of one scene's is found in others, the most that can be expected of anybody.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Overlap {
    /// Share of touches whose pad is at the same place (1 cm, hand frame).
    pub places: f64,
    /// Share of touches whose finger points in the same direction (15°, hand frame).
    pub directions: f64,
}

/// One hand's grasps from one source of contacts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SourceDiversity {
    /// Name of the source.
    pub source: String,
    /// Grasps that were looked at.
    pub grasps: usize,
    /// Share of the area of all pads that touches.
    pub contacted_area: Mean,
    /// Pads that touch.
    pub engaged_pads: Mean,
    /// Fingers that touch.
    pub engaged_fingers: Mean,
    /// Space that the touching pads reach, cubic centimetres.
    pub reached_cm3: f64,
    /// Share of all directions that each finger touches in, by its name.
    pub directions: Vec<(String, f64)>,
    /// What it has in common with the simulated geometry.
    pub overlap: Overlap,
}

/// One hand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct HandDiversity {
    /// Its name.
    pub hand: String,
    /// Pads that it has.
    pub pads: usize,
    /// Fingers that it has.
    pub fingers: usize,
    /// The sources, simulated geometry first.
    pub sources: Vec<SourceDiversity>,
}

/// A measurement of diversity.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DiversityReport {
    /// What was measured, and how.
    pub conditions: Vec<String>,
    /// Each hand.
    pub hands: Vec<HandDiversity>,
}

impl DiversityReport {
    /// Counts.
    pub fn new(conditions: Vec<String>, measured: &[HandPatterns]) -> Self {
        Self { conditions, hands: measured.iter().map(of_hand).collect() }
    }

    /// For a terminal.
    pub fn text(&self) -> String {
        self.written(|table| table.text())
    }

    /// For a document.
    pub fn markdown(&self) -> String {
        self.written(|table| table.markdown())
    }

    fn written(&self, table: impl Fn(&Table) -> String) -> String {
        let mut out = self.conditions.iter().map(|c| format!("- {c}\n")).collect::<String>();
        for hand in &self.hands {
            let mut rows = Table::new([
                format!("{}, contacts from", hand.hand),
                "grasps".into(),
                "contacted area".into(),
                format!("engaged pads of {}", hand.pads),
                format!("engaged fingers of {}", hand.fingers),
                "reached cm³".into(),
                "directions %".into(),
                "same places %".into(),
                "same directions %".into(),
            ]);
            for source in &hand.sources {
                let shares = source.directions.iter().map(|(_, share)| 100.0 * share);
                let mean = shares.sum::<f64>() / source.directions.len().max(1) as f64;
                rows.row([
                    source.source.clone(),
                    source.grasps.to_string(),
                    source.contacted_area.text(3),
                    source.engaged_pads.text(2),
                    source.engaged_fingers.text(2),
                    format!("{:.0}", source.reached_cm3),
                    format!("{mean:.1}"),
                    format!("{:.1}", 100.0 * source.overlap.places),
                    format!("{:.1}", 100.0 * source.overlap.directions),
                ]);
            }
            out = out + "\n" + &table(&rows);
        }
        out
    }
}

fn of_hand(measured: &HandPatterns) -> HandDiversity {
    let hand = &measured.hand;
    let geometry = measured.sources.first().map_or(&[][..], |(_, patterns)| patterns);
    let of_source = |(source, patterns): &(String, Vec<Pattern>)| SourceDiversity {
        source: source.clone(),
        grasps: patterns.len(),
        contacted_area: Mean::of(patterns, |p| p.area),
        engaged_pads: Mean::of(patterns, |p| p.touches.len() as f64),
        engaged_fingers: Mean::of(patterns, |p| p.fingers() as f64),
        reached_cm3: 1e6 * reached_m3(patterns, hand.pads.len()),
        directions: (hand.fingers.iter().enumerate())
            .map(|(i, finger)| (finger.name.clone(), directions_share(patterns, i)))
            .collect(),
        overlap: Overlap {
            places: same_places(geometry, patterns),
            directions: same_directions(geometry, patterns),
        },
    };
    HandDiversity {
        hand: hand.display_name.clone(),
        pads: hand.pads.len(),
        fingers: hand.fingers.len(),
        sources: measured.sources.iter().map(of_source).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grasps_of_one_scene_are_no_independent_witnesses() {
        let pattern = |scene, area| Pattern { scene, area, touches: Vec::new() };
        // Two scenes, each with the same grasp ten times: as good as two grasps.
        let few: Vec<Pattern> = vec![pattern(0, 0.4), pattern(1, 0.6)];
        let many: Vec<Pattern> =
            (0..20).map(|i| pattern(i % 2, if i % 2 == 0 { 0.4 } else { 0.6 })).collect();
        let (few, many) = (Mean::of(&few, |p| p.area), Mean::of(&many, |p| p.area));
        assert!((few.mean - 0.5).abs() < 1e-12 && (few.within - many.within).abs() < 1e-12);
        // Standard deviation 0.1414 of two values, over √2.
        assert!((few.within - 1.96 * 0.1).abs() < 1e-9, "{few:?}");
        assert_eq!(Mean::of(&[pattern(0, 0.4)], |p| p.area).text(2), "0.40");
    }
}
