//! Contact centroids from votes: where the middles of many antipodal chords meet, a hand closes well.
//!
//! The refinement keeps what is above a share of the field's maximum, so a plain vote count would leave the
//! largest object only. Votes are therefore normalized per peak: each object's own middle scores 1.

use crate::grid::Grid;

/// Peaks closer than this are one, metres.
const PEAK_DISTANCE_M: f64 = 0.045;
/// A peak with less than this share of the strongest is noise.
const MIN_SHARE: f32 = 0.02;
/// A peak of fewer votes per voxel is noise: ripples of a seen table reach 0.1, scissors lying on it 0.2, a cup 1.
const MIN_VOTES: f32 = 0.12;
/// Share of its peak from which a voxel's score reaches 1: a plateau that makes a cluster of some tens of voxels.
const PLATEAU: f32 = 0.8;

/// Scores 0 to 1 from smoothed votes; every accepted peak has a plateau of 1.
pub(super) fn normalized(grid: &Grid, votes: &[f32]) -> Vec<f32> {
    let mut score = vec![0.0; votes.len()];
    let strongest = votes.iter().copied().fold(0.0, f32::max);
    if strongest <= 0.0 {
        return score;
    }
    let least = (strongest * MIN_SHARE).max(MIN_VOTES);
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
    for i in voted {
        let p = position(i);
        let nearest = peaks.iter().min_by(|a, b| squared(p, a.0).total_cmp(&squared(p, b.0)));
        if let Some((_, peak)) = nearest {
            let share = votes[i as usize] / peak;
            // A shoulder that rises towards a stronger peak further off is no centre of its own.
            score[i as usize] = if share > 1.0 { 0.0 } else { (share / PLATEAU).min(1.0) };
        }
    }
    score
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
        let score = normalized(&grid, &votes);
        assert_eq!(score[grid.index(10, 10, 10)], 1.0);
        assert_eq!(score[grid.index(30, 30, 12)], 1.0);
        assert!(score[grid.index(20, 20, 11)] < 0.2);
        assert!(normalized(&grid, &vec![0.0; grid.len()]).iter().all(|&s| s == 0.0));
    }
}
