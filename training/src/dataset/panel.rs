//! A square of voxels as pixels, and the colours that stand for heights, scores and directions.

use graspd_planner::grid::Grid;
use nalgebra::Vector3;

use super::sample::{OCCUPIED, Sample};

/// Pixels along each side of a voxel.
pub(crate) const SCALE: usize = 5;

/// A square of voxels.
#[derive(Debug, Clone)]
pub(crate) struct Panel {
    /// Along each side.
    pub(crate) voxels: usize,
    /// Row by row from the top.
    pub(crate) pixels: Vec<[u8; 3]>,
}

impl Panel {
    /// All dark.
    pub(crate) fn new(voxels: usize) -> Self {
        Self { voxels, pixels: vec![[0; 3]; (voxels * SCALE).pow(2)] }
    }

    /// Colours a pixel; what lies outside is left out.
    pub(crate) fn pixel(&mut self, right: usize, down: usize, color: [u8; 3]) {
        let side = self.voxels * SCALE;
        if right < side && down < side {
            self.pixels[down * side + right] = color;
        }
    }

    /// Fills a voxel; the second axis points up.
    pub(crate) fn voxel(&mut self, [right, up]: [usize; 2], color: [u8; 3]) {
        for v in 0..SCALE {
            for u in 0..SCALE {
                self.pixel(right * SCALE + u, (self.voxels - 1 - up) * SCALE + v, color);
            }
        }
    }

    /// A line from a voxel's middle in a direction (right, up), two voxels long for a unit vector.
    pub(crate) fn needle(&mut self, [right, up]: [usize; 2], direction: [f64; 2]) {
        let start = [right * SCALE + SCALE / 2, (self.voxels - 1 - up) * SCALE + SCALE / 2];
        let steps = 2 * SCALE;
        for step in 0..=steps {
            let at = |i: usize, sign: f64| (start[i] as f64 + sign * direction[i] * step as f64).round();
            let (x, y) = (at(0, 1.0), at(1, -1.0));
            if x >= 0.0 && y >= 0.0 {
                self.pixel(x as usize, y as usize, [255, 255, 255]);
            }
        }
    }
}

/// The highest surface of every column (x·n + y), brighter the higher; nothing where none was seen.
pub(crate) fn heights(sample: &Sample, grid: &Grid) -> Vec<Option<[u8; 3]>> {
    let n = grid.resolution;
    let column = |at: usize| &sample.tsdf[grid.index(at / n, at % n, 0)..][..n];
    let highest = |at| column(at).iter().rposition(|v| OCCUPIED.contains(v));
    (0..n * n).map(|at| highest(at).map(|z| grey(0.12 + 0.7 * z as f32 / n as f32))).collect()
}

/// [`heights`] as a panel.
pub(crate) fn from_above(sample: &Sample, grid: &Grid) -> Panel {
    let n = grid.resolution;
    let mut panel = Panel::new(n);
    for (at, color) in heights(sample, grid).into_iter().enumerate() {
        if let Some(color) = color {
            panel.voxel([at / n, at % n], color);
        }
    }
    panel
}

/// From black (0) to white (1).
pub(crate) fn grey(value: f32) -> [u8; 3] {
    [(value.clamp(0.0, 1.0) * 255.0) as u8; 3]
}

/// From blue (0) over cyan, green and yellow to red (1).
pub(crate) fn heat(value: f32) -> [u8; 3] {
    [4.0 * value - 2.0, (4.0 * value).min(4.0 - 4.0 * value), 2.0 - 4.0 * value]
        .map(|channel| (255.0 * channel.clamp(0.0, 1.0)) as u8)
}

/// A direction as a colour: red along x, green along y, blue along z, half for none.
pub(crate) fn compass(direction: &Vector3<f64>) -> [u8; 3] {
    [0, 1, 2].map(|a| (127.5 + 127.5 * direction[a]) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn high_scores_are_red_and_low_ones_blue() {
        assert!(heat(1.0)[0] > 200 && heat(1.0)[2] == 0, "{:?}", heat(1.0));
        assert!(heat(0.1)[2] > 150 && heat(0.1)[0] == 0, "{:?}", heat(0.1));
        assert_eq!(compass(&Vector3::x()), [255, 127, 127]);
    }
}
