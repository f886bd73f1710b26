//! The servo itself: what it remembers from frame to frame, and what it makes of the next one.

use std::sync::Arc;
use std::time::Duration;

use graspd_hands::Hand;
use nalgebra::{Isometry3, Vector3};

use super::admission::{Admission, Refused};
use super::answer::{Answer, Change, Counters, State};
use super::follow::{Following, Verdict};
use super::mask::Mask;
use super::options::{Mode, ServoOptions, ServoOptionsError};
use super::smooth::{change, standing_off};
use super::stages::Stages;
use super::standoff::{Progress, Standoff};
use super::window::Memory;
use crate::budget::{Budget, Unlimited};
use crate::estimator::ContactEstimator;
use crate::frame::{CleanOptions, Frame, clean_depth};
use crate::objective::Scratch;
use crate::options::PlanOptions;
use crate::rank::Directions;
use crate::refine::CenteredCentroid;
use crate::scene::SceneError;

/// With less of the target in the picture than this share it is hidden, unless the camera is too near to see it.
pub(super) const LEAST_VISIBLE: f64 = 0.15;

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

/// Carries one grasp of one hand on from frame to frame. See the [module](super).
pub struct Servo {
    pub(super) hand: Arc<Hand>,
    pub(super) options: ServoOptions,
    /// As in the options, for any target: what is asked for decides about the first plan, then the target does.
    pub(super) any: PlanOptions,
    pub(super) estimator: Arc<dyn ContactEstimator>,
    pub(super) directions: Directions,
    admission: Admission,
    pub(super) masking: Mask,
    pub(super) standoff: Standoff,
    pub(super) counters: Counters,
    pub(super) memory: Option<Memory>,
    pub(super) following: Option<Following>,
    /// Where the answer before wanted the hand.
    wanted: Option<Isometry3<f64>>,
    pub(super) scratch: Option<Scratch>,
    pub(super) centroids: Vec<CenteredCentroid>,
    /// Frames in a row that showed nothing of the target.
    pub(super) hidden: usize,
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
            masking: Mask::default(),
            any: PlanOptions { target: None, ..options.plan.clone() },
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
            // To its end, whatever the budget says: what is remembered is seen through all of it.
            let depth = clean_depth(&frame.image, &CleanOptions::of_lens(&frame.intrinsics), &Unlimited);
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

    pub(super) fn hand_pivot(&self) -> [f64; 3] {
        let poses = self.hand.tree.body_poses(&self.hand.actuation.joints(&self.hand.actuation.open()));
        let candidates = &self.hand.candidates;
        let sum: Vector3<f64> = candidates.iter().map(|c| (poses[c.body] * c.point).coords).sum();
        (sum / candidates.len().max(1) as f64).into()
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
