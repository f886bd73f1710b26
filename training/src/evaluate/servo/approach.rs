//! One approach: the hand from where it first looks to where it goes straight in, frame by frame.

use std::time::Duration;

use graspd_planner::budget::Budget as _;
use graspd_planner::grasp::Grasp;
use graspd_planner::servo::{Answer, HandNow, Loss, Servo, ServoFrame, State};
use graspd_sim::world::{Command, HandId, ObjectId, World};
use nalgebra::{Isometry3, Vector3};
use serde::{Deserialize, Serialize};

use super::palm::PalmCamera;
use super::settings::Nudge;
use crate::evaluate::clock::Stopwatch;
use crate::evaluate::seeds::derive;

/// An approach that takes longer is given up, simulated seconds.
const LONGEST_S: f64 = 15.0;
/// So many answers in a row without anything to follow end it.
const MOST_LOST: usize = 8;
/// How fast the arm goes to the start of the approach and after the stand-off, metres and radians per second.
const ARM_SPEED: (f64, f64) = (0.25, 1.0);
/// Directions in which a nudge is tried.
const DIRECTIONS: u64 = 8;
/// Room that a nudged object must have to others, metres.
const ROOM_M: f64 = 0.035;

/// What an approach took, and what the servo said on the way.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Way {
    /// Frames that were answered.
    pub frames: usize,
    /// Of these, answers that tracked.
    pub tracking: usize,
    /// Grasps that were announced as others, the first included.
    pub replanned: usize,
    /// Largest change from one tracked answer to the next, metres.
    pub largest_change_m: f64,
    /// How far the final grasp is from the first, metres.
    pub drift_m: f64,
    /// Longest time for one frame after the first, milliseconds on one thread.
    pub slowest_ms: f64,
    /// All frames but the first, milliseconds on one thread.
    pub refining_ms: f64,
    /// The first frame, milliseconds on one thread.
    pub planning_ms: f64,
    /// Score of the first grasp; 0 without one.
    pub first_score: f64,
    /// Score of the last one.
    pub last_score: f64,
    /// Answers that waited: another grasp was searched, there was none, or the newest frame spoke against it.
    pub waited: usize,
    /// Whether the object was shoved.
    pub nudged: bool,
}

/// How an approach ends.
#[derive(Debug)]
pub(super) enum Arrived {
    /// Go straight in: the grasp, and where the hand stands.
    Go(Box<Grasp>),
    /// There is nothing to grip, for this reason.
    Nothing(&'static str),
}

/// The parts of an approach.
pub(super) struct Approach<'a> {
    pub(super) world: &'a mut World,
    pub(super) hand: HandId,
    pub(super) camera: &'a mut PalmCamera,
    pub(super) servo: &'a mut Servo,
    pub(super) frames_per_s: f64,
    pub(super) nudge: Option<Nudge>,
    pub(super) seed: u64,
}

impl Approach<'_> {
    /// Frame after frame. What a frame says is obeyed when the next one is taken: a real servo is that late.
    pub(super) fn run(mut self) -> (Arrived, Way, Vec<String>) {
        let mut way = Way::default();
        let mut replans: Vec<String> = Vec::new();
        let steps = (1.0 / (self.frames_per_s * self.world.settings().dt_s)).round().max(1.0) as usize;
        let frames = (LONGEST_S * self.frames_per_s) as u64;
        let (mut pending, mut first, mut lost): (Option<Answer>, Option<Grasp>, usize) = (None, None, 0);
        for sequence in 0..frames {
            let Some(state) = self.world.hand_state(self.hand) else { break };
            let frame =
                self.camera.look(self.world, &state.world_from_hand, derive(self.seed, &[0, sequence]));
            let frame = ServoFrame {
                sequence,
                captured: Duration::from_secs_f64(sequence as f64 / self.frames_per_s),
                frame,
                hand: Some(HandNow { world_from_hand: state.world_from_hand, joints: state.joints }),
            };
            let watch = Stopwatch::start();
            let answer = self.servo.step(frame, &watch);
            let took_ms = watch.elapsed().as_secs_f64() * 1e3;
            if let Some(before) = pending.take() {
                self.obey(&before);
            }
            for _ in 0..steps {
                self.world.step();
            }
            let Ok(answer) = answer else { continue };
            let announced = answer.counters.replanned as usize > way.replanned;
            way.note(&answer, took_ms);
            if let (true, State::Replanning(why)) = (announced, answer.state) {
                let score = answer.grasp.as_ref().map_or(0.0, |g| g.score);
                replans.push(format!(
                    "{sequence} {} {score:.2} {:.0} mm",
                    why.as_str(),
                    1e3 * answer.standoff_m
                ));
            }
            if let (None, Some(grasp)) = (&first, &answer.grasp) {
                first = Some(grasp.clone());
            }
            if let (Some(first), Some(grasp)) = (&first, &answer.grasp) {
                way.drift_m = (first.world_from_hand.translation.vector
                    - grasp.world_from_hand.translation.vector)
                    .norm();
            }
            lost = if matches!(answer.state, State::Lost(_)) { lost + 1 } else { 0 };
            if lost >= MOST_LOST {
                let why = match answer.state {
                    State::Lost(loss) => loss,
                    _ => Loss::TargetGone,
                };
                return (Arrived::Nothing(why.as_str()), way, replans);
            }
            if let Some(nudge) = self.nudge
                && !way.nudged
                && answer.standoff_m <= nudge.at_standoff_m
                && let Some(grasp) = &answer.grasp
            {
                way.nudged = self.shove(grasp, nudge.distance_m);
            }
            if answer.go
                && let Some(grasp) = answer.grasp
            {
                return (Arrived::Go(Box::new(grasp)), way, replans);
            }
            pending = Some(answer);
        }
        (Arrived::Nothing("never_close_enough"), way, replans)
    }

    /// To the stand-off, fingers as the grasp has them on its way.
    fn obey(&mut self, answer: &Answer) {
        let (Some(grasp), Some(wanted)) = (&answer.grasp, answer.world_from_standoff) else { return };
        // A robot whose servo searches or has lost stays where it is.
        if matches!(answer.state, State::Lost(_)) {
            return;
        }
        let open = grasp.actuators.open.clone();
        self.world.command(self.hand, Command::Close { actuators: open, force: 1.0, speed: 1.0 });
        let (speed_m_s, turn_rad_s) = ARM_SPEED;
        self.world.command(self.hand, Command::Move { world_from_hand: wanted, speed_m_s, turn_rad_s });
    }

    /// Shoves the object at the grasp to where there is room for it; false where there is none.
    fn shove(&mut self, grasp: &Grasp, distance_m: f64) -> bool {
        let near = |id: &ObjectId| self.world.distance(*id, &grasp.centroid).unwrap_or(f64::INFINITY);
        let ids = self.world.ids();
        let Some(meant) = ids.iter().copied().min_by(|a, b| near(a).total_cmp(&near(b))) else {
            return false;
        };
        let Some(pose) = self.world.pose(meant) else { return false };
        let begin = derive(self.seed, &[1]);
        for k in 0..DIRECTIONS {
            let angle = ((begin + k) % DIRECTIONS) as f64 / DIRECTIONS as f64 * std::f64::consts::TAU;
            let by = Vector3::new(angle.cos(), angle.sin(), 0.0) * distance_m;
            let to = grasp.centroid + by;
            let others = ids.iter().filter(|id| **id != meant);
            let has_room =
                others.map(|id| self.world.distance(*id, &to).unwrap_or(f64::INFINITY)).all(|d| d > ROOM_M);
            if has_room && to.x.abs() < 0.12 && to.y.abs() < 0.10 {
                let moved = Isometry3::from_parts((pose.translation.vector + by).into(), pose.rotation);
                return self.world.place(meant, &moved);
            }
        }
        false
    }
}

impl Way {
    fn note(&mut self, answer: &Answer, took_ms: f64) {
        self.frames += 1;
        if self.frames == 1 {
            self.planning_ms = took_ms;
        } else {
            self.refining_ms += took_ms;
            self.slowest_ms = self.slowest_ms.max(took_ms);
        }
        if answer.state == State::Tracking {
            self.tracking += 1;
            self.largest_change_m = self.largest_change_m.max(answer.change.translation_m);
        }
        self.replanned = answer.counters.replanned as usize;
        self.waited += usize::from(answer.state != State::Tracking || !answer.is_settled);
        if let Some(grasp) = &answer.grasp {
            if self.first_score == 0.0 {
                self.first_score = grasp.score;
            }
            self.last_score = grasp.score;
        }
    }
}
