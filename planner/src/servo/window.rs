//! The part of the world that is looked at anew with every frame: a small cube about the target, cut out of the volume that
//! remembers everything.
//!
//! Contact estimation, distance fields and clustering cost as much as they have voxels. A window of 56 voxels holds a hand
//! about an object, at a third of the cost of 80.

use nalgebra::{Isometry3, Point3, Translation3, Vector3};

use crate::budget::Budget;
use crate::estimator::ContactEstimator;
use crate::grid::Grid;
use crate::options::SceneOptions;
use crate::scene::{self, Scene, SceneError};
use crate::volume::{View, Volume};
use crate::workspace::Workspace;

/// A target this far from the window's middle moves the window, voxels.
const HYSTERESIS: f64 = 5.0;
/// Layers below the table top that are in the window.
const BELOW_TABLE: usize = 3;
/// A window this far beyond the volume moves the volume, voxels.
const OVERHANG: isize = 6;

/// The volume that remembers, and the window in it.
#[derive(Debug)]
pub(super) struct Memory {
    /// Everything that was seen.
    pub(super) volume: Volume,
    /// Where it stands.
    pub(super) world_from_volume: Isometry3<f64>,
    /// Lowest voxel of the window.
    low: [usize; 3],
    is_placed: bool,
    resolution: usize,
    /// Memory of the next window.
    spare: Option<Volume>,
    /// Times that the volume was moved.
    pub(super) moves: u64,
}

impl Memory {
    pub(super) fn new(volume: Volume, world_from_volume: Isometry3<f64>, window_voxels: usize) -> Self {
        let resolution = window_voxels.min(volume.grid.resolution);
        Self { volume, world_from_volume, low: [0; 3], is_placed: false, resolution, spare: None, moves: 0 }
    }

    /// Pose of the window in the world.
    pub(super) fn world_from_window(&self) -> Isometry3<f64> {
        let low = Vector3::from(self.low.map(|l| l as f64 * self.volume.grid.voxel_m()));
        self.world_from_volume * Translation3::from(low)
    }

    /// Puts the window about a target; where that is beyond the volume, moves the volume, which keeps what stays in it.
    pub(super) fn place(&mut self, target: &Point3<f64>) {
        let wanted = self.wanted(target);
        let room = (self.volume.grid.resolution - self.resolution) as isize;
        let beyond = wanted.map(|w| {
            if w < -OVERHANG {
                w
            } else if w > room + OVERHANG {
                w - room
            } else {
                0
            }
        });
        // Upwards the volume stays on its table.
        let by = [beyond[0], beyond[1], if self.volume.table_m.is_some() { 0 } else { beyond[2] }];
        if by != [0; 3] {
            self.volume.shift(by);
            let offset = Vector3::from(by.map(|b| b as f64 * self.volume.grid.voxel_m()));
            self.world_from_volume *= Translation3::from(offset);
            self.moves += 1;
            self.is_placed = false;
        }
        let wanted = self.wanted(target);
        let clamped = wanted.map(|w| w.clamp(0, room) as usize);
        let is_off = (0..3).any(|a| (clamped[a] as f64 - self.low[a] as f64).abs() > HYSTERESIS);
        if !self.is_placed || is_off {
            self.low = clamped;
            self.is_placed = true;
        }
    }

    /// Lowest voxel of a window about a target, which may lie outside the volume: in height it begins below the table.
    fn wanted(&self, target: &Point3<f64>) -> [isize; 3] {
        let at = self.world_from_volume.inverse_transform_point(target);
        let half = 0.5 * self.resolution as f64;
        let mut low = [0, 1, 2].map(|a| (at[a] / self.volume.grid.voxel_m() - half).round() as isize);
        if self.volume.table_m.is_some() {
            let floor = self.volume.table_layer().saturating_sub(BELOW_TABLE) as isize;
            // A target high above its table is looked at around itself.
            low[2] = low[2].max(floor);
            if at.z / self.volume.grid.voxel_m() < floor as f64 + 0.75 * self.resolution as f64 {
                low[2] = floor;
            }
        }
        low
    }

    /// The features of the window.
    pub(super) fn read(
        &mut self,
        view: &View<'_>,
        world_from_camera: &Isometry3<f64>,
        options: &SceneOptions,
        estimator: &dyn ContactEstimator,
        budget: &dyn Budget,
    ) -> Result<Scene, SceneError> {
        let whole = self.volume.grid;
        let grid = Grid { resolution: self.resolution, size_m: whole.voxel_m() * self.resolution as f64 };
        let mut part = self.spare.take().unwrap_or_else(|| Volume::empty(grid, None));
        self.volume.copy_part(self.low, &mut part);
        let workspace =
            Workspace { world_from_volume: self.world_from_window(), grid, table_m: part.table_m };
        let world_from_window = workspace.world_from_volume;
        let view = View { camera_from_volume: world_from_camera.inverse() * world_from_window, ..*view };
        scene::of_volume(part, &[view], &workspace, world_from_camera, options, estimator, budget)
    }

    /// The features of the whole volume.
    pub(super) fn read_whole(
        &self,
        view: &View<'_>,
        world_from_camera: &Isometry3<f64>,
        options: &SceneOptions,
        estimator: &dyn ContactEstimator,
        budget: &dyn Budget,
    ) -> Result<Scene, SceneError> {
        let Volume { grid, table_m, .. } = self.volume;
        let workspace = Workspace { world_from_volume: self.world_from_volume, grid, table_m };
        let volume = self.volume.clone();
        scene::of_volume(volume, &[*view], &workspace, world_from_camera, options, estimator, budget)
    }

    /// Gives the memory of a window back for the next one.
    pub(super) fn recycle(&mut self, scene: Scene) {
        self.spare = Some(scene.volume);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_window_follows_with_hysteresis_and_moves_the_volume_at_its_border() {
        let volume = Volume::empty(Grid::default(), Some(0.1));
        let mut memory = Memory::new(volume, Isometry3::translation(-0.2, -0.2, -0.1), 56);
        memory.place(&Point3::new(0.0, 0.0, 0.05));
        let first = memory.world_from_window();
        let corner = first.translation.vector;
        assert!((corner.x + 0.14).abs() < 0.003 && (corner.z + 0.015).abs() < 1e-9, "{corner}");
        memory.place(&Point3::new(0.012, 0.0, 0.05));
        assert_eq!(memory.world_from_window(), first, "a little does not move it");
        memory.place(&Point3::new(0.04, 0.0, 0.05));
        assert!((memory.world_from_window().translation.x + 0.1).abs() < 0.003);
        assert_eq!(memory.moves, 0);
        // Where the target stands 0.35 m from the middle, the volume has to go there.
        memory.place(&Point3::new(0.35, 0.0, 0.05));
        assert_eq!(memory.moves, 1);
        let window = memory.world_from_window().translation.vector;
        assert!((window.x + 0.14 - 0.35).abs() < 0.003, "{window}");
        assert_eq!(memory.volume.table_m, Some(0.1), "it stays on its table");
    }
}
