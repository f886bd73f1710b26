//! Looking for grasps: the first plan in the whole volume, and others of the target later on.

use nalgebra::{Isometry3, Vector3};

use super::answer::{Loss, Replan, State};
use super::follow::{Following, Verdict};
use super::rivals::{self, Rivals};
use super::smooth::change;
use super::target::Target;
use super::tracker::Servo;
use crate::budget::Budget;
use crate::frame::Frame;
use crate::grasp::{EmptyReason, Grasp, Plan};
use crate::optimize::Candidate;
use crate::options::{PlanOptions, Scheme, Target as PlanTarget};
use crate::plan::search;
use crate::scene::{Scene, SceneError};
use crate::volume::View;

/// Of so many grasps of the first plan those of the same target become rivals of the best one.
const FIRST_KEPT: usize = 48;
/// A search about the target: fewer candidates and iterations than the first plan, since the target is known.
const SEARCH_BATCH: usize = 24;
const SEARCH: Scheme = Scheme { iterations: 36, with_penetration: 14 };
/// Judging a candidate takes longer than optimizing it: only the most promising ones are.
const SEARCH_JUDGED: usize = 8;
/// Grasps of the target have their centroid this near to it, metres.
pub(super) const OF_TARGET_M: f64 = 0.05;

impl Servo {
    /// The first plan: in the whole volume.
    pub(super) fn first(
        &mut self,
        frame: &Frame,
        depth: &[f32],
        world_from_camera: &Isometry3<f64>,
        budget: &dyn Budget,
    ) -> Result<Verdict, SceneError> {
        let Some(memory) = &self.memory else { return Err(SceneError::NoFrames) };
        let view = View::of(frame, depth, &memory.world_from_volume);
        let scene =
            memory.read_whole(&view, world_from_camera, &self.options.scene, &*self.estimator, budget)?;
        let options = PlanOptions { max_grasps: FIRST_KEPT, seed: self.seed(), ..self.options.plan.clone() };
        let (plan, best) = search(&scene, &self.hand, &options, (usize::MAX, FIRST_KEPT), budget, None);
        budget.check().map_err(SceneError::Stopped)?;
        let why = reason_of(&plan);
        let Some((grasp, candidate, rivals)) = chosen(plan, best) else {
            return Ok(Verdict::held(State::Lost(Loss::NoGrasp(why))));
        };
        self.following = Some(Following {
            candidate,
            rivals,
            world_from_window: scene.workspace.world_from_volume,
            target: Target::at(grasp.centroid),
            trust: grasp.score,
            grasp,
            against: 0,
            other: 0,
            fallen: 0,
            renewals: 0,
            empty: 0,
            vain: 0,
            searching: None,
            lost: None,
        });
        Ok(Verdict { state: State::Replanning(Replan::First), jump_m: 0.0, is_settled: true })
    }

    /// Another frame, other candidates: where one search was in vain the next may not be.
    fn seed(&self) -> u64 {
        self.options.plan.seed ^ self.counters.answered.wrapping_mul(0x9E37_79B9_7F4A_7C15)
    }

    /// Searches another grasp of the target, for as many frames as are given for that.
    pub(super) fn search_or_wait(
        &mut self,
        f: &mut Following,
        scene: &Scene,
        why: Replan,
        budget: &dyn Budget,
    ) -> Verdict {
        match self.search(f, scene, OF_TARGET_M, why, budget) {
            Some(verdict) => verdict,
            None => {
                f.vain += 1;
                if f.vain >= self.options.give_up {
                    f.lost = Some(Loss::NoGrasp(EmptyReason::AllRejected));
                    return Verdict::held(State::Lost(Loss::NoGrasp(EmptyReason::AllRejected)));
                }
                Verdict::held(State::Replanning(why))
            }
        }
    }

    /// Searches grasps about the target; takes the best.
    pub(super) fn search(
        &mut self,
        f: &mut Following,
        scene: &Scene,
        radius_m: f64,
        why: Replan,
        budget: &dyn Budget,
    ) -> Option<Verdict> {
        let found = self.look_for(f, scene, radius_m, budget)?;
        Some(self.take(f, found, why))
    }

    /// Searches grasps of a target that is tracked, whose grasp scores so little by now; takes the best where that is
    /// clearly better.
    pub(super) fn renew(
        &mut self,
        f: &mut Following,
        scene: &Scene,
        score: f64,
        budget: &dyn Budget,
    ) -> Option<Verdict> {
        let found = self.look_for(f, scene, OF_TARGET_M, budget)?;
        let is_better = found.0.score >= score + self.options.reconsider_margin;
        is_better.then(|| self.take(f, found, Replan::Worse))
    }

    /// The best grasp about the target, its candidate and its rivals.
    fn look_for(
        &mut self,
        f: &Following,
        scene: &Scene,
        radius_m: f64,
        budget: &dyn Budget,
    ) -> Option<(Grasp, Candidate, Rivals)> {
        let target = Some(PlanTarget::Point { point: f.target.position, radius_m });
        let options = PlanOptions {
            batch: SEARCH_BATCH,
            scheme: SEARCH,
            target,
            seed: self.seed(),
            ..self.options.plan.clone()
        };
        let (plan, best) =
            search(scene, &self.hand, &options, (SEARCH_JUDGED, rivals::MOST + 1), budget, None);
        chosen(plan, best)
    }

    /// Follows another grasp from now on.
    fn take(&mut self, f: &mut Following, found: (Grasp, Candidate, Rivals), why: Replan) -> Verdict {
        let (grasp, candidate, rivals) = found;
        let pivot = Vector3::from(self.hand_pivot());
        let apart = change(&f.grasp.world_from_hand, &grasp.world_from_hand, &pivot);
        (f.candidate, f.rivals) = (candidate, rivals);
        f.target = Target::at(grasp.centroid);
        f.trust = grasp.score;
        f.grasp = grasp;
        (f.against, f.other, f.empty, f.vain, f.fallen) = (0, 0, 0, 0, 0);
        (f.searching, f.lost) = (None, None);
        self.hidden = 0;
        let jump_m = apart.translation_m.max(self.options.bounds.translation_m);
        Verdict { state: State::Replanning(why), jump_m, is_settled: true }
    }
}

/// The best grasp of a plan, its candidate, and the other grasps of the same target as its rivals.
fn chosen(plan: Plan, candidates: Vec<Candidate>) -> Option<(Grasp, Candidate, Rivals)> {
    let mut all = plan.grasps.into_iter().zip(candidates);
    let (grasp, candidate) = all.next()?;
    let of_target = |other: &Grasp| (other.centroid - grasp.centroid).norm() <= OF_TARGET_M;
    let rivals = Rivals::new(&candidate, all.filter(|(other, _)| of_target(other)).map(|(_, c)| c));
    Some((grasp, candidate, rivals))
}

fn reason_of(plan: &Plan) -> EmptyReason {
    plan.no_grasp.as_ref().map_or(EmptyReason::AllRejected, |n| n.reason)
}
