//! Exact Euclidean distance transforms on the grid.
//!
//! Squared distances between voxel centres are integers, so the transform is exact: two scans along z, then a
//! lower envelope over whole rows for y and for x. The envelopes are taken by min-plus over short vectors of
//! neighbours in z, outwards until no further row can be nearer; at 80³ this beats the linear-time
//! parabola algorithm because sixteen 16-bit lanes work at once.

use rayon::prelude::*;

use crate::budget::{Budget, Unlimited};
use crate::grid::Grid;

/// Neighbours along z that are worked on together.
const LANES: usize = 16;

/// Integers in which squared voxel distances are computed.
trait Squared: Copy + Ord + Send + Sync + std::ops::Add<Output = Self> {
    fn of(value: usize) -> Self;
    fn float(self) -> f32;
}

impl Squared for i16 {
    fn of(value: usize) -> Self {
        value as i16
    }
    fn float(self) -> f32 {
        f32::from(self)
    }
}

impl Squared for i32 {
    fn of(value: usize) -> Self {
        value as i32
    }
    fn float(self) -> f32 {
        self as f32
    }
}

/// Distance of every voxel centre to the nearest voxel centre in `set`, voxels, memory order; `None` for an
/// empty set. `set` must have one entry per voxel.
pub fn distance_to(grid: &Grid, set: impl Fn(usize) -> bool + Sync) -> Option<Vec<f32>> {
    distance_within(grid, set, &Unlimited)
}

/// [`distance_to`], which leaves out what is left when the budget ends: whoever calls looks at it next.
pub(super) fn distance_within(
    grid: &Grid,
    set: impl Fn(usize) -> bool + Sync,
    budget: &dyn Budget,
) -> Option<Vec<f32>> {
    let n = grid.resolution;
    if n == 0 {
        return None;
    }
    // The largest sum that occurs is "none" plus one more square.
    let farthest = 3 * (n - 1) * (n - 1) + 1;
    if farthest + (n - 1) * (n - 1) <= i16::MAX as usize {
        transform::<i16>(n, farthest, set, budget)
    } else {
        transform::<i32>(n, farthest, set, budget)
    }
}

/// Signed distance of every voxel centre to the surface of `solid`, metres: outside, half a voxel less than to the
/// nearest solid centre; inside, half a voxel less than to the nearest free centre, negative. A volume without
/// solid (or without free) voxels is the cube's edge length away from it.
pub fn signed_distance_m(grid: &Grid, solid: &[bool]) -> Vec<f32> {
    signed_distance_within(grid, solid, &Unlimited)
}

/// [`signed_distance_m`], which leaves out what is left when the budget ends: whoever calls looks at it next.
pub(super) fn signed_distance_within(grid: &Grid, solid: &[bool], budget: &dyn Budget) -> Vec<f32> {
    let voxel = grid.voxel_m() as f32;
    let far = grid.size_m as f32;
    let at = |i: usize| solid.get(i).copied().unwrap_or(false);
    let (outside, inside) =
        rayon::join(|| distance_within(grid, at, budget), || distance_within(grid, |i| !at(i), budget));
    match (outside, inside) {
        (Some(mut outside), Some(inside)) => {
            outside.par_iter_mut().zip(inside.par_iter()).for_each(|(out, &inside)| {
                *out = voxel * if *out > 0.0 { *out - 0.5 } else { 0.5 - inside };
            });
            outside
        }
        (Some(_), None) => vec![-far; grid.len()],
        _ => vec![far; grid.len()],
    }
}

fn transform<T: Squared>(
    n: usize,
    none: usize,
    set: impl Fn(usize) -> bool + Sync,
    budget: &dyn Budget,
) -> Option<Vec<f32>> {
    let none = T::of(none);
    // Rows along z are padded to whole vectors.
    let row = n.div_ceil(LANES) * LANES;
    let slab = n * row;
    let squares: Vec<T> = (0..n).map(|d| T::of(d * d)).collect();

    // Along z, then along y, one slab of constant x at a time.
    let mut after_y = vec![none; n * slab];
    let found = after_y
        .par_chunks_mut(slab)
        .enumerate()
        .map_init(
            || vec![none; slab],
            |along_z, (x, out)| {
                let mut found = false;
                if budget.stop().is_some() {
                    return found;
                }
                for y in 0..n {
                    let line = &mut along_z[y * row..y * row + n];
                    found |= scan(line, &squares, none, |z| set((x * n + y) * n + z));
                }
                if found {
                    envelope(
                        n,
                        row,
                        &squares,
                        |y, z| &along_z[y * row + z..],
                        |y, z, v| {
                            out[y * row + z..][..LANES].copy_from_slice(v);
                        },
                    );
                }
                found
            },
        )
        .reduce(|| false, |a, b| a || b);
    if !found {
        return None;
    }

    // Along x: each slab of the result reads all slabs.
    let mut result = vec![0.0f32; n * n * n];
    result.par_chunks_mut(n * n).enumerate().for_each(|(x, out)| {
        if budget.stop().is_some() {
            return;
        }
        for y in 0..n {
            for z in (0..n).step_by(LANES) {
                let best = nearest(n, x, &squares, |x| &after_y[x * slab + y * row + z..]);
                let lanes = LANES.min(n - z);
                for (o, b) in out[y * n + z..][..lanes].iter_mut().zip(&best) {
                    *o = b.float().sqrt();
                }
            }
        }
    });
    Some(result)
}

/// Squared distances along one row by a scan each way; false when the row holds no member.
fn scan<T: Squared>(line: &mut [T], squares: &[T], none: T, set: impl Fn(usize) -> bool) -> bool {
    let n = line.len();
    let mut since = usize::MAX;
    for (z, out) in line.iter_mut().enumerate() {
        since = if set(z) { 0 } else { since.saturating_add(1) };
        *out = squares.get(since).copied().unwrap_or(none);
    }
    if since == usize::MAX {
        return false;
    }
    since = usize::MAX;
    for z in (0..n).rev() {
        since = if line[z] == squares[0] { 0 } else { since.saturating_add(1) };
        if let Some(&s) = squares.get(since) {
            line[z] = line[z].min(s);
        }
    }
    true
}

fn envelope<'a, T: Squared + 'a>(
    n: usize,
    row: usize,
    squares: &[T],
    line: impl Fn(usize, usize) -> &'a [T],
    mut store: impl FnMut(usize, usize, &[T; LANES]),
) {
    for y in 0..n {
        for z in (0..row).step_by(LANES) {
            let best = nearest(n, y, squares, |y| line(y, z));
            store(y, z, &best);
        }
    }
}

/// `min over other of line(other) + (other - here)²` for [`LANES`] neighbours in z.
#[inline(always)]
fn nearest<'a, T: Squared + 'a>(
    n: usize,
    here: usize,
    squares: &[T],
    line: impl Fn(usize) -> &'a [T],
) -> [T; LANES] {
    let mut best = [squares[0]; LANES];
    best.copy_from_slice(&line(here)[..LANES]);
    let reach = here.max(n - 1 - here);
    for (d, &square) in squares.iter().enumerate().take(reach + 1).skip(1) {
        // Nothing further away can improve a vector whose worst entry is within this distance already.
        if d % 4 == 1 && best.iter().copied().max().is_some_and(|worst| worst <= square) {
            break;
        }
        if here >= d {
            lower(&mut best, &line(here - d)[..LANES], square);
        }
        if here + d < n {
            lower(&mut best, &line(here + d)[..LANES], square);
        }
    }
    best
}

#[inline(always)]
fn lower<T: Squared>(best: &mut [T; LANES], other: &[T], square: T) {
    for (b, &o) in best.iter_mut().zip(other) {
        *b = (*b).min(o + square);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn brute(grid: &Grid, set: &[bool]) -> Vec<f32> {
        let members: Vec<[i64; 3]> =
            (0..grid.len()).filter(|&i| set[i]).map(|i| grid.voxel(i).map(|v| v as i64)).collect();
        (0..grid.len())
            .map(|i| {
                let v = grid.voxel(i).map(|v| v as i64);
                let nearest = members.iter().map(|m| (0..3).map(|a| (m[a] - v[a]).pow(2)).sum::<i64>()).min();
                (nearest.unwrap() as f32).sqrt()
            })
            .collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]
        #[test]
        fn equals_brute_force(
            n in prop_oneof![Just(1usize), Just(5), Just(16), Just(19)],
            seeds in proptest::collection::vec(0usize..19 * 19 * 19, 1..40),
        ) {
            let grid = Grid { resolution: n, size_m: 0.1 };
            let mut set = vec![false; grid.len()];
            for s in seeds {
                set[s % grid.len()] = true;
            }
            let expected = brute(&grid, &set);
            prop_assert_eq!(distance_to(&grid, |i| set[i]).unwrap(), expected.clone());
            // Wider integers give the same.
            let far = 3 * (n - 1) * (n - 1) + 1;
            prop_assert_eq!(transform::<i32>(n, far, |i| set[i], &Unlimited).unwrap(), expected);
        }
    }

    #[test]
    fn full_size_corner_to_corner() {
        for n in [80, 96] {
            let grid = Grid { resolution: n, size_m: 0.4 };
            let d = distance_to(&grid, |i| i == 0).unwrap();
            assert_eq!(d[grid.len() - 1], (3.0 * ((n - 1) * (n - 1)) as f32).sqrt());
        }
    }

    #[test]
    fn signed_distance_of_a_half_space() {
        let grid = Grid { resolution: 20, size_m: 0.1 };
        let solid: Vec<bool> = (0..grid.len()).map(|i| i % 20 < 8).collect();
        let d = signed_distance_m(&grid, &solid);
        for (i, &d) in d.iter().enumerate() {
            let height = grid.center(grid.voxel(i)).z - 0.04;
            assert!((f64::from(d) - height).abs() < 1e-6);
        }
        assert_eq!(signed_distance_m(&grid, &[]), vec![0.1; grid.len()]);
        assert_eq!(signed_distance_m(&grid, &vec![true; grid.len()]), vec![-0.1; grid.len()]);
    }
}
