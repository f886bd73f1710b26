//! Standing the cube on a table, around a cloud of points, or finding the table inside a placed cube.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::TABLE_HEIGHT_M;
use super::plane::Plane;
use super::points::FramePoints;

/// What stands lower is the table, metres.
const LOWEST_M: f64 = 0.012;
/// Edge of the cells in which points on the table are counted, metres.
const CELL_M: f64 = 0.01;
/// Objects stand within this distance of seen table, metres: what is further out stands elsewhere.
const NEAR_TABLE_M: f64 = 0.10;
/// The objects' square is this much smaller than the cube on each side, metres, so that fingers fit.
const MARGIN_M: f64 = 0.02;
/// Factor for cells of things that leave the image or the cube's height.
const PARTLY: f64 = 0.03;
/// Eccentricity from which a point is on the image's border.
const OUTER: f64 = 0.97;

/// Rotation whose z axis is `up` and whose x axis is as close as possible to `along`.
fn upright(up: &Vector3<f64>, along: &Vector3<f64>) -> UnitQuaternion<f64> {
    let z = up.normalize();
    let flat = along - z * z.dot(along);
    let x =
        if flat.norm() > 1e-6 { flat.normalize() } else { z.cross(&Vector3::new(0.3, 0.5, 0.8)).normalize() };
    let y = z.cross(&x);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, z])))
}

/// Pose of the cube on the table: its square of floor holds as much as possible of what stands on the table;
/// of equally good places the one nearest the camera, then centred on what it holds.
pub(super) fn on_table(points: &FramePoints, table: &Plane, size_m: f64) -> Isometry3<f64> {
    // Table frame: origin below the camera on the table, z up, x along the camera's horizontal axis.
    let foot = -table.normal.into_inner() * table.offset_m;
    let rotation = upright(&table.normal, &Vector3::x());
    let camera_from_table = Isometry3::from_parts(Translation3::from(foot), rotation);
    let depth = TABLE_HEIGHT_M.min(0.5 * size_m);
    let center = densest_square(
        points,
        &camera_from_table,
        size_m - depth,
        (size_m - 2.0 * MARGIN_M).max(0.5 * size_m),
    )
    .unwrap_or([0.0, 0.0]);
    let corner = Point3::new(center[0] - 0.5 * size_m, center[1] - 0.5 * size_m, -depth);
    points.world_from_camera * camera_from_table * Translation3::from(corner.coords)
}

/// Centre of the square of edge `side` that holds most of what stands on the table, lower than `top`; without
/// anything that stands there, the middle of the seen table; `None` without a table.
fn densest_square(
    points: &FramePoints,
    camera_from_table: &Isometry3<f64>,
    top: f64,
    side: f64,
) -> Option<[f64; 2]> {
    let mut floor = Floor::around(points, camera_from_table)?;
    let weight = floor.weights(points, camera_from_table, top);
    let cells = floor.cells;
    let weight_sums = sums(&weight, cells);
    let span = (side / CELL_M).round() as usize;
    let mut best: Option<(f64, f64, [usize; 2])> = None;
    for x in 0..=cells[0].saturating_sub(span) {
        for y in 0..=cells[1].saturating_sub(span) {
            let to = [(x + span).min(cells[0]), (y + span).min(cells[1])];
            let held = window(&weight_sums, cells, [x, y], to);
            let c = floor.position([x, y], 0.5 * span as f64);
            let far = c[0].hypot(c[1]);
            let better =
                best.is_none_or(|(h, f, _)| held > h * (1.0 + 1e-9) || (held >= h * (1.0 - 1e-9) && far < f));
            if held > 1e-9 && better {
                best = Some((held, far, [x, y]));
            }
        }
    }
    let Some((held, _, from)) = best else { return median_2d(&floor.lying) };
    // Centre the square on what it holds whole, as long as nothing is lost by that.
    let inside = |x: usize, y: usize| weight[x * cells[1] + y];
    let squares = || {
        (from[0]..(from[0] + span).min(cells[0]))
            .flat_map(|x| (from[1]..(from[1] + span).min(cells[1])).map(move |y| (x, y)))
    };
    let least = if squares().any(|(x, y)| inside(x, y) > PARTLY) { PARTLY } else { 0.0 };
    let (mut low, mut high) = ([usize::MAX; 2], [0; 2]);
    for (x, y) in squares().filter(|&(x, y)| inside(x, y) > least) {
        low = [low[0].min(x), low[1].min(y)];
        high = [high[0].max(x + 1), high[1].max(y + 1)];
    }
    let middle = |a: usize| 0.5 * (low[a] + high[a]) as f64 - 0.5 * span as f64;
    let start = [0, 1].map(|a| middle(a).round().clamp(0.0, cells[a].saturating_sub(span) as f64) as usize);
    let to = [(start[0] + span).min(cells[0]), (start[1] + span).min(cells[1])];
    if window(&weight_sums, cells, start, to) < 0.98 * held {
        return Some(floor.position(from, 0.5 * span as f64));
    }
    floor.low = [0, 1].map(|a| floor.low[a] + middle(a) * CELL_M);
    Some(floor.position([0, 0], 0.5 * span as f64))
}

/// The seen table, divided into cells.
struct Floor {
    low: [f64; 2],
    cells: [usize; 2],
    /// Points on the table.
    lying: Vec<[f64; 2]>,
}

impl Floor {
    /// Cells around every point of the table up to three metres from the camera's foot.
    fn around(points: &FramePoints, camera_from_table: &Isometry3<f64>) -> Option<Self> {
        let lying: Vec<[f64; 2]> = points
            .camera
            .iter()
            .map(|p| camera_from_table.inverse_transform_point(p))
            .filter(|q| q.z.abs() < LOWEST_M && q.x.hypot(q.y) < 3.0)
            .map(|q| [q.x, q.y])
            .collect();
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for p in &lying {
            for a in 0..2 {
                low[a] = low[a].min(p[a] - NEAR_TABLE_M);
                high[a] = high[a].max(p[a] + NEAR_TABLE_M);
            }
        }
        let cells = [0, 1].map(|a| ((high[a] - low[a]) / CELL_M).ceil().max(0.0) as usize + 1);
        (!lying.is_empty()).then_some(Self { low, cells, lying })
    }

    fn cell(&self, x: f64, y: f64) -> Option<usize> {
        let c = [(x - self.low[0]) / CELL_M, (y - self.low[1]) / CELL_M].map(f64::floor);
        (c[0] >= 0.0 && c[1] >= 0.0 && c[0] < self.cells[0] as f64 && c[1] < self.cells[1] as f64)
            .then(|| c[0] as usize * self.cells[1] + c[1] as usize)
    }

    /// Position `add` cells beyond the corner of a cell.
    fn position(&self, cell: [usize; 2], add: f64) -> [f64; 2] {
        [0, 1].map(|a| self.low[a] + (cell[a] as f64 + add) * CELL_M)
    }

    /// What a cell counts for: 0 without anything standing on it or far from the table, else up to 1.
    ///
    /// Cells count, not points: a wall or a robot's arm has many points over little floor. What is connected to
    /// something that leaves the image or the cube's height counts little, for it is such a wall or arm, or cannot
    /// be seen well enough to grasp; and what is in the image's middle counts more, since that is where people
    /// point a camera.
    fn weights(&self, points: &FramePoints, camera_from_table: &Isometry3<f64>, top: f64) -> Vec<f64> {
        let count = self.cells[0] * self.cells[1];
        let mut table = vec![0.0; count];
        for i in self.lying.iter().filter_map(|p| self.cell(p[0], p[1])) {
            table[i] = 1.0;
        }
        let mut weight = vec![0.0f64; count];
        let mut cut = vec![false; count];
        for (p, &eccentricity) in points.camera.iter().zip(&points.eccentricity) {
            let q = camera_from_table.inverse_transform_point(p);
            if q.z < LOWEST_M {
                continue;
            }
            if let Some(i) = self.cell(q.x, q.y) {
                weight[i] = weight[i].max(1.0 - 0.7 * eccentricity * eccentricity);
                cut[i] |= eccentricity > OUTER || q.z > top;
            }
        }
        let near = sums(&table, self.cells);
        let reach = (NEAR_TABLE_M / CELL_M) as usize;
        for (i, w) in weight.iter_mut().enumerate() {
            let (x, y) = (i / self.cells[1], i % self.cells[1]);
            let from = [x.saturating_sub(reach), y.saturating_sub(reach)];
            let to = [(x + reach + 1).min(self.cells[0]), (y + reach + 1).min(self.cells[1])];
            // A few stray cells of table are noise.
            if window(&near, self.cells, from, to) < 4.0 {
                *w = 0.0;
            }
        }
        self.discount(&mut weight, &cut);
        weight
    }

    /// Multiplies by [`PARTLY`] the weights of every group of neighbouring cells that is cut somewhere.
    fn discount(&self, weight: &mut [f64], cut: &[bool]) {
        let [width, height] = self.cells;
        let mut open: Vec<bool> = weight.iter().map(|&w| w > 0.0).collect();
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
                let (x, y) = (group[next] / height, group[next] % height);
                next += 1;
                for a in x.saturating_sub(1)..(x + 2).min(width) {
                    for b in y.saturating_sub(1)..(y + 2).min(height) {
                        if std::mem::take(&mut open[a * height + b]) {
                            group.push(a * height + b);
                        }
                    }
                }
            }
            // One stray pixel does not cut an object off.
            if group.iter().filter(|&&i| cut[i]).count() > 1 {
                for &i in &group {
                    weight[i] *= PARTLY;
                }
            }
        }
    }
}

/// Summed-area table with a border of zeros.
fn sums(values: &[f64], cells: [usize; 2]) -> Vec<f64> {
    let stride = cells[1] + 1;
    let mut out = vec![0.0; (cells[0] + 1) * stride];
    for x in 0..cells[0] {
        let mut row = 0.0;
        for y in 0..cells[1] {
            row += values[x * cells[1] + y];
            out[(x + 1) * stride + y + 1] = out[x * stride + y + 1] + row;
        }
    }
    out
}

fn window(sums: &[f64], cells: [usize; 2], from: [usize; 2], to: [usize; 2]) -> f64 {
    let at = |x: usize, y: usize| sums[x * (cells[1] + 1) + y];
    at(to[0], to[1]) - at(from[0], to[1]) - at(to[0], from[1]) + at(from[0], from[1])
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let middle = values.len() / 2;
    let (_, value, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    Some(*value)
}

fn median_2d(points: &[[f64; 2]]) -> Option<[f64; 2]> {
    Some([median(points.iter().map(|p| p[0]).collect())?, median(points.iter().map(|p| p[1]).collect())?])
}

/// Pose of a cube around the median of the points. Up is the world's z axis where the camera's pose is known,
/// else against the optical axis (the cube faces the camera). Without points: half a metre in front of it.
pub(super) fn around_median(points: &FramePoints, size_m: f64) -> Isometry3<f64> {
    let axis = |a: usize| median(points.camera.iter().map(|p| p[a]).collect());
    let middle = match (axis(0), axis(1), axis(2)) {
        (Some(x), Some(y), Some(z)) => Point3::new(x, y, z),
        _ => Point3::new(0.0, 0.0, 0.5),
    };
    let camera = &points.world_from_camera;
    let up = if points.posed { Vector3::z() } else { camera * -Vector3::z() };
    let rotation = upright(&up, &(camera * Vector3::x()));
    let half = Vector3::repeat(0.5 * size_m);
    Isometry3::from_parts(Translation3::from((camera * middle).coords - rotation * half), rotation)
}

/// Height of the lowest large horizontal surface in a placed cube, metres above its floor.
pub(crate) fn table_height(
    points: &FramePoints,
    world_from_volume: &Isometry3<f64>,
    size_m: f64,
) -> Option<f64> {
    const BIN_M: f64 = 0.002;
    let volume_from_camera = world_from_volume.inverse() * points.world_from_camera;
    let heights: Vec<f64> = points
        .camera
        .iter()
        .map(|p| volume_from_camera * p)
        .filter(|p| (0..3).all(|a| p[a] >= 0.0 && p[a] < size_m))
        .map(|p| p.z)
        .collect();
    if heights.len() < 50 {
        return None;
    }
    let bins = (size_m / BIN_M).ceil() as usize + 1;
    let mut histogram = vec![0usize; bins];
    for h in &heights {
        histogram[((h / BIN_M) as usize).min(bins - 1)] += 1;
    }
    let level = |b: usize| -> usize { histogram[b.saturating_sub(2)..(b + 3).min(bins)].iter().sum() };
    let highest = (0..bins).map(level).max()?;
    if (highest as f64) < 0.15 * heights.len() as f64 {
        return None;
    }
    // The lowest level that is about as full as the fullest, then its own peak.
    let start = (0..bins).find(|&b| 2 * level(b) >= highest)?;
    let peak = (start..(start + 5).min(bins)).max_by_key(|&b| (level(b), bins - b))?;
    let middle = (peak as f64 + 0.5) * BIN_M;
    median(heights.into_iter().filter(|h| (h - middle).abs() < 0.006).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;
    use crate::options::WorkspaceRequest;
    use crate::workspace::Workspace;

    /// A level table (0.8 m square, 1 cm apart) one metre under a camera that looks straight down, with a block.
    fn scene(block: [f64; 2]) -> FramePoints {
        let mut camera = Vec::new();
        for i in 0..80 {
            for j in 0..80 {
                let (x, y) = (0.01 * f64::from(i) - 0.4, 0.01 * f64::from(j) - 0.4);
                let on_block = (x - block[0]).abs() < 0.05 && (y - block[1]).abs() < 0.03;
                camera.push(Point3::new(x, y, if on_block { 0.92 } else { 1.0 }));
            }
        }
        let eccentricity = vec![0.0; camera.len()];
        FramePoints { camera, eccentricity, world_from_camera: Isometry3::identity(), posed: false }
    }

    #[test]
    fn the_cube_stands_on_the_table_around_the_block() {
        let points = scene([0.13, -0.08]);
        let workspace = Workspace::place(&WorkspaceRequest::Auto, Grid::default(), &points);
        assert_eq!(workspace.table_m, Some(0.1));
        let block = workspace.world_from_volume.inverse() * Point3::new(0.13, -0.08, 0.92);
        assert!((block - Point3::new(0.2, 0.2, 0.18)).norm() < 0.01, "{block}");
        // Yaw along the camera's x axis, z against its optical axis.
        let x = workspace.world_from_volume * Vector3::x();
        let z = workspace.world_from_volume * Vector3::z();
        assert!((x - Vector3::x()).norm() < 1e-2 && (z + Vector3::z()).norm() < 1e-2);
    }

    #[test]
    fn an_empty_table_and_no_table_are_placed_too() {
        let empty = scene([9.0, 9.0]);
        let workspace = Workspace::place(&WorkspaceRequest::Auto, Grid::default(), &empty);
        assert_eq!(workspace.table_m, Some(0.1));
        let nothing = FramePoints { camera: vec![], eccentricity: vec![], ..empty };
        let workspace = Workspace::place(&WorkspaceRequest::Auto, Grid::default(), &nothing);
        assert_eq!(workspace.table_m, None);
        let middle = workspace.world_from_volume * Point3::new(0.2, 0.2, 0.2);
        assert!((middle - Point3::new(0.0, 0.0, 0.5)).norm() < 1e-9);
    }

    #[test]
    fn a_placed_cube_finds_its_table() {
        let points = scene([0.0, 0.0]);
        // Corner 0.13 m below the table, z up.
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let world_from_volume = Isometry3::from_parts(Translation3::new(-0.2, 0.2, 1.13), rotation);
        let placed = |table_m| WorkspaceRequest::Placed { world_from_volume, table_m };
        let found = Workspace::place(&placed(None), Grid::default(), &points).table_m.unwrap();
        assert!((found - 0.13).abs() < 1e-6);
        let kept = Workspace::place(&placed(Some(0.05)), Grid::default(), &points);
        assert_eq!(kept.table_m, Some(0.05));
    }
}
