//! Antipodal chords: from a contact straight through the object to a surface that faces the other way.

use crate::grid::Grid;
use crate::volume::VoxelState;

/// Longest chord that any hand of interest spans, metres.
pub(super) const MAX_CHORD_M: f32 = 0.16;
/// Room that a finger wants on the far side and at the contact, voxels.
const FINGER_VOXELS: usize = 4;
/// A gap of this width and less is too narrow for a finger, voxels.
const GAP_VOXELS: f32 = 4.5;
/// Step of the march, voxels.
const STEP: f32 = 0.7;

/// A chord through an object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Chord {
    /// Where it leaves the object on the far side, voxel units.
    pub(super) exit: [f32; 3],
    /// Its length, voxels.
    pub(super) length: f32,
    /// Cosine between the direction of the chord and the outward normal at the exit.
    pub(super) opposition: f32,
    /// Free share of the finger's room at the worse of both ends, 0 to 1.
    pub(super) room: f32,
    /// Whether a frame has seen the far side to be free.
    pub(super) exit_seen: bool,
}

/// What the march looks at; positions are in voxel units, voxel (i, j, k) being centred at (i, j, k).
pub(super) struct Body<'a> {
    pub(super) grid: &'a Grid,
    /// Connected group of object voxels that each voxel belongs to, 0 for none; extended below the table.
    pub(super) group: &'a [u16],
    /// Everything that a finger must not enter.
    pub(super) solid: &'a [bool],
    /// What is known of each voxel.
    pub(super) state: &'a [VoxelState],
    /// Smoothed occupancy by objects, 0 to 1.
    pub(super) density: &'a [f32],
    /// First layer above the table.
    pub(super) floor: usize,
}

impl Body<'_> {
    /// Memory position of the nearest voxel, `None` outside the grid.
    #[inline]
    pub(super) fn at(&self, p: [f32; 3]) -> Option<usize> {
        let n = self.grid.resolution as f32;
        let [x, y, z] = p.map(|c| (c + 0.5).floor());
        (x >= 0.0 && y >= 0.0 && z >= 0.0 && x < n && y < n && z < n)
            .then(|| self.grid.index(x as usize, y as usize, z as usize))
    }

    /// Outward normal at a voxel: down the smoothed density. `None` where the density is flat.
    #[inline]
    pub(super) fn outward(&self, i: usize) -> Option<[f32; 3]> {
        let n = self.grid.resolution;
        let [x, y, z] = self.grid.voxel(i);
        let d = self.density;
        let difference = |at: usize, stride: usize| {
            let low = if at > 0 { d[i - stride] } else { d[i] };
            let high = if at + 1 < n { d[i + stride] } else { d[i] };
            low - high
        };
        let g = [difference(x, n * n), difference(y, n), difference(z, 1)];
        let norm = (g[0] * g[0] + g[1] * g[1] + g[2] * g[2]).sqrt();
        (norm > 1e-3).then(|| g.map(|c| c / norm))
    }

    /// Follows `inward` from a contact voxel; `None` when it meets no object within two voxels, does not leave it
    /// within [`MAX_CHORD_M`], or leaves it into the table.
    ///
    /// A gap in the object that is too narrow for a finger (the hole of a nut, a notch) is no way out: the chord
    /// goes on to the far side, if that can be closed on.
    pub(super) fn chord(&self, start: [f32; 3], inward: [f32; 3]) -> Option<Chord> {
        let limit = MAX_CHORD_M / self.grid.voxel_m() as f32;
        let point = |t: f32| -> [f32; 3] { std::array::from_fn(|a| start[a] + t * inward[a]) };
        let mut inside = None;
        let mut nearer = None;
        let mut t = STEP;
        while t <= limit {
            let p = point(t);
            let Some(i) = self.at(p) else { return nearer };
            if self.group[i] > 0 {
                inside = Some(i);
            } else if let Some(last) = inside {
                if i % self.grid.resolution < self.floor || self.solid[i] {
                    return nearer;
                }
                let exit = self.exit(start, inward, t, last, i);
                let across = (1..=(GAP_VOXELS / STEP) as usize)
                    .map(|k| t + k as f32 * STEP)
                    .find(|&t| self.at(point(t)).is_some_and(|j| self.group[j] == self.group[last]));
                match across {
                    Some(far) => {
                        nearer = exit.or(nearer);
                        t = far;
                        continue;
                    }
                    None => return exit.or(nearer),
                }
            } else if t > 2.5 {
                return None;
            }
            t += STEP;
        }
        nearer
    }

    /// The chord that ends after `t`, between the voxel `inside` the object and the voxel `outside`.
    fn exit(
        &self,
        start: [f32; 3],
        inward: [f32; 3],
        t: f32,
        inside: usize,
        outside: usize,
    ) -> Option<Chord> {
        let p: [f32; 3] = std::array::from_fn(|a| start[a] + t * inward[a]);
        // The normal at the exit is steadier half way between the last voxel inside and the first outside.
        let mut normal: [f32; 3] = match (self.outward(inside), self.outward(outside)) {
            (Some(a), Some(b)) => std::array::from_fn(|k| a[k] + b[k]),
            (Some(n), None) | (None, Some(n)) => n,
            (None, None) => return None,
        };
        // A horizontal chord asks how the far side stands in the horizontal plane only.
        if inward[2] == 0.0 && normal[0].hypot(normal[1]) > 0.5 * normal[2].abs() {
            normal[2] = 0.0;
        }
        let norm = normal.iter().map(|c| c * c).sum::<f32>().sqrt();
        let along: f32 = (0..3).map(|k| normal[k] * inward[k]).sum();
        let room = self.room(p, inward).min(self.room(start, inward.map(|c| -c)));
        let opposition = if norm > 1e-6 { along / norm } else { 0.0 };
        let exit_seen = self.state[outside] == VoxelState::Free;
        Some(Chord { exit: p, length: t, opposition, room, exit_seen })
    }

    /// Share of the finger's room beyond `p` that is not solid; outside the cube counts as free.
    fn room(&self, p: [f32; 3], outward: [f32; 3]) -> f32 {
        let free = (0..FINGER_VOXELS)
            .take_while(|&k| {
                let q = std::array::from_fn(|a| p[a] + k as f32 * outward[a]);
                self.at(q).is_none_or(|i| !self.solid[i])
            })
            .count();
        free as f32 / FINGER_VOXELS as f32
    }
}
