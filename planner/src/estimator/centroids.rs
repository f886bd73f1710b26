//! Contact centroids from votes: where the middles of many antipodal chords meet, or where a network says so, a hand
//! closes well.
//!
//! The refinement keeps what is above a share of the field's maximum, so votes as they are would leave the strongest
//! object only. They are therefore normalized per peak: each object's own middle scores 1. An object
//! without a peak (little of it was seen, or a neighbour hides its far side) gets a small one of its own.

use crate::grid::Grid;

/// Peaks closer than this are one, metres.
const PEAK_DISTANCE_M: f64 = 0.045;
/// A peak with less than this share of the strongest is noise.
const MIN_SHARE: f32 = 0.02;

/// What makes a peak of votes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Peaks {
    /// A peak of fewer votes per voxel is noise.
    pub(super) least: f32,
    /// Share of its peak from which a voxel's score reaches 1: a plateau that makes a cluster of some tens of voxels.
    pub(super) plateau: f32,
}

impl Peaks {
    /// Of counted chords: ripples of a seen table reach 0.1 votes, scissors lying on it 0.2, a cup 1.
    pub(super) const CHORDS: Self = Self { least: 0.12, plateau: 0.8 };
    /// Of a network's probabilities, which are broader around a middle than chords, and never 0. Chosen by
    /// `graspd eval ap` with five scenes of seed 1: AP 47.4, with a share of 0.8 from 0.12 on 32.5; on the field as it is,
    /// 28.7 with T_fe = 0.95 and at best (T_fe = 0.6) 39.1.
    pub(super) const PROBABILITIES: Self = Self { least: 0.5, plateau: 0.95 };
}

/// An object is no ripple of the table when it is at least so many layers of voxels high ...
const STANDING_LAYERS: usize = 3;
/// ... and has at least so many voxels.
const STANDING_VOXELS: usize = 30;
/// A peak so far outside an object's box still belongs to it, voxels.
const REACH_VOXELS: usize = 1;

/// Where a connected group of object voxels is.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Extent {
    low: [usize; 3],
    high: [usize; 3],
    count: usize,
    sum: [usize; 3],
}

impl Extent {
    /// Whether this is more than a ripple of the table.
    pub(super) fn stands_out(&self) -> bool {
        self.count >= STANDING_VOXELS && self.high[2] + 1 - self.low[2] >= STANDING_LAYERS
    }

    fn reaches(&self, voxel: [usize; 3]) -> bool {
        (0..3).all(|a| voxel[a] + REACH_VOXELS >= self.low[a] && voxel[a] <= self.high[a] + REACH_VOXELS)
    }
}

/// The extents of groups 1, 2, ... as [`Volume::object_groups`](crate::volume::Volume::object_groups) counts them.
pub(super) fn extents(grid: &Grid, groups: &[u16]) -> Vec<Extent> {
    let mut found: Vec<Extent> = Vec::new();
    for (i, &group) in groups.iter().enumerate().filter(|(_, group)| **group > 0) {
        let voxel = grid.voxel(i);
        let none = Extent { low: [usize::MAX; 3], high: [0; 3], count: 0, sum: [0; 3] };
        if found.len() < usize::from(group) {
            found.resize(usize::from(group), none);
        }
        let extent = &mut found[usize::from(group) - 1];
        extent.count += 1;
        for (a, &c) in voxel.iter().enumerate() {
            extent.low[a] = extent.low[a].min(c);
            extent.high[a] = extent.high[a].max(c);
            extent.sum[a] += c;
        }
    }
    found
}

/// Scores 0 to 1 from smoothed votes; every accepted peak has a plateau of 1, and so has the middle of each object
/// that stands out of the table and has no peak: one of few voxels, which the refinement weights low.
pub(super) fn normalized(grid: &Grid, votes: &[f32], objects: &[Extent], rule: Peaks) -> Vec<f32> {
    let mut score = vec![0.0; votes.len()];
    let strongest = votes.iter().copied().fold(0.0, f32::max);
    let least = (strongest * MIN_SHARE).max(rule.least);
    let floor = 0.5 * least;
    let voted: Vec<u32> = (0..votes.len()).filter(|&i| votes[i] > floor).map(|i| i as u32).collect();

    // Local maxima, strongest first; ties in memory order.
    let mut maxima: Vec<u32> = voted
        .iter()
        .copied()
        .filter(|&i| votes[i as usize] >= least && is_maximum(grid, votes, i as usize))
        .collect();
    maxima.sort_by(|&a, &b| votes[b as usize].total_cmp(&votes[a as usize]).then(a.cmp(&b)));
    let radius = (PEAK_DISTANCE_M / grid.voxel_m()) as f32;
    let position = |i: u32| grid.voxel(i as usize).map(|c| c as f32);
    let squared = |a: [f32; 3], b: [f32; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f32>();
    let mut peaks: Vec<([f32; 3], f32)> = Vec::new();
    for i in maxima {
        let p = position(i);
        if peaks.iter().all(|(q, _)| squared(p, *q) > radius * radius) {
            peaks.push((p, votes[i as usize]));
        }
    }
    for &i in &voted {
        let p = position(i);
        let nearest = peaks.iter().min_by(|a, b| squared(p, a.0).total_cmp(&squared(p, b.0)));
        if let Some((_, peak)) = nearest {
            let share = votes[i as usize] / peak;
            // A shoulder that rises towards a stronger peak further off is no centre of its own.
            score[i as usize] = if share > 1.0 { 0.0 } else { (share / rule.plateau).min(1.0) };
        }
    }
    let peaks: Vec<[usize; 3]> = peaks.iter().map(|(p, _)| p.map(|c| c as usize)).collect();
    for object in objects.iter().filter(|o| o.stands_out()) {
        // The strongest peak of a small object may be too sharp for a cluster of the size that the refinement asks
        // for. Its further peaks have to be broad enough by themselves.
        let own = peaks.iter().copied().find(|&p| object.reaches(p));
        small_plateau(grid, &mut score, own.unwrap_or_else(|| middle(grid, votes, object, 0.5 * rule.least)));
    }
    score
}

/// Where an object without a peak has most votes, or, where these are next to nothing, its middle.
/// `least` votes are not next to nothing.
fn middle(grid: &Grid, votes: &[f32], object: &Extent, least: f32) -> [usize; 3] {
    let mut best = (least, object.sum.map(|s| (s + object.count / 2) / object.count.max(1)));
    for x in object.low[0]..=object.high[0] {
        for y in object.low[1]..=object.high[1] {
            for z in object.low[2]..=object.high[2] {
                let votes = votes[grid.index(x, y, z)];
                if votes > best.0 {
                    best = (votes, [x, y, z]);
                }
            }
        }
    }
    best.1
}

/// The 19 voxels around `center` that share a face or an edge with it: enough to be a cluster.
fn small_plateau(grid: &Grid, score: &mut [f32], center: [usize; 3]) {
    let n = grid.resolution;
    let range = |c: usize| c.saturating_sub(1)..(c + 2).min(n);
    for x in range(center[0]) {
        for y in range(center[1]) {
            for z in range(center[2]) {
                if x.abs_diff(center[0]) + y.abs_diff(center[1]) + z.abs_diff(center[2]) <= 2 {
                    score[grid.index(x, y, z)] = 1.0;
                }
            }
        }
    }
}

fn is_maximum(grid: &Grid, votes: &[f32], i: usize) -> bool {
    let n = grid.resolution;
    let [x, y, z] = grid.voxel(i);
    let range = |c: usize| c.saturating_sub(1)..(c + 2).min(n);
    range(x).all(|a| range(y).all(|b| range(z).all(|c| votes[grid.index(a, b, c)] <= votes[i])))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_weak_object_scores_as_high_as_a_strong_one() {
        let grid = Grid { resolution: 40, size_m: 0.2 };
        let bump = |c: [usize; 3], height: f32, i: usize| {
            let v = grid.voxel(i);
            let d2: f32 = (0..3).map(|a| (v[a] as f32 - c[a] as f32).powi(2)).sum();
            height * (-d2 / 8.0).exp()
        };
        let votes: Vec<f32> =
            (0..grid.len()).map(|i| bump([10, 10, 10], 9.0, i) + bump([30, 30, 12], 1.0, i)).collect();
        let score = normalized(&grid, &votes, &[], Peaks::CHORDS);
        assert_eq!(score[grid.index(10, 10, 10)], 1.0);
        assert_eq!(score[grid.index(30, 30, 12)], 1.0);
        assert!(score[grid.index(20, 20, 11)] < 0.2);
        assert!(normalized(&grid, &vec![0.0; grid.len()], &[], Peaks::CHORDS).iter().all(|&s| s == 0.0));
    }

    #[test]
    fn an_object_without_a_peak_gets_a_small_one_and_a_ripple_none() {
        let grid = Grid { resolution: 40, size_m: 0.2 };
        let mut groups = vec![0u16; grid.len()];
        for (i, group) in groups.iter_mut().enumerate() {
            let [x, y, z] = grid.voxel(i);
            let within = |c: usize, low: usize, high: usize| (low..=high).contains(&c);
            if within(x, 8, 12) && within(y, 8, 12) && within(z, 8, 12) {
                *group = 1;
            } else if within(x, 28, 32) && within(y, 20, 24) && within(z, 8, 11) {
                *group = 2;
            } else if within(x, 5, 35) && within(y, 36, 38) && z == 8 {
                *group = 3;
            }
        }
        let votes: Vec<f32> = (0..grid.len())
            .map(|i| {
                let v = grid.voxel(i).map(|c| c as f32 - 10.0);
                9.0 * (-v.iter().map(|c| c * c).sum::<f32>() / 8.0).exp()
            })
            .collect();
        let score = normalized(&grid, &votes, &extents(&grid, &groups), Peaks::CHORDS);
        let ones = |group: u16| (0..score.len()).filter(|&i| groups[i] == group && score[i] >= 1.0).count();
        assert_eq!(score[grid.index(30, 22, 10)], 1.0);
        assert_eq!([ones(2), ones(3)], [19, 0]);
        assert!(ones(1) >= 7, "the votes decide where there are enough of them");
    }
}
