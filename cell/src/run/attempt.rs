//! The attempt that is under way.

use nalgebra::Isometry3;

use super::palm::PalmFrame;
use crate::frame::Frame;
use crate::outcome::{FailureClass, Outcome};
use crate::plan::{Answer, PlannedGrasp, Question};
use crate::record::{AnswerRecord, AttemptRecord, Chosen, OutOfReach, ServoRecord, StepRecord, frame_stem};
use crate::witness::Witnessed;

/// A grasp this near to one that failed would fail again: metres, radians.
const SAME_GRASP: (f64, f64) = (0.01, 0.2);

/// From the look into the tray to the open hand.
#[derive(Debug)]
pub(super) struct Attempt {
    pub(super) number: u32,
    pub(super) frame: Option<Frame>,
    /// The same frame, and where the hand was, where the camera is in its palm.
    pub(super) palm: Option<PalmFrame>,
    pub(super) question: Option<Question>,
    pub(super) answer: Option<Answer>,
    /// Grasps that are not tried, and why.
    pub(super) out_of_reach: Vec<OutOfReach>,
    /// Ranks in the order in which they are tried.
    order: Vec<usize>,
    /// Place in `order`.
    at: usize,
    /// The first of the grasps that a servo has refined.
    first: Option<PlannedGrasp>,
    /// What the servo did.
    pub(super) servo: Option<ServoRecord>,
    /// Where the fingers were told to open, in the order of the grasp's actuators.
    pub(super) opened: Option<Vec<f64>>,
    pub(super) steps: Vec<StepRecord>,
    /// The straight approach began.
    pub(super) trial: bool,
    /// The hand met something on the straight approach.
    pub(super) met: bool,
    /// Where the fingers were told to go last, in the order of the grasp's actuators; `None`: not yet closed.
    pub(super) told: Option<Vec<f64>>,
    /// The hand felt the object at the drop pose.
    pub(super) felt: bool,
    /// It has failed, and is being brought to an end.
    pub(super) failed: Option<(FailureClass, String)>,
    /// The hand is among the objects: the way out is straight back along the approach.
    pub(super) inside: bool,
    /// Where the fingers were when the way out began, in the order of the hand's actuators.
    pub(super) before_opening: Option<Vec<f64>>,
    /// The arm stopped itself on the way out: opened fingers may be what presses.
    pub(super) wedged: bool,
    /// Where the lift goes, once it has begun.
    pub(super) lift_to: Option<Isometry3<f64>>,
    /// The full lift is out of reach.
    pub(super) lift_short: bool,
}

impl Attempt {
    pub(super) fn new(number: u32) -> Self {
        Self {
            number,
            frame: None,
            palm: None,
            question: None,
            answer: None,
            out_of_reach: Vec::new(),
            order: Vec::new(),
            at: 0,
            first: None,
            servo: None,
            opened: None,
            steps: Vec::new(),
            trial: false,
            met: false,
            told: None,
            felt: false,
            failed: None,
            inside: false,
            before_opening: None,
            wedged: false,
            lift_to: None,
            lift_short: false,
        }
    }

    /// Takes an answer; grasps out of reach are left out, grasps near to those that failed come last.
    pub(super) fn take(&mut self, answer: Answer, out_of_reach: Vec<OutOfReach>, failed: &[Isometry3<f64>]) {
        let near = |grasp: &PlannedGrasp| {
            let pose = grasp.world_from_hand.isometry();
            failed.iter().any(|f| {
                let between = f.inverse() * pose;
                between.translation.vector.norm() < SAME_GRASP.0 && between.rotation.angle() < SAME_GRASP.1
            })
        };
        let left_out = |rank: &usize| out_of_reach.iter().any(|out| out.rank == *rank);
        self.order = (0..answer.grasps.len()).filter(|rank| !left_out(rank)).collect();
        self.order.sort_by_key(|&rank| near(&answer.grasps[rank]));
        self.at = 0;
        self.answer = Some(answer);
        self.out_of_reach = out_of_reach;
    }

    /// The one grasp of an answer that somebody else has chosen.
    pub(super) fn choose(&mut self, rank: usize) {
        self.order = vec![rank];
        self.at = 0;
    }

    /// The grasp that is tried.
    pub(super) fn grasp(&self) -> Option<(usize, &PlannedGrasp)> {
        let rank = *self.order.get(self.at)?;
        self.answer.as_ref()?.grasps.get(rank).map(|grasp| (rank, grasp))
    }

    /// A servo has refined the grasp.
    pub(super) fn refine(&mut self, grasp: PlannedGrasp) {
        let before = self.grasp().map(|(_, grasp)| grasp.clone());
        if self.first.is_none() {
            self.first = before;
        }
        if let (Some(&rank), Some(answer)) = (self.order.get(self.at), &mut self.answer)
            && let Some(place) = answer.grasps.get_mut(rank)
        {
            *place = grasp;
        }
    }

    /// The grasp that a servo began with.
    pub(super) fn first_grasp(&self) -> Option<&PlannedGrasp> {
        self.first.as_ref().or_else(|| self.grasp().map(|(_, grasp)| grasp))
    }

    /// Goes to the next grasp; false when there is none.
    pub(super) fn next_grasp(&mut self) -> bool {
        let more = self.at + 1 < self.order.len();
        self.at += usize::from(more);
        more
    }

    /// Sets why it failed; the first reason stays.
    pub(super) fn fail(&mut self, class: FailureClass, why: &str) {
        self.failed.get_or_insert_with(|| (class, why.to_owned()));
    }

    pub(super) fn record(self, outcome: Outcome, witnessed: Option<Witnessed>) -> AttemptRecord {
        let chosen = self.grasp().map(|(rank, grasp)| Chosen { rank, grasp: grasp.clone() });
        AttemptRecord {
            attempt: self.number,
            frame: self.frame.is_some().then(|| frame_stem(self.number)),
            question: self.question,
            answer: self.answer.as_ref().map(AnswerRecord::from),
            out_of_reach: self.out_of_reach,
            chosen,
            servo: self.servo,
            steps: self.steps,
            trial: self.trial,
            felt: self.felt,
            witnessed,
            outcome,
        }
    }
}
