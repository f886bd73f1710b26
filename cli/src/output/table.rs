//! Tables of plain text, and the tables of plans.

use std::fmt;

use graspd_planner::grasp::BETTER_NOT;

use crate::outcome::Outcome;

/// Rows under a header; columns as wide as their widest cell.
#[derive(Debug, Clone, Default)]
pub(crate) struct Table {
    rows: Vec<Vec<String>>,
    left: usize,
}

impl Table {
    /// A table with this header. The first `left` columns are aligned left, the others right.
    pub(crate) fn new(header: &[&str], left: usize) -> Self {
        Self { rows: vec![header.iter().map(|&h| h.to_owned()).collect()], left }
    }

    /// Adds a row.
    pub(crate) fn row(&mut self, cells: Vec<String>) {
        self.rows.push(cells);
    }

    /// True without rows under the header.
    pub(crate) fn is_empty(&self) -> bool {
        self.rows.len() < 2
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let columns = self.rows.iter().map(Vec::len).max().unwrap_or(0);
        let width = |c: usize| {
            self.rows.iter().filter_map(|r| r.get(c)).map(|s| s.chars().count()).max().unwrap_or(0)
        };
        let widths: Vec<usize> = (0..columns).map(width).collect();
        for row in &self.rows {
            let mut line = String::new();
            for (c, cell) in row.iter().enumerate() {
                let pad = " ".repeat(widths[c].saturating_sub(cell.chars().count()));
                if c > 0 {
                    line.push_str("  ");
                }
                if c < self.left {
                    line.push_str(cell);
                    line.push_str(&pad);
                } else {
                    line.push_str(&pad);
                    line.push_str(cell);
                }
            }
            writeln!(f, "{}", line.trim_end())?;
        }
        Ok(())
    }
}

/// A score; small ones with the advice that goes with them.
fn score(score: f64) -> String {
    if score < BETTER_NOT { format!("{score:.3} better not") } else { format!("{score:.3}") }
}

/// Every grasp of every hand; for hands without one, why, and what would help.
pub(crate) fn grasps(outcomes: &[Outcome]) -> String {
    let mut table = Table::new(
        &["hand", "rank", "score", "x m", "y m", "z m", "width", "contacts", "epsilon", "clearance"],
        1,
    );
    for outcome in outcomes {
        for (i, g) in outcome.grasps.iter().enumerate() {
            let p = g.world_from_hand.translation.vector;
            table.row(vec![
                outcome.hand.clone(),
                (i + 1).to_string(),
                score(g.score),
                format!("{:.4}", p.x),
                format!("{:.4}", p.y),
                format!("{:.4}", p.z),
                g.jaw_width_m.map_or_else(|| "-".to_owned(), |w| format!("{:.1} mm", w * 1e3)),
                g.contacts.len().to_string(),
                format!("{:.3}", g.epsilon),
                format!("{:.1} mm", g.clearance_m * 1e3),
            ]);
        }
    }
    let mut text = if table.is_empty() { String::new() } else { table.to_string() };
    for outcome in outcomes {
        text.push_str(&summary(outcome));
    }
    text
}

/// One line of figures; more where there is no grasp.
fn summary(outcome: &Outcome) -> String {
    let stages: Vec<String> =
        outcome.stages.iter().map(|(name, d)| format!("{name} {:.1}", d.as_secs_f64() * 1e3)).collect();
    let early = if outcome.stopped { ", stopped by the budget" } else { "" };
    let mut text = format!(
        "{}: {} of {} candidates, {} iterations, N_fc {}, N_fe {}, N_ee {}{early}; ms: {}\n",
        outcome.hand,
        outcome.grasps.len(),
        outcome.candidates,
        outcome.iterations,
        outcome.focal_contacts,
        outcome.focal_centroids,
        outcome.centered_centroids,
        stages.join(", "),
    );
    if let Some((reason, fix)) = &outcome.no_grasp {
        text.push_str(&format!("  no grasp: {reason}\n  nearest fix: {fix}\n"));
        let mut counts: Vec<(&String, &usize)> = outcome.rejected.iter().filter(|(_, n)| **n > 0).collect();
        counts.sort_by(|a, b| b.1.cmp(a.1).then(a.0.cmp(b.0)));
        if !counts.is_empty() {
            let list: Vec<String> = counts.iter().map(|(r, n)| format!("{r} {n}")).collect();
            text.push_str(&format!("  rejected: {}\n", list.join(", ")));
        }
    }
    text
}

/// One line for each hand: the table of the demo.
pub(crate) fn hands(outcomes: &[Outcome]) -> String {
    let header = [
        "hand",
        "grasps",
        "best score",
        "N_fc",
        "N_fe",
        "N_ee",
        "scene ms",
        "optimize ms",
        "rank ms",
        "if none",
    ];
    let mut table = Table::new(&header, 1);
    let ms = |x: Option<f64>| x.map_or_else(|| "-".to_owned(), |x| format!("{x:.1}"));
    for o in outcomes {
        let scene = ["decode", "frame", "volume", "estimate", "refine"]
            .iter()
            .filter_map(|s| o.stage_ms(s))
            .sum::<f64>();
        table.row(vec![
            o.hand.clone(),
            o.grasps.len().to_string(),
            o.grasps.first().map_or_else(|| "-".to_owned(), |g| format!("{:.3}", g.score)),
            o.focal_contacts.to_string(),
            o.focal_centroids.to_string(),
            o.centered_centroids.to_string(),
            ms(Some(scene)),
            ms(o.stage_ms("optimize")),
            ms(o.stage_ms("rank")),
            o.no_grasp.as_ref().map_or_else(String::new, |(reason, _)| reason.clone()),
        ]);
    }
    let mut text = table.to_string();
    for o in outcomes {
        if let Some((_, fix)) = &o.no_grasp {
            text.push_str(&format!("{}: nearest fix: {fix}\n", o.hand));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::fixtures;

    #[test]
    fn columns_are_aligned() {
        let mut table = Table::new(&["name", "n"], 1);
        table.row(vec!["µ".into(), "10".into()]);
        assert_eq!(table.to_string(), "name   n\nµ     10\n");
    }

    #[test]
    fn a_plan_without_grasps_says_why() {
        let outcome = Outcome {
            hand: "leap".into(),
            no_grasp: Some(("all_rejected".into(), "raise the camera".into())),
            rejected: [("too_wide".to_owned(), 3), ("collision_scene".to_owned(), 45)].into(),
            ..Outcome::default()
        };
        let text = grasps(std::slice::from_ref(&outcome));
        assert!(text.contains("no grasp: all_rejected\n  nearest fix: raise the camera\n"), "{text}");
        assert!(text.contains("rejected: collision_scene 45, too_wide 3"), "{text}");
        let text = hands(&[outcome]);
        assert!(text.ends_with("all_rejected\nleap: nearest fix: raise the camera\n"), "{text}");
    }

    #[test]
    fn a_grasp_is_one_row() {
        let text = grasps(&[fixtures::toy_outcome()]);
        let row = text.lines().nth(1).unwrap();
        let cells: Vec<&str> = row.split_whitespace().collect();
        assert_eq!(
            cells,
            ["toy", "1", "0.810", "0.0230", "0.0120", "0.1300", "62.0", "mm", "2", "0.120", "11.0", "mm"]
        );
    }
}
