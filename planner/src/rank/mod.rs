//! Ranking: from optimized candidates to grasps that can be executed, best first.

mod closing;
mod collision;
mod force_closure;
mod judge;
mod reason;
mod score;
mod suppress;

pub(crate) use force_closure::Directions;
pub(crate) use judge::Judge;
pub(crate) use reason::all_rejected;

use std::collections::BTreeMap;

use nalgebra::Point3;
use rayon::prelude::*;

use crate::grasp::{Grasp, RejectReason};
use crate::objective::Scratch;
use crate::optimize::Candidate;
use judge::Rejection;

/// Grasps best first, and what became of the other candidates.
#[derive(Debug)]
pub(crate) struct Ranking {
    pub(crate) grasps: Vec<Grasp>,
    /// Index of the candidate behind the best grasp.
    pub(crate) best: Option<usize>,
    pub(crate) rejected: BTreeMap<RejectReason, usize>,
    pub(crate) rejections: Vec<Rejection>,
}

/// Judges all candidates in parallel, sorts, suppresses duplicates, and cuts to what was asked for.
pub(crate) fn rank(judge: &Judge<'_>, candidates: &[Candidate]) -> Ranking {
    let model = judge.objective.model;
    let judged: Vec<Result<Grasp, Rejection>> = candidates
        .par_iter()
        .map_init(|| Scratch::new(model), |scratch, candidate| judge.judge(candidate, scratch))
        .collect();
    let mut rejected = BTreeMap::new();
    let mut rejections = Vec::new();
    let mut kept: Vec<(usize, Grasp)> = Vec::new();
    for (index, result) in judged.into_iter().enumerate() {
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
    let best = kept.first().map(|k| k.0);
    let mut grasps: Vec<Grasp> = kept.into_iter().map(|k| k.1).collect();
    let mut count = |reason, n: usize| {
        if n > 0 {
            *rejected.entry(reason).or_insert(0) += n;
        }
    };
    count(RejectReason::Duplicate, suppress::suppress(&mut grasps, &Point3::from(model.pivot)));
    let limit = judge.options.max_grasps;
    if grasps.len() > limit {
        count(RejectReason::BeyondLimit, grasps.len() - limit);
        grasps.truncate(limit);
    }
    Ranking { grasps, best, rejected, rejections }
}
