//! One candidate of the batch: its state, its noise, its best so far.

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_xoshiro::Xoshiro256PlusPlus;

use nalgebra::Vector3;

use super::adam::{Adam, StepSizes};
use crate::budget::Budget;
use crate::configuration::Configuration;
use crate::grasp::ObjectiveTerms;
use crate::init::Initializer;
use crate::objective::{Objective, Scratch};
use crate::options::Scheme;
use crate::orientation::Allowed;

/// Length constant of the annealing noise in iterations: a step is noise with probability
/// `1 − sigmoid(1 + k/20)`, as in the reference.
const ANNEALING_ITERATIONS: f64 = 20.0;

/// One candidate on its way down the objective.
#[derive(Debug, Clone)]
pub(crate) struct Candidate {
    current: Configuration,
    /// The best configuration of the present phase (without, then with penetration).
    pub(crate) best: Configuration,
    /// Its terms.
    pub(crate) terms: ObjectiveTerms,
    /// These terms know of penetration; those of the first phase do not, and compare only with their like.
    pub(crate) knows_penetration: bool,
    /// This candidate's reaching direction, volume frame.
    pub(crate) reaching: Vector3<f64>,
    /// Terms of every iteration, when asked for.
    pub(crate) trace: Vec<ObjectiveTerms>,
    keep_trace: bool,
    /// What each contact candidate counts in means; see [`crate::balance`].
    pub(crate) shares: Vec<f64>,
    adam: Adam,
    gradient: Vec<f64>,
    rng: Xoshiro256PlusPlus,
    iteration: usize,
    /// Share of the step length that a refinement begins with.
    trust: f64,
}

/// Shares of the step length between which refinements move.
const TRUST: (f64, f64) = (0.05, 1.0);

impl Candidate {
    pub(crate) fn new(
        initializer: &Initializer<'_>,
        allowed: &Allowed,
        index: usize,
        iterations: usize,
        keep_trace: bool,
    ) -> Self {
        // Distinct streams from one seed: SplitMix64 inside `seed_from_u64` spreads neighbouring numbers.
        let stream = initializer.options.seed ^ (index as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(stream);
        let (mut current, reaching, shares) = initializer.draw(&mut rng);
        allowed.enforce(initializer.model, &reaching, &mut current);
        let dimension = 6 + current.coordinates.len();
        Self {
            best: current.clone(),
            current,
            terms: ObjectiveTerms { total: f64::INFINITY, ..ObjectiveTerms::default() },
            knows_penetration: false,
            reaching,
            shares,
            trace: Vec::with_capacity(if keep_trace { iterations } else { 0 }),
            keep_trace,
            adam: Adam::new(dimension),
            gradient: vec![0.0; dimension],
            rng,
            iteration: 0,
            trust: 0.5,
        }
    }

    /// Goes on from the best so far in fields that may have changed: so many iterations with penetration and without
    /// noise, of which the best is kept; so it never gets worse in the new fields. Steps grow while they
    /// help and shrink while they do not, so that a candidate at rest stays at rest. Does not allocate.
    pub(crate) fn refine(
        &mut self,
        objective: &Objective<'_>,
        allowed: &Allowed,
        sizes: &StepSizes,
        lengths: &[f64],
        iterations: usize,
        scratch: &mut Scratch,
    ) {
        scratch.contacts.share.copy_from_slice(&self.shares);
        self.current.copy_from(&self.best);
        let mut has_improved = false;
        for k in 0..=iterations {
            let terms = objective.evaluate(&self.current, &self.reaching, true, scratch, &mut self.gradient);
            if k == 0 {
                self.terms = terms;
                self.knows_penetration = true;
            } else if terms.total < self.terms.total {
                self.best.copy_from(&self.current);
                self.terms = terms;
                has_improved = true;
            }
            if k == iterations {
                break;
            }
            self.adam.step(sizes, lengths, self.trust, &mut self.gradient);
            self.current.step(objective.model, &self.gradient);
            self.current.clamp_coordinates(objective.model);
            allowed.enforce(objective.model, &self.reaching, &mut self.current);
        }
        self.trust = (self.trust * if has_improved { 1.5 } else { 0.5 }).clamp(TRUST.0, TRUST.1);
    }

    /// Becomes what another candidate of the same hand is, but for its trace. Does not allocate.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.current.copy_from(&other.current);
        self.best.copy_from(&other.best);
        self.terms = other.terms;
        self.reaching = other.reaching;
        self.shares.copy_from_slice(&other.shares);
        self.adam.copy_from(&other.adam);
        self.gradient.copy_from_slice(&other.gradient);
        self.rng.clone_from(&other.rng);
        (self.iteration, self.trust) = (other.iteration, other.trust);
        self.knows_penetration = other.knows_penetration;
    }

    /// Moves the candidate: its frame of reference has moved by as much the other way, or what it holds on to has moved.
    pub(crate) fn translate(&mut self, by: &Vector3<f64>) {
        self.best.translation += by;
        self.current.translation += by;
    }

    /// False while not a single iteration has been done.
    pub(crate) fn has_started(&self) -> bool {
        self.iteration > 0
    }

    /// Iterates up to iteration `until`; false when the budget stopped it before. Does not allocate.
    #[allow(clippy::too_many_arguments)] // the batch's shared parts, each by reference
    pub(crate) fn advance(
        &mut self,
        objective: &Objective<'_>,
        allowed: &Allowed,
        sizes: &StepSizes,
        lengths: &[f64],
        scheme: Scheme,
        until: usize,
        budget: &dyn Budget,
        scratch: &mut Scratch,
    ) -> bool {
        let first_with_penetration = scheme.iterations.saturating_sub(scheme.with_penetration);
        scratch.contacts.share.copy_from_slice(&self.shares);
        while self.iteration < until {
            if budget.stop().is_some() {
                return false;
            }
            let k = self.iteration;
            if k == first_with_penetration {
                // Totals with and without penetration do not compare: this phase has its own best.
                self.terms.total = f64::INFINITY;
            }
            let with_penetration = k >= first_with_penetration;
            let terms = objective.evaluate(
                &self.current,
                &self.reaching,
                with_penetration,
                scratch,
                &mut self.gradient,
            );
            if terms.total < self.terms.total {
                self.best.copy_from(&self.current);
                self.terms = terms;
                self.knows_penetration = with_penetration;
            }
            if self.keep_trace {
                self.trace.push(terms);
            }
            let share = sizes.share(k, scheme);
            let keep = 1.0 / (1.0 + (-(1.0 + k as f64 / ANNEALING_ITERATIONS)).exp());
            if self.rng.random::<f64>() < keep {
                self.adam.step(sizes, lengths, share, &mut self.gradient);
            } else {
                for (g, length) in self.gradient.iter_mut().zip(lengths) {
                    *g = self.rng.sample::<f64, _>(StandardNormal) * length;
                }
            }
            self.current.step(objective.model, &self.gradient);
            self.current.clamp_coordinates(objective.model);
            allowed.enforce(objective.model, &self.reaching, &mut self.current);
            self.iteration += 1;
        }
        true
    }
}
