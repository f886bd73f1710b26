//! What a clearing run found, as numbers: by hand and setup, by class of failure, by kind of object.

mod tables;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::attempt::{Attempt, Class};
use super::clear::{Run, Setup};
use super::statistics::{Share, quantile, wilson};

/// One cell of the table: one hand, one setup; or one hand over both.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cell {
    /// Id of the hand.
    pub hand: String,
    /// The setup; none for both together.
    pub setup: Option<Setup>,
    /// Executed grasps ("total grasp execution times", Supplementary Note 7).
    pub trials: usize,
    /// Plans that found no grasp though objects were there; not trials, for nothing was executed.
    pub empty_plans: usize,
    /// Trials after which an object was in the container.
    pub successes: usize,
    /// Successes over trials, with its 95 % Wilson interval.
    pub rate: Share,
    /// Successes over attempts, with its 95 % Wilson interval: plans without a grasp count as failures. A hand whose
    /// planner gives an object up is not better here than one that tries on and fails.
    pub rate_of_attempts: Share,
    /// Objects that were to be cleared.
    pub items: usize,
    /// Objects that were.
    pub cleared: usize,
    /// Objects that were held after successful grasps; more than the successes where several were held at once.
    pub held: usize,
    /// FGM: successful grasps over grasped objects (Supplementary Note 7); 1 without any.
    pub fgm: f64,
    /// Trials and plans without a grasp, over items.
    pub attempts_per_object: f64,
    /// Trials and plans without a grasp, by class.
    pub classes: BTreeMap<Class, usize>,
    /// Why no grasp was found, by the planner's reason.
    pub nothing: BTreeMap<String, usize>,
    /// Candidates that were rejected in plans without a grasp, by reason.
    pub rejected: BTreeMap<String, usize>,
    /// From the frame to the grasps, on one thread, median, milliseconds.
    pub planning_median_ms: f64,
    /// 95 of 100 plans took at most so long, milliseconds.
    pub planning_p95_ms: f64,
    /// Objects that had left the tray and were put back.
    pub put_back: usize,
}

impl Cell {
    fn of(hand: &str, setup: Option<Setup>, runs: &[&Run]) -> Self {
        let attempts: Vec<&Attempt> = runs.iter().flat_map(|r| &r.attempts).collect();
        let items = runs.iter().map(|r| r.items.len()).sum();
        let successes = attempts.iter().filter(|a| a.class == Class::Success).count();
        let held: usize = attempts.iter().filter(|a| a.class == Class::Success).map(|a| a.held.len()).sum();
        let empty_plans = attempts.iter().filter(|a| a.class == Class::NoGrasp).count();
        let trials = attempts.len() - empty_plans;
        let mut classes = BTreeMap::new();
        let (mut nothing, mut rejected) = (BTreeMap::new(), BTreeMap::new());
        for attempt in &attempts {
            *classes.entry(attempt.class).or_insert(0) += 1;
            if let Some(why) = &attempt.figures.nothing {
                *nothing.entry(why.reason.clone()).or_insert(0) += 1;
                for (reason, n) in &attempt.figures.rejected {
                    *rejected.entry(reason.clone()).or_insert(0) += n;
                }
            }
        }
        let times: Vec<f64> = runs.iter().flat_map(|r| r.planning_ms.iter().copied()).collect();
        Self {
            hand: hand.to_owned(),
            setup,
            trials,
            empty_plans,
            successes,
            rate: wilson(successes, trials),
            rate_of_attempts: wilson(successes, attempts.len()),
            items,
            cleared: runs.iter().flat_map(|r| &r.items).filter(|i| i.cleared).count(),
            held,
            fgm: if held > 0 { successes as f64 / held as f64 } else { 1.0 },
            attempts_per_object: attempts.len() as f64 / items.max(1) as f64,
            classes,
            nothing,
            rejected,
            planning_median_ms: quantile(&times, 0.5).unwrap_or(0.0),
            planning_p95_ms: quantile(&times, 0.95).unwrap_or(0.0),
            put_back: runs.iter().map(|r| r.put_back).sum(),
        }
    }

    fn count(&self, class: Class) -> usize {
        self.classes.get(&class).copied().unwrap_or(0)
    }
}

/// How grasps of one kind of object went, over all hands.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FamilyRow {
    /// The kind: the objects' name without its number.
    pub name: String,
    /// Executed grasps that meant one.
    pub trials: usize,
    /// Those that held something.
    pub successes: usize,
    /// Items of that name, counted once for every hand and setup.
    pub items: usize,
    /// Those that were cleared.
    pub cleared: usize,
}

/// Everything that a clearing run found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Report {
    /// What was measured, one condition a line.
    pub conditions: Vec<String>,
    /// One cell for every hand and setup, then one for every hand over all setups.
    pub cells: Vec<Cell>,
    /// By kind of object.
    pub families: Vec<FamilyRow>,
    /// All runs.
    pub runs: Vec<Run>,
}

impl Report {
    /// Counts.
    pub fn new(conditions: Vec<String>, runs: Vec<Run>) -> Self {
        let mut hands: Vec<&str> = Vec::new();
        let mut setups: Vec<Setup> = Vec::new();
        for run in &runs {
            if !hands.contains(&run.hand.as_str()) {
                hands.push(&run.hand);
            }
            if !setups.contains(&run.setup) {
                setups.push(run.setup);
            }
        }
        let cell = |hand: &str, setup: Option<Setup>| {
            let of_cell = |r: &&Run| r.hand == hand && setup.is_none_or(|s| r.setup == s);
            Cell::of(hand, setup, &runs.iter().filter(of_cell).collect::<Vec<_>>())
        };
        let mut rows: Vec<Option<Setup>> = setups.iter().copied().map(Some).collect();
        if rows.len() > 1 {
            rows.push(None);
        }
        let cells = rows.iter().flat_map(|&setup| hands.iter().map(move |&hand| (hand, setup)));
        let cells = cells.map(|(hand, setup)| cell(hand, setup)).collect();
        let families = families(&runs);
        Self { conditions, cells, families, runs }
    }
}

/// The kind of an object: its name without the number that tells it from others of its kind, `peg` for `peg 2`.
fn kind(name: &str) -> &str {
    match name.rsplit_once(' ') {
        Some((kind, number)) if number.parse::<u32>().is_ok() => kind,
        _ => name,
    }
}

/// By kind of object, worst first.
fn families(runs: &[Run]) -> Vec<FamilyRow> {
    let mut rows: BTreeMap<&str, FamilyRow> = BTreeMap::new();
    for item in runs.iter().flat_map(|r| &r.items) {
        let name = kind(&item.name);
        let row = rows.entry(name).or_insert_with(|| FamilyRow {
            name: name.to_owned(),
            trials: 0,
            successes: 0,
            items: 0,
            cleared: 0,
        });
        row.items += 1;
        row.cleared += usize::from(item.cleared);
    }
    for attempt in runs.iter().flat_map(|r| &r.attempts) {
        if let Some(row) = attempt.meant.as_deref().and_then(|name| rows.get_mut(kind(name))) {
            row.trials += 1;
            row.successes += usize::from(attempt.class == Class::Success);
        }
    }
    let mut rows: Vec<FamilyRow> = rows.into_values().collect();
    let rate = |r: &FamilyRow| wilson(r.successes, r.trials).rate;
    rows.sort_by(|a, b| rate(a).total_cmp(&rate(b)).then_with(|| a.name.cmp(&b.name)));
    rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::attempt::Figures;
    use crate::evaluate::clear::Item;

    fn attempt(setup: Setup, class: Class, held: &[&str]) -> Attempt {
        Attempt {
            hand: "leap".into(),
            setup,
            run: 0,
            number: 1,
            class,
            other_held: false,
            meant: (class != Class::NoGrasp).then(|| "peg 2".into()),
            held: held.iter().map(|h| (*h).to_owned()).collect(),
            objects: 2,
            slip_m: 0.0,
            figures: Figures::default(),
        }
    }

    fn run(setup: Setup, attempts: Vec<Attempt>, cleared: [bool; 2]) -> Run {
        let item = |name: &str, cleared| Item { name: name.into(), cleared, attempts: 1 };
        let planning_ms = vec![100.0; attempts.len()];
        let items = vec![item("peg", cleared[0]), item("peg 2", cleared[1])];
        Run { hand: "leap".into(), setup, run: 0, attempts, items, put_back: 0, planning_ms }
    }

    #[test]
    fn the_table_counts_trials_intervals_and_several_at_once() {
        let clutter = run(
            Setup::Clutter,
            vec![
                attempt(Setup::Clutter, Class::LostLifting, &[]),
                attempt(Setup::Clutter, Class::Success, &["peg", "peg 2"]),
            ],
            [true, true],
        );
        let single = run(Setup::Single, vec![attempt(Setup::Single, Class::NoGrasp, &[])], [false, false]);
        let report = Report::new(Vec::new(), vec![single, clutter]);
        let rows: Vec<_> = report.cells.iter().map(|c| (c.setup, c.trials, c.successes, c.cleared)).collect();
        let expected = [(Some(Setup::Single), 0, 0, 0), (Some(Setup::Clutter), 2, 1, 2), (None, 2, 1, 2)];
        assert_eq!(rows, expected);
        let overall = &report.cells[2];
        assert_eq!((overall.held, overall.fgm), (2, 0.5));
        assert_eq!(overall.attempts_per_object, 0.75);
        assert_eq!((overall.rate, overall.empty_plans), (wilson(1, 2), 1));
        assert_eq!(overall.rate_of_attempts, wilson(1, 3));
        // Both pegs are of one kind.
        assert_eq!(report.families.len(), 1);
        let family = &report.families[0];
        assert_eq!((family.name.as_str(), family.trials, family.items), ("peg", 2, 4));
        let text = report.text();
        assert!(text.contains("2/50.0%") && text.contains("51/98.0%"), "{text}");
        let row =
            text.lines().rfind(|line| line.starts_with("  successes over attempts, empty plans included"));
        assert!(row.is_some_and(|row| row.ends_with("3/33.3%")), "{text}");
        let json = serde_json::to_value(&report).unwrap();
        assert!((json["cells"][2]["rate_of_attempts"]["rate"].as_f64().unwrap() - 1.0 / 3.0).abs() < 1e-12);
    }

    #[test]
    fn kinds_lose_their_number_only() {
        assert_eq!([kind("peg 2"), kind("peg"), kind("power drill")], ["peg", "peg", "power drill"]);
    }
}
