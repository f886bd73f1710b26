//! DBSCAN on voxels: neighbours are looked up on the grid, so the cost is linear in the number of points.

use crate::grid::Grid;

/// Neighbourhood radius, metres (the reference implementation's setting).
pub const EPS_M: f64 = 0.012;
/// Points (itself included) that make a point a core point.
pub const MIN_POINTS: usize = 4;

/// Clusters of the voxels at these memory positions (each given once), every cluster sorted, in the order of
/// their first core points. Two points are neighbours when their centres are at most `eps_m` apart; a border
/// point goes to the first cluster that reaches it; noise is left out.
pub fn dbscan(grid: &Grid, voxels: &[u32], eps_m: f64, min_points: usize) -> Vec<Vec<u32>> {
    const NONE: u32 = u32::MAX;
    let n = grid.resolution as i64;
    // Position in `voxels` of the point at each memory position.
    let mut point_at = vec![NONE; grid.len()];
    for (p, &v) in voxels.iter().enumerate() {
        point_at[v as usize] = p as u32;
    }
    let offsets = neighbourhood(eps_m / grid.voxel_m());
    let neighbours = |v: u32, found: &mut Vec<u32>| {
        found.clear();
        let [x, y, z] = grid.voxel(v as usize).map(|c| c as i64);
        for [dx, dy, dz] in &offsets {
            let (x, y, z) = (x + dx, y + dy, z + dz);
            if (0..n).contains(&x) && (0..n).contains(&y) && (0..n).contains(&z) {
                let p = point_at[((x * n + y) * n + z) as usize];
                if p != NONE {
                    found.push(p);
                }
            }
        }
    };

    let mut cluster_of = vec![NONE; voxels.len()];
    let mut clusters: Vec<Vec<u32>> = Vec::new();
    let (mut near, mut queue) = (Vec::new(), Vec::new());
    for seed in 0..voxels.len() {
        if cluster_of[seed] != NONE {
            continue;
        }
        neighbours(voxels[seed], &mut near);
        if near.len() < min_points {
            continue;
        }
        let id = clusters.len() as u32;
        let mut members = Vec::new();
        cluster_of[seed] = id;
        queue.clear();
        queue.push(seed as u32);
        while let Some(p) = queue.pop() {
            members.push(voxels[p as usize]);
            neighbours(voxels[p as usize], &mut near);
            if near.len() < min_points {
                continue;
            }
            for &q in &near {
                if cluster_of[q as usize] == NONE {
                    cluster_of[q as usize] = id;
                    queue.push(q);
                }
            }
        }
        members.sort_unstable();
        clusters.push(members);
    }
    clusters
}

/// Offsets of at most `radius` voxels, itself included.
fn neighbourhood(radius: f64) -> Vec<[i64; 3]> {
    let reach = radius.floor().clamp(0.0, 32.0) as i64;
    let limit = radius * radius + 1e-9;
    let mut offsets = Vec::new();
    for x in -reach..=reach {
        for y in -reach..=reach {
            for z in -reach..=reach {
                if (x * x + y * y + z * z) as f64 <= limit {
                    offsets.push([x, y, z]);
                }
            }
        }
    }
    offsets
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The textbook algorithm on all pairs; same order of seeds.
    fn naive(grid: &Grid, voxels: &[u32], eps: f64, min_points: usize) -> Vec<Vec<u32>> {
        let centers: Vec<_> = voxels.iter().map(|&v| grid.center(grid.voxel(v as usize))).collect();
        let near = |i: usize| -> Vec<usize> {
            (0..voxels.len()).filter(|&j| (centers[i] - centers[j]).norm() <= eps + 1e-9).collect()
        };
        let mut label = vec![None; voxels.len()];
        let mut count = 0;
        for i in 0..voxels.len() {
            if label[i].is_some() || near(i).len() < min_points {
                continue;
            }
            label[i] = Some(count);
            let mut queue = vec![i];
            while let Some(p) = queue.pop() {
                let around = near(p);
                if around.len() >= min_points {
                    for q in around {
                        if label[q].is_none() {
                            label[q] = Some(count);
                            queue.push(q);
                        }
                    }
                }
            }
            count += 1;
        }
        (0..count)
            .map(|c| {
                let mut members: Vec<u32> =
                    (0..voxels.len()).filter(|&i| label[i] == Some(c)).map(|i| voxels[i]).collect();
                members.sort_unstable();
                members
            })
            .collect()
    }

    proptest! {
        #[test]
        fn equals_the_naive_algorithm(
            picked in proptest::collection::btree_set(0u32..12 * 12 * 12, 0..160),
            eps in 0.004f64..0.02,
        ) {
            let grid = Grid { resolution: 12, size_m: 0.06 };
            let voxels: Vec<u32> = picked.into_iter().collect();
            prop_assert_eq!(dbscan(&grid, &voxels, eps, 4), naive(&grid, &voxels, eps, 4));
        }
    }
}
