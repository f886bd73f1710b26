//! Fusing a depth frame into the volume: every voxel centre is projected into the image and compared with the
//! depth of the nearest pixel.

use nalgebra::Isometry3;
use rayon::prelude::*;

use super::{Labels, SURFACE_BAND_VOXELS, TRUNCATION_VOXELS, Volume, VoxelState};
use crate::budget::{Budget, Unlimited};
use crate::frame::{Frame, Intrinsics};

/// A measurement that differs from what is remembered by more than this share of the truncation (2 cm) says that the world
/// has changed there, not that one of both is noisy.
const CHANGED: f32 = 0.5;

/// Nearer than this no sensor measures, metres.
const NEAR_M: f32 = 0.02;

/// What one row of voxels (along z) sees of the image.
struct Row {
    /// Pixel index, or -1.
    pixel: Vec<i32>,
    /// Depth of the voxel centre along the optical axis.
    depth: Vec<f32>,
    /// Length of the ray per unit of depth.
    stretch: Vec<f32>,
}

/// The projection, in single precision (a voxel is five thousand times larger than its rounding at 1 m).
struct Projector {
    rotation: [[f32; 3]; 3],
    translation: [f32; 3],
    voxel: f32,
    fx: f32,
    fy: f32,
    cx: f32,
    cy: f32,
    width: usize,
    height: usize,
    lens: Option<(Intrinsics, f32)>,
}

impl Volume {
    /// Fuses one frame: `depth` is its cleaned depth image ([`crate::frame::clean_depth`]: metres, 0 for holes).
    ///
    /// Signed distances are measured along the viewing ray, truncated, and averaged over frames. Voxels further
    /// behind the surface than the truncation, outside the image or behind holes stay as they were. Fusing the
    /// same frame again changes no distance and no state.
    ///
    /// The frame must have passed [`Frame::validate`]; a depth image of another size is ignored.
    pub fn integrate(&mut self, frame: &Frame, depth: &[f32], camera_from_volume: &Isometry3<f64>) {
        self.fuse(frame, depth, camera_from_volume, u16::MAX, &Unlimited);
    }

    /// [`integrate`](Self::integrate), which leaves out what is left when the budget ends: whoever calls looks at it next.
    pub(crate) fn integrate_within(
        &mut self,
        frame: &Frame,
        depth: &[f32],
        camera_from_volume: &Isometry3<f64>,
        budget: &dyn Budget,
    ) {
        self.fuse(frame, depth, camera_from_volume, u16::MAX, budget);
    }

    /// Fuses one frame of many, of a world that may change: what was seen before counts as at most `memory` frames, so
    /// that old measurements fade, and where a voxel is now seen to be clearly something else, as one. A voxel that was
    /// surface and is now looked through is free at once; one that was free becomes surface within a few frames. What is
    /// hidden is remembered as it was.
    ///
    /// Otherwise as [`integrate`](Self::integrate).
    pub fn update(&mut self, frame: &Frame, depth: &[f32], camera_from_volume: &Isometry3<f64>, memory: u16) {
        // The largest number means that nothing is forgotten.
        self.fuse(frame, depth, camera_from_volume, memory.clamp(1, u16::MAX - 1), &Unlimited);
    }

    fn fuse(
        &mut self,
        frame: &Frame,
        depth: &[f32],
        camera_from_volume: &Isometry3<f64>,
        memory: u16,
        budget: &dyn Budget,
    ) {
        let (width, height) = (frame.image.width, frame.image.height);
        if depth.len() != width * height || depth.is_empty() || self.grid.is_empty() {
            return;
        }
        let n = self.grid.resolution;
        let projector =
            Projector::new(&frame.intrinsics, width, height, camera_from_volume, self.grid.voxel_m());
        let per_metre = (1.0 / (TRUNCATION_VOXELS * self.grid.voxel_m())) as f32;
        let band = -(SURFACE_BAND_VOXELS / TRUNCATION_VOXELS) as f32;
        let labels_in = frame.labels.as_deref().filter(|l| l.len() == depth.len());
        if labels_in.is_some() && self.labels.is_none() {
            self.labels = Some(Labels { label: vec![0; self.grid.len()], votes: vec![0; self.grid.len()] });
        }

        let slab = n * n;
        self.tsdf
            .par_chunks_mut(slab)
            .zip(self.weight.par_chunks_mut(slab))
            .zip(self.state.par_chunks_mut(slab))
            .enumerate()
            .for_each_init(
                || Row { pixel: vec![-1; n], depth: vec![0.0; n], stretch: vec![0.0; n] },
                |row, (x, ((tsdf, weight), state))| {
                    if budget.stop().is_some() {
                        return;
                    }
                    for y in 0..n {
                        if !projector.row(x, y, row) {
                            continue;
                        }
                        let at = y * n..(y + 1) * n;
                        let voxels =
                            tsdf[at.clone()].iter_mut().zip(&mut weight[at.clone()]).zip(&mut state[at]);
                        let seen = row.pixel.iter().zip(&row.depth).zip(&row.stretch);
                        for (((mean, weight), state), ((&pixel, &z), &stretch)) in voxels.zip(seen) {
                            if pixel < 0 {
                                continue;
                            }
                            let d = depth[pixel as usize];
                            let value = (d - z) * stretch * per_metre;
                            if d <= 0.0 || value < -1.0 {
                                continue;
                            }
                            let value = value.min(1.0);
                            if memory < u16::MAX {
                                let has_changed = (value - *mean).abs() > CHANGED;
                                *weight = (*weight).min(if has_changed { 1 } else { memory });
                            }
                            *mean += (value - *mean) / (f32::from(*weight) + 1.0);
                            *weight = weight.saturating_add(1);
                            *state = state_of(*mean, band);
                        }
                    }
                },
            );

        if let (Some(labels_in), Some(labels)) = (labels_in, &mut self.labels) {
            let surface = &self.state;
            labels
                .label
                .par_chunks_mut(slab)
                .zip(labels.votes.par_chunks_mut(slab))
                .enumerate()
                .for_each_init(
                    || Row { pixel: vec![-1; n], depth: vec![0.0; n], stretch: vec![0.0; n] },
                    |row, (x, (label, votes))| {
                        for y in 0..n {
                            let states = &surface[x * slab + y * n..][..n];
                            if !states.contains(&VoxelState::Surface) || !projector.row(x, y, row) {
                                continue;
                            }
                            for (z, &state) in states.iter().enumerate() {
                                let pixel = row.pixel[z];
                                if pixel < 0 || state != VoxelState::Surface {
                                    continue;
                                }
                                let d = depth[pixel as usize];
                                let value = (d - row.depth[z]) * row.stretch[z] * per_metre;
                                // Only a frame that sees this very surface may name it.
                                if d > 0.0 && value >= band && value <= -band {
                                    let i = y * n + z;
                                    vote(&mut label[i], &mut votes[i], labels_in[pixel as usize]);
                                }
                            }
                        }
                    },
                );
        }
    }
}

fn state_of(mean: f32, band: f32) -> VoxelState {
    if mean > 0.0 {
        VoxelState::Free
    } else if mean >= band {
        VoxelState::Surface
    } else {
        VoxelState::Unseen
    }
}

/// Running majority (Boyer and Moore): the label that leads, and by how many votes.
fn vote(label: &mut u8, votes: &mut u8, cast: u8) {
    if *votes == 0 {
        (*label, *votes) = (cast, 1);
    } else if *label == cast {
        *votes = votes.saturating_add(1);
    } else {
        *votes -= 1;
    }
}

impl Projector {
    fn new(
        intrinsics: &Intrinsics,
        width: usize,
        height: usize,
        camera_from_volume: &Isometry3<f64>,
        voxel_m: f64,
    ) -> Self {
        let r = camera_from_volume.rotation.to_rotation_matrix();
        let m = r.matrix();
        let row = |i: usize| [m[(i, 0)] as f32, m[(i, 1)] as f32, m[(i, 2)] as f32];
        let t = camera_from_volume.translation.vector;
        Self {
            rotation: [row(0), row(1), row(2)],
            translation: [t.x as f32, t.y as f32, t.z as f32],
            voxel: voxel_m as f32,
            fx: intrinsics.fx_px as f32,
            fy: intrinsics.fy_px as f32,
            cx: intrinsics.cx_px as f32,
            cy: intrinsics.cy_px as f32,
            width,
            height,
            lens: intrinsics
                .is_distorted()
                .then(|| (*intrinsics, intrinsics.largest_radius_squared(width, height) as f32)),
        }
    }

    /// Projects the voxels (x, y, ·); false when none can be in the image.
    fn row(&self, x: usize, y: usize, row: &mut Row) -> bool {
        let n = row.pixel.len();
        let v = self.voxel;
        let (px, py, pz) = ((x as f32 + 0.5) * v, (y as f32 + 0.5) * v, 0.5 * v);
        let start: [f32; 3] = std::array::from_fn(|i| {
            let r = self.rotation[i];
            r[0] * px + r[1] * py + r[2] * pz + self.translation[i]
        });
        let step: [f32; 3] = std::array::from_fn(|i| self.rotation[i][2] * v);
        let last = (n - 1) as f32;
        if start[2] < NEAR_M && start[2] + last * step[2] < NEAR_M {
            return false;
        }
        let (w, h) = (self.width as f32, self.height as f32);
        for k in 0..n {
            let t = k as f32;
            let (cx, cy, cz) = (start[0] + t * step[0], start[1] + t * step[1], start[2] + t * step[2]);
            let inverse = 1.0 / cz;
            let (xn, yn) = (cx * inverse, cy * inverse);
            row.depth[k] = cz;
            row.stretch[k] = (xn * xn + yn * yn + 1.0).sqrt();
            // Half a pixel is added so that truncation rounds.
            let (u, v) = match &self.lens {
                None => (self.fx * xn + (self.cx + 0.5), self.fy * yn + (self.cy + 0.5)),
                Some((lens, limit)) => {
                    if xn * xn + yn * yn <= *limit {
                        let [xd, yd] = lens.distort([f64::from(xn), f64::from(yn)]);
                        (self.fx * xd as f32 + (self.cx + 0.5), self.fy * yd as f32 + (self.cy + 0.5))
                    } else {
                        (-1.0, -1.0)
                    }
                }
            };
            let inside = cz >= NEAR_M && u >= 0.0 && u < w && v >= 0.0 && v < h;
            row.pixel[k] = if inside { v as i32 * self.width as i32 + u as i32 } else { -1 };
        }
        true
    }
}
