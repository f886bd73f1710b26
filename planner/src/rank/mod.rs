//! Ranking: from optimized candidates to grasps that can be executed, best first.

mod closing;
mod collision;
mod force_closure;
mod judge;
mod opposition;
mod reason;
mod regrip;
mod score;
mod suppress;
mod touch;

pub(crate) use force_closure::Directions;
pub(crate) use judge::{Judge, Rejection};
pub(crate) use reason::all_rejected;

use std::collections::BTreeMap;

use nalgebra::Point3;
use rayon::prelude::*;

use crate::budget::{Budget, Stop};
use crate::grasp::{Grasp, RejectReason};
use crate::objective::Scratch;
use crate::optimize::Candidate;

/// Grasps best first, and what became of the other candidates.
#[derive(Debug)]
pub(crate) struct Ranking {
    pub(crate) grasps: Vec<Grasp>,
    /// Indices of the candidates behind the grasps.
    pub(crate) sources: Vec<usize>,
    pub(crate) rejected: BTreeMap<RejectReason, usize>,
    pub(crate) rejections: Vec<Rejection>,
}

/// Judged whatever the budget says, of the candidates with the lowest objectives: an answer in time is worth
/// little without a look at the best.
const ALWAYS_JUDGED: usize = 24;

/// Judges candidates in parallel, lowest objective first, sorts, suppresses duplicates, and cuts to what was
/// asked for. At most `most` candidates are judged, and only the first few once the budget has ended; the
/// others count as unfinished. None is judged for a cancelled call.
pub(crate) fn rank(judge: &Judge<'_>, candidates: &[Candidate], most: usize, budget: &dyn Budget) -> Ranking {
    let model = judge.objective.model;
    let mut order: Vec<usize> = (0..candidates.len()).collect();
    // Whose objective does not know of obstacles comes after those whose does.
    order.sort_by(|&a, &b| {
        let (one, other) = (&candidates[a], &candidates[b]);
        let knows = other.knows_penetration.cmp(&one.knows_penetration);
        knows.then(one.terms.total.total_cmp(&other.terms.total)).then(a.cmp(&b))
    });
    let unfinished = || Err(Rejection::new(RejectReason::Unfinished, 0.0));
    let mut judged: Vec<(usize, Result<Grasp, Rejection>)> = order
        .into_par_iter()
        .enumerate()
        .with_max_len(4)
        .map_init(
            || Scratch::new(model),
            |scratch, (place, index)| {
                let skip = match budget.stop() {
                    Some(Stop::Cancelled) => true,
                    Some(Stop::Deadline) => place >= ALWAYS_JUDGED,
                    None => false,
                };
                let result = if skip || place >= most {
                    unfinished()
                } else {
                    judge.judge(&candidates[index], scratch, budget)
                };
                (index, result)
            },
        )
        .collect();
    judged.sort_by_key(|(index, _)| *index);
    let mut rejected = BTreeMap::new();
    let mut rejections = Vec::new();
    let mut kept: Vec<(usize, Grasp)> = Vec::new();
    for (index, result) in judged {
        match result {
            Ok(grasp) => kept.push((index, grasp)),
            Err(rejection) => {
                *rejected.entry(rejection.reason).or_insert(0) += 1;
                rejections.push(rejection);
            }
        }
    }
    // Equal scores keep the order of the candidates, so that the ranking does not depend on chance.
    kept.sort_by(|a, b| b.1.score.total_cmp(&a.1.score).then(a.0.cmp(&b.0)));
    let mut count = |reason, n: usize| {
        if n > 0 {
            *rejected.entry(reason).or_insert(0) += n;
        }
    };
    count(RejectReason::Duplicate, suppress::suppress(&mut kept, &Point3::from(model.pivot)));
    let limit = judge.options.max_grasps;
    if kept.len() > limit {
        count(RejectReason::BeyondLimit, kept.len() - limit);
        kept.truncate(limit);
    }
    let (sources, grasps) = kept.into_iter().unzip();
    Ranking { grasps, sources, rejected, rejections }
}
