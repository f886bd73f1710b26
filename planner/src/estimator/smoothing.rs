//! Binomial smoothing of voxel arrays: five taps along each axis, zeros outside.

use rayon::prelude::*;

use crate::grid::Grid;

/// 1 4 6 4 1 over 16.
const TAPS: [f32; 5] = [0.0625, 0.25, 0.375, 0.25, 0.0625];

/// Values that can be averaged with weights.
pub(super) trait Weighted: Copy + Default + Send + Sync {
    /// `self + w * other`.
    fn add(self, w: f32, other: Self) -> Self;
}

impl Weighted for f32 {
    #[inline(always)]
    fn add(self, w: f32, other: Self) -> Self {
        self + w * other
    }
}

impl<const N: usize> Weighted for [f32; N]
where
    [f32; N]: Default,
{
    #[inline(always)]
    fn add(mut self, w: f32, other: Self) -> Self {
        for (a, b) in self.iter_mut().zip(other) {
            *a += w * b;
        }
        self
    }
}

/// Smooths `values` (memory order) along x, y and z: a Gaussian of one voxel's standard deviation, nearly.
pub(super) fn smooth<T: Weighted>(grid: &Grid, values: &[T]) -> Vec<T> {
    let n = grid.resolution;
    let slab = n * n;
    // Along z and y within each slab.
    let mut within = vec![T::default(); values.len()];
    within.par_chunks_mut(slab).zip(values.par_chunks(slab)).for_each_init(
        || vec![T::default(); slab],
        |along_z, (out, values)| {
            for (out, line) in along_z.chunks_mut(n).zip(values.chunks(n)) {
                tap_line(out, line);
            }
            for y in 0..n {
                let out = &mut out[y * n..(y + 1) * n];
                tap_rows(out, y, n, |y| &along_z[y * n..(y + 1) * n]);
            }
        },
    );
    let mut smoothed = vec![T::default(); values.len()];
    smoothed.par_chunks_mut(slab).enumerate().for_each(|(x, out)| {
        tap_rows(out, x, n, |x| &within[x * slab..(x + 1) * slab]);
    });
    smoothed
}

fn tap_line<T: Weighted>(out: &mut [T], line: &[T]) {
    let n = line.len();
    for (k, w) in TAPS.into_iter().enumerate() {
        // out[z] += w * line[z + k - 2]
        let (to, from) = (2usize.saturating_sub(k), k.saturating_sub(2));
        let count = n.saturating_sub(to.max(from));
        if k == 0 {
            out.fill(T::default());
        }
        for (o, &v) in out[to.min(n)..].iter_mut().zip(&line[from.min(n)..]).take(count) {
            *o = o.add(w, v);
        }
    }
}

fn tap_rows<'a, T: Weighted + 'a>(out: &mut [T], at: usize, n: usize, row: impl Fn(usize) -> &'a [T]) {
    out.fill(T::default());
    for (k, w) in TAPS.into_iter().enumerate() {
        if at + k < 2 || at + k - 2 >= n {
            continue;
        }
        for (o, &v) in out.iter_mut().zip(row(at + k - 2)) {
            *o = o.add(w, v);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spreads_a_point_by_the_product_of_taps_and_cuts_at_the_border() {
        let grid = Grid { resolution: 9, size_m: 0.09 };
        let mut values = vec![0.0f32; grid.len()];
        values[grid.index(4, 4, 1)] = 1.0;
        let out = smooth(&grid, &values);
        assert!((out[grid.index(4, 4, 1)] - 0.375f32.powi(3)).abs() < 1e-7);
        assert!((out[grid.index(5, 2, 0)] - 0.25 * 0.0625 * 0.25).abs() < 1e-7);
        assert!((out.iter().sum::<f32>() - 0.9375).abs() < 1e-5);
    }
}
