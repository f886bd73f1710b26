//! The interleaved cells that the objectives look up, and trilinear interpolation with its exact gradient.
//!
//! All channels of a voxel lie side by side: one contact candidate costs eight reads of 32 bytes,
//! whatever the number of focal contacts.

use nalgebra::{Point3, Vector3};

use crate::grid::Grid;

/// Channels of a [`Cell`].
pub const CHANNELS: usize = 8;

/// What one voxel holds: distance to the nearest focal contact (metres), certainty (0 to 1, relative to the
/// field's maximum), the inward direction (x, y, z; unit length at voxel centres), signed distance to occupied
/// space (metres), and two spare channels that are zero.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[repr(C, align(32))]
pub struct Cell(pub [f32; CHANNELS]);

/// Cells on a grid.
#[derive(Debug, Clone)]
pub struct FieldCells {
    /// The grid.
    pub grid: Grid,
    /// One per voxel, in memory order.
    pub cells: Vec<Cell>,
}

/// The interpolated channels at a point and their gradients in metres⁻¹.
#[derive(Debug, Clone, Copy, Default)]
pub struct Sample {
    /// Channel values.
    pub value: [f32; CHANNELS],
    /// Derivative of each channel along x, y, z.
    pub gradient: [[f32; CHANNELS]; 3],
}

impl FieldCells {
    /// Interpolates every channel at `p` (volume frame, metres).
    ///
    /// Outside the grid of voxel centres the nearest border value holds and the gradient along that axis
    /// is zero: callers that need a pull back into the volume add it themselves.
    #[inline]
    pub fn sample(&self, p: &Point3<f64>) -> Sample {
        let n = self.grid.resolution;
        let inverse_voxel = 1.0 / self.grid.voxel_m();
        let top = (n - 1) as f64;
        let (mut base, mut t, mut scale) = ([0usize; 3], [0f32; 3], [0f32; 3]);
        for axis in 0..3 {
            let u = p[axis] * inverse_voxel - 0.5;
            let clamped = u.clamp(0.0, top);
            let low = (clamped as usize).min(n - 2);
            base[axis] = low;
            t[axis] = (clamped - low as f64) as f32;
            scale[axis] = if u == clamped { inverse_voxel as f32 } else { 0.0 };
        }
        let i = self.grid.index(base[0], base[1], base[2]);
        let (dx, dy) = (n * n, n);
        let c = &self.cells;
        // Along z first: its neighbours are adjacent in memory.
        let (v00, g00) = edge(&c[i].0, &c[i + 1].0, t[2]);
        let (v01, g01) = edge(&c[i + dy].0, &c[i + dy + 1].0, t[2]);
        let (v10, g10) = edge(&c[i + dx].0, &c[i + dx + 1].0, t[2]);
        let (v11, g11) = edge(&c[i + dx + dy].0, &c[i + dx + dy + 1].0, t[2]);
        let (v0, y0) = edge(&v00, &v01, t[1]);
        let (v1, y1) = edge(&v10, &v11, t[1]);
        let z0 = lerp(&g00, &g01, t[1]);
        let z1 = lerp(&g10, &g11, t[1]);
        let (value, gx) = edge(&v0, &v1, t[0]);
        let gy = lerp(&y0, &y1, t[0]);
        let gz = lerp(&z0, &z1, t[0]);
        Sample { value, gradient: [times(&gx, scale[0]), times(&gy, scale[1]), times(&gz, scale[2])] }
    }
}

impl Sample {
    /// Gradient of one channel, metres⁻¹.
    #[inline]
    pub fn gradient_of(&self, channel: usize) -> Vector3<f64> {
        Vector3::new(
            f64::from(self.gradient[0][channel]),
            f64::from(self.gradient[1][channel]),
            f64::from(self.gradient[2][channel]),
        )
    }
}

type Row = [f32; CHANNELS];

#[inline(always)]
fn edge(a: &Row, b: &Row, t: f32) -> (Row, Row) {
    let (mut value, mut slope) = ([0f32; CHANNELS], [0f32; CHANNELS]);
    for k in 0..CHANNELS {
        slope[k] = b[k] - a[k];
        value[k] = a[k] + t * slope[k];
    }
    (value, slope)
}

#[inline(always)]
fn lerp(a: &Row, b: &Row, t: f32) -> Row {
    let mut out = [0f32; CHANNELS];
    for k in 0..CHANNELS {
        out[k] = a[k] + t * (b[k] - a[k]);
    }
    out
}

#[inline(always)]
fn times(a: &Row, s: f32) -> Row {
    let mut out = [0f32; CHANNELS];
    for k in 0..CHANNELS {
        out[k] = a[k] * s;
    }
    out
}
