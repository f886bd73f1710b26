//! Refinement: from a contact field to focal contacts, centred centroids and the fields that the optimizer reads.

mod cells;
mod cluster;
mod distance;
mod sharpen;

pub use cells::{CHANNELS, Cell, FieldCells, Sample};
pub use cluster::{EPS_M, MIN_POINTS, dbscan};
pub use distance::{distance_to, signed_distance_m};
pub use sharpen::sharpen;

use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use distance::{distance_within, signed_distance_within};
use sharpen::sharpen_within;

use crate::budget::{Budget, Stop, Unlimited};
use crate::contact_field::ContactField;
use crate::grid::Grid;
use crate::options::SceneOptions;
use crate::volume::SurfaceVoxel;

/// Clusters of fewer focal centroids are dropped when a larger one exists.
pub const MIN_CLUSTER: usize = 10;

/// Voxels that are looked through in one piece.
const CHUNK: usize = 4096;

/// Below this share of the largest certainty a voxel's own direction is not trusted.
const TINY_CERTAINTY: f32 = 0.05;

/// A centred centroid `s_ee`: where the middle of a grasp's contacts should come to lie.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CenteredCentroid {
    /// Mean of the cluster's voxel centres, volume frame, metres.
    pub position: Point3<f64>,
    /// Share of this cluster in all clustered voxels; the weights of all centroids sum to 1.
    pub weight: f64,
    /// Voxels in the cluster.
    pub voxel_count: usize,
    /// Label of the nearest labelled object voxel, where the frames had labels.
    pub label: Option<u8>,
}

/// What is left of a contact field after refinement, ready for any number of hands.
#[derive(Debug, Clone)]
pub struct Features {
    /// The grid, in the volume frame.
    pub grid: Grid,
    /// Focal contacts `S_fc`: memory indices of voxels whose certainty exceeds `T_fc` of the maximum.
    pub focal_contacts: Vec<u32>,
    /// Number of focal centroids, `N_fe`.
    pub focal_centroid_count: usize,
    /// Centred centroids `S_ee`, heaviest first.
    pub centroids: Vec<CenteredCentroid>,
    /// The fields that the objectives look up.
    pub cells: FieldCells,
    /// Signed distance to occupied space at voxel centres, metres, negative inside (own array: collision
    /// spheres read nothing else).
    pub scene_distance_m: Vec<f32>,
    /// Height of the table top in the volume, metres; solid below.
    pub table_m: Option<f64>,
}

/// Refines a contact field (Supplementary Note 3).
///
/// Focal contacts and focal centroids are the voxels above a share of their field's maximum; focal centroids are
/// clustered by [`dbscan`] into centred centroids. `solid` is what a hand must not enter, one entry per voxel, and
/// `surface` where its surface lies within voxels, as far as that is known (else whole voxels are taken);
/// `labels` the object label of each voxel, 0 for none. Values that are not finite count as 0, so a field loaded
/// from elsewhere cannot spoil the optimization; an empty field gives empty features.
pub fn refine(
    field: &ContactField,
    solid: &[bool],
    surface: &[SurfaceVoxel],
    table_m: Option<f64>,
    labels: Option<&[u8]>,
    options: &SceneOptions,
) -> Features {
    let done = refine_within(field, solid, surface, table_m, labels, options, &Unlimited);
    // Nothing stops an unlimited budget; an empty field has no features.
    done.unwrap_or_else(|_| Features {
        grid: field.grid,
        focal_contacts: Vec::new(),
        focal_centroid_count: 0,
        centroids: Vec::new(),
        cells: FieldCells { grid: field.grid, cells: Vec::new() },
        scene_distance_m: Vec::new(),
        table_m,
    })
}

/// [`refine`], looking at the budget between its steps.
///
/// # Errors
/// [`Stop`] when the budget ended first.
pub fn refine_within(
    field: &ContactField,
    solid: &[bool],
    surface: &[SurfaceVoxel],
    table_m: Option<f64>,
    labels: Option<&[u8]>,
    options: &SceneOptions,
    budget: &dyn Budget,
) -> Result<Features, Stop> {
    let grid = field.grid;
    let (focal_contacts, largest) = above_share(&field.certainty, options.focal_contact_threshold);
    budget.check()?;
    let (focal_centroids, _) = above_share(&field.centroid, options.focal_centroid_threshold);
    budget.check()?;
    let centroids = centered(&grid, &focal_centroids, labels, table_m);
    budget.check()?;

    let mut is_focal = vec![false; grid.len()];
    for &i in &focal_contacts {
        is_focal[i as usize] = true;
    }
    let contact_distance = distance_within(&grid, |i| is_focal[i], budget);
    budget.check()?;
    let mut scene_distance_m = signed_distance_within(&grid, solid, budget);
    budget.check()?;
    sharpen_within(&grid, solid, surface, &mut scene_distance_m, budget);
    budget.check()?;
    let cells = fill(field, largest, contact_distance.as_deref(), &scene_distance_m, budget);
    budget.check()?;
    Ok(Features {
        grid,
        focal_contacts,
        focal_centroid_count: focal_centroids.len(),
        centroids,
        cells: FieldCells { grid, cells },
        scene_distance_m,
        table_m,
    })
}

fn finite(v: f32) -> f32 {
    if v.is_finite() { v } else { 0.0 }
}

/// Memory positions of the values above `share` of the largest, and the largest (0 for an empty field).
fn above_share(values: &[f32], share: f64) -> (Vec<u32>, f32) {
    let largest = values.par_chunks(CHUNK).map(largest_finite).reduce(|| 0.0, f32::max);
    if largest <= 0.0 {
        return (Vec::new(), 0.0);
    }
    let threshold = (f64::from(largest) * share.clamp(0.0, 1.0)) as f32;
    let above = |v: f32| {
        let v = finite(v);
        // A share of 1 leaves the maximum itself.
        v > 0.0 && (v > threshold || v >= largest)
    };
    let of_chunk = |(k, chunk): (usize, &[f32])| {
        let found = chunk.iter().enumerate().filter(|&(_, &v)| above(v));
        found.map(|(i, _)| (k * CHUNK + i) as u32).collect::<Vec<u32>>()
    };
    let found = values.par_chunks(CHUNK).enumerate().flat_map_iter(of_chunk).collect();
    (found, largest)
}

/// The largest of the finite values, at least 0. In lanes: one maximum for all would wait for itself at every value.
fn largest_finite(values: &[f32]) -> f32 {
    let mut lanes = [0.0f32; 16];
    let larger = |largest: &mut f32, v: f32| {
        if v > *largest && v < f32::INFINITY {
            *largest = v;
        }
    };
    let (rows, rest) = values.as_chunks::<16>();
    for row in rows {
        lanes.iter_mut().zip(row).for_each(|(largest, &v)| larger(largest, v));
    }
    lanes.iter_mut().zip(rest).for_each(|(largest, &v)| larger(largest, v));
    lanes.into_iter().fold(0.0, f32::max)
}

/// Clusters focal centroids; heaviest first, equal ones in memory order.
fn centered(
    grid: &Grid,
    focal: &[u32],
    labels: Option<&[u8]>,
    table_m: Option<f64>,
) -> Vec<CenteredCentroid> {
    let mut clusters = dbscan(grid, focal, EPS_M, MIN_POINTS);
    if clusters.iter().any(|c| c.len() >= MIN_CLUSTER) {
        clusters.retain(|c| c.len() >= MIN_CLUSTER);
    }
    clusters.sort_by_key(|c| std::cmp::Reverse(c.len()));
    let total: usize = clusters.iter().map(Vec::len).sum();
    let named = labels.map(|labels| labelled(grid, labels, table_m));
    clusters
        .iter()
        .map(|cluster| {
            let sum = cluster
                .iter()
                .fold(Vector3::zeros(), |sum, &i| sum + grid.center(grid.voxel(i as usize)).coords);
            let position = Point3::from(sum / cluster.len() as f64);
            let nearest = named.as_ref().and_then(|named| {
                named.iter().min_by(|a, b| {
                    (a.0 - position).norm_squared().total_cmp(&(b.0 - position).norm_squared())
                })
            });
            CenteredCentroid {
                position,
                weight: cluster.len() as f64 / total as f64,
                voxel_count: cluster.len(),
                label: nearest.map(|&(_, label)| label),
            }
        })
        .collect()
}

/// Labelled voxels above the table.
fn labelled(grid: &Grid, labels: &[u8], table_m: Option<f64>) -> Vec<(Point3<f64>, u8)> {
    let floor = table_m.map_or(f64::NEG_INFINITY, |t| t + grid.voxel_m());
    labels
        .iter()
        .enumerate()
        .filter(|&(_, &label)| label != 0)
        .map(|(i, &label)| (grid.center(grid.voxel(i)), label))
        .filter(|(p, _)| p.z >= floor)
        .collect()
}

/// Interleaves the fields.
///
/// The direction field is defined wherever there is a focal contact: where a voxel's own certainty is tiny its
/// direction is the one that leads through the nearest focal contact into the object, which is down the distance
/// field in free space and up the distance field inside the solid.
fn fill(
    field: &ContactField,
    largest: f32,
    contact_distance: Option<&[f32]>,
    scene_distance_m: &[f32],
    budget: &dyn Budget,
) -> Vec<Cell> {
    let grid = field.grid;
    let n = grid.resolution;
    let voxel = grid.voxel_m() as f32;
    let scale = if largest > 0.0 { 1.0 / largest } else { 0.0 };
    let stopped = AtomicBool::new(false);
    // Collected, not filled in place: 16 MB are written once, by all threads.
    (0..grid.len() as u32)
        .into_par_iter()
        .map(|index| {
            let side = n as u32;
            let i = index as usize;
            let [x, y, z] = [index / (side * side), index / side % side, index % side].map(|c| c as usize);
            // A look for each row of voxels; what comes after the end of the budget is left out.
            if z == 0 && budget.stop().is_some() {
                stopped.store(true, Ordering::Relaxed);
            }
            if stopped.load(Ordering::Relaxed) {
                return Cell::default();
            }
            let certainty = (finite(field.certainty.get(i).copied().unwrap_or(0.0)) * scale).max(0.0);
            let scene = scene_distance_m[i];
            let own = || unit(field.inward.get(i).copied().unwrap_or_default().map(finite));
            let direction = match (certainty >= TINY_CERTAINTY).then(own).flatten() {
                Some(own) => own,
                None => {
                    let through = contact_distance.and_then(|distance| {
                        let difference = |at: usize, stride: usize| {
                            let (low, high) = (at.saturating_sub(1), (at + 1).min(n - 1));
                            distance[i + (high - at) * stride] - distance[i - (at - low) * stride]
                        };
                        let gradient = [difference(x, n * n), difference(y, n), difference(z, 1)];
                        let sign = if scene > 0.0 { -1.0 } else { 1.0 };
                        unit(gradient.map(|g| sign * g))
                    });
                    through.or_else(own).unwrap_or_default()
                }
            };
            let distance = contact_distance.map_or(grid.size_m as f32, |d| d[i] * voxel);
            let [dx, dy, dz] = direction;
            Cell([distance, certainty, dx, dy, dz, scene, 0.0, 0.0])
        })
        .collect()
}

fn unit(v: [f32; 3]) -> Option<[f32; 3]> {
    let norm = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    (norm > 1e-6 && norm.is_finite()).then(|| v.map(|c| c / norm))
}

#[cfg(test)]
mod tests;
