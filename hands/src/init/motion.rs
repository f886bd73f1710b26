//! Which way each joint closes: towards the middle of where the fingertips can be.

use nalgebra::{Point3, Vector3};

use super::fingers::Chain;
use super::pads::PadGuess;
use crate::urdf::{Mimic, Model};
use crate::{JointKind, opening};

/// A joint closes when it moves fingertips towards the middle more than this cosine.
const CLOSES: f64 = 0.4;
/// Postures for the workspace.
const POSTURES: usize = 200;

/// What a joint does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Role {
    /// Moves fingertips together; the cosine says how directly.
    Closes(f64),
    /// Moves them aside: stays put while the hand closes.
    Spreads,
    /// Follows another joint (mimic).
    Follows,
}

/// The closing motion.
#[derive(Debug, Clone)]
pub(super) struct Motion {
    /// Per joint.
    pub(super) roles: Vec<Role>,
    /// Open posture per joint; followers' entries are not used.
    pub(super) open: Vec<f64>,
    /// Closed posture per joint, likewise.
    pub(super) closed: Vec<f64>,
}

impl Motion {
    /// Joint positions at a fraction of the way from open to closed.
    pub(super) fn joints(&self, mimics: &[Option<Mimic>], fraction: f64) -> Vec<f64> {
        let lead: Vec<f64> =
            self.open.iter().zip(&self.closed).map(|(o, c)| o + fraction * (c - o)).collect();
        follow(mimics, lead)
    }
}

/// Fills in the joints that follow others.
fn follow(mimics: &[Option<Mimic>], mut q: Vec<f64>) -> Vec<f64> {
    // Chains of mimic tags end: this many rounds reach the ends of all.
    for _ in 0..q.len() {
        let mut changed = false;
        for j in 0..q.len() {
            if let Some(m) = mimics[j] {
                let value = m.multiplier * q[m.joint] + m.offset;
                changed |= value != q[j];
                q[j] = value;
            }
        }
        if !changed {
            break;
        }
    }
    q
}

/// Ranges of the joints; those of leaders shrunk so that their followers keep theirs.
fn ranges(model: &Model) -> Vec<(f64, f64)> {
    let mut out: Vec<(f64, f64)> = model.tree.joints.iter().map(|j| (j.lower, j.upper)).collect();
    for j in 0..out.len() {
        // The follower as a function of its leader, through chains.
        let (mut at, mut factor, mut offset) = (j, 1.0, 0.0);
        while let Some(m) = model.mimics[at] {
            offset += factor * m.offset;
            factor *= m.multiplier;
            at = m.joint;
        }
        if at != j && factor != 0.0 {
            let joint = &model.tree.joints[j];
            let (a, b) = ((joint.lower - offset) / factor, (joint.upper - offset) / factor);
            out[at] = (out[at].0.max(a.min(b)), out[at].1.min(a.max(b)));
        }
    }
    out
}

/// Fingertips in the hand frame.
fn tips(model: &Model, fingers: &[Chain], q: &[f64]) -> Vec<Point3<f64>> {
    let poses = model.tree.body_poses(q);
    fingers.iter().map(|f| poses[f.last()] * f.tip).collect()
}

/// Derives roles and postures. The closed posture is where the fingertips come closest.
pub(super) fn derive(model: &Model, fingers: &[Chain]) -> Motion {
    let ranges = ranges(model);
    let centre = centre(model, fingers, &ranges);
    let count = ranges.len();
    let zero: Vec<f64> = ranges.iter().map(|&(l, u)| if l < u { 0.0_f64.clamp(l, u) } else { l }).collect();
    let halfway: Vec<f64> = ranges.iter().map(|&(l, u)| l + 0.4 * (u - l)).collect();
    let mut motion = Motion { roles: vec![Role::Follows; count], open: zero.clone(), closed: zero.clone() };
    for j in (0..count).filter(|&j| model.mimics[j].is_none()) {
        let cosine = 0.5 * (towards(model, fingers, &zero, j, &centre) + towards(model, fingers, &halfway, j, &centre));
        if cosine.abs() < CLOSES {
            motion.roles[j] = Role::Spreads;
            continue;
        }
        motion.roles[j] = Role::Closes(cosine.abs());
        let (lower, upper) = ranges[j];
        let (from, to) = if cosine > 0.0 { (lower, upper) } else { (upper, lower) };
        // Fingers are straight at zero in most URDFs; beyond it they bend backwards.
        let inside = lower < 0.0 && upper > 0.0 && to.abs() > 0.5 * from.abs();
        let revolute = model.tree.joints[j].kind == JointKind::Revolute;
        motion.open[j] = if revolute && inside { 0.0 } else { from };
        motion.closed[j] = to;
    }
    let apart = |fraction: f64| {
        let tips = tips(model, fingers, &motion.joints(&model.mimics, fraction));
        let middle = super::middle(&tips);
        tips.iter().map(|t| (t - middle).norm()).sum::<f64>()
    };
    let steps = (1..=40).map(|n| f64::from(n) / 40.0);
    let best = steps.min_by(|a, b| apart(*a).total_cmp(&apart(*b))).unwrap_or(1.0);
    shorten(&mut motion, best);
    motion
}

/// Stops where opposed pads meet, if they meet before the end.
pub(super) fn stop_at_contact(model: &Model, motion: &mut Motion, pads: &[PadGuess]) {
    const STEPS: u32 = 200;
    for n in 1..=STEPS {
        let fraction = f64::from(n) / f64::from(STEPS);
        let q = motion.joints(&model.mimics, fraction);
        let links = model.tree.link_poses(&model.tree.body_poses(&q));
        let at: Vec<_> = pads.iter().map(|p| (links[p.link] * p.center, links[p.link].rotation * p.normal)).collect();
        let crossed = (0..at.len()).any(|i| {
            (i + 1..at.len()).any(|j| {
                pads[i].finger != pads[j].finger && opening::gap(&at[i], &at[j]).is_some_and(|g| g < 0.0)
            })
        });
        if crossed {
            shorten(motion, (fraction - 1.0 / f64::from(STEPS)).max(0.02));
            return;
        }
    }
}

fn shorten(motion: &mut Motion, fraction: f64) {
    for (open, closed) in motion.open.iter().zip(&mut motion.closed) {
        *closed = open + fraction * (*closed - open);
    }
}

/// The middle of the fingertips' workspaces.
fn centre(model: &Model, fingers: &[Chain], ranges: &[(f64, f64)]) -> Point3<f64> {
    let mut sums = vec![Vector3::zeros(); fingers.len()];
    for n in 1..=POSTURES {
        let q = ranges.iter().enumerate().map(|(j, &(l, u))| {
            // Square roots of distinct integers are irrational multiples of each other often enough.
            let fraction = (n as f64 * (j as f64 + 2.0).sqrt() * 0.754_877_666).fract();
            l + fraction * (u - l)
        });
        let q = follow(&model.mimics, q.collect());
        for (sum, tip) in sums.iter_mut().zip(tips(model, fingers, &q)) {
            *sum += tip.coords / POSTURES as f64;
        }
    }
    let means: Vec<Point3<f64>> = sums.into_iter().map(Point3::from).collect();
    super::middle(&means)
}

/// How directly joint `j` moves fingertips to the centre: a cosine, positive for increasing positions.
fn towards(model: &Model, fingers: &[Chain], q: &[f64], j: usize, centre: &Point3<f64>) -> f64 {
    const STEP: f64 = 1e-4;
    let mut moved = q.to_vec();
    moved[j] += STEP;
    let before = tips(model, fingers, &follow(&model.mimics, q.to_vec()));
    let after = tips(model, fingers, &follow(&model.mimics, moved));
    let (mut along, mut total) = (0.0, 0.0);
    for (a, b) in before.iter().zip(&after) {
        let (velocity, way) = (b - a, centre - a);
        along += velocity.dot(&way);
        total += velocity.norm() * way.norm();
    }
    if total > 1e-12 { along / total } else { 0.0 }
}
