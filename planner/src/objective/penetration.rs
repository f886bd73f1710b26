//! Penetration `O_pn`: the whole hand against the scene, the table, keep-out boxes and itself.
//!
//! Every sphere of the hand's covering is looked up in the scene's signed distance field, in constant time.

use nalgebra::{Isometry3, Point3, Vector3};

use crate::grid::Grid;

/// Solid geometry in the volume frame.
#[derive(Debug, Clone)]
pub(crate) struct Obstacles<'a> {
    pub(crate) grid: Grid,
    /// Signed distance at voxel centres, metres.
    pub(crate) distance: &'a [f32],
    /// Group of each voxel of an object; 0: none.
    pub(crate) objects: &'a [u16],
    /// Height of the table top.
    pub(crate) table_m: Option<f64>,
    /// Boxes: pose in the volume and half extents.
    pub(crate) boxes: Vec<(Isometry3<f64>, Vector3<f64>)>,
}

impl Obstacles<'_> {
    /// Signed distance to the scene's voxels and its gradient. Outside the volume nothing is known to be
    /// solid: the border's distance grows with the way out.
    #[inline]
    pub(crate) fn scene(&self, p: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let n = self.grid.resolution;
        let inverse = 1.0 / self.grid.voxel_m();
        let top = (n - 1) as f64;
        let (mut base, mut t, mut inside) = ([0usize; 3], [0f64; 3], [1f64; 3]);
        let mut outside = Vector3::zeros();
        for axis in 0..3 {
            let u = p[axis] * inverse - 0.5;
            let clamped = u.clamp(0.0, top);
            let low = (clamped as usize).min(n - 2);
            base[axis] = low;
            t[axis] = clamped - low as f64;
            if u != clamped {
                inside[axis] = 0.0;
                outside[axis] = (u - clamped) / inverse;
            }
        }
        let i = self.grid.index(base[0], base[1], base[2]);
        let (dx, dy) = (n * n, n);
        let d = |k: usize| f64::from(self.distance[k]);
        let (a, b, c, e) = (i, i + dy, i + dx, i + dx + dy);
        let (z00, z01, z10, z11) = (d(a), d(b), d(c), d(e));
        let (s00, s01, s10, s11) = (d(a + 1) - z00, d(b + 1) - z01, d(c + 1) - z10, d(e + 1) - z11);
        let (v00, v01, v10, v11) = (z00 + t[2] * s00, z01 + t[2] * s01, z10 + t[2] * s10, z11 + t[2] * s11);
        let (v0, v1) = (v00 + t[1] * (v01 - v00), v10 + t[1] * (v11 - v10));
        let mut value = v0 + t[0] * (v1 - v0);
        let gy = (v01 - v00) + t[0] * ((v11 - v10) - (v01 - v00));
        let (g0, g1) = (s00 + t[1] * (s01 - s00), s10 + t[1] * (s11 - s10));
        let mut gradient =
            Vector3::new((v1 - v0) * inside[0], gy * inside[1], (g0 + t[0] * (g1 - g0)) * inside[2])
                * inverse;
        let away = outside.norm();
        if away > 0.0 {
            value = value.max(0.0) + away;
            gradient += outside / away;
        }
        (value, gradient)
    }

    /// The object behind a surface point: the first group that is met on the way in, within two voxels; 0 where
    /// there is none. The noise of a table's surface is solid but no object.
    pub(crate) fn object_behind(&self, surface: &Vector3<f64>, inward: &Vector3<f64>) -> u16 {
        let met = |i: usize| (self.objects[i] > 0).then_some(self.objects[i]);
        self.behind(surface, inward, met).unwrap_or(0)
    }

    /// The first answer that a voxel on the way in from a surface point gives, within two voxels.
    pub(crate) fn behind<T>(
        &self,
        surface: &Vector3<f64>,
        inward: &Vector3<f64>,
        ask: impl Fn(usize) -> Option<T>,
    ) -> Option<T> {
        let voxel_m = self.grid.voxel_m();
        let within = |p: &Vector3<f64>| p.iter().all(|&v| (0.0..self.grid.size_m).contains(&v));
        (0..5).map(|k| surface + inward * (f64::from(k) * 0.5 * voxel_m)).filter(within).find_map(|p| {
            let [x, y, z] = [p.x, p.y, p.z].map(|v| ((v / voxel_m) as usize).min(self.grid.resolution - 1));
            ask(self.grid.index(x, y, z))
        })
    }

    /// Signed distance of a point to a keep-out box and its gradient.
    pub(crate) fn keep_out(
        pose: &Isometry3<f64>,
        half: &Vector3<f64>,
        p: &Vector3<f64>,
    ) -> (f64, Vector3<f64>) {
        let local = pose.inverse_transform_point(&Point3::from(*p)).coords;
        let gap = local.abs() - half;
        let outer = gap.map(|v| v.max(0.0));
        let sign = local.map(|v| if v < 0.0 { -1.0 } else { 1.0 });
        let away = outer.norm();
        let (value, gradient) = if away > 0.0 {
            (away, (outer / away).component_mul(&sign))
        } else {
            let axis = gap.imax();
            let mut g = Vector3::zeros();
            g[axis] = sign[axis];
            (gap[axis], g)
        };
        (value, pose.rotation * gradient)
    }

    /// Depth of a sphere in scene, table and boxes together (metres, 0 when free), and its gradient with
    /// respect to the centre.
    #[inline]
    pub(crate) fn depth(&self, center: &Vector3<f64>, radius: f64) -> (f64, Vector3<f64>) {
        let mut depth = 0.0;
        let mut gradient = Vector3::zeros();
        let mut add = |value: f64, g: &Vector3<f64>| {
            let into = radius - value;
            if into > 0.0 {
                depth += into;
                gradient -= g;
            }
        };
        if let Some(table) = self.table_m {
            add(center.z - table, &Vector3::z());
        }
        let (value, g) = self.scene(center);
        add(value, &g);
        for (pose, half) in &self.boxes {
            let (value, g) = Self::keep_out(pose, half, center);
            add(value, &g);
        }
        (depth, gradient)
    }
}
