//! What came of it: success rate, clearing rate, focused grasping metric, each with its interval, dynamic against static.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::paired::{self, Pair};
use super::run::{ServoEnd, ServoTray};
use super::settings::Group;
use crate::evaluate::Class;
use crate::evaluate::statistics::{Share, mean, quantile, wilson};
use crate::evaluate::table::Table;

/// One hand in one mode on one group, or on all of them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Row {
    /// Id of the hand.
    pub hand: String,
    /// The objects; nothing: all groups together.
    pub group: Option<Group>,
    /// The mode.
    pub is_dynamic: bool,
    /// Counted.
    pub end: ServoEnd,
    /// Attempts without a grip.
    pub without_grip: usize,
    /// Successful grasps over trials.
    pub success: Share,
    /// Cleared objects over objects.
    pub clearing: Share,
    /// Successful grasps over grasped objects.
    pub focus: Share,
    /// Failures by class.
    pub failures: BTreeMap<Class, usize>,
}

/// Everything.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ServoReport {
    /// How it was measured.
    pub conditions: Vec<String>,
    /// By hand, group and mode.
    pub rows: Vec<Row>,
    /// Every tray.
    pub trays: Vec<ServoTray>,
    /// Every pair of attempts in the same tray, where pairs were made instead.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub pairs: Vec<Pair>,
}

impl ServoReport {
    /// Counts trays.
    pub fn new(conditions: Vec<String>, trays: Vec<ServoTray>) -> Self {
        let mut hands: Vec<&str> = Vec::new();
        let mut groups: Vec<Group> = Vec::new();
        for tray in &trays {
            if !hands.contains(&tray.hand.as_str()) {
                hands.push(&tray.hand);
            }
            if !groups.contains(&tray.group) {
                groups.push(tray.group);
            }
        }
        groups.sort_unstable();
        let mut rows = Vec::new();
        for hand in hands {
            for group in groups.iter().map(|g| Some(*g)).chain([None]) {
                for is_dynamic in [false, true] {
                    let of = |t: &&ServoTray| {
                        t.hand == hand && t.is_dynamic == is_dynamic && group.is_none_or(|g| g == t.group)
                    };
                    let of: Vec<&ServoTray> = trays.iter().filter(of).collect();
                    if !of.is_empty() {
                        rows.push(Row::of(hand, group, is_dynamic, &of));
                    }
                }
            }
        }
        Self { conditions, rows, trays, pairs: Vec::new() }
    }

    /// Pairs of attempts, also counted as if each mode had had trays of its own (nothing is cleared in them).
    pub fn of_pairs(conditions: Vec<String>, pairs: Vec<Pair>) -> Self {
        let mut trays: Vec<ServoTray> = Vec::new();
        for pair in &pairs {
            for (is_dynamic, attempt) in [(false, &pair.fixed), (true, &pair.dynamic)] {
                let same = |t: &&mut ServoTray| {
                    (t.is_dynamic, t.run, t.group, t.hand.as_str())
                        == (is_dynamic, pair.run, pair.group, pair.hand.as_str())
                };
                if let Some(tray) = trays.iter_mut().find(same) {
                    tray.attempts.push(attempt.clone());
                    continue;
                }
                trays.push(ServoTray {
                    hand: pair.hand.clone(),
                    group: pair.group,
                    run: pair.run,
                    is_dynamic,
                    objects: attempt.objects,
                    cleared: 0,
                    attempts: vec![attempt.clone()],
                });
            }
        }
        Self { pairs, ..Self::new(conditions, trays) }
    }

    /// The rows over all groups.
    pub fn totals(&self) -> impl Iterator<Item = &Row> {
        self.rows.iter().filter(|r| r.group.is_none())
    }

    /// As plain text.
    pub fn text(&self) -> String {
        self.layout(Table::text, "")
    }

    /// As Markdown.
    pub fn markdown(&self) -> String {
        self.layout(Table::markdown, "- ")
    }

    fn layout(&self, show: impl Fn(&Table) -> String, bullet: &str) -> String {
        let conditions: String = self.conditions.iter().map(|c| format!("{bullet}{c}\n")).collect();
        let differences: String = self.differences().iter().map(|d| format!("{bullet}{d}\n")).collect();
        let outcome = if self.pairs.is_empty() {
            format!("{}\n{differences}", show(&self.quality()))
        } else {
            show(&paired::table(&self.pairs))
        };
        format!("{conditions}\n{outcome}\n{}\n{}", show(&self.ways()), show(&self.failures()))
    }

    fn quality(&self) -> Table {
        let mut table = Table::new([
            "hand, objects",
            "mode",
            "trials",
            "no grip",
            "success rate",
            "clearing rate",
            "FGM",
        ]);
        for r in &self.rows {
            table.row([
                r.title(),
                mode(r.is_dynamic).into(),
                r.end.trials.to_string(),
                r.without_grip.to_string(),
                percent(&r.success),
                percent(&r.clearing),
                percent(&r.focus),
            ]);
        }
        table
    }

    /// What approaches took, by hand and mode.
    fn ways(&self) -> Table {
        let mut table = Table::new([
            "approaches",
            "mode",
            "frames",
            "tracking",
            "replanned",
            "largest tracked change mm",
            "first plan ms",
            "frame ms",
            "drift mm p50, p95",
            "score first, last",
        ]);
        for r in self.totals() {
            let trays = self.trays.iter().filter(|t| t.hand == r.hand && t.is_dynamic == r.is_dynamic);
            let ways: Vec<_> = trays.flat_map(|t| &t.attempts).map(|a| a.way).collect();
            let of = |get: &dyn Fn(&super::approach::Way) -> f64| ways.iter().map(get).collect::<Vec<f64>>();
            let show = |v: Option<f64>, digits: usize| v.map_or("-".into(), |v| format!("{v:.digits$}"));
            let (frames, tracking) = (of(&|w| w.frames as f64), of(&|w| w.tracking as f64));
            let share = tracking.iter().sum::<f64>() / frames.iter().sum::<f64>().max(1.0);
            let refined = of(&|w| (w.frames.max(1) - 1) as f64).iter().sum::<f64>().max(1.0);
            let drift = of(&|w| 1e3 * w.drift_m);
            table.row([
                r.hand.clone(),
                mode(r.is_dynamic).into(),
                show(mean(&frames), 0),
                format!("{:.0}%", 100.0 * share),
                show(mean(&of(&|w| w.replanned as f64)), 1),
                show(of(&|w| 1e3 * w.largest_change_m).into_iter().reduce(f64::max), 1),
                show(quantile(&of(&|w| w.planning_ms), 0.5), 0),
                format!("{:.1}", of(&|w| w.refining_ms).iter().sum::<f64>() / refined),
                format!("{}, {}", show(quantile(&drift, 0.5), 0), show(quantile(&drift, 0.95), 0)),
                format!(
                    "{}, {}",
                    show(mean(&of(&|w| w.first_score)), 2),
                    show(mean(&of(&|w| w.last_score)), 2)
                ),
            ]);
        }
        table
    }

    fn failures(&self) -> Table {
        let seen: Vec<Class> = Class::FAILURES
            .into_iter()
            .filter(|c| self.rows.iter().any(|r| r.failures.contains_key(c)))
            .collect();
        let header = ["failures".to_owned(), "mode".into()].into_iter();
        let mut table = Table::new(header.chain(seen.iter().map(|c| c.title().to_owned())));
        for r in self.totals() {
            let counts = seen.iter().map(|c| r.failures.get(c).copied().unwrap_or(0).to_string());
            table.row([r.hand.clone(), mode(r.is_dynamic).into()].into_iter().chain(counts));
        }
        table
    }

    /// Dynamic less static over all hands, for each figure, with its interval.
    fn differences(&self) -> Vec<String> {
        let sum = |is_dynamic: bool| {
            let of = self.totals().filter(|r| r.is_dynamic == is_dynamic);
            of.fold(ServoEnd::default(), |a, r| a.plus(&r.end))
        };
        let (fixed, dynamic) = (sum(false), sum(true));
        if fixed.objects == 0 || dynamic.objects == 0 {
            return Vec::new();
        }
        type Figure = fn(&ServoEnd) -> (usize, usize);
        let figures: [(&str, Figure); 3] = [
            ("success rate", |e| (e.successes, e.trials)),
            ("clearing rate", |e| (e.cleared, e.objects)),
            ("FGM", |e| (e.successes, e.grasped)),
        ];
        let line = |(name, of): &(&str, Figure)| {
            let (a, b) = (of(&fixed), of(&dynamic));
            let d = difference(a, b);
            let verdict = if d.low > 0.0 {
                "dynamic is better"
            } else if d.high < 0.0 {
                "static is better"
            } else {
                "no difference is proven"
            };
            format!(
                "{name}, dynamic less static, all hands: {:+.1} points, 95 % interval {:+.1} to {:+.1}: {verdict} ({}/{} \
                 against {}/{})",
                100.0 * d.rate,
                100.0 * d.low,
                100.0 * d.high,
                b.0,
                b.1,
                a.0,
                a.1
            )
        };
        figures.iter().map(line).collect()
    }
}

impl Row {
    fn of(hand: &str, group: Option<Group>, is_dynamic: bool, trays: &[&ServoTray]) -> Self {
        let end = trays.iter().fold(ServoEnd::default(), |a, t| a.plus(&t.end()));
        let attempts = || trays.iter().flat_map(|t| &t.attempts);
        let mut failures = BTreeMap::new();
        for attempt in attempts().filter(|a| a.class != Class::Success) {
            *failures.entry(attempt.class).or_insert(0) += 1;
        }
        Self {
            hand: hand.to_owned(),
            group,
            is_dynamic,
            end,
            without_grip: attempts().filter(|a| a.class == Class::NoGrasp).count(),
            success: wilson(end.successes, end.trials),
            clearing: wilson(end.cleared, end.objects),
            focus: wilson(end.successes.min(end.grasped), end.grasped),
            failures,
        }
    }

    fn title(&self) -> String {
        format!("{}, {}", self.hand, self.group.map_or("all", Group::name))
    }
}

impl ServoEnd {
    fn plus(&self, other: &Self) -> Self {
        Self {
            trials: self.trials + other.trials,
            successes: self.successes + other.successes,
            grasped: self.grasped + other.grasped,
            objects: self.objects + other.objects,
            cleared: self.cleared + other.cleared,
        }
    }
}

/// Difference of two independent shares, `b` less `a`, with its 95 % interval from both Wilson intervals (Newcombe 1998,
/// method 10).
fn difference((a_hit, a_all): (usize, usize), (b_hit, b_all): (usize, usize)) -> Share {
    let (a, b) = (wilson(a_hit.min(a_all), a_all), wilson(b_hit.min(b_all), b_all));
    let rate = b.rate - a.rate;
    let down = (b.rate - b.low).hypot(a.high - a.rate);
    let up = (b.high - b.rate).hypot(a.rate - a.low);
    Share { rate, low: rate - down, high: rate + up }
}

fn mode(is_dynamic: bool) -> &'static str {
    if is_dynamic { "dynamic" } else { "static" }
}

fn percent(s: &Share) -> String {
    format!("{:.1}% ({:.1}-{:.1})", 100.0 * s.rate, 100.0 * s.low, 100.0 * s.high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_of_shares_have_published_intervals() {
        // Newcombe (1998), Table II, method 10: 56/70 less 48/80.
        let d = difference((48, 80), (56, 70));
        assert!((d.rate - 0.2).abs() < 1e-12);
        assert!((d.low - 0.0524).abs() < 1e-4 && (d.high - 0.3339).abs() < 1e-4, "{d:?}");
    }
}
