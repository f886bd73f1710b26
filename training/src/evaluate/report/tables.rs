//! The tables of a clearing run: Supplementary Table 4's layout, and why grasps failed.

use std::collections::BTreeMap;

use super::{Cell, Report};
use crate::evaluate::attempt::Class;
use crate::evaluate::clear::Setup;
use crate::evaluate::statistics::wilson;
use crate::evaluate::table::Table;

/// Supplementary Table 4, SpaHybGen on hardware: hand, then trials of single objects and of clutter, with their
/// success rates in per cent.
const PUBLISHED: [(&str, [(usize, f64); 2]); 7] = [
    ("finray-2f", [(25, 100.0), (27, 92.6)]),
    ("robotiq-2f85", [(26, 96.2), (27, 92.6)]),
    ("robotiq-3f", [(25, 100.0), (26, 96.2)]),
    ("model-o", [(26, 96.2), (25, 100.0)]),
    ("finray-4f", [(25, 100.0), (26, 96.2)]),
    ("brunel", [(26, 96.2), (26, 96.2)]),
    ("leap", [(25, 100.0), (26, 96.2)]),
];

impl Report {
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
        for (title, content) in [
            ("Trials and success rate, 95 % interval, objects cleared", self.success_table()),
            ("What became of the trials, all setups", self.class_table()),
            ("Effort", self.effort_table()),
            ("By kind of object, all hands and setups", self.family_table()),
            ("Why no grasp was found", self.nothing_table()),
        ] {
            let mark = if bullet.is_empty() { "" } else { "### " };
            if let Some(content) = content {
                out += &format!("\n{mark}{title}\n\n{}", table(&content));
            }
        }
        out
    }

    fn rows(&self) -> Vec<Option<Setup>> {
        let mut rows = Vec::new();
        for cell in &self.cells {
            if !rows.contains(&cell.setup) {
                rows.push(cell.setup);
            }
        }
        rows
    }

    fn in_row(&self, setup: Option<Setup>) -> Vec<&Cell> {
        self.cells.iter().filter(|c| c.setup == setup).collect()
    }

    /// One cell a hand, over everything that was measured.
    fn overall(&self) -> Vec<&Cell> {
        self.rows().last().map_or_else(Vec::new, |&last| self.in_row(last))
    }

    fn success_table(&self) -> Option<Table> {
        let hands: Vec<String> = self.overall().iter().map(|c| c.hand.clone()).collect();
        let mut table = Table::new(std::iter::once(String::new()).chain(hands));
        for setup in self.rows() {
            let cells = self.in_row(setup);
            let title = setup.map_or("Overall", Setup::title);
            let mut row = |title: &str, cell: &dyn Fn(&Cell) -> String| {
                table.row(std::iter::once(title.to_owned()).chain(cells.iter().map(|c| cell(c))));
            };
            row(title, &|c| format!("{}/{:.1}%", c.trials, 100.0 * c.rate.rate));
            row("  95 %", &|c| format!("{:.1}–{:.1}%", 100.0 * c.rate.low, 100.0 * c.rate.high));
            row("  cleared", &|c| format!("{} of {}", c.cleared, c.items));
            row("  plans without a grasp", &|c| c.empty_plans.to_string());
            row("  successes over attempts, empty plans included", &|c| {
                format!("{}/{:.1}%", c.trials + c.empty_plans, 100.0 * c.rate_of_attempts.rate)
            });
            row("  hardware, published", &|c| published(&c.hand, setup));
        }
        Some(table)
    }

    fn class_table(&self) -> Option<Table> {
        let cells = self.overall();
        let hands = cells.iter().map(|c| c.hand.clone()).chain(["all".to_owned()]);
        let mut table = Table::new(std::iter::once(String::new()).chain(hands));
        for class in std::iter::once(Class::Success).chain(Class::FAILURES) {
            let counts: Vec<usize> = cells.iter().map(|c| c.count(class)).collect();
            let all: usize = counts.iter().sum();
            let counts = counts.iter().chain([&all]).map(ToString::to_string);
            table.row(std::iter::once(class.title().to_owned()).chain(counts));
        }
        Some(table)
    }

    fn effort_table(&self) -> Option<Table> {
        let mut table = Table::new([
            "hand",
            "attempts per object",
            "FGM",
            "planning median ms",
            "planning p95 ms",
            "put back",
        ]);
        for c in self.overall() {
            table.row([
                c.hand.clone(),
                format!("{:.2}", c.attempts_per_object),
                format!("{:.3}", c.fgm),
                format!("{:.0}", c.planning_median_ms),
                format!("{:.0}", c.planning_p95_ms),
                c.put_back.to_string(),
            ]);
        }
        Some(table)
    }

    fn family_table(&self) -> Option<Table> {
        let mut table = Table::new(["kind", "trials", "successes", "rate", "cleared"]);
        for f in &self.families {
            table.row([
                f.name.clone(),
                f.trials.to_string(),
                f.successes.to_string(),
                format!("{:.1}%", 100.0 * wilson(f.successes, f.trials).rate),
                format!("{} of {}", f.cleared, f.items),
            ]);
        }
        Some(table)
    }

    fn nothing_table(&self) -> Option<Table> {
        let cells = self.overall();
        let mut table = Table::new(["hand", "reasons", "rejected candidates"]);
        let list = |counts: &BTreeMap<String, usize>| {
            let mut counts: Vec<_> = counts.iter().collect();
            counts.sort_by_key(|&(_, n)| std::cmp::Reverse(*n));
            counts.iter().map(|(reason, n)| format!("{reason} {n}")).collect::<Vec<_>>().join(", ")
        };
        let mut any = false;
        for c in cells.iter().filter(|c| !c.nothing.is_empty()) {
            any = true;
            table.row([c.hand.clone(), list(&c.nothing), list(&c.rejected)]);
        }
        any.then_some(table)
    }
}

/// What the paper measured on hardware.
fn published(hand: &str, setup: Option<Setup>) -> String {
    let Some((_, [single, clutter])) = PUBLISHED.iter().find(|(id, _)| *id == hand) else {
        return "–".into();
    };
    let show = |(trials, rate): (usize, f64)| format!("{trials}/{rate:.1}%");
    match setup {
        Some(Setup::Single) => show(*single),
        Some(Setup::Clutter) => show(*clutter),
        None => {
            let trials = single.0 + clutter.0;
            // Of the 50 items, one was grasped with every success.
            show((trials, 100.0 * 50.0 / trials as f64))
        }
    }
}
