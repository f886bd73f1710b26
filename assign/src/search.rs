//! Branch and bound over arms: which grasp each takes, or none.

use crate::judge::Judged;
use crate::problem::Settings;

/// Nodes between two questions whether to stop.
const ASK_EVERY: u64 = 256;
/// Sums that differ by less are equal: of equals the first found stands.
const EQUAL: f64 = 1e-12;

/// What was found.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Found {
    /// Candidate of each arm.
    pub(crate) chosen: Vec<Option<usize>>,
    pub(crate) value: f64,
    /// No assignment is worth more.
    pub(crate) bound: f64,
    pub(crate) optimal: bool,
    pub(crate) nodes: u64,
}

/// A set of candidates.
type Bits = Vec<u64>;

fn has(bits: &[u64], i: usize) -> bool {
    bits[i / 64] >> (i % 64) & 1 == 1
}

struct Search<'a> {
    judged: &'a Judged<'a>,
    settings: &'a Settings,
    stop: &'a mut dyn FnMut() -> bool,
    /// Arms in the order in which they are decided.
    order: Vec<usize>,
    /// Candidates that may be taken beside each one, as far as is known.
    beside: Vec<Bits>,
    /// Pairs whose corridors have been compared.
    compared: Vec<Bits>,
    /// Object of each candidate, where sameness is an equivalence; else empty.
    objects: Vec<usize>,
    object_count: usize,
    /// Memory for bounds, and for what is free at each depth.
    best_of_objects: Vec<f64>,
    rests: Vec<Bits>,
    best: Vec<Option<usize>>,
    best_value: f64,
    nodes: u64,
    stopped: bool,
}

/// The best assignment that the budget finds.
pub(crate) fn search(judged: &Judged<'_>, settings: &Settings, stop: &mut dyn FnMut() -> bool) -> Found {
    let count = judged.candidates.len();
    let words = count.div_ceil(64);
    let mut beside = vec![vec![u64::MAX; words]; count];
    for a in 0..count {
        for b in 0..a {
            let apart = judged.candidates[a].arm != judged.candidates[b].arm && !judged.same_object(a, b);
            if !apart {
                beside[a][b / 64] &= !(1 << (b % 64));
                beside[b][a / 64] &= !(1 << (a % 64));
            }
        }
        beside[a][a / 64] &= !(1 << (a % 64));
    }
    let mut order: Vec<usize> = (0..judged.of_arm.len()).filter(|&a| !judged.of_arm[a].is_empty()).collect();
    // Who has least to choose from decides first.
    order.sort_by_key(|&arm| judged.of_arm[arm].len());
    let (objects, object_count) = objects(judged);
    let mut search = Search {
        judged,
        settings,
        stop,
        order,
        beside,
        compared: vec![vec![0; words]; count],
        objects,
        object_count,
        best_of_objects: Vec::new(),
        rests: vec![Vec::with_capacity(words); judged.of_arm.len()],
        best: vec![None; judged.of_arm.len()],
        best_value: 0.0,
        nodes: 0,
        stopped: false,
    };
    search.greedy();
    let all = vec![u64::MAX; words];
    let root = search.bound(0, &all, &[]);
    let mut chosen = Vec::new();
    search.descend(0, &all, &mut chosen, 0.0);
    let optimal = !search.stopped && judged.left_out == 0;
    let value = search.best_value;
    // What was left out is worth at most as much, for each arm, as the best that was kept.
    Found {
        chosen: search.best,
        value,
        bound: if optimal { value } else { root.max(value) },
        optimal,
        nodes: search.nodes,
    }
}

/// Numbers of the objects, where sameness is transitive among the candidates.
fn objects(judged: &Judged<'_>) -> (Vec<usize>, usize) {
    let mut firsts: Vec<usize> = Vec::new();
    let mut numbers = Vec::with_capacity(judged.candidates.len());
    for candidate in 0..judged.candidates.len() {
        let number = firsts.iter().position(|&first| judged.same_object(candidate, first));
        numbers.push(number.unwrap_or_else(|| {
            firsts.push(candidate);
            firsts.len() - 1
        }));
    }
    let consistent =
        (0..numbers.len()).all(|a| (0..a).all(|b| (numbers[a] == numbers[b]) == judged.same_object(a, b)));
    if consistent { (numbers, firsts.len()) } else { (Vec::new(), 0) }
}

impl Search<'_> {
    /// True when both can be taken. Corridors are compared when it is asked for the first time.
    fn fits(&mut self, a: usize, b: usize) -> bool {
        if !has(&self.beside[a], b) {
            return false;
        }
        if !has(&self.compared[a], b) {
            self.compared[a][b / 64] |= 1 << (b % 64);
            self.compared[b][a / 64] |= 1 << (a % 64);
            if self.judged.corridors_conflict(a, b) {
                self.beside[a][b / 64] &= !(1 << (b % 64));
                self.beside[b][a / 64] &= !(1 << (a % 64));
                return false;
            }
        }
        true
    }

    /// A first answer: the best grasps one after the other, each where it fits.
    fn greedy(&mut self) {
        let mut by_value: Vec<usize> = (0..self.judged.candidates.len()).collect();
        by_value.sort_by(|&a, &b| {
            let value = |i: usize| self.judged.candidates[i].value;
            value(b).total_cmp(&value(a)).then(a.cmp(&b))
        });
        let mut chosen: Vec<usize> = Vec::new();
        for candidate in by_value {
            if chosen.iter().all(|&other| self.fits(candidate, other)) {
                chosen.push(candidate);
            }
        }
        let value = chosen.iter().map(|&c| self.judged.candidates[c].value).sum();
        self.keep(&chosen, value);
    }

    fn keep(&mut self, chosen: &[usize], value: f64) {
        if value > self.best_value + EQUAL {
            self.best_value = value;
            self.best.fill(None);
            for &candidate in chosen {
                self.best[self.judged.candidates[candidate].arm] = Some(candidate);
            }
        }
    }

    /// The best candidate of an arm that fits beside all that are chosen.
    fn first(&mut self, arm: usize, free: &[u64], chosen: &[usize]) -> Option<usize> {
        let range = self.judged.of_arm[arm].clone();
        range.into_iter().find(|&c| has(free, c) && chosen.iter().all(|&other| self.fits(c, other)))
    }

    /// No choice of the arms from `depth` on is worth more: neither more than the best of each arm, nor than the best of as
    /// many objects as there are arms.
    fn bound(&mut self, depth: usize, free: &[u64], chosen: &[usize]) -> f64 {
        let mut sum = 0.0;
        for at in depth..self.order.len() {
            if let Some(first) = self.first(self.order[at], free, chosen) {
                sum += self.judged.candidates[first].value;
            }
        }
        if self.objects.is_empty() || self.order.len() - depth < 2 {
            return sum;
        }
        let mut best = std::mem::take(&mut self.best_of_objects);
        best.clear();
        best.resize(self.object_count, 0.0f64);
        for &arm in &self.order[depth..] {
            for c in self.judged.of_arm[arm].clone() {
                if has(free, c) {
                    let of = &mut best[self.objects[c]];
                    *of = of.max(self.judged.candidates[c].value);
                }
            }
        }
        best.sort_unstable_by(|a, b| b.total_cmp(a));
        let together = best.iter().take(self.order.len() - depth).sum();
        self.best_of_objects = best;
        sum.min(together)
    }

    fn descend(&mut self, depth: usize, free: &[u64], chosen: &mut Vec<usize>, value: f64) {
        self.keep(chosen, value);
        let Some(&arm) = self.order.get(depth) else { return };
        self.nodes += 1;
        if self.nodes.is_multiple_of(ASK_EVERY) && (self.stop)() || self.nodes >= self.settings.nodes {
            self.stopped = true;
        }
        if self.stopped {
            return;
        }
        if value + self.bound(depth, free, chosen) <= self.best_value + EQUAL {
            return;
        }
        // What the others can add at most, whatever this arm takes.
        let others = self.bound(depth + 1, free, chosen);
        let mut rest = std::mem::take(&mut self.rests[depth]);
        for candidate in self.judged.of_arm[arm].clone() {
            // They come in the order of their values: none of those that follow is better.
            if value + self.judged.candidates[candidate].value + others <= self.best_value + EQUAL {
                break;
            }
            if !has(free, candidate) || !chosen.iter().all(|&other| self.fits(candidate, other)) {
                continue;
            }
            rest.clear();
            rest.extend(free.iter().zip(&self.beside[candidate]).map(|(a, b)| a & b));
            chosen.push(candidate);
            let worth = self.judged.candidates[candidate].value;
            self.descend(depth + 1, &rest, chosen, value + worth);
            chosen.pop();
            if self.stopped {
                return;
            }
        }
        self.rests[depth] = rest;
        // The arm takes nothing.
        if value + others > self.best_value + EQUAL {
            self.descend(depth + 1, free, chosen, value);
        }
    }
}
