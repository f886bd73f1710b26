//! A picture of a sample, to judge it by eye.
//!
//! Three by two panels: the depth image; the volume from above with contacts by score; the same by direction; centroids
//! from above; a level slice and an upright slice through the TSDF with contacts and their directions.

use graspd_planner::grid::Grid;
use graspd_sim::render::RgbImage;

use super::panel::{Panel, SCALE, compass, from_above, grey, heat};
use super::sample::{OCCUPIED, Sample};

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
}
