//! The batch optimization: every candidate goes down the objective on its own, in parallel, anytime.
//!
//! Rounds of a few iterations over the whole batch: after every round all candidates have done the same
//! number of iterations, so stopping early leaves a fair best-so-far. Each candidate owns its random
//! numbers and its memory, nothing is summed across candidates: the result does not depend on the number
//! of threads.

mod adam;
mod candidate;

pub use adam::StepSizes;
pub(crate) use adam::lengths;
pub(crate) use candidate::Candidate;

use rayon::prelude::*;

use crate::budget::{Budget, Stop};
use crate::init::Initializer;
use crate::objective::{Objective, Scratch};
use crate::options::Scheme;
use crate::orientation::Allowed;

/// Iterations between two looks at the batch as a whole.
const ROUND: usize = 10;

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
        Self { objective, allowed, scheme, sizes, lengths, candidates, scratches, chunk, done: 0 }
    }

    /// Iterations that every candidate has completed.
    pub(crate) fn iterations_done(&self) -> usize {
        self.done
    }

    /// True once the scheme is through.
    pub(crate) fn is_finished(&self) -> bool {
        self.done >= self.scheme.iterations
    }

    /// One round of iterations for all candidates.
    ///
    /// # Errors
    /// [`Stop`] when the budget ended within the round; candidates keep their best so far.
    pub(crate) fn round(&mut self, budget: &dyn Budget) -> Result<(), Stop> {
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
}
