//! Volumes that follow something: part of a volume as a volume of its own, and a volume that is moved without forgetting
//! what it keeps in view.

use nalgebra::{Translation3, Vector3};

use super::{Labels, Volume, VoxelState};
use crate::grid::Grid;
use crate::options::Region;

impl Volume {
    /// Copies the cube of `out.grid.resolution` voxels whose lowest voxel is `low` into `out`; what of it lies outside
    /// this volume is unseen. Table and region go with it, in the frame of the part; the edge of its voxels must be that
    /// of this volume. Does not allocate, but for labels.
    pub fn copy_part(&self, low: [usize; 3], out: &mut Self) {
        let (n, m) = (self.grid.resolution, out.grid.resolution);
        let offset = self.grid.voxel_m() * Vector3::from(low.map(|l| l as f64));
        out.kind = self.kind;
        out.region = self.region.map(|region| moved(&region, &-offset));
        out.table_m = self.table_m.map(|t| t - offset.z).filter(|t| (0.0..out.grid.size_m).contains(t));
        for i in 0..m * m {
            let (x, y) = (low[0] + i / m, low[1] + i % m);
            let to = i * m;
            let deep = if x < n && y < n { n.saturating_sub(low[2]).min(m) } else { 0 };
            if deep > 0 {
                let from = self.grid.index(x, y, low[2]);
                out.state[to..to + deep].copy_from_slice(&self.state[from..from + deep]);
                out.tsdf[to..to + deep].copy_from_slice(&self.tsdf[from..from + deep]);
                out.weight[to..to + deep].copy_from_slice(&self.weight[from..from + deep]);
            }
            out.state[to + deep..to + m].fill(VoxelState::Unseen);
            out.tsdf[to + deep..to + m].fill(0.0);
            out.weight[to + deep..to + m].fill(0);
        }
        out.labels = self.labels.as_ref().map(|labels| {
            let mut part = Labels { label: vec![0; out.grid.len()], votes: vec![0; out.grid.len()] };
            for i in 0..out.grid.len() {
                let [x, y, z] = out.grid.voxel(i);
                let at = [low[0] + x, low[1] + y, low[2] + z];
                if at.iter().all(|&c| c < n) {
                    let from = self.grid.index(at[0], at[1], at[2]);
                    (part.label[i], part.votes[i]) = (labels.label[from], labels.votes[from]);
                }
            }
            part
        });
    }

    /// The volume moved by whole voxels: what was at voxel `v + by` is at voxel `v` now. What both places have in common
    /// keeps everything that was learned; the rest is unseen. The region stays where it is in the world, and so does the
    /// table while it is in the cube.
    pub fn shift(&mut self, by: [isize; 3]) {
        if by == [0; 3] {
            return;
        }
        let n = self.grid.resolution;
        let source = |grid: &Grid, i: usize| {
            let voxel = grid.voxel(i);
            let mut at = [0; 3];
            for a in 0..3 {
                at[a] = voxel[a].checked_add_signed(by[a]).filter(|&c| c < n)?;
            }
            Some(grid.index(at[0], at[1], at[2]))
        };
        let mut moved_to = Self::empty(self.grid, None);
        moved_to.kind = self.kind;
        let offset = self.grid.voxel_m() * Vector3::from(by.map(|b| b as f64));
        moved_to.region = self.region.map(|region| moved(&region, &-offset));
        moved_to.table_m = self.table_m.map(|t| t - offset.z).filter(|t| (0.0..self.grid.size_m).contains(t));
        moved_to.labels = self
            .labels
            .as_ref()
            .map(|_| Labels { label: vec![0; self.grid.len()], votes: vec![0; self.grid.len()] });
        for i in 0..self.grid.len() {
            let Some(from) = source(&self.grid, i) else { continue };
            moved_to.state[i] = self.state[from];
            moved_to.tsdf[i] = self.tsdf[from];
            moved_to.weight[i] = self.weight[from];
            if let (Some(to), Some(labels)) = (&mut moved_to.labels, &self.labels) {
                (to.label[i], to.votes[i]) = (labels.label[from], labels.votes[from]);
            }
        }
        *self = moved_to;
    }
}

/// A region whose frame of reference has moved.
fn moved(region: &Region, by: &Vector3<f64>) -> Region {
    Region { world_from_box: Translation3::from(*by) * region.world_from_box, ..*region }
}

#[cfg(test)]
mod tests {
    use nalgebra::Isometry3;

    use super::*;

    /// A volume of which every voxel says where it is.
    fn numbered(n: usize) -> Volume {
        let grid = Grid { resolution: n, size_m: 0.01 * n as f64 };
        let mut volume = Volume::empty(grid, Some(0.025));
        for i in 0..grid.len() {
            volume.tsdf[i] = i as f32;
            volume.weight[i] = 1 + (i % 7) as u16;
            volume.state[i] = if i % 3 == 0 { VoxelState::Surface } else { VoxelState::Free };
        }
        volume.region = Some(Region {
            world_from_box: Isometry3::translation(0.05, 0.05, 0.05),
            half_extents_m: Vector3::repeat(0.02),
        });
        volume
    }

    #[test]
    fn moving_there_and_back_keeps_what_stayed_in_view() {
        let whole = numbered(10);
        let mut volume = whole.clone();
        volume.shift([3, -2, 1]);
        assert_eq!(volume.tsdf[volume.grid.index(0, 2, 0)], whole.tsdf[whole.grid.index(3, 0, 1)]);
        assert_eq!(volume.state[volume.grid.index(0, 0, 0)], VoxelState::Unseen, "nothing was known there");
        assert!((volume.table_m.unwrap() - 0.015).abs() < 1e-12);
        let region = volume.region.unwrap().world_from_box.translation.vector;
        assert!(
            (region - Vector3::new(0.02, 0.07, 0.04)).norm() < 1e-12,
            "the region stands still: {region}"
        );
        volume.shift([-3, 2, -1]);
        for i in 0..whole.grid.len() {
            let [x, y, z] = whole.grid.voxel(i);
            if x >= 3 && y < 8 && z >= 1 {
                assert_eq!((volume.tsdf[i], volume.weight[i]), (whole.tsdf[i], whole.weight[i]));
            } else {
                assert_eq!((volume.state[i], volume.weight[i]), (VoxelState::Unseen, 0));
            }
        }
    }

    #[test]
    fn a_part_is_what_the_whole_says_and_unseen_beyond_it() {
        let whole = numbered(10);
        let mut part = Volume::empty(Grid { resolution: 6, size_m: 0.06 }, None);
        // Memory of another part, to be overwritten.
        part.tsdf.fill(-7.0);
        whole.copy_part([5, 2, 1], &mut part);
        for i in 0..part.grid.len() {
            let [x, y, z] = part.grid.voxel(i);
            if x < 5 {
                let from = whole.grid.index(5 + x, 2 + y, 1 + z);
                assert_eq!((part.tsdf[i], part.state[i]), (whole.tsdf[from], whole.state[from]));
            } else {
                assert_eq!((part.tsdf[i], part.state[i], part.weight[i]), (0.0, VoxelState::Unseen, 0));
            }
        }
        assert!((part.table_m.unwrap() - 0.015).abs() < 1e-12);
        assert!(part.region.unwrap().contains(&nalgebra::Point3::new(0.0, 0.03, 0.04)));
    }
}
