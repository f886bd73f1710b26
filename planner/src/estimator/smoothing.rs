//! Binomial smoothing of voxel arrays: five taps along each axis, zeros outside.

use std::ops::Range;

use rayon::prelude::*;

use crate::budget::Budget;
use crate::grid::Grid;

/// 1 4 6 4 1 over 16.
const TAPS: [f32; 5] = [0.0625, 0.25, 0.375, 0.25, 0.0625];

/// The box of voxels outside which an array is zero.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Region(pub(super) [Range<usize>; 3]);

impl Region {
    /// Smallest box around the voxels that are not 0, grown by `margin` voxels on each side; `None` for an empty set.
    pub(super) fn around(grid: &Grid, set: &[u16], margin: usize) -> Option<Self> {
        let n = grid.resolution;
        let (mut low, mut high) = ([usize::MAX; 3], [0; 3]);
        for (row, column) in set.chunks(n.max(1)).enumerate() {
            let Some(first) = column.iter().position(|&s| s > 0) else { continue };
            let last = column.iter().rposition(|&s| s > 0).unwrap_or(first);
            let [x, y] = [row / n, row % n];
            low = [low[0].min(x), low[1].min(y), low[2].min(first)];
            high = [high[0].max(x), high[1].max(y), high[2].max(last)];
        }
        (low[0] != usize::MAX)
            .then(|| Self([0, 1, 2].map(|a| low[a].saturating_sub(margin)..(high[a] + 1 + margin).min(n))))
    }
}

/// Smooths `values` (memory order) along x, y and z: a Gaussian of one voxel's standard deviation, nearly.
///
/// Only voxels of `region` are read and written; the result is zero elsewhere. The budget is looked at in every slab;
/// when it ends the other slabs stay zero: the caller looks at it next.
pub(super) fn smooth(grid: &Grid, values: &[f32], region: &Region, budget: &dyn Budget) -> Vec<f32> {
    let n = grid.resolution;
    let slab = n * n;
    let Region([xs, ys, zs]) = region;
    let line = |slab: usize, y: usize| slab + y * n + zs.start..slab + y * n + zs.end;
    // Along z and y within each slab.
    let mut within = vec![0.0f32; values.len()];
    within
        .par_chunks_mut(slab)
        .zip(values.par_chunks(slab))
        .enumerate()
        .skip(xs.start)
        .take(xs.len())
        .for_each_init(
            || vec![0.0f32; slab],
            |along_z, (_, (out, values))| {
                if budget.stop().is_some() {
                    return;
                }
                for y in ys.clone() {
                    tap_line(&mut along_z[line(0, y)], &values[line(0, y)]);
                }
                for y in ys.clone() {
                    tap_rows(&mut out[line(0, y)], y, ys, |y| &along_z[line(0, y)]);
                }
            },
        );
    let mut smoothed = vec![0.0f32; values.len()];
    smoothed.par_chunks_mut(slab).enumerate().skip(xs.start).take(xs.len()).for_each(|(x, out)| {
        if budget.stop().is_some() {
            return;
        }
        for y in ys.clone() {
            tap_rows(&mut out[line(0, y)], x, xs, |x| &within[line(x * slab, y)]);
        }
    });
    smoothed
}

/// Along one row.
fn tap_line(out: &mut [f32], line: &[f32]) {
    let n = line.len();
    out.fill(0.0);
    for (k, w) in TAPS.into_iter().enumerate() {
        // out[z] += w * line[z + k - 2]
        let (to, from) = (2usize.saturating_sub(k).min(n), k.saturating_sub(2).min(n));
        for (o, &v) in out[to..].iter_mut().zip(&line[from..]) {
            *o += w * v;
        }
    }
}

/// Across rows: `out` is row number `at` of `range`.
fn tap_rows<'a>(out: &mut [f32], at: usize, range: &Range<usize>, row: impl Fn(usize) -> &'a [f32]) {
    out.fill(0.0);
    for (k, w) in TAPS.into_iter().enumerate() {
        if at + k >= 2 && range.contains(&(at + k - 2)) {
            for (o, &v) in out.iter_mut().zip(row(at + k - 2)) {
                *o += w * v;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::budget::Unlimited;

    #[test]
    fn spreads_a_point_by_the_product_of_taps_and_cuts_at_the_border() {
        let grid = Grid { resolution: 9, size_m: 0.09 };
        let mut values = vec![0.0f32; grid.len()];
        values[grid.index(4, 4, 1)] = 1.0;
        let region =
            Region::around(&grid, &values.iter().map(|&v| u16::from(v > 0.0)).collect::<Vec<_>>(), 2)
                .unwrap();
        assert_eq!(region, Region([2..7, 2..7, 0..4]));
        let out = smooth(&grid, &values, &region, &Unlimited);
        assert!((out[grid.index(4, 4, 1)] - 0.375f32.powi(3)).abs() < 1e-7);
        assert!((out[grid.index(5, 2, 0)] - 0.25 * 0.0625 * 0.25).abs() < 1e-7);
        assert!((out.iter().sum::<f32>() - 0.9375).abs() < 1e-5);
        assert_eq!(Region::around(&grid, &vec![0; grid.len()], 2), None);
    }
}
