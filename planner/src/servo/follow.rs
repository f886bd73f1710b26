//! One grasp that is carried on: what is remembered of it, and what a frame makes of it.

use nalgebra::Isometry3;

use super::answer::{Loss, Replan, State};
use super::rivals::Rivals;
use super::stages::Stages;
use super::target::{Sight, Target};
use super::tracker::{LEAST_VISIBLE, Servo};
use crate::budget::Budget;
use crate::frame::Frame;
use crate::grasp::Grasp;
use crate::optimize::Candidate;
use crate::scene::{Scene, SceneError};
use crate::volume::View;

/// A target that was lost is looked for this far about its last place, metres.
const FIND_AGAIN_M: f64 = 0.10;
/// What has moved by more than this from one frame to the next is followed at once, metres; less is left to the
/// optimization.
const CARRY_M: f64 = 0.007;
/// So many times its patience the servo follows a hidden target.
const BLIND_PATIENCE: usize = 8;
/// Frames in a row that find the target's place empty before it is believed.
const EMPTY_FRAMES: usize = 2;

/// One grasp that is being carried on.
#[derive(Debug)]
pub(super) struct Following {
    /// The candidate behind the grasp.
    pub(super) candidate: Candidate,
    /// Others that may turn out better.
    pub(super) rivals: Rivals,
    /// Where the candidates' frame stands.
    pub(super) world_from_window: Isometry3<f64>,
    pub(super) target: Target,
    /// The grasp that was answered last.
    pub(super) grasp: Grasp,
    /// What it scored when it was taken.
    pub(super) trust: f64,
    /// Frames in a row whose evidence speaks against it.
    pub(super) against: usize,
    /// Frames in a row for which the best grasp was another one.
    pub(super) other: usize,
    /// Frames in a row in which it scored clearly less than when it was taken.
    pub(super) fallen: usize,
    /// Searches because of that.
    pub(super) renewals: usize,
    /// Frames in a row that found its place empty.
    pub(super) empty: usize,
    /// Searches in vain.
    pub(super) vain: usize,
    /// Why it is being searched anew; nothing while it is tracked.
    pub(super) searching: Option<Replan>,
    pub(super) lost: Option<Loss>,
}

/// What a frame made of the grasp.
pub(super) struct Verdict {
    pub(super) state: State,
    /// Another grasp: how far away, metres.
    pub(super) jump_m: f64,
    pub(super) is_settled: bool,
}

impl Verdict {
    /// The grasp stays as it was.
    pub(super) fn held(state: State) -> Self {
        Self { state, jump_m: 0.0, is_settled: false }
    }
}

impl Following {
    /// Moves all candidates: their frame of reference has moved by as much the other way, or what they hold on to has.
    fn translate(&mut self, by: &nalgebra::Vector3<f64>) {
        self.candidate.translate(by);
        self.rivals.translate(by);
    }
}

impl Servo {
    /// One frame of a grasp that is followed.
    #[allow(clippy::too_many_arguments)] // the parts of one frame, each by reference
    pub(super) fn track(
        &mut self,
        f: &mut Following,
        frame: &Frame,
        depth: &[f32],
        visible: f64,
        has_moved: bool,
        stages: &mut Stages<'_>,
        budget: &dyn Budget,
    ) -> Result<Verdict, SceneError> {
        let world_from_camera = frame.world_from_camera.unwrap_or_else(Isometry3::identity);
        let Some(memory) = &mut self.memory else { return Err(SceneError::NoFrames) };
        memory.place(&f.target.position);
        let world_from_window = memory.world_from_window();
        let moved = world_from_window.inverse() * f.world_from_window;
        f.translate(&moved.translation.vector);
        f.world_from_window = world_from_window;
        let view = View::of(frame, depth, &world_from_window);
        let scene = memory.read(&view, &world_from_camera, &self.options.scene, &*self.estimator, budget)?;
        stages.end("window");
        let verdict = self.look(f, &scene, visible, has_moved, stages, budget);
        if let Some(memory) = &mut self.memory {
            memory.recycle(scene);
        }
        Ok(verdict)
    }

    /// What new features make of a grasp.
    fn look(
        &mut self,
        f: &mut Following,
        scene: &Scene,
        visible: f64,
        has_moved: bool,
        stages: &mut Stages<'_>,
        budget: &dyn Budget,
    ) -> Verdict {
        self.hidden = if visible < LEAST_VISIBLE { self.hidden + 1 } else { 0 };
        if self.hidden > BLIND_PATIENCE * (self.options.patience + 1) {
            f.lost = Some(Loss::Hidden);
            return Verdict::held(State::Lost(Loss::Hidden));
        }
        if has_moved {
            f.searching = Some(Replan::CameraMoved);
        }
        match f.target.follow(scene) {
            Sight::Here { moved, is_real } => {
                f.empty = 0;
                if is_real && moved.norm() > CARRY_M && f.searching.is_none() && f.lost.is_none() {
                    let most = self.options.bounds.translation_m;
                    let by = moved * (most / moved.norm()).min(1.0);
                    f.translate(&(f.world_from_window.rotation.inverse() * by));
                }
            }
            Sight::Unclear => f.empty = 0,
            Sight::Moved { to } => {
                f.empty += 1;
                if f.empty >= EMPTY_FRAMES {
                    f.target = Target::at(to);
                    f.searching = Some(Replan::TargetMoved);
                    f.empty = 0;
                }
            }
            Sight::Gone => {
                f.empty += 1;
                if f.empty >= EMPTY_FRAMES && f.lost.is_none() {
                    f.lost = Some(Loss::TargetGone);
                    f.searching = None;
                }
            }
        }
        if let Some(loss) = f.lost {
            return match self.search(f, scene, FIND_AGAIN_M, Replan::FoundAgain, budget) {
                Some(verdict) => verdict,
                None => Verdict::held(State::Lost(loss)),
            };
        }
        if let Some(why) = f.searching {
            return self.search_or_wait(f, scene, why, budget);
        }
        self.improve(f, scene, stages, budget)
    }
}
