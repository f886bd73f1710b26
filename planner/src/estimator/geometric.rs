//! The geometric rule: contacts from the shape that was seen, without a network.
//!
//! Supplementary Note 6 makes geometric alternatives to estimated contacts from scanned object models: candidates
//! near surfaces, certainty falling with distance, directions along normals, centroids from occupancy. Here
//! the same is made of one observed volume, and of the candidates those are preferred that a hand can use: with a
//! surface opposite within reach, and room for fingers at both ends.

use rayon::prelude::*;

use super::ContactEstimator;
use super::centroids::{Extent, Peaks, extents, normalized};
use super::chords::{Body, MAX_CHORD_M};
use super::smoothing::{Region, smooth};
use crate::budget::{Budget, Stop};
use crate::contact_field::ContactField;
use crate::grid::Grid;
use crate::volume::{Volume, VoxelState};

/// Certainty of a contact that has nothing opposite to it, relative to the best.
const UNOPPOSED: f32 = 0.25;
/// Certainty one shell of voxels further out, relative to the shell that touches the surface.
const SECOND_SHELL: f32 = 0.6;
/// Factor for contacts of which one end of the chord is in space that no frame looked at: there the shape is a
/// guess.
const UNSEEN: f32 = 0.8;
/// An object's contacts are scaled to its own best one, but never as if that had less than this share of the best
/// contact of all: what can hardly be held is not to look as good as the rest.
const MIN_SCALE: f32 = 0.5;
/// Margin around the objects in which smoothing works, voxels: two passes of two.
const MARGIN_VOXELS: usize = 4;
/// Directions whose horizontal part is at least this also try the horizontal direction.
const FLATTENABLE: f32 = 0.5;
/// Chords up to this length are equally good, metres; longer ones fall off to half at the longest.
const EASY_CHORD_M: f32 = 0.07;

/// The estimator.
#[derive(Debug, Clone, Copy, Default)]
pub struct Geometric;

/// What one surface voxel found.
struct Contact {
    /// Memory position.
    index: usize,
    /// The object that it touches, see [`Volume::object_groups`].
    group: u16,
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
        let solid = volume.solid();
        budget.check()?;
        let groups = volume.object_groups(&solid);
        self.estimate_known(volume, &solid, &groups, budget)
    }

    fn estimate_known(
        &self,
        volume: &Volume,
        solid: &[bool],
        groups: &[u16],
        budget: &dyn Budget,
    ) -> Result<ContactField, Stop> {
        let grid = volume.grid;
        let mut group = groups.to_vec();
        budget.check()?;
        let extents = extents(&grid, &group);
        extend_into_table(volume, &mut group);
        let Some(region) = Region::around(&grid, &group, MARGIN_VOXELS) else {
            return Ok(ContactField::empty(grid));
        };
        // Two passes: a standard deviation of 1.4 voxels, enough that a staircase of voxels has smooth normals.
        budget.check()?;
        let occupied: Vec<f32> = group.iter().map(|&g| if g > 0 { 1.0 } else { 0.0 }).collect();
        budget.check()?;
        let once = smooth(&grid, &occupied, &region, budget);
        budget.check()?;
        let density = smooth(&grid, &once, &region, budget);
        budget.check()?;
        let floor = volume.table_layer();
        let body = Body { grid: &grid, group: &group, solid, state: &volume.state, density: &density, floor };
        let contacts = contacts(volume, &body, budget);
        budget.check()?;

        let mut field = ContactField::empty(grid);
        spread(&mut field, &contacts, &extents, solid, volume.first_object_layer(), budget);
        budget.check()?;
        let mut votes = vec![0.0f32; grid.len()];
        for (middle, weight) in contacts.iter().filter_map(|c| c.vote) {
            if let Some(i) = body.at(middle) {
                votes[i] += weight;
            }
        }
        budget.check()?;
        let once = smooth(&grid, &votes, &region, budget);
        budget.check()?;
        let votes = smooth(&grid, &once, &region, budget);
        budget.check()?;
        field.centroid = normalized(&grid, &votes, &extents, Peaks::CHORDS);
        Ok(field)
    }
}

/// Objects that touch the table are continued below it, so that the smoothed shape has upright sides down to
/// the table instead of a rounded foot.
fn extend_into_table(volume: &Volume, group: &mut [u16]) {
    let n = volume.grid.resolution;
    let first = volume.first_object_layer();
    if first == 0 || first >= n {
        return;
    }
    for column in group.chunks_mut(n) {
        if column[first] > 0 {
            let own = column[first];
            column[..first].fill(own);
        }
    }
}

/// Judges every voxel outside the solid that touches an object over a face.
fn contacts(volume: &Volume, body: &Body<'_>, budget: &dyn Budget) -> Vec<Contact> {
    let grid = &volume.grid;
    let n = grid.resolution;
    let first = volume.first_object_layer();
    (0..n * n)
        .into_par_iter()
        .flat_map_iter(|row| {
            let (x, y) = (row / n, row % n);
            // Nobody reads what is left out: the caller looks at the budget next.
            let first = if budget.stop().is_some() { n } else { first };
            (first..n).filter_map(move |z| {
                let i = row * n + z;
                if body.solid[i] {
                    return None;
                }
                let near = |inside: bool, j: usize| if inside { body.group[j] } else { 0 };
                // Where two groups are touched the later one gets the contact; they are a voxel apart.
                let group = near(x > 0, i.wrapping_sub(n * n))
                    .max(near(x + 1 < n, i + n * n))
                    .max(near(y > 0, i.wrapping_sub(n)))
                    .max(near(y + 1 < n, i + n))
                    .max(near(z > 0, i.wrapping_sub(1)))
                    .max(near(z + 1 < n, i + 1));
                (group > 0).then(|| judge(volume, body, i, group)).flatten()
            })
        })
        .collect()
}

/// Judges one voxel. Sides of low objects have normals that smoothing against the top has tilted upwards, so that
/// the chord would end in the table: there the horizontal direction is tried too.
fn judge(volume: &Volume, body: &Body<'_>, index: usize, group: u16) -> Option<Contact> {
    let inward = body.outward(index)?.map(|c| -c);
    let start = volume.grid.voxel(index).map(|c| c as f32);
    let along = follow(volume, body, (index, group), start, inward, 1.0);
    let flat = inward[0].hypot(inward[1]);
    let level = (flat > FLATTENABLE && flat < 0.98).then(|| {
        let direction = [inward[0] / flat, inward[1] / flat, 0.0];
        follow(volume, body, (index, group), start, direction, flat)
    });
    match level {
        Some(level) if level.quality > along.quality => Some(level),
        _ => Some(along),
    }
}

fn follow(
    volume: &Volume,
    body: &Body<'_>,
    (index, group): (usize, u16),
    start: [f32; 3],
    inward: [f32; 3],
    trust: f32,
) -> Contact {
    let mut contact = Contact { index, group, quality: UNOPPOSED, inward, vote: None };
    let mut seen = volume.state[index] != VoxelState::Unseen;
    // A contact that presses upwards from below an overhang is rarely reachable.
    contact.quality *= 1.0 - 0.5 * inward[2].max(0.0);
    if let Some(chord) = body.chord(start, inward) {
        let opposed = trust * ramp(chord.opposition, 0.6, 0.9);
        let length_m = chord.length * volume.grid.voxel_m() as f32;
        let reach = 1.0 - 0.5 * ramp(length_m, EASY_CHORD_M, MAX_CHORD_M);
        let quality = opposed * (0.4 + 0.6 * chord.room) * reach * (1.0 - 0.4 * inward[2] * inward[2]);
        contact.quality += (1.0 - UNOPPOSED) * quality;
        seen &= chord.exit_seen;
        if quality > 0.0 {
            let middle = std::array::from_fn(|a| 0.5 * (start[a] + chord.exit[a]));
            contact.vote = Some((middle, quality));
        }
    }
    if !seen {
        contact.quality *= UNSEEN;
    }
    contact
}

/// 0 below `low`, 1 above `high`, linear between.
fn ramp(value: f32, low: f32, high: f32) -> f32 {
    ((value - low) / (high - low)).clamp(0.0, 1.0)
}

/// Smooths quality and direction along the surface, carries both to a second shell of voxels, and scales so that
/// the best contact has certainty 1. The best contact of every object that stands out of the table has nearly as
/// much, so that the refinement's threshold, a share of the maximum, leaves each object its contacts.
///
/// What is left when the budget ends is left out: the caller looks at it next.
fn spread(
    field: &mut ContactField,
    contacts: &[Contact],
    extents: &[Extent],
    solid: &[bool],
    floor: usize,
    budget: &dyn Budget,
) {
    let grid = field.grid;
    let n = grid.resolution;
    // Number of the contact at each voxel, plus one.
    let mut slot = vec![0u32; grid.len()];
    for (k, c) in contacts.iter().enumerate() {
        slot[c.index] = k as u32 + 1;
    }
    let mut reached = vec![false; grid.len()];
    let mut second = Vec::new();
    for c in contacts {
        let [x, y, z] = grid.voxel(c.index);
        let mut visit = |inside: bool, i: usize| {
            if inside && slot[i] == 0 && !solid[i] && !std::mem::replace(&mut reached[i], true) {
                second.push((i, c.group));
            }
        };
        visit(x > 0, c.index.wrapping_sub(n * n));
        visit(x + 1 < n, c.index + n * n);
        visit(y > 0, c.index.wrapping_sub(n));
        visit(y + 1 < n, c.index + n);
        visit(z > floor, c.index.wrapping_sub(1));
        visit(z + 1 < n, c.index + 1);
    }
    let shells: Vec<(usize, u16, f32)> = contacts
        .iter()
        .map(|c| (c.index, c.group, 1.0))
        .chain(second.into_iter().map(|(i, group)| (i, group, SECOND_SHELL)))
        .collect();
    let blended = |&(i, _, distance): &(usize, u16, f32)| match budget.stop() {
        None => blend(&grid, &slot, contacts, i, distance),
        Some(_) => (0.0, [0.0; 3]),
    };
    let values: Vec<(f32, [f32; 3])> = shells.par_iter().map(blended).collect();
    if budget.stop().is_some() {
        return;
    }
    let mut largest = vec![0.0f32; extents.len() + 1];
    for (&(_, group, _), &(certainty, _)) in shells.iter().zip(&values) {
        let own = &mut largest[usize::from(group)];
        *own = own.max(certainty);
    }
    let overall = largest.iter().copied().fold(0.0, f32::max);
    if overall <= 0.0 {
        return;
    }
    for (own, extent) in largest.iter_mut().skip(1).zip(extents) {
        *own = if extent.stands_out() { own.max(MIN_SCALE * overall) } else { overall };
    }
    for (&(i, group, _), (certainty, inward)) in shells.iter().zip(values) {
        field.certainty[i] = certainty / largest[usize::from(group)];
        field.inward[i] = inward;
    }
}

/// Mean quality, times `distance`, and direction of the contacts among a voxel and its 26 neighbours, with weights
/// 1 2 1 along each axis.
fn blend(grid: &Grid, slot: &[u32], contacts: &[Contact], i: usize, distance: f32) -> (f32, [f32; 3]) {
    let n = grid.resolution;
    let [x, y, z] = grid.voxel(i);
    let (mut count, mut quality, mut sum) = (0.0, 0.0, [0.0f32; 3]);
    let around = |c: usize| c.saturating_sub(1)..(c + 2).min(n);
    for a in around(x) {
        for b in around(y) {
            for c in around(z) {
                let Some(k) = slot[grid.index(a, b, c)].checked_sub(1) else { continue };
                let contact = &contacts[k as usize];
                let off = a.abs_diff(x) + b.abs_diff(y) + c.abs_diff(z);
                let w = [8.0, 4.0, 2.0, 1.0][off];
                count += w;
                quality += w * contact.quality;
                for (s, d) in sum.iter_mut().zip(contact.inward) {
                    *s += w * contact.quality * d;
                }
            }
        }
    }
    let norm = (sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]).sqrt();
    if norm > 1e-6 { (distance * quality / count, sum.map(|s| s / norm)) } else { (0.0, [0.0; 3]) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::budget::Unlimited;

    /// A table at 0.1 m, and on it what `object` says of voxel (x, y) counted from the cube's middle, up to so
    /// many layers.
    fn estimate(object: impl Fn(f32, f32) -> usize) -> (Grid, ContactField) {
        let grid = Grid::default();
        let n = grid.resolution;
        let middle = 0.5 * (n as f32 - 1.0);
        let solid: Vec<bool> = (0..grid.len())
            .map(|i| {
                let [x, y, z] = grid.voxel(i);
                z < 20 || z < 20 + object(x as f32 - middle, y as f32 - middle)
            })
            .collect();
        let volume = Volume::from_solid(grid, Some(0.1), &solid);
        (grid, Geometric.estimate(&volume, &Unlimited).unwrap())
    }

    /// Largest value of `field` within `reach` voxels of (x, y), counted from the cube's middle.
    fn best(grid: &Grid, field: &[f32], (x, y): (f32, f32), reach: f32) -> f32 {
        let middle = 0.5 * (grid.resolution as f32 - 1.0);
        let near = |i: &usize| {
            let v = grid.voxel(*i).map(|c| c as f32 - middle);
            (v[0] - x).hypot(v[1] - y) <= reach
        };
        (0..grid.len()).filter(near).map(|i| field[i]).fold(0.0, f32::max)
    }

    #[test]
    fn a_nut_is_held_from_outside_although_it_has_a_hole() {
        // 34 mm across, a hole of 18 mm, 20 mm high.
        let (grid, field) = estimate(|x, y| if (1.8..3.5).contains(&x.hypot(y)) { 4 } else { 0 });
        assert_eq!(best(&grid, &field.centroid, (0.0, 0.0), 1.2), 1.0, "the middle of the hole");
        let outside = (0..grid.len())
            .filter(|&i| {
                let v = grid.voxel(i).map(|c| c as f32 - 39.5);
                v[0].hypot(v[1]) > 3.5 && field.certainty[i] > 0.7
            })
            .count();
        assert!(outside >= 20, "{outside} focal contacts outside");
    }

    #[test]
    fn a_small_object_keeps_contacts_and_centroid_beside_a_large_one() {
        let (grid, field) = estimate(|x, y| {
            if (x + 15.0).abs() < 5.0 && y.abs() < 10.0 {
                16
            } else if (x - 15.0).hypot(y) < 2.1 {
                3
            } else {
                0
            }
        });
        for at in [(-15.0, 0.0), (15.0, 0.0)] {
            assert_eq!(best(&grid, &field.centroid, at, 3.0), 1.0, "{at:?}");
            assert!(best(&grid, &field.certainty, at, 8.0) > 0.7, "{at:?}");
        }
        assert_eq!(best(&grid, &field.centroid, (0.0, 30.0), 8.0), 0.0);
    }
}
