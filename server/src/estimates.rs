//! How long jobs take on this machine, learned from those that have run: what admission and the choice of a scheme
//! go by.
//!
//! Reading a scene takes a time of its own for each estimator and size. A search takes time for each candidate and
//! iteration, ranking for each candidate; both depend on the hand. Estimates are a moving mean and a little of
//! its deviation, and fade where no job confirms them; nothing is known at the beginning, and then nothing is refused by
//! estimate.

use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use graspd_planner::grasp::PlanStats;
use graspd_planner::options::Scheme;

/// Weight of the newest observation.
const NEWEST: f64 = 0.15;
/// Deviations that are added to a mean.
const DEVIATIONS: f64 = 0.25;
/// An estimate this old is not doubted.
const FRESH: Duration = Duration::from_secs(1);
/// An older one loses half of itself in this long. Who is refused by estimate does not run and teaches nothing: without
/// this, a slow minute would refuse everybody for ever.
const HALF_LIFE: Duration = Duration::from_secs(3);
/// At most so many hands and kinds of scenes are remembered.
const MOST: usize = 256;

/// A moving mean and the moving mean of the deviation from it.
#[derive(Debug, Clone, Copy, Default)]
struct Mean {
    mean: f64,
    deviation: f64,
    count: u32,
    observed: Option<Instant>,
}

impl Mean {
    fn observe(&mut self, value: f64) {
        self.observed = Some(Instant::now());
        self.count = self.count.saturating_add(1);
        // The first few count alike.
        let weight = NEWEST.max(1.0 / f64::from(self.count));
        let error = value - self.mean;
        self.mean += weight * error;
        if self.count > 1 {
            self.deviation += weight * (error.abs() - self.deviation);
        }
    }

    fn expected(&self) -> f64 {
        self.expected_at(Instant::now())
    }

    fn expected_at(&self, now: Instant) -> f64 {
        let age = self.observed.map_or(Duration::ZERO, |at| now.saturating_duration_since(at));
        let stale = age.saturating_sub(FRESH).as_secs_f64() / HALF_LIFE.as_secs_f64();
        (self.mean + DEVIATIONS * self.deviation) * (-stale).exp2()
    }
}

/// What the time of reading a scene depends on.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(crate) struct SceneKind {
    /// The estimator's name.
    pub(crate) estimator: String,
    /// Voxels along an edge.
    pub(crate) resolution: usize,
    /// Pixels of all frames, as a power of two.
    pub(crate) pixels_log2: u32,
}

#[derive(Debug, Clone, Copy, Default)]
struct Search {
    /// Seconds for an iteration of a candidate.
    iteration: Mean,
    /// Seconds of ranking for a candidate.
    rank: Mean,
}

#[derive(Debug, Default)]
struct Known {
    scenes: HashMap<SceneKind, Mean>,
    hands: HashMap<String, Search>,
    /// All hands together, for a hand that has not been seen.
    any: Search,
    /// What a job elsewhere takes besides its stages.
    detour: Mean,
}

/// What has been learned.
#[derive(Debug, Default)]
pub(crate) struct Estimates(Mutex<Known>);

impl Estimates {
    /// How long a scene takes to read; zero while nothing is known.
    pub(crate) fn scene(&self, kind: &SceneKind) -> Duration {
        self.lock().scenes.get(kind).map_or(Duration::ZERO, |mean| seconds(mean.expected()))
    }

    /// A scene was read from beginning to end.
    pub(crate) fn observe_scene(&self, kind: SceneKind, took: Duration) {
        let mut known = self.lock();
        if known.scenes.len() < MOST || known.scenes.contains_key(&kind) {
            known.scenes.entry(kind).or_default().observe(took.as_secs_f64());
        }
    }

    /// How long a search takes for a hand; zero while nothing is known.
    pub(crate) fn search(&self, hand: &str, batch: usize, iterations: usize) -> Duration {
        let known = self.lock();
        let search = known.hands.get(hand).unwrap_or(&known.any);
        let batch = batch as f64;
        seconds(search.iteration.expected() * batch * iterations as f64 + search.rank.expected() * batch)
    }

    /// A search has ended; what it says of its stages teaches.
    pub(crate) fn observe_search(&self, hand: &str, stats: &PlanStats) {
        if stats.candidates == 0 || stats.iterations < Scheme::QUICK.iterations / 3 {
            return;
        }
        let stage = |names: &[&str]| -> f64 {
            let of = stats.stages.iter().filter(|(name, _)| names.contains(name));
            of.map(|(_, took)| took.as_secs_f64()).sum()
        };
        let candidates = stats.candidates as f64;
        let iteration = stage(&["initialize", "optimize"]) / (candidates * stats.iterations as f64);
        let rank = stage(&["rank"]) / candidates;
        let mut known = self.lock();
        let known = &mut *known;
        if known.hands.len() < MOST || known.hands.contains_key(hand) {
            let own = known.hands.entry(hand.to_owned()).or_default();
            for search in [own, &mut known.any] {
                search.iteration.observe(iteration);
                // A ranking that was cut short says nothing.
                if stats.stopped.is_none() {
                    search.rank.observe(rank);
                }
            }
        }
    }

    /// How long the way to an engine elsewhere and back takes, and waiting there.
    pub(crate) fn detour(&self) -> Duration {
        seconds(self.lock().detour.expected())
    }

    /// A job elsewhere took so much longer than its stages.
    pub(crate) fn observe_detour(&self, took: Duration) {
        self.lock().detour.observe(took.as_secs_f64());
    }

    fn lock(&self) -> MutexGuard<'_, Known> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn seconds(value: f64) -> Duration {
    Duration::try_from_secs_f64(value.clamp(0.0, 86_400.0)).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stats(ms: u64, iterations: usize) -> PlanStats {
        PlanStats {
            candidates: 10,
            iterations,
            stages: vec![("optimize", Duration::from_millis(ms)), ("rank", Duration::from_millis(20))],
            ..PlanStats::default()
        }
    }

    #[test]
    fn a_search_grows_with_candidates_and_iterations_and_other_hands_are_a_guess() {
        let known = Estimates::default();
        assert_eq!(known.search("leap", 10, 100), Duration::ZERO);
        for _ in 0..20 {
            known.observe_search("leap", &stats(100, 100));
        }
        let near = |found: Duration, ms: f64| {
            assert!((found.as_secs_f64() * 1e3 - ms).abs() < 1.0, "{found:?}, expected {ms} ms");
        };
        near(known.search("leap", 10, 100), 120.0);
        near(known.search("leap", 20, 200), 440.0);
        near(known.search("claw", 10, 100), 120.0);
        known.observe_search("leap", &stats(100_000, 1));
        near(known.search("leap", 10, 100), 120.0);
    }

    #[test]
    fn a_mean_follows_and_a_wild_one_is_taken_with_care() {
        let mut steady = Mean::default();
        let mut wild = Mean::default();
        for i in 0..200 {
            steady.observe(2.0);
            wild.observe(if i % 2 == 0 { 1.0 } else { 3.0 });
        }
        assert!((steady.expected() - 2.0).abs() < 1e-9);
        assert!(wild.expected() > 2.15, "{wild:?}");
        for _ in 0..40 {
            steady.observe(4.0);
        }
        assert!(steady.mean > 3.9);
    }

    #[test]
    fn an_estimate_that_nothing_confirms_fades() {
        let mut mean = Mean::default();
        mean.observe(8.0);
        let now = mean.observed.unwrap();
        let at = |seconds| mean.expected_at(now + Duration::from_secs(seconds));
        assert_eq!(at(1), 8.0);
        assert!((at(4) - 4.0).abs() < 1e-9 && (at(10) - 1.0).abs() < 1e-9);
    }

    #[test]
    fn scenes_of_a_kind_are_known_by_themselves() {
        let known = Estimates::default();
        let kind = |resolution| SceneKind { estimator: "e".to_owned(), resolution, pixels_log2: 18 };
        known.observe_scene(kind(80), Duration::from_millis(30));
        assert_eq!(known.scene(&kind(80)), Duration::from_millis(30));
        assert_eq!(known.scene(&kind(128)), Duration::ZERO);
    }
}
