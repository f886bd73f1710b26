//! Who does what, live.

use std::fmt;

use serde::Serialize;

use super::record::DecisionRecord;
use crate::steps::Step;

/// What an arm is doing.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "doing")]
pub enum Doing {
    /// On its way home, its hand empty.
    Homing,
    /// At home, with nothing to do; why.
    Idle {
        /// The last decision's words.
        why: String,
    },
    /// Picking.
    Picking {
        /// Number of the object in this look.
        object: usize,
        /// Its bin.
        bin: String,
        /// Its step.
        step: Step,
    },
    /// It does not do what it is asked; it is tried again.
    Lost {
        /// Why.
        why: String,
    },
    /// It is out of this run.
    Out {
        /// Why.
        why: String,
    },
}

/// One line of the table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// The arm.
    pub arm: String,
    /// Its hand.
    pub hand: String,
    /// What it is doing.
    pub doing: Doing,
    /// True while it holds a lease on shared space.
    pub leased: bool,
    /// Objects that it has delivered, as its hand felt.
    pub delivered: u32,
    /// Grasp trials of its own.
    pub trials: u32,
}

/// The whole table.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Table {
    /// Seconds since the run began, on the cell's clock.
    pub time_s: f64,
    /// One line for each arm.
    pub rows: Vec<Row>,
    /// Looks so far.
    pub looks: u32,
    /// Objects of the last look that nobody has or has had.
    pub waiting: usize,
}

impl fmt::Display for Doing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Homing => f.write_str("going home"),
            Self::Idle { why } if why.is_empty() => f.write_str("idle"),
            Self::Idle { why } => f.write_str(why),
            Self::Picking { object, bin, step } => write!(f, "object {object} to {bin}: {step}"),
            Self::Lost { why } => write!(f, "LOST: {why}"),
            Self::Out { why } => write!(f, "OUT: {why}"),
        }
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{:<12} {:<14} {:>4} {:>6} {:>5}  doing", "arm", "hand", "done", "trials", "space")?;
        for row in &self.rows {
            let space = if row.leased { "held" } else { "-" };
            let doing: String = row.doing.to_string().chars().take(90).collect();
            writeln!(
                f,
                "{:<12} {:<14} {:>4} {:>6} {space:>5}  {doing}",
                row.arm, row.hand, row.delivered, row.trials
            )?;
        }
        writeln!(f, "{:.1} s, look {}, {} objects waiting", self.time_s, self.looks, self.waiting)
    }
}

/// What happens in a run.
#[derive(Debug)]
pub enum SortEvent<'a> {
    /// Somebody does something else.
    Table(&'a Table),
    /// What was decided.
    Decided(&'a [DecisionRecord]),
    /// Trouble, in words.
    Trouble {
        /// The arm; `None`: camera or planner.
        arm: Option<&'a str>,
        /// Words.
        text: &'a str,
    },
}

/// Somebody who watches.
pub trait SortObserver: Send {
    /// Sees what happens; must be quick.
    fn on(&mut self, event: &SortEvent<'_>);

    /// True when the run shall end: arms deliver what they have and go home.
    fn wants_end(&self) -> bool {
        false
    }
}
