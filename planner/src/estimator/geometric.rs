//! The geometric rule: contacts from the shape that was seen, without a network.
//!
//! Supplementary Note 6 makes geometric alternatives to estimated contacts from scanned object models: candidates
//! near surfaces, certainty falling with distance, directions along normals, centroids from occupancy. Here
//! the same is made of one observed volume, and of the candidates those are preferred that a hand can use: with a
//! surface opposite within reach, and room for fingers at both ends.

use rayon::prelude::*;

use super::ContactEstimator;
use super::centroids::normalized;
use super::chords::{Body, MAX_CHORD_M};
use super::smoothing::smooth;
use crate::budget::{Budget, Stop};
use crate::contact_field::ContactField;
use crate::volume::{Volume, VoxelState};

/// Certainty of a contact that has nothing opposite to it, relative to the best.
const UNOPPOSED: f32 = 0.25;
/// Certainty one shell of voxels further out, relative to the shell that touches the surface.
const SECOND_SHELL: f32 = 0.6;
/// Factor for contacts in space that no frame looked at.
const UNSEEN: f32 = 0.9;
/// Chords up to this length are equally good, metres; longer ones fall off to half at the longest.
const EASY_CHORD_M: f32 = 0.07;

/// The estimator.
#[derive(Debug, Clone, Copy, Default)]
pub struct Geometric;

/// What one surface voxel found.
struct Contact {
    /// Memory position.
    index: usize,
    /// 0 to 1.
    quality: f32,
    inward: [f32; 3],
    /// Middle of its chord (voxel units) and the weight of its vote.
    vote: Option<([f32; 3], f32)>,
}

impl ContactEstimator for Geometric {
    fn name(&self) -> &str {
        "geometric"
    }

    fn estimate(&self, volume: &Volume, budget: &dyn Budget) -> Result<ContactField, Stop> {
        let grid = volume.grid;
        let solid = volume.solid();
        let mut object = volume.objects(&solid);
        if let Some(stop) = budget.stop() {
            return Err(stop);
        }
        if !object.contains(&true) {
            return Ok(ContactField::empty(grid));
        }
        extend_into_table(volume, &mut object);
        // Two passes: a standard deviation of 1.4 voxels, enough that a staircase of voxels has smooth normals.
        let occupied: Vec<f32> = object.iter().map(|&o| if o { 1.0 } else { 0.0 }).collect();
        let density = smooth(&grid, &smooth(&grid, &occupied));
        let body = Body {
            grid: &grid,
            object: &object,
            solid: &solid,
            density: &density,
            floor: volume.table_layer(),
        };
        let contacts = contacts(volume, &body);
        if let Some(stop) = budget.stop() {
            return Err(stop);
        }

        let mut field = ContactField::empty(grid);
        spread(&mut field, &contacts, &solid, volume.first_object_layer());
        let mut votes = vec![0.0f32; grid.len()];
        for (middle, weight) in contacts.iter().filter_map(|c| c.vote) {
            if let Some(i) = body.at(middle) {
                votes[i] += weight;
            }
        }
        let votes = smooth(&grid, &smooth(&grid, &votes));
        field.centroid = normalized(&grid, &votes);
        Ok(field)
    }
}

/// Objects that touch the table are continued below it, so that the smoothed shape has upright sides down to
/// the table instead of a rounded foot.
fn extend_into_table(volume: &Volume, object: &mut [bool]) {
    let n = volume.grid.resolution;
    let first = volume.first_object_layer();
    if first == 0 || first >= n {
        return;
    }
    for column in object.chunks_mut(n) {
        if column[first] {
            column[..first].fill(true);
        }
    }
}

/// Judges every voxel outside the solid that touches an object over a face.
fn contacts(volume: &Volume, body: &Body<'_>) -> Vec<Contact> {
    let grid = &volume.grid;
    let n = grid.resolution;
    let first = volume.first_object_layer();
    (0..n * n)
        .into_par_iter()
        .flat_map_iter(|row| {
            let (x, y) = (row / n, row % n);
            (first..n).filter_map(move |z| {
                let i = row * n + z;
                if body.solid[i] {
                    return None;
                }
                let o = body.object;
                let touches = (x > 0 && o[i - n * n])
                    || (x + 1 < n && o[i + n * n])
                    || (y > 0 && o[i - n])
                    || (y + 1 < n && o[i + n])
                    || (z > 0 && o[i - 1])
                    || (z + 1 < n && o[i + 1]);
                touches.then(|| judge(volume, body, i)).flatten()
            })
        })
        .collect()
}

fn judge(volume: &Volume, body: &Body<'_>, index: usize) -> Option<Contact> {
    let inward = body.outward(index)?.map(|c| -c);
    let start = volume.grid.voxel(index).map(|c| c as f32);
    let mut contact = Contact { index, quality: UNOPPOSED, inward, vote: None };
    // A contact that presses upwards from below an overhang is rarely reachable.
    contact.quality *= 1.0 - 0.5 * inward[2].max(0.0);
    if let Some(chord) = body.chord(start, inward) {
        let opposed = ramp(chord.opposition, 0.6, 0.95);
        let length_m = chord.length * volume.grid.voxel_m() as f32;
        let reach = 1.0 - 0.5 * ramp(length_m, EASY_CHORD_M, MAX_CHORD_M);
        let quality = opposed * (0.4 + 0.6 * chord.room) * reach * (1.0 - 0.4 * inward[2] * inward[2]);
        contact.quality += (1.0 - UNOPPOSED) * quality;
        if quality > 0.0 {
            let middle = std::array::from_fn(|a| 0.5 * (start[a] + chord.exit[a]));
            contact.vote = Some((middle, quality));
        }
    }
    if volume.state[index] == VoxelState::Unseen {
        contact.quality *= UNSEEN;
    }
    Some(contact)
}

/// 0 below `low`, 1 above `high`, linear between.
fn ramp(value: f32, low: f32, high: f32) -> f32 {
    ((value - low) / (high - low)).clamp(0.0, 1.0)
}

/// Smooths quality and direction along the surface, carries both to a second shell of voxels, and scales so that
/// the best contact has certainty 1.
fn spread(field: &mut ContactField, contacts: &[Contact], solid: &[bool], floor: usize) {
    let grid = field.grid;
    let n = grid.resolution;
    // Count, quality, and direction weighted by quality.
    let mut sums = vec![[0.0f32; 5]; grid.len()];
    let mut first_shell = vec![false; grid.len()];
    for c in contacts {
        let [x, y, z] = c.inward.map(|d| d * c.quality);
        sums[c.index] = [1.0, c.quality, x, y, z];
        first_shell[c.index] = true;
    }
    let sums = smooth(&grid, &sums);
    let shell = &first_shell;
    let values = field.certainty.par_chunks_mut(n).zip(field.inward.par_chunks_mut(n));
    values.enumerate().for_each(|(row, (certainty, inward))| {
        let (x, y) = (row / n, row % n);
        for z in floor..n {
            let i = row * n + z;
            let [count, quality, dx, dy, dz] = sums[i];
            if solid[i] || count < 1e-3 {
                continue;
            }
            let beside = || {
                (x > 0 && shell[i - n * n])
                    || (x + 1 < n && shell[i + n * n])
                    || (y > 0 && shell[i - n])
                    || (y + 1 < n && shell[i + n])
                    || (z > 0 && shell[i - 1])
                    || (z + 1 < n && shell[i + 1])
            };
            let distance = if shell[i] {
                1.0
            } else if beside() {
                SECOND_SHELL
            } else {
                continue;
            };
            let norm = (dx * dx + dy * dy + dz * dz).sqrt();
            if norm > 1e-6 {
                certainty[z] = distance * quality / count;
                inward[z] = [dx / norm, dy / norm, dz / norm];
            }
        }
    });
    let largest = field.certainty.iter().copied().fold(0.0, f32::max);
    if largest > 0.0 {
        field.certainty.par_iter_mut().for_each(|c| *c /= largest);
    }
}
