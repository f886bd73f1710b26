//! Moving a distance field that was made of whole voxels to where the surface lies within them.

use rayon::prelude::*;

use crate::budget::{Budget, Unlimited};
use crate::grid::Grid;
use crate::volume::SurfaceVoxel;

/// Voxels this far from one that is partly filled, along each axis, are computed anew.
const REACH: usize = 2;
/// Up to this distance from the surface the new distances count alone, voxels ...
const NEAR: f32 = 1.0;
/// ... and from this one on the old ones do.
const FAR: f32 = 2.5;

/// Voxels between two looks at the budget.
const PIECE: usize = 256;

/// Corrects a signed distance field of `solid` (metres, memory order, see
/// [`signed_distance_m`](super::signed_distance_m)) near the voxels of which `surface` tells how full they are.
///
/// The surface crosses a voxel that is filled to a share `f` at `½ − f` voxels from its centre. Distances near it are
/// the shortest ways to any such crossing, over the centres of the voxels; some voxels away the difference to whole
/// voxels fades, since distances there follow from many of them.
pub fn sharpen(grid: &Grid, solid: &[bool], surface: &[SurfaceVoxel], distance_m: &mut [f32]) {
    sharpen_within(grid, solid, surface, distance_m, &Unlimited);
}

/// [`sharpen`], which leaves out what is left when the budget ends: whoever calls looks at it next.
pub(super) fn sharpen_within(
    grid: &Grid,
    solid: &[bool],
    surface: &[SurfaceVoxel],
    distance_m: &mut [f32],
    budget: &dyn Budget,
) {
    if surface.is_empty() || solid.len() != grid.len() || distance_m.len() != grid.len() {
        return;
    }
    let mut filled: Vec<f32> = solid.iter().map(|&s| f32::from(u8::from(s))).collect();
    let cube = Neighbour::cube(grid);
    let voxel = grid.voxel_m() as f32;
    let mut near = vec![false; grid.len()];
    for (k, s) in surface.iter().filter(|s| (s.index as usize) < grid.len()).enumerate() {
        if k % PIECE == 0 && budget.stop().is_some() {
            return;
        }
        let told = s.filled.clamp(0.0, 1.0);
        if told == std::mem::replace(&mut filled[s.index as usize], told) {
            continue;
        }
        around(grid, &cube, s.index as usize, |i, _| {
            near[i] = true;
            true
        });
    }
    // Whole voxels are off by less than one voxel: what is farther by that keeps its distance anyway.
    let farthest = (FAR + 1.0) * voxel;
    let near: Vec<usize> = (0..near.len()).filter(|&i| near[i] && distance_m[i].abs() < farthest).collect();
    let mut corrected = vec![0.0f32; near.len()];
    corrected.par_chunks_mut(PIECE).zip(near.par_chunks(PIECE)).for_each(|(corrected, near)| {
        if budget.stop().is_some() {
            return;
        }
        for (corrected, &i) in corrected.iter_mut().zip(near) {
            let exact = to_surface(grid, &cube, &filled, i);
            let weight = ((FAR - exact.abs()) / (FAR - NEAR)).clamp(0.0, 1.0);
            let whole = distance_m[i];
            *corrected = if exact.is_finite() { whole + weight * (exact * voxel - whole) } else { whole };
        }
    });
    for (i, corrected) in near.into_iter().zip(corrected) {
        distance_m[i] = corrected;
    }
}

/// Signed distance of a voxel's centre to the surface, voxels, from the voxels around it; infinite where those are
/// all full or all empty.
fn to_surface(grid: &Grid, cube: &[Neighbour], filled: &[f32], index: usize) -> f32 {
    let own = filled[index];
    if own > 0.0 && own < 1.0 {
        return 0.5 - own;
    }
    let mut least = f32::INFINITY;
    around(grid, cube, index, |i, apart| {
        // What is missing to a voxel of the other kind, from half a voxel before its centre to half behind.
        let other = if own == 0.0 { filled[i] } else { 1.0 - filled[i] };
        if other > 0.0 {
            least = least.min(apart + 0.5 - other);
        }
        // Those that follow are at least as far apart.
        apart - 0.5 < least
    });
    if own == 0.0 { least } else { -least }
}

/// A voxel relative to another.
#[derive(Debug, Clone, Copy)]
struct Neighbour {
    offset: [isize; 3],
    /// Difference of the memory indices.
    stride: isize,
    /// Distance of the centres, voxels.
    apart: f32,
}

impl Neighbour {
    /// The voxels of the cube about one, nearest first.
    fn cube(grid: &Grid) -> Vec<Self> {
        let (n, reach) = (grid.resolution as isize, REACH as isize);
        let range = || -reach..=reach;
        let offsets = range().flat_map(|x| range().flat_map(move |y| range().map(move |z| [x, y, z])));
        let mut all: Vec<Self> = offsets
            .map(|offset| {
                let [x, y, z] = offset;
                let apart = ((x * x + y * y + z * z) as f32).sqrt();
                Self { offset, stride: (x * n + y) * n + z, apart }
            })
            .collect();
        all.sort_by(|a, b| a.apart.total_cmp(&b.apart));
        all
    }
}

/// Calls with every voxel of the cube about one, and how far apart their centres are, voxels; nearest first, until
/// told to stop.
fn around(grid: &Grid, cube: &[Neighbour], index: usize, mut visit: impl FnMut(usize, f32) -> bool) {
    let n = grid.resolution;
    let voxel = grid.voxel(index);
    let inside = voxel.iter().all(|&c| c >= REACH && c + REACH < n);
    for neighbour in cube {
        let within = |(c, d): (&usize, &isize)| c.checked_add_signed(*d).is_some_and(|c| c < n);
        if !inside && !voxel.iter().zip(&neighbour.offset).all(within) {
            continue;
        }
        if !visit(index.wrapping_add_signed(neighbour.stride), neighbour.apart) {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;
    use proptest::prelude::*;

    use super::*;
    use crate::refine::signed_distance_m;

    /// Share of each voxel within a ball, by points, and the ball's solid voxels.
    fn ball(grid: &Grid, center: Point3<f64>, radius: f64) -> (Vec<bool>, Vec<SurfaceVoxel>) {
        let edge = grid.voxel_m();
        let inside = |p: Point3<f64>| (p - center).norm() < radius;
        let mut surface = Vec::new();
        let mut solid = vec![false; grid.len()];
        for (index, solid) in solid.iter_mut().enumerate() {
            let middle = grid.center(grid.voxel(index));
            *solid = inside(middle);
            let points = (0..512).filter(|k| {
                let at = |d: u32| ((k / 8_i32.pow(d) % 8) as f64 + 0.5) / 8.0 - 0.5;
                inside(middle + nalgebra::Vector3::new(at(0), at(1), at(2)) * edge)
            });
            let filled = points.count() as f32 / 512.0;
            if filled > 0.0 && filled < 1.0 {
                surface.push(SurfaceVoxel { index: index as u32, filled });
            }
        }
        (solid, surface)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]
        #[test]
        fn a_ball_is_as_large_as_it_is_and_not_as_its_voxels(
            x in 0.055..0.065_f64, y in 0.055..0.065_f64, z in 0.055..0.065_f64, radius in 0.012..0.04_f64
        ) {
            let grid = Grid { resolution: 24, size_m: 0.12 };
            let center = Point3::new(x, y, z);
            let (solid, surface) = ball(&grid, center, radius);
            let whole = signed_distance_m(&grid, &solid);
            let mut sharp = whole.clone();
            sharpen(&grid, &solid, &surface, &mut sharp);
            let errors = |field: &[f32]| {
                let near = (0..grid.len()).filter_map(|i| {
                    let exact = (grid.center(grid.voxel(i)) - center).norm() - radius;
                    (exact.abs() < 0.0075).then(|| (f64::from(field[i]) - exact).abs())
                });
                let all: Vec<f64> = near.collect();
                (all.iter().sum::<f64>() / all.len() as f64, all.iter().copied().fold(0.0, f64::max))
            };
            let ((mean, most), (before, _)) = (errors(&sharp), errors(&whole));
            prop_assert!(mean < 0.5 * before && mean < 5e-4 && most < 2.5e-3, "{before} -> {mean}, at most {most}");
        }
    }

    #[test]
    fn what_is_not_known_better_stays_and_what_does_not_fit_is_ignored() {
        let grid = Grid { resolution: 24, size_m: 0.12 };
        let (solid, surface) = ball(&grid, Point3::new(0.06, 0.06, 0.06), 0.02);
        let whole = signed_distance_m(&grid, &solid);
        let mut field = whole.clone();
        sharpen(&grid, &solid, &[], &mut field);
        assert_eq!(field, whole);
        sharpen(&grid, &solid[1..], &surface, &mut field);
        sharpen(&grid, &solid, &[SurfaceVoxel { index: u32::MAX, filled: 0.5 }], &mut field);
        assert_eq!(field, whole);
    }
}
