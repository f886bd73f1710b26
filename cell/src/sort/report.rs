//! How a sorting run ended.

use std::collections::BTreeMap;
use std::fmt;

use async_trait::async_trait;
use serde::{Deserialize, Serialize};

use super::shares::Shares;
use crate::outcome::End;
use crate::report::Report;

/// Two arms, or what they carry, that touched or overlapped.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Collision {
    /// The arms.
    pub between: [String; 2],
    /// What met: `hand`, `arm`, or a link.
    pub parts: [String; 2],
    /// When, seconds on the witness's clock.
    pub time_s: f64,
    /// How deep they overlapped at first, metres.
    pub depth_m: f64,
}

/// What somebody who knows the truth saw.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Truth {
    /// Names of the objects in each bin.
    pub delivered: BTreeMap<String, Vec<String>>,
    /// Of those, in a bin that no rule names for them.
    pub misplaced: Vec<String>,
    /// Names of the objects in the tray.
    pub in_tray: Vec<String>,
    /// In hands.
    pub in_hand: Vec<String>,
    /// Anywhere else.
    pub lost: Vec<String>,
    /// Arms that met.
    pub collisions: Vec<Collision>,
    /// Seconds on its clock since the run began.
    pub time_s: f64,
}

impl Truth {
    /// Objects in bins.
    pub fn delivered_count(&self) -> usize {
        self.delivered.values().map(Vec::len).sum()
    }

    /// All objects.
    pub fn total(&self) -> usize {
        self.delivered_count() + self.in_tray.len() + self.in_hand.len() + self.lost.len()
    }
}

/// Somebody who sees what the cell cannot feel.
#[async_trait]
pub trait SortWitness: Send + Sync + fmt::Debug {
    /// The truth now; `None` when it cannot tell.
    async fn truth(&self) -> Option<Truth>;
}

/// An arm's share.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ArmReport {
    /// Its name.
    pub arm: String,
    /// Its own run.
    pub report: Report,
    /// How often it was lost, and came back.
    pub lost: u32,
    /// See [`ArmReport::lost`].
    pub came_back: u32,
    /// Where its time went; reports of older runs do not say.
    #[serde(default)]
    pub time: Shares,
}

/// How a sorting run ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SortReport {
    /// Why.
    pub end: End,
    /// Each arm's share.
    pub arms: Vec<ArmReport>,
    /// Looks into the tray.
    pub looks: u32,
    /// Assignments made.
    pub assignments: u32,
    /// Of the looks, those past arms that were over the tray.
    #[serde(default)]
    pub looks_past_arms: u32,
    /// Seconds with none, one, two, ... arms over the tray, on the clock of the devices.
    #[serde(default)]
    pub over_tray_s: Vec<f64>,
    /// Times that two or more arms were picking at the begin of a pick.
    pub together: u32,
    /// Planning time of each look, for all hands, as waited for, seconds.
    pub plan_s: Vec<f64>,
    /// Time of each assignment, seconds.
    pub assign_s: Vec<f64>,
    /// Whole run, wall clock, seconds.
    pub duration_s: f64,
    /// The truth at the end.
    pub truth: Option<Truth>,
    /// First trouble with the record.
    pub record_trouble: Option<String>,
}

impl SortReport {
    /// Objects that arrived: as the witness saw, else as the hands felt.
    pub fn delivered(&self) -> u32 {
        let felt = || self.arms.iter().map(|a| a.report.tally.successes).sum();
        self.truth.as_ref().map_or_else(felt, |t| u32::try_from(t.delivered_count()).unwrap_or(u32::MAX))
    }

    /// Grasp trials of all arms.
    pub fn trials(&self) -> u32 {
        self.arms.iter().map(|a| a.report.tally.trials).sum()
    }
}

impl fmt::Display for SortReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "end             {}", self.end)?;
        for arm in &self.arms {
            let t = &arm.report.tally;
            let lost = if arm.lost > 0 {
                format!(", lost {} times and came back {}", arm.lost, arm.came_back)
            } else {
                String::new()
            };
            writeln!(f, "{:<15} {} of {} grasps{lost}; {}", arm.arm, t.successes, t.trials, arm.time)?;
        }
        writeln!(
            f,
            "looks           {}, {} of them past arms at work; {} picks began while another arm picked",
            self.looks, self.looks_past_arms, self.together
        )?;
        if let Some(truth) = &self.truth {
            for (bin, names) in &truth.delivered {
                writeln!(f, "bin {bin:<11} {}", names.join(", "))?;
            }
            writeln!(
                f,
                "objects         {} delivered ({} in a wrong bin), {} in the tray, {} in hands, {} lost",
                truth.delivered_count(),
                truth.misplaced.len(),
                truth.in_tray.len(),
                truth.in_hand.len(),
                truth.lost.len()
            )?;
            writeln!(f, "collisions      {} between arms", truth.collisions.len())?;
            for c in &truth.collisions {
                writeln!(
                    f,
                    "                {} ({}) and {} ({}) at {:.1} s, {:.0} mm deep",
                    c.between[0],
                    c.parts[0],
                    c.between[1],
                    c.parts[1],
                    c.time_s,
                    1e3 * c.depth_m
                )?;
            }
            writeln!(f, "simulated       {:.1} s", truth.time_s)?;
        }
        writeln!(f, "duration        {:.1} s", self.duration_s)
    }
}
