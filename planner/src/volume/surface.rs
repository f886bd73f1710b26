//! Where the surface lies within the voxels at it: how much of each is filled.
//!
//! A voxel is solid or not by its centre, so a surface made of whole voxels is off by up to half of one, and the flank of
//! a ball becomes a wall with a roof. Things of a few centimetres are only a few voxels wide: where fingers meet them,
//! and which way the surface faces there, is decided within the voxel. The depth images know more than the centres do,
//! so the voxels at the surface are looked at again, at several points each.

use nalgebra::{Isometry3, Point3, Vector3};
use rayon::prelude::*;

use super::{TRUNCATION_VOXELS, Volume, VoxelState};
use crate::budget::{Budget, Unlimited};
use crate::frame::Frame;

/// Points along each edge of a voxel.
const PER_EDGE: usize = 2;

/// A frame as the volume saw it.
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    /// The frame; it must have passed [`Frame::validate`].
    pub frame: &'a Frame,
    /// Its cleaned depth image, metres, 0 for holes; one of another size shows nothing.
    pub depth: &'a [f32],
    /// Pose of the volume in the camera's frame.
    pub camera_from_volume: Isometry3<f64>,
}

/// A voxel at the surface of the solid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceVoxel {
    /// Memory index.
    pub index: u32,
    /// How much of it is solid, 0 to 1.
    pub filled: f32,
}

impl Volume {
    /// The voxels at the surface of `solid` (see [`Volume::solid`]), of which the views tell how full they are, or what was
    /// fused before where none of them shows it; above the table only, whose height is known better. A voxel that nobody has
    /// looked into is as full as `solid` says and is not listed.
    pub fn surface(&self, solid: &[bool], views: &[View<'_>]) -> Vec<SurfaceVoxel> {
        self.surface_within(solid, views, &Unlimited)
    }

    /// [`Volume::surface`], which leaves out what is left when the budget ends: whoever calls looks at it next.
    pub(crate) fn surface_within(
        &self,
        solid: &[bool],
        views: &[View<'_>],
        budget: &dyn Budget,
    ) -> Vec<SurfaceVoxel> {
        let n = self.grid.resolution;
        if solid.len() != self.grid.len() || n == 0 {
            return Vec::new();
        }
        let views: Vec<&View<'_>> =
            views.iter().filter(|v| v.depth.len() == v.frame.image.width * v.frame.image.height).collect();
        let first = self.table_layer() + 1;
        let shares = |column: usize| {
            let (x, y) = (column / n, column % n);
            let views = &views;
            let first = if budget.stop().is_some() { n } else { first };
            (first..n).filter_map(move |z| {
                let index = column * n + z;
                // What is neither solid nor seen to be free is unknown, and no part of it is solid.
                let known = solid[index] || self.state[index] == VoxelState::Free;
                if !known || !is_at_surface(solid, n, [x, y, z]) {
                    return None;
                }
                let filled = self.filled([x, y, z], views).or_else(|| self.remembered(index))?;
                Some(SurfaceVoxel { index: index as u32, filled })
            })
        };
        (0..n * n).into_par_iter().flat_map_iter(shares).collect()
    }

    /// Share of a voxel that lies behind the surface that was seen before, by its signed distance; nothing where it was not.
    /// A volume that follows something shows more than its newest view does, and a camera that has come too near sees nothing.
    fn remembered(&self, index: usize) -> Option<f32> {
        let distance = self.tsdf[index] * TRUNCATION_VOXELS as f32;
        (self.weight[index] > 0 && distance.abs() < TRUNCATION_VOXELS as f32)
            .then(|| (0.5 - distance).clamp(0.0, 1.0))
    }

    /// Share of a voxel that lies behind what the views see; nothing where they see nothing.
    fn filled(&self, voxel: [usize; 3], views: &[&View<'_>]) -> Option<f32> {
        let edge = self.grid.voxel_m();
        let step = edge / PER_EDGE as f64;
        let corner = self.grid.center(voxel) - Vector3::repeat(0.5 * (edge - step));
        let (mut told, mut filled) = (0.0, 0.0);
        for k in 0..PER_EDGE.pow(3) {
            let [a, b, c] = [k % PER_EDGE, k / PER_EDGE % PER_EDGE, k / PER_EDGE.pow(2)].map(|i| i as f64);
            let point = corner + Vector3::new(a, b, c) * step;
            // The view that sees farthest past the point decides: it was free to look there.
            let ahead = views.iter().filter_map(|v| v.ahead(&point)).reduce(f64::max);
            if let Some(ahead) = ahead {
                told += 1.0;
                filled += (0.5 - ahead / step).clamp(0.0, 1.0);
            }
        }
        (told > 0.0).then(|| (filled / told) as f32)
    }
}

impl<'a> View<'a> {
    /// A frame with its cleaned depth image; a frame without a pose has its camera in the world's origin.
    pub fn of(frame: &'a Frame, depth: &'a [f32], world_from_volume: &Isometry3<f64>) -> Self {
        let world_from_camera = frame.world_from_camera.unwrap_or_else(Isometry3::identity);
        Self { frame, depth, camera_from_volume: world_from_camera.inverse() * world_from_volume }
    }

    /// How far a point lies in front of the surface that is seen in its direction, metres along the optical axis,
    /// negative behind it; nothing where nothing is seen.
    fn ahead(&self, point: &Point3<f64>) -> Option<f64> {
        let p = self.camera_from_volume * point;
        let pixel = self.frame.intrinsics.project([p.x, p.y, p.z])?;
        let [u, v] = pixel.map(|c| c + 0.5);
        let (width, height) = (self.frame.image.width, self.frame.image.height);
        if !(0.0..width as f64).contains(&u) || !(0.0..height as f64).contains(&v) {
            return None;
        }
        let depth = self.depth[v as usize * width + u as usize];
        (depth > 0.0).then(|| f64::from(depth) - p.z)
    }
}

/// True when one of the six neighbours is of the other kind.
fn is_at_surface(solid: &[bool], n: usize, voxel: [usize; 3]) -> bool {
    let index = (voxel[0] * n + voxel[1]) * n + voxel[2];
    (0..3).any(|axis| {
        let (stride, at) = ([n * n, n, 1][axis], voxel[axis]);
        (at > 0 && solid[index - stride] != solid[index])
            || (at + 1 < n && solid[index + stride] != solid[index])
    })
}
