//! The answer, and why it is so.

use std::collections::BTreeMap;
use std::fmt;

use crate::judge::{Factors, Judged};
use crate::problem::Problem;
use crate::search::Found;

/// Why a grasp cannot be taken, whatever the others do.
#[derive(Debug, Clone, PartialEq)]
pub enum Cause {
    /// A rule of the task.
    Barred(String),
    /// Somebody has the object.
    Taken {
        /// Who.
        by: String,
    },
    /// The hand is not made for objects of this size.
    Size {
        /// Width of the object, metres.
        width_m: f64,
        /// What the hand takes, metres.
        opening_m: (f64, f64),
    },
    /// The arm does not get there.
    OutOfReach(String),
    /// It is worth nothing.
    Worthless {
        /// Its value.
        value: f64,
    },
    /// Its corridor enters space where this arm must not be.
    KeepOut {
        /// Name of the space.
        name: String,
    },
    /// Its corridor enters space that somebody is in.
    Occupied {
        /// Who.
        by: String,
    },
}

impl Cause {
    /// Machine readable.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Barred(_) => "barred",
            Self::Taken { .. } => "taken",
            Self::Size { .. } => "size",
            Self::OutOfReach(_) => "out_of_reach",
            Self::Worthless { .. } => "worthless",
            Self::KeepOut { .. } => "keep_out",
            Self::Occupied { .. } => "occupied",
        }
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Barred(why) => f.write_str(why),
            Self::Taken { by } => write!(f, "{by} has the object"),
            Self::Size { width_m, opening_m: (min, max) } => {
                write!(f, "the object is {width_m:.3} m wide, the hand takes {min:.3} to {max:.3} m")
            }
            Self::OutOfReach(why) => write!(f, "out of reach: {why}"),
            Self::Worthless { value } => write!(f, "expected success {value:.4}"),
            Self::KeepOut { name } => write!(f, "the way enters {name}, where this arm must not be"),
            Self::Occupied { by } => write!(f, "{by} is in the way"),
        }
    }
}

/// A grasp that cannot be taken.
#[derive(Debug, Clone, PartialEq)]
pub struct Rejected {
    /// Which of the arm's grasps.
    pub grasp: usize,
    /// Why.
    pub cause: Cause,
}

/// Why an arm got what it got.
#[derive(Debug, Clone, PartialEq)]
pub enum Reason {
    /// The best grasp that it can take at all.
    Best,
    /// So many of its grasps are worth more, and lose more elsewhere than they gain; the best of them is in conflict with
    /// another arm's.
    BestTogether {
        /// How many are worth more.
        better: usize,
        /// Whose grasp the best of them is in conflict with; `None` where only others were worth more together.
        with: Option<String>,
        /// True when they would take the same object, false when they would be in each other's way.
        same_object: bool,
    },
    /// There is no grasp for its hand.
    NoGrasps,
    /// None of its grasps can be taken; the most frequent cause, and the words of the first such grasp.
    NoneFeasible {
        /// Count of grasps by cause.
        counts: BTreeMap<&'static str, usize>,
        /// Words.
        example: String,
    },
    /// Each grasp that it could take is in conflict with those of others, which are worth more; the best of them is.
    LeftOut {
        /// Whose grasp is in its way.
        with: Option<String>,
        /// True when both would take the same object.
        same_object: bool,
    },
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let conflict = |same| if same { "takes the object" } else { "is in the way" };
        match self {
            Self::Best => f.write_str("its best grasp"),
            Self::BestTogether { better, with: Some(with), same_object } => {
                write!(
                    f,
                    "best together: {better} of its grasps are worth more; at the best {with} {}",
                    conflict(*same_object)
                )
            }
            Self::BestTogether { better, with: None, .. } => {
                write!(f, "best together: {better} of its grasps are worth more to it, less to all")
            }
            Self::NoGrasps => f.write_str("idle: no grasp was planned for its hand"),
            Self::NoneFeasible { counts, example } => {
                let counts: Vec<String> = counts.iter().map(|(cause, n)| format!("{cause} {n}")).collect();
                write!(
                    f,
                    "idle: none of its grasps can be taken ({}); for example: {example}",
                    counts.join(", ")
                )
            }
            Self::LeftOut { with: Some(with), same_object } => {
                write!(f, "idle: at its best grasp {with} {}", conflict(*same_object))
            }
            Self::LeftOut { with: None, .. } => f.write_str("idle: others are worth more without it"),
        }
    }
}

/// What an arm does.
#[derive(Debug, Clone, PartialEq)]
pub struct Chosen {
    /// Which of its grasps.
    pub grasp: usize,
    /// Expected success.
    pub value: f64,
    /// What it is made of.
    pub factors: Factors,
}

/// What was decided for an arm.
#[derive(Debug, Clone, PartialEq)]
pub struct Decision {
    /// What it does; `None`: nothing.
    pub chosen: Option<Chosen>,
    /// Why.
    pub reason: Reason,
    /// Grasps that it cannot take.
    pub rejected: Vec<Rejected>,
}

/// Who takes what.
#[derive(Debug, Clone, PartialEq)]
pub struct Assignment {
    /// One for each arm, in the problem's order.
    pub decisions: Vec<Decision>,
    /// Expected number of objects that arrive.
    pub value: f64,
    /// No assignment is worth more than this.
    pub bound: f64,
    /// Nothing better exists; `value == bound`.
    pub optimal: bool,
    /// Nodes of the search.
    pub nodes: u64,
}

/// Words for what was found.
pub(crate) fn explain(problem: &Problem<'_>, judged: &Judged<'_>, found: &Found) -> Assignment {
    // The first chosen grasp of another arm that is in conflict with a candidate.
    let conflict = |candidate: usize| {
        let others = found.chosen.iter().flatten().copied();
        let mut others = others.filter(|&o| judged.candidates[o].arm != judged.candidates[candidate].arm);
        others.find_map(|other| {
            let same = judged.same_object(candidate, other);
            let met = same || judged.corridors_conflict(candidate, other);
            met.then(|| (problem.arms[judged.candidates[other].arm].name.clone(), same))
        })
    };
    let decisions = (problem.arms.iter().enumerate())
        .map(|(arm, asked)| {
            let range = judged.of_arm[arm].clone();
            let rejected = judged.rejected[arm].clone();
            let (with, same_object) = range.clone().next().and_then(conflict).unzip();
            let same_object = same_object.unwrap_or(false);
            let (chosen, reason) = match found.chosen[arm] {
                Some(candidate) => {
                    let c = &judged.candidates[candidate];
                    let better = range.clone().take_while(|&i| judged.candidates[i].value > c.value).count();
                    let reason = match better {
                        0 => Reason::Best,
                        _ => Reason::BestTogether { better, with, same_object },
                    };
                    (Some(Chosen { grasp: c.grasp, value: c.value, factors: c.factors }), reason)
                }
                None if asked.grasps.is_empty() => (None, Reason::NoGrasps),
                None if range.is_empty() => {
                    let mut counts = BTreeMap::new();
                    for r in &rejected {
                        *counts.entry(r.cause.name()).or_insert(0) += 1;
                    }
                    let most = counts.iter().max_by_key(|(_, n)| **n).map(|(name, _)| *name);
                    let example = rejected.iter().find(|r| Some(r.cause.name()) == most);
                    let example = example.map_or_else(String::new, |r| r.cause.to_string());
                    (None, Reason::NoneFeasible { counts, example })
                }
                None => (None, Reason::LeftOut { with, same_object }),
            };
            Decision { chosen, reason, rejected }
        })
        .collect();
    Assignment {
        decisions,
        value: found.value,
        bound: found.bound,
        optimal: found.optimal,
        nodes: found.nodes,
    }
}
