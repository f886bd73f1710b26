//! The servo itself: what it remembers from frame to frame, and what it makes of the next one.

use std::sync::Arc;
use std::time::Duration;

use graspd_hands::Hand;
use nalgebra::{Isometry3, Vector3};

use super::admission::{Admission, Refused};
use super::answer::{Answer, Change, Counters, Loss, Replan, State};
use super::mask::Mask;
use super::options::{Mode, ServoOptions, ServoOptionsError};
use super::smooth::{allowed_share, between, change, standing_off};
use super::standoff::{Progress, Standoff};
use super::target::{Sight, Target};
use super::window::Memory;
use crate::budget::Budget;
use crate::estimator::ContactEstimator;
use crate::frame::{CleanOptions, Frame, clean_depth};
use crate::grasp::{EmptyReason, Grasp, Plan, RejectReason};
use crate::hand_model::HandModel;
use crate::objective::{Objective, Scratch, Weights};
use crate::optimize::{Candidate, StepSizes, lengths};
use crate::options::{PlanOptions, Scheme, Target as PlanTarget, WorkspaceRequest};
use crate::orientation::Allowed;
use crate::plan::{obstacles, search};
use crate::rank::{Directions, Judge};
use crate::refine::CenteredCentroid;
use crate::scene::{self, Scene, SceneError};
use crate::volume::View;
use crate::workspace::{frame_points, table_height};

/// A search about the target: fewer candidates and iterations than the first plan, since the target is known.
const SEARCH_BATCH: usize = 24;
const SEARCH: Scheme = Scheme { iterations: 36, with_penetration: 14 };
/// Judging a candidate takes longer than optimizing it: only the most promising ones are.
const SEARCH_JUDGED: usize = 8;
/// Grasps of the target have their centroid this near to it, metres.
const OF_TARGET_M: f64 = 0.05;
/// A target that was lost is looked for this far about its last place, metres.
const FIND_AGAIN_M: f64 = 0.10;
/// What has moved by more than this from one frame to the next is followed at once, metres; less is left to the
/// optimization.
const CARRY_M: f64 = 0.007;
/// A grasp that would change by more than so many times the bounds is another grasp.
const ANOTHER: f64 = 4.0;
/// Where the target must show something, metres about its middle.
const TARGET_RADIUS_M: f64 = 0.02;
/// With less of the target in the picture than this share it is hidden, unless the camera is too near to see it.
const LEAST_VISIBLE: f64 = 0.15;
/// So many times its patience the servo follows a hidden target.
const BLIND_PATIENCE: usize = 8;
/// Frames in a row that find the target's place empty before it is believed.
const EMPTY_FRAMES: usize = 2;
/// The table's height is looked for again with every so many frames: depth cameras are off by other amounts from near by.
const TABLE_EVERY: u64 = 4;
/// Heights further than this from the known one are another surface, metres.
const SAME_TABLE_M: f64 = 0.012;

/// Where the hand is when a frame is taken.
#[derive(Debug, Clone, PartialEq)]
pub struct HandNow {
    /// Pose of its root link, world frame.
    pub world_from_hand: Isometry3<f64>,
    /// Joint positions, in the order of the tree's joints; empty: open.
    pub joints: Vec<f64>,
}

/// A frame of a servo.
#[derive(Debug, Clone, PartialEq)]
pub struct ServoFrame {
    /// Its number: rises with every frame.
    pub sequence: u64,
    /// When it was taken, on any clock that does not go back.
    pub captured: Duration,
    /// The frame, with its pose.
    pub frame: Frame,
    /// Where the hand is, if known.
    pub hand: Option<HandNow>,
}

/// One grasp that is being carried on.
#[derive(Debug)]
struct Following {
    candidate: Candidate,
    /// Where the candidate's frame stands.
    world_from_window: Isometry3<f64>,
    target: Target,
    /// The grasp that was answered last.
    grasp: Grasp,
    /// Frames in a row whose evidence speaks against it, and the last reason.
    against: usize,
    /// Frames in a row for which the best grasp was another one.
    other: usize,
    /// Frames in a row that found its place empty.
    empty: usize,
    /// Tracked frames since the last search.
    tracked: usize,
    /// Searches in vain.
    vain: usize,
    /// Why it is being searched anew; nothing while it is tracked.
    searching: Option<Replan>,
    lost: Option<Loss>,
}

/// What a frame made of the grasp.
struct Verdict {
    state: State,
    /// Another grasp: how far away, metres.
    jump_m: f64,
    is_settled: bool,
}

/// Carries one grasp of one hand on from frame to frame. See the [module](super).
pub struct Servo {
    hand: Arc<Hand>,
    options: ServoOptions,
    estimator: Arc<dyn ContactEstimator>,
    directions: Directions,
    admission: Admission,
    mask: Mask,
    standoff: Standoff,
    counters: Counters,
    memory: Option<Memory>,
    following: Option<Following>,
    /// Where the answer before wanted the hand.
    wanted: Option<Isometry3<f64>>,
    scratch: Option<Scratch>,
    centroids: Vec<CenteredCentroid>,
    /// Frames in a row that showed nothing of the target.
    hidden: usize,
}

impl std::fmt::Debug for Servo {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Servo")
            .field("hand", &self.hand.id)
            .field("counters", &self.counters)
            .finish_non_exhaustive()
    }
}

impl Servo {
    /// A servo that has seen nothing yet.
    ///
    /// # Errors
    /// [`ServoOptionsError`] for an option that cannot be taken.
    pub fn new(
        hand: Arc<Hand>,
        options: ServoOptions,
        estimator: Arc<dyn ContactEstimator>,
    ) -> Result<Self, ServoOptionsError> {
        options.validate()?;
        Ok(Self {
            directions: Directions::new(),
            admission: Admission::new(options.camera),
            mask: Mask::default(),
            standoff: Standoff::new(options.standoff),
            counters: Counters::default(),
            memory: None,
            following: None,
            wanted: None,
            scratch: None,
            centroids: Vec::new(),
            hidden: 0,
            hand,
            options,
            estimator,
        })
    }

    /// What was counted so far.
    pub fn counters(&self) -> Counters {
        self.counters
    }

    /// The hand.
    pub fn hand(&self) -> &Arc<Hand> {
        &self.hand
    }

    /// Times that the remembered volume was moved to stay about the target.
    pub fn volume_moves(&self) -> u64 {
        self.memory.as_ref().map_or(0, |m| m.moves)
    }

    /// Takes a frame in and says what the robot should do.
    ///
    /// # Errors
    /// [`Refused`] for a frame that is not looked at, or whose work had to stop; what was known stays.
    pub fn step(&mut self, input: ServoFrame, budget: &dyn Budget) -> Result<Answer, Refused> {
        let ServoFrame { sequence, captured, mut frame, hand } = input;
        let valid = frame.validate().map_err(Refused::Frame);
        let posed = valid.and_then(|()| frame.world_from_camera.ok_or(Refused::MissingPose));
        let world_from_camera = posed.inspect_err(|_| self.counters.invalid += 1)?;
        let has_moved = self.admission.admit(sequence, captured, &world_from_camera, &mut self.counters)?;
        let mut stages = Stages::new(budget);
        let world_from_hand = hand
            .as_ref()
            .map(|h| h.world_from_hand)
            .or_else(|| Some(world_from_camera * self.options.hand_from_camera?.inverse()));
        let before = self.following.as_ref().map(|f| f.grasp.world_from_hand);
        let is_static = self.options.mode == Mode::Static && self.following.is_some();
        let (mut visible, mut is_near) = (1.0, false);
        let verdict = if is_static {
            Verdict { state: State::Tracking, jump_m: 0.0, is_settled: true }
        } else {
            self.mask(&mut frame, &world_from_camera, world_from_hand.as_ref(), hand.as_ref());
            let depth = clean_depth(&frame.image, &CleanOptions::of_lens(&frame.intrinsics));
            stages.end("frame");
            self.remember(&frame, &depth, &world_from_camera)?;
            stages.end("fuse");
            let looked = match self.following.take() {
                Some(mut following) => {
                    visible = self.visible(&frame, &depth, &world_from_camera, &following);
                    let apart = following.target.position.coords - world_from_camera.translation.vector;
                    is_near = apart.norm() < self.options.blind_within_m;
                    let sight = if is_near { 1.0 } else { visible };
                    let verdict =
                        self.track(&mut following, &frame, &depth, sight, has_moved, &mut stages, budget);
                    self.following = Some(following);
                    verdict
                }
                None => self.first(&frame, &depth, &world_from_camera, budget),
            };
            let verdict = looked.map_err(|error| match error {
                SceneError::Stopped(stop) => Refused::Stopped(stop),
                other => Refused::Scene(other),
            })?;
            stages.end("judge");
            verdict
        };
        self.counters.answered += 1;
        Ok(self.answer(
            Seen { sequence, captured, visible, is_near, before, world_from_hand },
            &verdict,
            stages.done,
        ))
    }

    /// What is answered after all is known.
    fn answer(&mut self, seen: Seen, verdict: &Verdict, stages: Vec<(&'static str, Duration)>) -> Answer {
        let grasp = self.following.as_ref().map(|f| f.grasp.clone());
        let pivot = Vector3::from(self.hand_pivot());
        let change = match (&seen.before, &grasp) {
            (Some(before), Some(grasp)) => change(before, &grasp.world_from_hand, &pivot),
            _ => Change::default(),
        };
        let lag_m = match (&self.wanted, &seen.world_from_hand) {
            (Some(wanted), Some(hand)) => Some((wanted.translation.vector - hand.translation.vector).norm()),
            _ => None,
        };
        let is_good = verdict.state == State::Tracking && (seen.is_near || seen.visible >= LEAST_VISIBLE);
        let is_go_good = is_good && verdict.is_settled;
        let (standoff_m, go) = if grasp.is_some() {
            let progress = Progress { is_good, jump_m: verdict.jump_m, lag_m };
            let (at, go) = self.standoff.next(seen.captured, &progress);
            (at, go && is_go_good)
        } else {
            (self.options.standoff.start_m, false)
        };
        let world_from_standoff =
            grasp.as_ref().map(|g| standing_off(&g.world_from_hand, &self.hand, standoff_m));
        self.wanted = world_from_standoff;
        if matches!(verdict.state, State::Replanning(_)) && verdict.jump_m > 0.0
            || seen.before.is_none() && grasp.is_some()
        {
            self.counters.replanned += 1;
        }
        Answer {
            sequence: seen.sequence,
            captured: seen.captured,
            state: verdict.state,
            grasp,
            change,
            is_settled: verdict.is_settled,
            standoff_m,
            world_from_standoff,
            go,
            visible: seen.visible,
            counters: self.counters,
            stages,
        }
    }

    fn hand_pivot(&self) -> [f64; 3] {
        let poses = self.hand.tree.body_poses(&self.hand.actuation.joints(&self.hand.actuation.open()));
        let candidates = &self.hand.candidates;
        let sum: Vector3<f64> = candidates.iter().map(|c| (poses[c.body] * c.point).coords).sum();
        (sum / candidates.len().max(1) as f64).into()
    }

    /// Makes holes where the frame shows the hand itself.
    fn mask(
        &mut self,
        frame: &mut Frame,
        world_from_camera: &Isometry3<f64>,
        world_from_hand: Option<&Isometry3<f64>>,
        hand: Option<&HandNow>,
    ) {
        let Some(world_from_hand) = world_from_hand else { return };
        let told = hand.filter(|h| !h.joints.is_empty()).map(|h| h.joints.clone());
        let joints = told.unwrap_or_else(|| self.hand.actuation.joints(&self.hand.actuation.open()));
        self.mask.apply(frame, world_from_camera, &self.hand, world_from_hand, &joints);
    }

    /// Fuses a frame into what is remembered; the first one decides where the volume stands.
    fn remember(
        &mut self,
        frame: &Frame,
        depth: &[f32],
        world_from_camera: &Isometry3<f64>,
    ) -> Result<(), Refused> {
        let Some(memory) = &mut self.memory else {
            let (workspace, volume) =
                scene::look(std::slice::from_ref(frame), &self.options.scene).map_err(Refused::Scene)?;
            let window = self.options.window_voxels;
            self.memory = Some(Memory::new(volume, workspace.world_from_volume, window));
            return Ok(());
        };
        let camera_from_volume = world_from_camera.inverse() * memory.world_from_volume;
        memory.volume.update(frame, depth, &camera_from_volume, self.options.memory);
        let is_given =
            matches!(self.options.scene.workspace, WorkspaceRequest::Placed { table_m: Some(_), .. });
        if let Some(table) = memory.volume.table_m
            && !is_given
            && self.counters.answered.is_multiple_of(TABLE_EVERY)
        {
            let points = frame_points(frame, depth);
            let size = memory.volume.grid.size_m;
            let seen = table_height(&points, &memory.world_from_volume, size);
            if let Some(seen) = seen.filter(|s| (s - table).abs() <= SAME_TABLE_M) {
                memory.volume.table_m = Some(table + 0.5 * (seen - table));
            }
        }
        Ok(())
    }

    /// The first plan: in the whole volume.
    fn first(
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
        let (plan, best) = search(&scene, &self.hand, &self.options.plan, usize::MAX, budget, None);
        budget.check().map_err(SceneError::Stopped)?;
        let Some((grasp, candidate)) = plan.grasps.first().cloned().zip(best) else {
            let state = State::Lost(Loss::NoGrasp(reason_of(&plan)));
            return Ok(Verdict { state, jump_m: 0.0, is_settled: false });
        };
        self.following = Some(Following {
            candidate,
            world_from_window: scene.workspace.world_from_volume,
            target: Target::at(grasp.centroid),
            grasp,
            against: 0,
            other: 0,
            empty: 0,
            tracked: 0,
            vain: 0,
            searching: None,
            lost: None,
        });
        Ok(Verdict { state: State::Replanning(Replan::First), jump_m: 0.0, is_settled: true })
    }

    /// Share of the target's place that a frame shows.
    fn visible(
        &self,
        frame: &Frame,
        depth: &[f32],
        world_from_camera: &Isometry3<f64>,
        following: &Following,
    ) -> f64 {
        let at = world_from_camera.inverse_transform_point(&following.target.position);
        let Some([u, v]) = frame.intrinsics.project([at.x, at.y, at.z]) else { return 0.0 };
        let (width, height) = (frame.image.width as isize, frame.image.height as isize);
        let reach = (frame.intrinsics.fx_px * TARGET_RADIUS_M / at.z.max(0.05)).clamp(1.0, 64.0) as isize;
        let (mut shown, mut all) = (0, 0);
        for dv in -reach..=reach {
            for du in -reach..=reach {
                all += 1;
                let (x, y) = (u.round() as isize + du, v.round() as isize + dv);
                if (0..width).contains(&x) && (0..height).contains(&y) {
                    shown += i32::from(depth[(y * width + x) as usize] > 0.0);
                }
            }
        }
        f64::from(shown) / f64::from(all.max(1))
    }

    /// One frame of a grasp that is followed.
    #[allow(clippy::too_many_arguments)] // the parts of one frame, each by reference
    fn track(
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
        f.candidate.translate(&moved.translation.vector);
        f.world_from_window = world_from_window;
        let view = View::of(frame, depth, &world_from_window);
        let scene = memory.read(&view, &world_from_camera, &self.options.scene, &*self.estimator, budget)?;
        stages.end("window");
        let verdict = self.judge(f, &scene, visible, has_moved, stages, budget);
        if let Some(memory) = &mut self.memory {
            memory.recycle(scene);
        }
        Ok(verdict)
    }

    /// What new features make of a grasp.
    fn judge(
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
            return held(State::Lost(Loss::Hidden));
        }
        if has_moved {
            f.searching = Some(Replan::CameraMoved);
        }
        match f.target.follow(scene) {
            Sight::Here { moved } => {
                f.empty = 0;
                if moved.norm() > CARRY_M && f.searching.is_none() && f.lost.is_none() {
                    let most = self.options.bounds.translation_m;
                    let by = moved * (most / moved.norm()).min(1.0);
                    f.candidate.translate(&(f.world_from_window.rotation.inverse() * by));
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
            return match self.search(f, scene, FIND_AGAIN_M, Replan::FoundAgain, 0.0, budget) {
                Some(verdict) => verdict,
                None => held(State::Lost(loss)),
            };
        }
        if let Some(why) = f.searching {
            return self.search_or_wait(f, scene, why, budget);
        }
        self.refine(f, scene, stages, budget)
    }

    /// A few iterations of the one candidate, and what its judge says.
    fn refine(
        &mut self,
        f: &mut Following,
        scene: &Scene,
        stages: &mut Stages<'_>,
        budget: &dyn Budget,
    ) -> Verdict {
        let hand = Arc::clone(&self.hand);
        let model = HandModel::new(&hand);
        let mut centroids = std::mem::take(&mut self.centroids);
        f.target.centroids(scene, &mut centroids);
        let options = &self.options.plan;
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
        f.candidate.refine(&objective, &allowed, &sizes, &lengths, self.options.iterations, scratch);
        stages.end("refine");
        // What is asked for decided about the first plan; now the target does.
        let any = PlanOptions { target: None, ..options.clone() };
        let directions = self.directions.clone();
        let judge = Judge { scene, objective: &objective, allowed: &allowed, options: &any, directions };
        let judged = judge.judge(&f.candidate, scratch);
        let pivot = model.pivot;
        drop(objective);
        self.centroids = centroids;

        let judged = judged.map_err(|r| r.reason).and_then(|grasp| {
            let is_target = (grasp.centroid - f.target.position).norm() <= OF_TARGET_M;
            if is_target { Ok(grasp) } else { Err(RejectReason::NotTarget) }
        });
        let grasp = match judged {
            Ok(grasp) => grasp,
            Err(reason) => {
                f.against += 1;
                if f.against <= self.options.patience {
                    return held(State::Tracking);
                }
                f.searching = Some(Replan::Rejected(reason));
                return self.search_or_wait(f, scene, Replan::Rejected(reason), budget);
            }
        };
        f.against = 0;
        f.tracked += 1;
        let bounds = &self.options.bounds;
        let difference = change(&f.grasp.world_from_hand, &grasp.world_from_hand, &pivot);
        let share = allowed_share(&difference, bounds);
        if share * ANOTHER < 1.0 {
            f.other += 1;
            if f.other <= self.options.patience {
                return held(State::Tracking);
            }
            f.other = 0;
            f.grasp = grasp;
            let jump_m = difference.translation_m.max(bounds.translation_m);
            return Verdict { state: State::Replanning(Replan::Jump), jump_m, is_settled: true };
        }
        f.other = 0;
        let every = self.options.reconsider_every;
        if every > 0 && f.tracked >= every {
            f.tracked = 0;
            let least = grasp.score + self.options.reconsider_margin;
            if let Some(verdict) = self.search(f, scene, OF_TARGET_M, Replan::Better, least, budget) {
                return verdict;
            }
        }
        let is_settled = share >= 1.0;
        f.grasp = if is_settled {
            grasp
        } else {
            between(&f.grasp, &grasp, share, &hand, &pivot, &scene.world_from_camera)
        };
        Verdict { state: State::Tracking, jump_m: 0.0, is_settled }
    }

    /// Searches another grasp of the target, for as many frames as are given for that.
    fn search_or_wait(
        &mut self,
        f: &mut Following,
        scene: &Scene,
        why: Replan,
        budget: &dyn Budget,
    ) -> Verdict {
        match self.search(f, scene, OF_TARGET_M, why, 0.0, budget) {
            Some(verdict) => verdict,
            None => {
                f.vain += 1;
                if f.vain >= self.options.give_up {
                    f.lost = Some(Loss::NoGrasp(EmptyReason::AllRejected));
                    return held(State::Lost(Loss::NoGrasp(EmptyReason::AllRejected)));
                }
                held(State::Replanning(why))
            }
        }
    }

    /// Searches grasps about the target; takes the best if it scores at least `least`.
    fn search(
        &mut self,
        f: &mut Following,
        scene: &Scene,
        radius_m: f64,
        why: Replan,
        least: f64,
        budget: &dyn Budget,
    ) -> Option<Verdict> {
        let target = Some(PlanTarget::Point { point: f.target.position, radius_m });
        let options = PlanOptions {
            batch: SEARCH_BATCH,
            scheme: SEARCH,
            target,
            // Another frame, other candidates.
            seed: self.options.plan.seed ^ self.counters.answered.wrapping_mul(0x9E37_79B9_7F4A_7C15),
            ..self.options.plan.clone()
        };
        let (plan, best) = search(scene, &self.hand, &options, SEARCH_JUDGED, budget, None);
        let (grasp, candidate) = plan.grasps.into_iter().next().zip(best)?;
        if grasp.score < least {
            return None;
        }
        let pivot = Vector3::from(self.hand_pivot());
        let apart = change(&f.grasp.world_from_hand, &grasp.world_from_hand, &pivot);
        f.candidate = candidate;
        f.target = Target::at(grasp.centroid);
        f.grasp = grasp;
        (f.against, f.other, f.empty, f.tracked, f.vain) = (0, 0, 0, 0, 0);
        (f.searching, f.lost) = (None, None);
        self.hidden = 0;
        let jump_m = apart.translation_m.max(self.options.bounds.translation_m);
        Some(Verdict { state: State::Replanning(why), jump_m, is_settled: true })
    }
}

/// What is known of a frame when its answer is made.
struct Seen {
    sequence: u64,
    captured: Duration,
    visible: f64,
    /// So near to the target that the camera may be blind.
    is_near: bool,
    before: Option<Isometry3<f64>>,
    world_from_hand: Option<Isometry3<f64>>,
}

/// The grasp stays as it was.
fn held(state: State) -> Verdict {
    Verdict { state, jump_m: 0.0, is_settled: false }
}

fn reason_of(plan: &Plan) -> EmptyReason {
    plan.no_grasp.as_ref().map_or(EmptyReason::AllRejected, |n| n.reason)
}

/// Stage durations from a budget's clock.
struct Stages<'a> {
    budget: &'a dyn Budget,
    since: Duration,
    done: Vec<(&'static str, Duration)>,
}

impl<'a> Stages<'a> {
    fn new(budget: &'a dyn Budget) -> Self {
        Self { budget, since: budget.elapsed(), done: Vec::with_capacity(4) }
    }

    fn end(&mut self, name: &'static str) {
        let now = self.budget.elapsed();
        self.done.push((name, now.saturating_sub(self.since)));
        self.since = now;
    }
}
