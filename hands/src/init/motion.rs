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
    let rest: Vec<f64> = ranges.iter().map(|&(l, u)| if l < u { 0.0_f64.clamp(l, u) } else { l }).collect();
    let first = classify(model, fingers, &ranges, &centre, &rest);
    // A thumb at rest may lie aside: turn what does not close so that it opposes, then look again.
    let held = hold(model, fingers, &ranges, &centre, &first);
    let mut motion = classify(model, fingers, &ranges, &centre, &held);
    let apart = |fraction: f64| {
        let tips = tips(model, fingers, &motion.joints(&model.mimics, fraction));
        let middle = super::middle(&tips);
        tips.iter().map(|t| (t - middle).norm()).sum::<f64>()
    };
    // The first time that the tips part again: fingers that curl on come near each other once more.
    let steps: Vec<f64> = (0..=60).map(|n| apart(f64::from(n) / 60.0)).collect();
    let turn = (1..60).find(|&n| steps[n] < steps[0] - 1e-3 && steps[n + 1] > steps[n]).unwrap_or(60);
    shorten(&mut motion, turn as f64 / 60.0);
    motion
}

/// Roles and the widest motion about a resting posture.
fn classify(
    model: &Model,
    fingers: &[Chain],
    ranges: &[(f64, f64)],
    centre: &Point3<f64>,
    rest: &[f64],
) -> Motion {
    let count = ranges.len();
    let mut motion = Motion { roles: vec![Role::Follows; count], open: rest.to_vec(), closed: rest.to_vec() };
    // Part of the way along the ranges of what bends; the rest stays.
    let mut cosines = vec![0.0; count];
    for j in (0..count).filter(|&j| model.mimics[j].is_none()) {
        let mut halfway = rest.to_vec();
        halfway[j] = ranges[j].0 + 0.4 * (ranges[j].1 - ranges[j].0);
        cosines[j] =
            0.5 * (towards(model, fingers, rest, j, centre) + towards(model, fingers, &halfway, j, centre));
    }
    let bending = bending(model, fingers, rest, &cosines);
    for j in (0..count).filter(|&j| model.mimics[j].is_none()) {
        if cosines[j].abs() < CLOSES || !bending[j] {
            motion.roles[j] = Role::Spreads;
            continue;
        }
        motion.roles[j] = Role::Closes(cosines[j].abs());
        let (lower, upper) = ranges[j];
        let (from, to) = if cosines[j] > 0.0 { (lower, upper) } else { (upper, lower) };
        // Fingers are straight at zero in most URDFs; beyond it they bend backwards.
        let inside = lower < 0.0 && upper > 0.0 && to.abs() > 0.5 * from.abs();
        let revolute = model.tree.joints[j].kind == JointKind::Revolute;
        motion.open[j] = if revolute && inside { 0.0 } else { from };
        motion.closed[j] = to;
    }
    motion
}

/// Joints whose axes lie along the axis that most of their finger's closing is about; all prismatic ones.
///
/// A finger flexes about parallel axes and spreads about others.
fn bending(model: &Model, fingers: &[Chain], rest: &[f64], cosines: &[f64]) -> Vec<bool> {
    let tree = &model.tree;
    let poses = tree.body_poses(&follow(&model.mimics, rest.to_vec()));
    let mut out = vec![true; tree.joints.len()];
    for finger in fingers {
        let axes: Vec<(usize, Vector3<f64>)> = finger
            .bodies
            .iter()
            .filter_map(|&b| tree.bodies[b].joint.map(|j| (j, poses[b] * tree.joints[j].axis.into_inner())))
            .filter(|&(j, _)| tree.joints[j].kind == JointKind::Revolute)
            .collect();
        let parallel = |a: &Vector3<f64>, b: &Vector3<f64>| a.dot(b).abs() > 0.8;
        let weight = |axis: &Vector3<f64>| -> f64 {
            axes.iter().filter(|(_, a)| parallel(a, axis)).map(|&(j, _)| cosines[j].powi(2)).sum()
        };
        let main = axes.iter().max_by(|a, b| weight(&a.1).total_cmp(&weight(&b.1))).map(|a| a.1);
        if let Some(main) = main {
            for (j, axis) in &axes {
                out[*j] = parallel(axis, &main);
            }
        }
    }
    out
}

/// Resting values: joints that do not close are turned to where closing brings their fingertip nearest to
/// the centre, when that is clearly nearer than at rest.
fn hold(
    model: &Model,
    fingers: &[Chain],
    ranges: &[(f64, f64)],
    centre: &Point3<f64>,
    motion: &Motion,
) -> Vec<f64> {
    const CLEARLY_M: f64 = 0.02;
    let mut held = motion.clone();
    for finger in fingers {
        let nearest = |motion: &Motion| {
            let at = |n: u32| {
                let q = motion.joints(&model.mimics, f64::from(n) / 8.0);
                (model.tree.body_poses(&q)[finger.last()] * finger.tip - centre).norm()
            };
            (0..=8).map(at).fold(f64::INFINITY, f64::min)
        };
        for &body in &finger.bodies {
            let Some(j) = model.tree.bodies[body].joint else { continue };
            if motion.roles[j] != Role::Spreads {
                continue;
            }
            let mut best = (nearest(&held) - CLEARLY_M, None);
            for n in 0..=8 {
                let value = ranges[j].0 + (ranges[j].1 - ranges[j].0) * f64::from(n) / 8.0;
                let mut tried = held.clone();
                (tried.open[j], tried.closed[j]) = (value, value);
                let distance = nearest(&tried);
                if distance < best.0 {
                    best = (distance, Some(value));
                }
            }
            if let Some(value) = best.1 {
                (held.open[j], held.closed[j]) = (value, value);
            }
        }
    }
    let spreads = |j: usize| motion.roles[j] == Role::Spreads;
    (0..ranges.len())
        .map(|j| {
            let rest = 0.0_f64.max(ranges[j].0).min(ranges[j].1);
            if spreads(j) { held.open[j] } else { rest }
        })
        .collect()
}

/// Stops where opposed pads meet, if they meet before the end.
pub(super) fn stop_at_contact(model: &Model, motion: &mut Motion, pads: &[PadGuess]) {
    const STEPS: u32 = 200;
    for n in 1..=STEPS {
        let fraction = f64::from(n) / f64::from(STEPS);
        let q = motion.joints(&model.mimics, fraction);
        let links = model.tree.link_poses(&model.tree.body_poses(&q));
        let at: Vec<_> =
            pads.iter().map(|p| (links[p.link] * p.center, links[p.link].rotation * p.normal)).collect();
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
