//! The batch optimization: every candidate goes down the objective on its own, in parallel, anytime.
//!
//! Rounds of a few iterations over the whole batch: after every round all candidates have done the same
//! number of iterations, so stopping early leaves a fair best-so-far. A budget that will end before the scheme
//! does has it shortened: the iterations with penetration come last and must not be those that are left out, for
//! a grasp that was optimized without them is inside of what it should hold. Each candidate owns its random
//! numbers and its memory, nothing is summed across candidates: the result does not depend on the number
//! of threads.

mod adam;
mod candidate;

pub use adam::StepSizes;
pub(crate) use adam::lengths;
pub(crate) use candidate::Candidate;

use std::time::Duration;

use rayon::prelude::*;

use crate::budget::{Budget, Stop};
use crate::init::Initializer;
use crate::objective::{Objective, Scratch};
use crate::options::Scheme;
use crate::orientation::Allowed;

/// Iterations between two looks at the batch as a whole.
const ROUND: usize = 10;
/// What an iteration with penetration takes of time, against one without: 1.7 (2F-85), 2.0 (3-Finger, LEAP).
const PENETRATION_COST: f64 = 2.0;
/// A shortened scheme has at least so many iterations with penetration, if the whole one has: the paper's schemes all do.
const LEAST_WITH_PENETRATION: usize = 40;

/// A batch of candidates on their way.
#[derive(Debug)]
pub(crate) struct Batch<'a> {
    pub(crate) objective: &'a Objective<'a>,
    pub(crate) allowed: &'a Allowed,
    pub(crate) scheme: Scheme,
    pub(crate) sizes: StepSizes,
    lengths: Vec<f64>,
    pub(crate) candidates: Vec<Candidate>,
    /// Memory of one evaluation for every chunk of candidates that a thread takes at a time.
    scratches: Vec<Scratch>,
    chunk: usize,
    done: usize,
    /// When iterating began, on the budget's clock.
    began: Option<Duration>,
    /// The scheme is no longer the one that was asked for.
    is_shortened: bool,
}

impl<'a> Batch<'a> {
    /// Draws the initial configurations; candidate `i` of seed `s` is the same whatever the batch size.
    pub(crate) fn new(
        objective: &'a Objective<'a>,
        allowed: &'a Allowed,
        initializer: &Initializer<'_>,
        sizes: StepSizes,
    ) -> Self {
        let options = initializer.options;
        let candidates: Vec<Candidate> = (0..options.batch)
            .into_par_iter()
            .map(|i| Candidate::new(initializer, allowed, i, options.scheme.iterations, options.trace))
            .collect();
        let lengths = adam::lengths(objective.model, &sizes);
        // Four chunks a thread: candidates cost about the same, threads do not.
        let chunk = candidates.len().div_ceil(4 * rayon::current_num_threads()).max(1);
        let scratches = vec![Scratch::new(objective.model); candidates.len().div_ceil(chunk)];
        let scheme = options.scheme;
        Self {
            objective,
            allowed,
            scheme,
            sizes,
            lengths,
            candidates,
            scratches,
            chunk,
            done: 0,
            began: None,
            is_shortened: false,
        }
    }

    /// Iterations that every candidate has completed.
    pub(crate) fn iterations_done(&self) -> usize {
        self.done
    }

    /// True once the scheme is through.
    pub(crate) fn is_finished(&self) -> bool {
        self.done >= self.scheme.iterations
    }

    /// True where the budget's end had the scheme shortened.
    pub(crate) fn is_shortened(&self) -> bool {
        self.is_shortened
    }

    /// One round of iterations for all candidates.
    ///
    /// # Errors
    /// [`Stop`] when the budget ended within the round; candidates keep their best so far.
    pub(crate) fn round(&mut self, budget: &dyn Budget) -> Result<(), Stop> {
        self.began.get_or_insert_with(|| budget.elapsed());
        self.shorten(budget);
        let until = (self.done + ROUND).min(self.scheme.iterations);
        let (objective, allowed, sizes) = (self.objective, self.allowed, &self.sizes);
        let (lengths, scheme) = (&self.lengths, self.scheme);
        let complete = self
            .candidates
            .par_chunks_mut(self.chunk)
            .zip(&mut self.scratches)
            .map(|(chunk, scratch)| {
                chunk
                    .iter_mut()
                    .all(|c| c.advance(objective, allowed, sizes, lengths, scheme, until, budget, scratch))
            })
            .reduce(|| true, |a, b| a && b);
        if complete {
            self.done = until;
            return Ok(());
        }
        Err(budget.stop().unwrap_or(Stop::Cancelled))
    }

    /// Begins with the last phase where the budget would end before its time comes; as long as it does not, nothing
    /// changes.
    fn shorten(&mut self, budget: &dyn Budget) {
        let Scheme { iterations, with_penetration } = self.scheme;
        let first_with_penetration = iterations.saturating_sub(with_penetration);
        let (Some(began), Some(remaining)) = (self.began, budget.remaining()) else { return };
        if self.done == 0 || with_penetration == 0 || self.done >= first_with_penetration {
            return;
        }
        let taken = budget.elapsed().saturating_sub(began).as_secs_f64() / self.done as f64;
        let left = remaining.as_secs_f64() / taken;
        let whole = (first_with_penetration - self.done) as f64 + with_penetration as f64 * PENETRATION_COST;
        if !left.is_finite() || left >= whole {
            return;
        }
        // The last phase keeps its share of what can be done, and is no shorter than what makes grasps free.
        let share = with_penetration as f64 / iterations as f64;
        let least = with_penetration.min(LEAST_WITH_PENETRATION) as f64;
        let last = (share * (self.done as f64 + left)).max(least) * PENETRATION_COST;
        if left > last + ROUND as f64 {
            return;
        }
        // At least one, or candidates would be ranked by an objective that does not know of obstacles.
        let last = ((left / PENETRATION_COST) as usize).clamp(1, with_penetration);
        self.scheme = Scheme { iterations: self.done + last, with_penetration: last };
        self.is_shortened = true;
    }
}
