//! Candidates that may turn out better than the one behind the grasp: its own continuation, and those that a search liked
//! next best.
//!
//! What is lowered by iterations is the objective; what foretells success is the judge's score, and a plan's best grasp
//! was the best of many by that. A candidate that only goes on down the objective loses what it was chosen for. So the
//! grasp stays the candidate that it is, and one rival a frame goes on and is judged beside it, in the same features: the
//! grasp changes where the rival scores clearly more.

use nalgebra::Vector3;

use crate::optimize::Candidate;

/// So many others are kept.
pub(super) const MOST: usize = 6;
/// A continuation that has not become better in so many looks begins again from the grasp.
const IN_VAIN: usize = 6;
/// Another grasp must have been better in so many looks in a row.
const CONVINCING: usize = 3;

/// Whose turn it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Turn {
    /// The grasp's own continuation.
    Own,
    /// One of the others.
    Other(usize),
}

/// All rivals of one grasp.
#[derive(Debug)]
pub(super) struct Rivals {
    own: Candidate,
    in_vain: usize,
    others: Vec<Candidate>,
    frames: usize,
    next: usize,
    /// How often in a row the one whose turn it was has been better.
    wins: usize,
}

impl Rivals {
    /// The continuation of a candidate, and others; at most [`MOST`] of them.
    pub(super) fn new(of: &Candidate, others: impl IntoIterator<Item = Candidate>) -> Self {
        let others = others.into_iter().take(MOST).collect();
        Self { own: of.clone(), in_vain: 0, others, frames: 0, next: 0, wins: 0 }
    }

    /// Whose turn it is in the next frame: one of the others every so many frames, never for 0.
    pub(super) fn turn(&mut self, every: usize) -> Turn {
        self.frames += 1;
        if every == 0 || self.others.is_empty() || !self.frames.is_multiple_of(every) {
            return Turn::Own;
        }
        // One that has just been better is looked at again.
        if self.wins == 0 {
            self.next = (self.next + 1) % self.others.len();
        }
        Turn::Other(self.next)
    }

    /// The candidate whose turn it is.
    pub(super) fn candidate(&mut self, turn: Turn) -> &mut Candidate {
        match turn {
            Turn::Other(i) if i < self.others.len() => &mut self.others[i],
            Turn::Own | Turn::Other(_) => &mut self.own,
        }
    }

    /// How many others there are.
    pub(super) fn len(&self) -> usize {
        self.others.len()
    }

    /// The candidate whose turn it was is better in this frame; true when that is enough: others must be so often enough in
    /// a row, since the best of many noisy figures is one that is too good.
    pub(super) fn wins(&mut self, turn: Turn) -> bool {
        if turn == Turn::Own {
            return true;
        }
        self.wins += 1;
        self.wins >= CONVINCING
    }

    /// The candidate whose turn it was has become the grasp; what was the grasp becomes one of the others.
    pub(super) fn promote(&mut self, turn: Turn, grasp: &mut Candidate) {
        (self.in_vain, self.wins) = (0, 0);
        match turn {
            Turn::Other(i) if i < self.others.len() => {
                std::mem::swap(&mut self.others[i], grasp);
                self.own.copy_from(grasp);
            }
            Turn::Own | Turn::Other(_) => grasp.copy_from(&self.own),
        }
    }

    /// The candidate whose turn it was is no better than the grasp.
    pub(super) fn leave(&mut self, turn: Turn, grasp: &Candidate) {
        if turn != Turn::Own {
            self.wins = 0;
            return;
        }
        self.in_vain += 1;
        if self.in_vain >= IN_VAIN {
            self.in_vain = 0;
            self.own.copy_from(grasp);
        }
    }

    /// Moves all of them.
    pub(super) fn translate(&mut self, by: &Vector3<f64>) {
        self.own.translate(by);
        self.others.iter_mut().for_each(|c| c.translate(by));
    }
}
