//! A picture of a sample, to judge it by eye.
//!
//! Three by two panels: the depth image; the volume from above with contacts by score; the same by direction; centroids
//! from above; a level slice and an upright slice through the TSDF with contacts and their directions.

use graspd_planner::grid::Grid;
use graspd_sim::render::RgbImage;
use nalgebra::Vector3;

use super::sample::{OCCUPIED, Sample};

/// Pixels along each side of a voxel.
const SCALE: usize = 5;
/// Gap between panels, pixels.
const GAP: usize = 8;
/// What lies behind the panels.
const GROUND: [u8; 3] = [14, 17, 22];
/// Directions are drawn for one voxel in so many along each axis.
const EVERY: usize = 2;

/// What a panel's two axes and its line of sight are: indices of the volume's axes.
#[derive(Debug, Clone, Copy)]
struct Plane {
    right: usize,
    up: usize,
    along: usize,
}

const LEVEL: Plane = Plane { right: 0, up: 1, along: 2 };
const UPRIGHT: Plane = Plane { right: 0, up: 2, along: 1 };

/// The picture; empty volumes give dark panels.
pub fn picture(sample: &Sample) -> RgbImage {
    let grid = Grid { resolution: sample.resolution as usize, size_m: 1.0 };
    let n = grid.resolution;
    let side = n * SCALE;
    let above = from_above(sample, &grid);
    let by = |color: &dyn Fn(usize) -> [u8; 3]| {
        let mut panel = above.clone();
        for (at, i) in highest(sample, &grid) {
            panel.voxel([at / n, at % n], color(i));
        }
        panel
    };
    let score = by(&|i| heat(sample.contacts[i].score()));
    let direction = by(&|i| compass(&sample.contacts[i].inward()));
    let mut centroids = above.clone();
    let mut best = vec![0.0f32; n * n];
    for c in &sample.centroids {
        let [x, y, _] = grid.voxel(c.index as usize);
        best[x * n + y] = best[x * n + y].max(c.score());
    }
    for (at, &value) in best.iter().enumerate().filter(|(_, v)| **v > 0.0) {
        centroids.voxel([at / n, at % n], heat(value));
    }
    let panels = [
        depth(sample, side),
        score,
        direction,
        centroids,
        slice(sample, &grid, LEVEL),
        slice(sample, &grid, UPRIGHT),
    ];
    let (width, height) = (3 * side + 4 * GAP, 2 * side + 3 * GAP);
    let mut image = RgbImage { width, height, pixels: vec![GROUND; width * height] };
    for (i, panel) in panels.iter().enumerate() {
        let (left, top) = (GAP + i % 3 * (side + GAP), GAP + i / 3 * (side + GAP));
        for (row, pixels) in panel.pixels.chunks(side).enumerate() {
            let at = (top + row) * width + left;
            image.pixels[at..at + side].copy_from_slice(pixels);
        }
    }
    image
}

/// A square of voxels.
#[derive(Debug, Clone)]
struct Panel {
    voxels: usize,
    pixels: Vec<[u8; 3]>,
}

impl Panel {
    fn new(voxels: usize) -> Self {
        Self { voxels, pixels: vec![[0; 3]; (voxels * SCALE).pow(2)] }
    }

    fn pixel(&mut self, right: usize, down: usize, color: [u8; 3]) {
        let side = self.voxels * SCALE;
        if right < side && down < side {
            self.pixels[down * side + right] = color;
        }
    }

    /// Fills a voxel; the second axis points up.
    fn voxel(&mut self, [right, up]: [usize; 2], color: [u8; 3]) {
        for v in 0..SCALE {
            for u in 0..SCALE {
                self.pixel(right * SCALE + u, (self.voxels - 1 - up) * SCALE + v, color);
            }
        }
    }

    /// A line from a voxel's middle in a direction (right, up), two voxels long for a unit vector.
    fn needle(&mut self, [right, up]: [usize; 2], direction: [f64; 2]) {
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

/// The highest surface of every column, brighter the higher.
fn from_above(sample: &Sample, grid: &Grid) -> Panel {
    let n = grid.resolution;
    let mut panel = Panel::new(n);
    for x in 0..n {
        for y in 0..n {
            let column = &sample.tsdf[grid.index(x, y, 0)..][..n];
            if let Some(z) = column.iter().rposition(|v| OCCUPIED.contains(v)) {
                panel.voxel([x, y], grey(0.12 + 0.7 * z as f32 / n as f32));
            }
        }
    }
    panel
}

/// Per column (x·n + y) with contacts the one with the highest score.
fn highest(sample: &Sample, grid: &Grid) -> Vec<(usize, usize)> {
    let n = grid.resolution;
    let mut best: Vec<Option<usize>> = vec![None; n * n];
    for (i, contact) in sample.contacts.iter().enumerate() {
        let [x, y, _] = grid.voxel(contact.index as usize);
        let own = &mut best[x * n + y];
        if own.is_none_or(|other| sample.contacts[other].score < contact.score) {
            *own = Some(i);
        }
    }
    best.into_iter().enumerate().filter_map(|(at, i)| Some((at, i?))).collect()
}

/// The slice with the most contacts: TSDF in grey, contacts by score with their directions.
fn slice(sample: &Sample, grid: &Grid, plane: Plane) -> Panel {
    let n = grid.resolution;
    let mut counts = vec![0usize; n];
    for c in &sample.contacts {
        counts[grid.voxel(c.index as usize)[plane.along]] += 1;
    }
    let deepest = (0..n).max_by_key(|&i| counts[i]).unwrap_or(0);
    let mut panel = Panel::new(n);
    for a in 0..n {
        for b in 0..n {
            let mut voxel = [0; 3];
            (voxel[plane.right], voxel[plane.up], voxel[plane.along]) = (a, b, deepest);
            let value = sample.tsdf[grid.index(voxel[0], voxel[1], voxel[2])];
            // Unseen black, inside dark, the surface's two sides apart.
            let shade = match value {
                0 => [0, 0, 0],
                v if OCCUPIED.contains(&v) => [70, 50, 90],
                v => grey(0.05 + 0.5 * (f32::from(v) / 255.0 - 0.5)),
            };
            panel.voxel([a, b], shade);
        }
    }
    let mut needles = Vec::new();
    for c in &sample.contacts {
        let voxel = grid.voxel(c.index as usize);
        if voxel[plane.along] == deepest {
            let at = [voxel[plane.right], voxel[plane.up]];
            panel.voxel(at, heat(c.score()));
            let inward = c.inward();
            if voxel.iter().sum::<usize>() % EVERY == 0 {
                needles.push((at, [inward[plane.right], inward[plane.up]]));
            }
        }
    }
    for (at, direction) in needles {
        panel.needle(at, direction);
    }
    panel
}

/// The preview, as large as a panel: near is bright, no return is dark red.
fn depth(sample: &Sample, side: usize) -> Panel {
    let preview = &sample.preview;
    let (width, height) = (usize::from(preview.width), usize::from(preview.height));
    let mut panel = Panel { voxels: side / SCALE, pixels: vec![GROUND; side * side] };
    let seen = || preview.depth_mm.iter().copied().filter(|d| *d > 0);
    let (Some(near), Some(far)) = (seen().min(), seen().max()) else { return panel };
    let largest = width.max(height);
    let (left, top) = ((side - side * width / largest) / 2, (side - side * height / largest) / 2);
    for down in top..side - top {
        for right in left..side - left {
            let (u, v) = ((right - left) * largest / side, (down - top) * largest / side);
            let Some(&d) = preview.depth_mm.get(v * width + u).filter(|_| u < width && v < height) else {
                continue;
            };
            let share = f32::from(far - d.clamp(near, far)) / f32::from((far - near).max(1));
            panel.pixel(right, down, if d == 0 { [70, 10, 10] } else { grey(0.1 + 0.9 * share) });
        }
    }
    panel
}

fn grey(value: f32) -> [u8; 3] {
    [(value.clamp(0.0, 1.0) * 255.0) as u8; 3]
}

/// From blue (0) over cyan, green and yellow to red (1).
fn heat(value: f32) -> [u8; 3] {
    [4.0 * value - 2.0, (4.0 * value).min(4.0 - 4.0 * value), 2.0 - 4.0 * value]
        .map(|channel| (255.0 * channel.clamp(0.0, 1.0)) as u8)
}

/// A direction as a colour: red along x, green along y, blue along z, half for none.
fn compass(direction: &Vector3<f64>) -> [u8; 3] {
    [0, 1, 2].map(|a| (127.5 + 127.5 * direction[a]) as u8)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::sample::samples::any_sample;
    use super::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        #[test]
        fn any_sample_can_be_drawn(sample in any_sample()) {
            let image = picture(&sample);
            prop_assert_eq!(image.pixels.len(), image.width * image.height);
        }
    }

    #[test]
    fn high_scores_are_red_and_low_ones_blue() {
        assert!(heat(1.0)[0] > 200 && heat(1.0)[2] == 0, "{:?}", heat(1.0));
        assert!(heat(0.1)[2] > 150 && heat(0.1)[0] == 0, "{:?}", heat(0.1));
        assert_eq!(compass(&Vector3::x()), [255, 127, 127]);
    }
}
