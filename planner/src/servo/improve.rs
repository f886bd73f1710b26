//! What becomes of a tracked grasp with new features: it is judged anew beside one rival, and gives way to a better one.

use std::sync::Arc;

use super::answer::{Replan, State};
use super::follow::{Following, Verdict};
use super::rivals::Turn;
use super::search::OF_TARGET_M;
use super::smooth::{allowed_share, between, change};
use super::stages::Stages;
use super::target::Target;
use super::tracker::Servo;
use crate::budget::Budget;
use crate::grasp::{Grasp, RejectReason};
use crate::hand_model::HandModel;
use crate::objective::{Objective, Scratch, Weights};
use crate::optimize::{Candidate, StepSizes, lengths};
use crate::orientation::Allowed;
use crate::plan::obstacles;
use crate::rank::{Judge, Rejection};
use crate::scene::Scene;

/// A grasp that would change by more than so many times the bounds is another grasp.
const ANOTHER: f64 = 4.0;
/// The grasp's own continuation is taken for so much more score: less is noise, and noise adds up to drift.
const OWN_MARGIN: f64 = 0.05;
/// A grasp that the newest frames speak against gives way to one that scores at most so much less than it did when it was
/// taken.
const AS_GOOD: f64 = 0.1;
/// So much less score than when a grasp was taken is a reason to look for another one.
const FALLEN: f64 = 0.15;
/// So many times in all of an approach.
const RENEWALS: usize = 4;
/// Collisions no deeper than this may be the noise of a near view, metres.
const SHALLOW_M: f64 = 0.01;
/// A rival that takes hold this far away holds another part of the target, or its neighbour, metres.
const SAME_MIDDLE_M: f64 = 0.02;

impl Servo {
    /// A few iterations of one rival, and what the judge says of it and of the grasp.
    pub(super) fn improve(
        &mut self,
        f: &mut Following,
        scene: &Scene,
        stages: &mut Stages<'_>,
        budget: &dyn Budget,
    ) -> Verdict {
        let hand = Arc::clone(&self.hand);
        let model = HandModel::new(&hand);
        let pivot = model.pivot;
        let mut centroids = std::mem::take(&mut self.centroids);
        f.target.centroids(scene, &mut centroids);
        let options = &self.any;
        let objective = Objective {
            model: &model,
            cells: &scene.features.cells,
            centroids: &centroids,
            obstacles: obstacles(scene, options, &scene.workspace.world_from_volume),
            weights: Weights::default(),
        };
        let world_from_volume = &scene.workspace.world_from_volume;
        let allowed = Allowed::new(&options.orientation, &options.reaching, world_from_volume);
        let scratch = self.scratch.get_or_insert_with(|| Scratch::new(&model));
        let sizes = StepSizes::default();
        let lengths = lengths(&model, &sizes);
        let judge =
            Judge { scene, objective: &objective, allowed: &allowed, options, directions: &self.directions };
        let target = f.target.position;
        let judged = |candidate: &Candidate, scratch: &mut Scratch| {
            let grasp = judge.judge(candidate, scratch, budget)?;
            let is_target = (grasp.centroid - target).norm() <= OF_TARGET_M;
            if is_target { Ok(grasp) } else { Err(Rejection::new(RejectReason::NotTarget, 0.0)) }
        };
        let iterations = self.options.iterations;
        let ask = |candidate: &mut Candidate, scratch: &mut Scratch| {
            candidate.refine(&objective, &allowed, &sizes, &lengths, iterations, scratch);
        };
        let turn = f.rivals.turn(self.options.reconsider_every);
        ask(f.rivals.candidate(turn), scratch);
        stages.end("refine");
        let held = judged(&f.candidate, scratch);
        let proposed = judged(f.rivals.candidate(turn), scratch);

        let bounds = self.options.bounds;
        let margin = match turn {
            Turn::Own => OWN_MARGIN,
            Turn::Other(_) => self.options.reconsider_margin,
        };
        let has_stayed = (f.grasp.centroid - target).norm() <= SAME_MIDDLE_M;
        // What this one frame rejects may be noise: another grasp waits for more of that, and must be about as good.
        let may_replace = turn == Turn::Own || f.against >= self.options.patience;
        let is_doubt = matches!(&held, Err(rejection) if is_doubtful(rejection)) && has_stayed;
        let is_better = match (&held, &proposed) {
            (_, Err(_)) => false,
            // What was planned is not given up because of the noise of a near view.
            (Err(_), Ok(_)) if is_doubt => false,
            (Err(_), Ok(proposed)) => may_replace && proposed.score >= f.trust - AS_GOOD,
            (Ok(held), Ok(proposed)) => proposed.score >= held.score + margin,
        };
        let is_taken = is_better && (held.is_err() || f.rivals.wins(turn));
        let found = if is_taken {
            f.rivals.promote(turn, &mut f.candidate);
            proposed
        } else {
            if !is_better {
                f.rivals.leave(turn, &f.candidate);
            }
            held
        };
        let (found, why) = match found {
            Ok(grasp) if is_taken && turn != Turn::Own => (Some(grasp), Some(Replan::Better)),
            Ok(grasp) => (Some(grasp), None),
            Err(_) if f.against < self.options.patience => {
                f.against += 1;
                (None, None)
            }
            Err(_) if is_doubt => {
                drop(objective);
                self.centroids = centroids;
                return Verdict { state: State::Tracking, jump_m: 0.0, is_settled: true };
            }
            Err(rejection) => {
                // The best of all rivals, before a search.
                let mut best: Option<(usize, Grasp)> = None;
                for i in 0..f.rivals.len() {
                    let rival = f.rivals.candidate(Turn::Other(i));
                    ask(rival, scratch);
                    if let Ok(grasp) = judged(rival, scratch)
                        && best.as_ref().is_none_or(|(_, b)| grasp.score > b.score)
                    {
                        best = Some((i, grasp));
                    }
                }
                let best = best.filter(|(_, grasp)| grasp.score >= f.trust - AS_GOOD);
                if let Some((i, _)) = best {
                    f.rivals.promote(Turn::Other(i), &mut f.candidate);
                }
                (best.map(|b| b.1), Some(Replan::Rejected(rejection.reason)))
            }
        };
        drop(objective);
        self.centroids = centroids;
        let Some(grasp) = found else {
            return match why {
                Some(why) => {
                    f.searching = Some(why);
                    self.search_or_wait(f, scene, why, budget)
                }
                None => Verdict::held(State::Tracking),
            };
        };
        f.against = 0;
        if why.is_some() {
            f.trust = grasp.score;
        }
        let has_fallen = grasp.score < f.trust - FALLEN;
        f.fallen = if has_fallen { f.fallen + 1 } else { 0 };
        if f.fallen > self.options.patience && f.renewals < RENEWALS {
            (f.fallen, f.renewals) = (0, f.renewals + 1);
            if let Some(verdict) = self.renew(f, scene, grasp.score, budget) {
                return verdict;
            }
        }
        if why.is_some() && (grasp.centroid - target).norm() > SAME_MIDDLE_M {
            f.target = Target::at(grasp.centroid);
        }
        let difference = change(&f.grasp.world_from_hand, &grasp.world_from_hand, &pivot);
        let share = allowed_share(&difference, &bounds);
        if share * ANOTHER < 1.0 {
            if why.is_none() {
                f.other += 1;
                if f.other <= self.options.patience {
                    return Verdict::held(State::Tracking);
                }
            }
            f.other = 0;
            f.grasp = grasp;
            let jump_m = difference.translation_m.max(bounds.translation_m);
            let state = State::Replanning(why.unwrap_or(Replan::Jump));
            return Verdict { state, jump_m, is_settled: true };
        }
        f.other = 0;
        let is_settled = share >= 1.0;
        f.grasp = if is_settled {
            grasp
        } else {
            between(&f.grasp, &grasp, share, &hand, &pivot, &scene.world_from_camera)
        };
        Verdict { state: State::Tracking, jump_m: 0.0, is_settled }
    }
}

/// True for a rejection that may be noise: a shallow collision, contacts that are seen a little otherwise, or an edge of a
/// keep-out box that the grasp was beside when it was taken.
fn is_doubtful(rejection: &Rejection) -> bool {
    use RejectReason as R;
    match rejection.reason {
        R::CollisionScene | R::CollisionTable | R::ApproachBlocked | R::KeepOut => {
            rejection.by_m <= SHALLOW_M
        }
        R::NoForceClosure | R::LowScore | R::NoContact | R::NotTarget => true,
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_near_view_may_get_wrong_is_doubted_and_the_rest_is_not() {
        let of = |reason, by_m| is_doubtful(&Rejection::new(reason, by_m));
        for reason in [RejectReason::CollisionScene, RejectReason::ApproachBlocked, RejectReason::KeepOut] {
            assert!(of(reason, 0.004), "{reason:?}");
            assert!(!of(reason, 0.02), "{reason:?}: something new may be in the way");
        }
        assert!(of(RejectReason::NoContact, 0.0));
        assert!(!of(RejectReason::CollisionSelf, 0.001), "no view changes that");
    }
}
