//! The report as a table for people.

use std::fmt;

use super::Report;
use crate::outcome::Holding;

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let t = &self.tally;
        let rate = t.rate().map_or_else(|| "-".to_owned(), |r| format!("{:.1} %", 100.0 * r));
        writeln!(f, "hand            {} (revision {})", self.hand, self.hand_revision)?;
        writeln!(f, "end             {}", self.end)?;
        writeln!(f, "success rate    {rate} ({} of n = {} grasp trials)", t.successes, t.trials)?;
        if let (Some(delivered), Some(lost), Some(left)) = (t.delivered, t.lost, t.in_tray) {
            let held =
                t.in_hand.filter(|n| *n > 0).map_or_else(String::new, |n| format!(", {n} in the hand"));
            writeln!(f, "objects         {delivered} delivered, {lost} lost, {left} left in the tray{held}")?;
            if !t.remaining.is_empty() {
                writeln!(f, "left            {}", t.remaining.join(", "))?;
            }
        }
        writeln!(
            f,
            "attempts        {} ({} without a trial, {} unknown)",
            t.attempts, t.not_executed, t.unknown
        )?;
        for (class, count) in &t.failures {
            writeln!(f, "  {:<13} {count}", class.name())?;
        }
        if let Some(plan) = t.median_plan_s() {
            writeln!(f, "planning        {:.0} ms (median of {})", 1000.0 * plan, t.plan_s.len())?;
        }
        if t.out_of_reach > 0 {
            writeln!(f, "out of reach    {} grasps, left out before anything moved", t.out_of_reach)?;
            if let Some(last) = &t.last_out_of_reach {
                writeln!(f, "  the last      {last}")?;
            }
        }
        writeln!(f, "trouble met     {}", t.troubles)?;
        let holding = match self.holding {
            Holding::Nothing => "nothing",
            Holding::Object => "an object",
            Holding::Unknown => "unknown: a person has to look",
        };
        writeln!(f, "in the hand     {holding}")?;
        writeln!(f, "duration        {:.1} s", self.duration_s)?;
        if let Some(trouble) = &self.record_trouble {
            writeln!(f, "record          incomplete: {trouble}")?;
        }
        Ok(())
    }
}
