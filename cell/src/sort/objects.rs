//! What lies in the tray, from a depth frame: connected heaps of what stands above the floor, with their sizes.

use nalgebra::{Matrix2, Point3, SymmetricEigen, Vector2, Vector3};

use super::shadow::Shadow;
use crate::config::TrayConfig;
use crate::frame::Frame;

/// Edge of a cell of the height map, metres.
const CELL_M: f64 = 0.004;
/// Heaps of less than so many cells are noise.
const LEAST_CELLS: usize = 12;
/// A heap so many cells from what is hidden may go on in it.
const CUT_CELLS: usize = 3;
/// Cells whose heights differ by more than this are not neighbours: something stands behind something, metres.
const STEP_M: f64 = 0.02;

/// A heap.
#[derive(Debug, Clone, PartialEq)]
pub struct Seen {
    /// Middle of what was seen of it, half way between floor and top, world frame.
    pub middle: Point3<f64>,
    /// Shorter edge of the box around it, seen from above, metres.
    pub width_m: f64,
    /// Longer edge, metres.
    pub length_m: f64,
    /// Of its top above the floor, metres.
    pub height_m: f64,
    /// It lies at the edge of what an arm hides: there may be more of it.
    pub is_cut: bool,
    /// Its cells, world x and y.
    cells: Vec<Vector2<f64>>,
}

impl Seen {
    /// Distance of a point from the heap as seen from above, metres.
    pub fn distance(&self, point: &Point3<f64>) -> f64 {
        let at = Vector2::new(point.x, point.y);
        self.cells.iter().map(|c| (c - at).norm()).fold(f64::INFINITY, f64::min)
    }

    /// Smallest distance between two heaps as seen from above, metres.
    pub fn gap(&self, other: &Self) -> f64 {
        other.cells.iter().map(|c| self.distance(&Point3::new(c.x, c.y, 0.0))).fold(f64::INFINITY, f64::min)
    }
}

/// The heaps in the tray, from the left to the right; `shadow` is what was taken out of the frame.
pub fn see(frame: &Frame, shadow: &Shadow, tray: &TrayConfig, least_height_m: f64) -> Vec<Seen> {
    let Ok(world_from_camera) = frame.world_from_camera() else { return Vec::new() };
    let region = tray.region();
    let (box_pose, half) = (region.pose.isometry(), region.half_extents_m);
    let size = [0, 1].map(|i: usize| (2.0 * half[i] / CELL_M).ceil().max(1.0) as usize);
    let mut heights = vec![f64::NEG_INFINITY; size[0] * size[1]];
    let info = &frame.info;
    for (i, &mm) in frame.millimetres.iter().enumerate().filter(|(_, mm)| **mm > 0) {
        let (u, v) = ((i % info.width as usize) as f64, (i / info.width as usize) as f64);
        let depth = f64::from(mm) * info.depth_scale;
        // Lens distortion moves points by millimetres here, less than a cell.
        let ray = Point3::new((u - info.cx) / info.fx * depth, (v - info.cy) / info.fy * depth, depth);
        let world = world_from_camera * ray;
        let local = box_pose.inverse_transform_point(&world);
        let height = world.z - tray.floor_m();
        if (0..2).any(|i| local[i].abs() >= half[i]) || height < least_height_m || height > tray.height_m {
            continue;
        }
        let cell = [0, 1].map(|i: usize| (((local[i] + half[i]) / CELL_M) as usize).min(size[i] - 1));
        let at = cell[1] * size[0] + cell[0];
        heights[at] = heights[at].max(height);
    }
    let local = |p: &Vector2<f64>| box_pose.inverse_transform_point(&Point3::new(p.x, p.y, 0.0));
    let hidden = near_shadow(shadow.points.iter().map(|p| local(p) + Vector3::from(half)), size);
    let mut seen = heaps(&heights, size)
        .into_iter()
        .filter(|cells| cells.len() >= LEAST_CELLS)
        .map(|cells| {
            let height_m = cells.iter().map(|&c| heights[c]).fold(0.0, f64::max);
            let world = |&c: &usize| {
                let x = (c % size[0]) as f64 * CELL_M + CELL_M / 2.0 - half[0];
                let y = (c / size[0]) as f64 * CELL_M + CELL_M / 2.0 - half[1];
                (box_pose * Point3::new(x, y, 0.0)).xy().coords
            };
            let is_cut = cells.iter().any(|&cell| hidden[cell]);
            Seen { is_cut, ..heap(cells.iter().map(world).collect(), height_m, tray.floor_m()) }
        })
        .collect::<Vec<Seen>>();
    seen.sort_by(|a, b| a.middle.x.total_cmp(&b.middle.x).then(a.middle.y.total_cmp(&b.middle.y)));
    seen
}

/// The cells that are hidden, or so near to it that what lies there may go on in it. Points are from the corner of the map.
fn near_shadow(points: impl Iterator<Item = Point3<f64>>, size: [usize; 2]) -> Vec<bool> {
    let wide = size.map(|n| n + 2 * CUT_CELLS);
    let mut hidden = vec![false; wide[0] * wide[1]];
    for point in points {
        let cell = [0, 1].map(|i: usize| (point[i] / CELL_M).floor() + CUT_CELLS as f64);
        if cell.iter().zip(wide).all(|(c, n)| *c >= 0.0 && *c < n as f64) {
            hidden[cell[1] as usize * wide[0] + cell[0] as usize] = true;
        }
    }
    // First along x, then along y: the same square around each cell.
    let around = |n: usize| n..=n + 2 * CUT_CELLS;
    let rows: Vec<bool> = (0..wide[1])
        .flat_map(|y| (0..size[0]).map(move |x| (x, y)))
        .map(|(x, y)| around(x).any(|x| hidden[y * wide[0] + x]))
        .collect();
    (0..size[1])
        .flat_map(|y| (0..size[0]).map(move |x| (x, y)))
        .map(|(x, y)| around(y).any(|y| rows[y * size[0] + x]))
        .collect()
}

/// Connected cells, corners included.
fn heaps(heights: &[f64], size: [usize; 2]) -> Vec<Vec<usize>> {
    let mut of = vec![false; heights.len()];
    let mut found = Vec::new();
    for start in 0..heights.len() {
        if of[start] || heights[start] == f64::NEG_INFINITY {
            continue;
        }
        of[start] = true;
        let (mut cells, mut open) = (Vec::new(), vec![start]);
        while let Some(cell) = open.pop() {
            cells.push(cell);
            let (x, y) = (cell % size[0], cell / size[0]);
            for ny in y.saturating_sub(1)..=(y + 1).min(size[1] - 1) {
                for nx in x.saturating_sub(1)..=(x + 1).min(size[0] - 1) {
                    let next = ny * size[0] + nx;
                    if !of[next] && (heights[next] - heights[cell]).abs() < STEP_M {
                        of[next] = true;
                        open.push(next);
                    }
                }
            }
        }
        cells.sort_unstable();
        found.push(cells);
    }
    found
}

/// A heap of cells: the box around it along its principal axes.
fn heap(cells: Vec<Vector2<f64>>, height_m: f64, floor_m: f64) -> Seen {
    let mean = cells.iter().sum::<Vector2<f64>>() / cells.len() as f64;
    let spread: Matrix2<f64> = cells.iter().map(|c| (c - mean) * (c - mean).transpose()).sum();
    let axes = SymmetricEigen::new(spread).eigenvectors;
    let extent = |axis: usize| {
        let along = cells.iter().map(|c| axes.column(axis).dot(c));
        let (low, high) = along.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        high - low + CELL_M
    };
    let (a, b) = (extent(0), extent(1));
    let middle = Point3::new(mean.x, mean.y, floor_m + height_m / 2.0);
    Seen { middle, width_m: a.min(b), length_m: a.max(b), height_m, is_cut: false, cells }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use graspd_adapters_core::{DepthFrame, Lens};
    use nalgebra::{Isometry3, Vector3};

    /// A camera 0.8 m above the floor at 0, looking straight down, and boxes (middle, edges, height) on it.
    pub(in crate::sort) fn frame(boxes: &[([f64; 2], [f64; 2], f64)]) -> Frame {
        let (width, height, f, up) = (320usize, 320usize, 400.0, 0.8);
        let lens = Lens { fx_px: f, fy_px: f, cx_px: 160.0, cy_px: 160.0, distortion: [0.0; 8] };
        let mut depth_m = Vec::new();
        for v in 0..height {
            for u in 0..width {
                let ray = ((u as f64 - 160.0) / f, (v as f64 - 160.0) / f);
                // Looking down with x to the right: world y is -v.
                let tops = boxes.iter().filter(|(at, edges, h)| {
                    let d = up - h;
                    let (x, y) = (ray.0 * d - at[0], -ray.1 * d - at[1]);
                    x.abs() < edges[0] / 2.0 && y.abs() < edges[1] / 2.0
                });
                depth_m.push((up - tops.map(|b| b.2).fold(0.0, f64::max)) as f32);
            }
        }
        let down = Isometry3::rotation(Vector3::x() * std::f64::consts::PI);
        let pose = Isometry3::translation(0.0, 0.0, up) * down;
        let device = DepthFrame {
            width,
            height,
            depth_m: depth_m.into(),
            lens,
            world_from_camera: Some(pose),
            sequence: 1,
            stamp: std::time::Duration::ZERO,
            age: std::time::Duration::ZERO,
        };
        Frame::of(&device, &pose).unwrap()
    }

    #[test]
    fn each_heap_has_its_place_and_its_size() {
        let boxes = [([-0.08, 0.05], [0.06, 0.03], 0.05), ([0.07, -0.02], [0.09, 0.12], 0.08)];
        let seen = see(&frame(&boxes), &Shadow::default(), &TrayConfig::default(), 0.012);
        assert_eq!(seen.len(), 2, "{seen:?}");
        for (seen, (at, edges, height)) in seen.iter().zip(boxes) {
            assert!(
                (seen.middle.x - at[0]).abs() < 0.006 && (seen.middle.y - at[1]).abs() < 0.006,
                "{seen:?}"
            );
            assert!((seen.width_m - edges[0].min(edges[1])).abs() < 0.012, "{}", seen.width_m);
            assert!((seen.length_m - edges[0].max(edges[1])).abs() < 0.012, "{}", seen.length_m);
            assert!((seen.height_m - height).abs() < 0.004);
        }
        assert!(seen[0].distance(&Point3::new(-0.08, 0.05, 0.0)) < 0.005);
        assert!((seen[0].gap(&seen[1]) - 0.075).abs() < 0.02, "{}", seen[0].gap(&seen[1]));
    }

    #[test]
    fn a_heap_at_the_edge_of_what_is_hidden_is_cut() {
        let boxes = [([-0.08, 0.05], [0.06, 0.03], 0.05), ([0.07, -0.02], [0.09, 0.12], 0.08)];
        for (at, cut) in
            [([-0.08, 0.073], [true, false]), ([-0.08, 0.09], [false, false]), ([0.0, 0.3], [false, false])]
        {
            let shadow = Shadow { points: vec![Vector2::from(at)] };
            let seen = see(&frame(&boxes), &shadow, &TrayConfig::default(), 0.012);
            assert_eq!([seen[0].is_cut, seen[1].is_cut], cut, "{at:?}");
        }
    }

    #[test]
    fn an_empty_tray_has_no_heaps() {
        assert_eq!(see(&frame(&[]), &Shadow::default(), &TrayConfig::default(), 0.012), []);
    }
}
