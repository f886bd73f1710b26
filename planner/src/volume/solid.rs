//! What a hand must not enter: the observed surfaces, completed downwards to the table.
//!
//! The paper's occupancy takes everything unseen as occupied; that is right for a network that was trained so,
//! and stays its input. As collision geometry it would forbid every finger behind an object, because the
//! shadow of an object seen from one side reaches to the volume's wall. Objects rest on the table, so here the
//! unseen below an observed surface, in the same column, belongs to the object; the rest of the shadow is
//! unknown, not solid. A caller who wants the cautious reading asks for an occupancy volume. There the shadows are
//! solid, but still no objects: nothing says that there is something to hold on to.

use rayon::prelude::*;

use super::{Volume, VoxelState};
use crate::budget::{Budget, Unlimited};
use crate::options::VolumeKind;

/// Groups of connected object voxels smaller than this are sensor noise.
pub const MIN_OBJECT_VOXELS: usize = 20;

/// An unseen voxel with solid ones at most this far away on all four sides lies in a hole of the depth image that
/// an object encloses (a mirroring or dark patch), voxels. What has no return at all has no such sides: it stays
/// unknown.
pub const PIT_VOXELS: usize = 5;

impl Volume {
    /// Solid voxels, memory order. Of an occupancy volume everything that was not seen to be free, as the paper's
    /// "Voxel" has it, but for the thin streaks that single pixels without a return leave. Of a TSDF: observed
    /// surfaces, unseen voxels below an observed object surface in the same column down to the table (or to the
    /// first voxel seen to be free), unseen gaps of one or two voxels between such voxels along x or y and wider
    /// ones between four of them (see [`PIT_VOXELS`]), and everything below the table top.
    pub fn solid(&self) -> Vec<bool> {
        self.solid_within(&Unlimited)
    }

    /// [`Volume::solid`], which leaves out what is left when the budget ends: whoever calls looks at it next.
    pub(crate) fn solid_within(&self, budget: &dyn Budget) -> Vec<bool> {
        let mut solid = self.completed(budget);
        if self.kind == VolumeKind::Occupancy {
            for (i, (solid, state)) in solid.iter_mut().zip(&self.state).enumerate() {
                *solid |= *state != VoxelState::Free && !self.is_streak(i);
            }
        }
        solid
    }

    /// True for an unseen voxel of a sheet or streak no thicker than two voxels with seen free space on both sides.
    ///
    /// A pixel without a return leaves its whole ray unseen, from the camera on, and the edges of objects are
    /// full of such pixels: without this, every object of an occupancy volume would stand between walls of one voxel.
    fn is_streak(&self, i: usize) -> bool {
        if self.state[i] != VoxelState::Unseen {
            return false;
        }
        let n = self.grid.resolution;
        let voxel = self.grid.voxel(i);
        (0..3).any(|axis| {
            let stride = [n * n, n, 1][axis];
            let at = voxel[axis];
            let below = |k: usize| at >= k && self.state[i - k * stride] == VoxelState::Free;
            let above = |k: usize| at + k < n && self.state[i + k * stride] == VoxelState::Free;
            (below(1) && (above(1) || above(2))) || (below(2) && above(1))
        })
    }

    /// What was seen, completed downwards: [`Volume::solid`] of a TSDF, whatever the kind.
    fn completed(&self, budget: &dyn Budget) -> Vec<bool> {
        let n = self.grid.resolution;
        let floor = self.table_layer();
        let mut solid = vec![false; self.grid.len()];
        if n == 0 {
            return solid;
        }
        solid.par_chunks_mut(n).zip(self.state.par_chunks(n)).for_each(|(solid, state)| {
            let mut covered = false;
            for z in (0..n).rev() {
                if z < floor {
                    solid[z] = true;
                    continue;
                }
                match state[z] {
                    VoxelState::Surface => {
                        solid[z] = true;
                        covered = true;
                    }
                    VoxelState::Free => covered = false,
                    VoxelState::Unseen => solid[z] = covered,
                }
            }
        });
        self.without_pits(&solid, budget)
    }

    /// A surface with a hole of few pixels would leave a shaft down to the table in the middle of an object, with
    /// walls that look like places to grasp. No finger fits there: unseen voxels that are narrowly enclosed on
    /// opposite sides are filled.
    fn without_pits(&self, solid: &[bool], budget: &dyn Budget) -> Vec<bool> {
        let n = self.grid.resolution;
        let mut filled = solid.to_vec();
        let blank = vec![false; n];
        let line = |x: Option<usize>, y: Option<usize>| match (x, y) {
            (Some(x), Some(y)) if x < n && y < n => &solid[(x * n + y) * n..][..n],
            _ => &blank[..],
        };
        let columns = filled.par_chunks_mut(n).zip(self.state.par_chunks(n)).enumerate();
        columns.for_each_init(
            || vec![0u8; n],
            |sides, (row, (out, state))| {
                if budget.stop().is_some() {
                    return;
                }
                let (x, y) = (row / n, row % n);
                // Distances to both sides of gaps of one and of two voxels.
                for (a, b) in [(1, 1), (1, 2), (2, 1)] {
                    let along_x = (line(x.checked_sub(a), Some(y)), line(Some(x + b), Some(y)));
                    let along_y = (line(Some(x), y.checked_sub(a)), line(Some(x), Some(y + b)));
                    for (low, high) in [along_x, along_y] {
                        for z in 0..n {
                            out[z] |= state[z] == VoxelState::Unseen && low[z] && high[z];
                        }
                    }
                }
                if !state.iter().zip(&out[..]).any(|(&s, &o)| s == VoxelState::Unseen && !o) {
                    return;
                }
                // Bit by bit the sides on which there is something near.
                sides.fill(0);
                for k in 1..=PIT_VOXELS {
                    let around = [
                        line(x.checked_sub(k), Some(y)),
                        line(Some(x + k), Some(y)),
                        line(Some(x), y.checked_sub(k)),
                        line(Some(x), Some(y + k)),
                    ];
                    for (bit, near) in around.into_iter().enumerate() {
                        for (sides, &near) in sides.iter_mut().zip(near) {
                            *sides |= u8::from(near) << bit;
                        }
                    }
                }
                for ((out, &sides), &state) in out.iter_mut().zip(&*sides).zip(state) {
                    *out |= sides == 0b1111 && state == VoxelState::Unseen;
                }
            },
        );
        filled
    }

    /// Adds unseen voxels that lie, in a layer of one or two, between an object and seen free space beside it: in an
    /// occupancy volume they are solid, and the object reaches as far as them.
    fn with_skin(&self, object: Vec<bool>) -> Vec<bool> {
        let n = self.grid.resolution;
        let first = self.first_object_layer();
        let mut out = object.clone();
        for i in (0..object.len()).filter(|&i| i % n >= first && self.state[i] == VoxelState::Unseen) {
            let voxel = self.grid.voxel(i);
            out[i] |= (0..2).any(|axis| {
                let stride = [n * n, n][axis];
                let at = voxel[axis];
                let low = |k: usize| (at >= k).then(|| i - k * stride);
                let high = |k: usize| (at + k < n).then(|| i + k * stride);
                let is = |j: Option<usize>| j.is_some_and(|j| object[j]);
                let free = |j: Option<usize>| j.is_some_and(|j| self.state[j] == VoxelState::Free);
                (is(low(1)) && (free(high(1)) || free(high(2))))
                    || (is(high(1)) && (free(low(1)) || free(low(2))))
                    || (is(low(2)) && free(high(1)))
                    || (is(high(2)) && free(low(1)))
            });
        }
        out
    }

    /// The part of `solid` that belongs to objects, see [`Volume::object_groups`].
    pub fn objects(&self, solid: &[bool]) -> Vec<bool> {
        self.object_groups(solid).iter().map(|&g| g > 0).collect()
    }

    /// What `solid` has of objects: inside the region, at least one voxel above the table top, in connected groups
    /// (over faces) of at least [`MIN_OBJECT_VOXELS`]. Without a table: all such groups. The number of its group for each voxel,
    /// counted from 1; 0 for voxels of no object. Objects that touch share a group.
    ///
    /// The shadows of an occupancy volume are solid but no objects: there the groups are those of what was seen,
    /// completed downwards as in a TSDF, with the unseen layer of one or two voxels that its noisy edges leave.
    pub fn object_groups(&self, solid: &[bool]) -> Vec<u16> {
        let n = self.grid.resolution;
        let first = self.first_object_layer();
        let mut open = if self.kind == VolumeKind::Occupancy {
            self.with_skin(self.completed(&Unlimited))
        } else {
            solid.to_vec()
        };
        for column in open.chunks_mut(n.max(1)) {
            column[..first].fill(false);
        }
        if let Some(region) = &self.region {
            for (i, open) in open.iter_mut().enumerate().filter(|(_, open)| **open) {
                *open = region.contains(&self.grid.center(self.grid.voxel(i)));
            }
        }
        let mut groups = vec![0u16; open.len()];
        let mut last = 0u16;
        let mut group = Vec::new();
        for seed in 0..open.len() {
            if !open[seed] {
                continue;
            }
            open[seed] = false;
            group.clear();
            group.push(seed);
            let mut next = 0;
            while next < group.len() {
                let i = group[next];
                next += 1;
                let [x, y, z] = self.grid.voxel(i);
                let mut visit = |inside: bool, j: usize| {
                    if inside && open[j] {
                        open[j] = false;
                        group.push(j);
                    }
                };
                visit(x > 0, i.wrapping_sub(n * n));
                visit(x + 1 < n, i + n * n);
                visit(y > 0, i.wrapping_sub(n));
                visit(y + 1 < n, i + n);
                visit(z > 0, i.wrapping_sub(1));
                visit(z + 1 < n, i + 1);
            }
            if group.len() >= MIN_OBJECT_VOXELS {
                last = last.saturating_add(1);
                for &i in &group {
                    groups[i] = last;
                }
            }
        }
        groups
    }

    /// Number of whole layers below the table top: the voxels whose centre is under it.
    pub(crate) fn table_layer(&self) -> usize {
        self.table_m.map_or(0, |t| {
            ((t / self.grid.voxel_m() - 0.5).ceil().max(0.0) as usize).min(self.grid.resolution)
        })
    }

    /// First layer whose voxel centres are at least one voxel above the table top.
    pub(crate) fn first_object_layer(&self) -> usize {
        self.table_m.map_or(0, |t| {
            ((t / self.grid.voxel_m() + 0.5).ceil().max(0.0) as usize).min(self.grid.resolution)
        })
    }
}
