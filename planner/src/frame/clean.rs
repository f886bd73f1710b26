//! Cleaning of a depth image: what is no measurement becomes a hole, and small holes are filled.
//!
//! The reference implementation inpaints every hole. Here a hole is filled only where it is so small that its
//! border says what is inside: along a row or column, at most [`CleanOptions::fill_gap_px`] wide, between two
//! measurements of similar depth, linearly between them. Larger holes (shiny or dark objects, occlusion between
//! projector and imager) stay unknown, and the volume treats them as not seen.

use rayon::prelude::*;

use super::{DepthImage, Intrinsics};
use crate::budget::Budget;

/// Depths beyond this are no measurement of a workspace, metres.
pub const MAX_DEPTH_M: f32 = 10.0;

/// How a depth image is cleaned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CleanOptions {
    /// Widest gap that is filled, pixels; 0 fills nothing.
    pub fill_gap_px: usize,
    /// Remove pixels that hang between a near and a far surface, as time-of-flight sensors give at edges.
    pub drop_flying: bool,
    /// What one pixel sees of a surface that faces the camera, metres per metre of distance: one over the focal
    /// length in pixels. Says how steep a surface is whose depth changes from pixel to pixel.
    pub pixel: f32,
}

impl CleanOptions {
    /// The defaults, for images of this lens.
    pub fn of_lens(lens: &Intrinsics) -> Self {
        let focal_px = lens.fx_px.min(lens.fy_px);
        let pixel = if focal_px > 0.0 { (1.0 / focal_px).clamp(1e-4, 0.02) as f32 } else { 0.002 };
        Self { pixel, ..Self::default() }
    }

    /// Neighbouring pixels whose depths differ by more do not lie on one surface that a sensor sees: one 79° from
    /// facing the camera, or 6 mm where that is more.
    #[inline]
    fn step(&self, depth: f32) -> f32 {
        (5.0 * self.pixel * depth).max(0.006)
    }

    /// Whether both ends of a gap lie on one surface: [`similar`], and no steeper than 64° (noise apart), so that a
    /// gap at an object's edge gets no ramp from the object to what is behind it.
    #[inline]
    fn bridges(&self, a: f32, b: f32, gap: usize) -> bool {
        similar(a, b) && (a - b).abs() <= (2.0 * self.pixel * a.min(b) * (gap + 1) as f32).max(0.006)
    }
}

impl Default for CleanOptions {
    fn default() -> Self {
        Self { fill_gap_px: 6, drop_flying: true, pixel: 0.002 }
    }
}

/// Depths that differ by no more belong to one surface: 1 cm, or 2 % of the distance where that is more.
#[inline]
fn similar(a: f32, b: f32) -> bool {
    (a - b).abs() <= (0.02 * a.min(b)).max(0.01)
}

/// Depth in metres, row major, 0 where there is none: NaN, infinities, values ≤ 0 or above [`MAX_DEPTH_M`]
/// are holes; flying pixels are removed, then small holes are filled.
///
/// The budget is looked at in every row. When it ends the rest stays as it is: the caller looks at it next.
pub fn clean_depth(image: &DepthImage, options: &CleanOptions, budget: &dyn Budget) -> Vec<f32> {
    let width = image.width;
    let mut depth: Vec<f32> =
        image.depth_m.par_iter().map(|&d| if d > 0.0 && d <= MAX_DEPTH_M { d } else { 0.0 }).collect();
    if options.drop_flying {
        depth = without_flying(&depth, width, options, budget);
    }
    if options.fill_gap_px > 0 && depth.contains(&0.0) {
        fill_gaps(&mut depth, width, options, budget);
    }
    depth
}

/// A pixel flies when it hangs between a nearer and a further surface and belongs to neither: among its neighbours
/// there are clearly nearer and clearly further ones, and no more than [`FLYING_FRIENDS`] of its own depth. The edge
/// pixels of an object are kept, as nothing around them is nearer, and so are steep surfaces, which go on to both
/// sides. A pixel that no neighbour supports and most contradict is noise.
fn without_flying(depth: &[f32], width: usize, options: &CleanOptions, budget: &dyn Budget) -> Vec<f32> {
    let height = depth.len() / width;
    let mut out = depth.to_vec();
    out.par_chunks_mut(width).enumerate().for_each_init(
        || vec![false; width],
        |suspect, (row, out)| {
            if budget.stop().is_some() {
                return;
            }
            let line = |row: usize| &depth[row * width..(row + 1) * width];
            let here = line(row);
            let (above, below) = (line(row.max(1) - 1), line((row + 1).min(height - 1)));
            // Most pixels go on smoothly in all four directions: one pass without branches finds the others.
            suspects(suspect, here, above, below, options);
            for column in (0..width).filter(|&c| suspect[c]) {
                let columns = column.max(1) - 1..(column + 2).min(width);
                let own = here[column];
                let limit = options.step(own);
                let (mut nearer, mut further, mut friends) = (0, 0, 0);
                // Sum of the offsets to friends: nothing for two that lie opposite to each other.
                let mut lean = [0i32; 2];
                let rows = [(row > 0).then_some(above), Some(here), (row + 1 < height).then_some(below)];
                for (k, line) in rows.into_iter().enumerate() {
                    let Some(line) = line else { continue };
                    for c in columns.clone() {
                        let d = line[c];
                        if d <= 0.0 || (k == 1 && c == column) {
                            continue;
                        }
                        nearer += usize::from(d < own - limit);
                        further += usize::from(d > own + limit);
                        if (d - own).abs() <= limit {
                            friends += 1;
                            lean = [lean[0] + k as i32 - 1, lean[1] + c as i32 - column as i32];
                        }
                    }
                }
                // On a very steep surface a line of like depth goes through the pixel.
                let on_line = friends == 2 && lean == [0; 2];
                let between = nearer > 0 && further > 0 && friends <= FLYING_FRIENDS && !on_line;
                let alone = friends == 0 && nearer + further >= LONE_NEIGHBOURS;
                if between || alone {
                    out[column] = 0.0;
                }
            }
        },
    );
    out
}

/// A flying pixel may have so many neighbours of like depth by chance, as the whole band along an edge flies.
const FLYING_FRIENDS: usize = 2;
/// So many measured neighbours must contradict a pixel without support.
const LONE_NEIGHBOURS: usize = 5;

/// Marks the measured pixels of a row that jump against one of their four neighbours.
fn suspects(suspect: &mut [bool], here: &[f32], above: &[f32], below: &[f32], options: &CleanOptions) {
    let width = here.len();
    let jumps = |own: f32, d: f32| (d - own).abs() > options.step(own);
    for (((suspect, &own), &a), &b) in suspect.iter_mut().zip(here).zip(above).zip(below) {
        *suspect = own > 0.0 && (jumps(own, a) | jumps(own, b));
    }
    for column in 1..width {
        let (left, right) = (here[column - 1], here[column]);
        suspect[column] |= right > 0.0 && jumps(right, left);
        suspect[column - 1] |= left > 0.0 && jumps(left, right);
    }
}

/// Fills rows first, then, from what was measured (not from what was filled), columns.
fn fill_gaps(depth: &mut [f32], width: usize, options: &CleanOptions, budget: &dyn Budget) {
    let gap_px = options.fill_gap_px;
    let height = depth.len() / width;
    // Column gaps are found on the measurements, before rows are filled.
    let mut fills: Vec<(usize, f32)> = Vec::new();
    let mut last = vec![usize::MAX; width];
    for row in 0..height {
        if budget.stop().is_some() {
            return;
        }
        for column in 0..width {
            let d = depth[row * width + column];
            if d <= 0.0 {
                continue;
            }
            let previous = last[column];
            last[column] = row;
            if previous == usize::MAX {
                continue;
            }
            let gap = row - previous - 1;
            if gap == 0 || gap > gap_px {
                continue;
            }
            let start = depth[previous * width + column];
            if options.bridges(start, d, gap) {
                for k in 1..=gap {
                    let t = k as f32 / (gap + 1) as f32;
                    fills.push(((previous + k) * width + column, start + t * (d - start)));
                }
            }
        }
    }
    depth.par_chunks_mut(width).for_each(|row| {
        let mut previous = usize::MAX;
        for column in 0..width {
            let d = row[column];
            if d <= 0.0 {
                continue;
            }
            if previous != usize::MAX {
                let gap = column - previous - 1;
                if gap > 0 && gap <= gap_px && options.bridges(row[previous], d, gap) {
                    let start = row[previous];
                    for k in 1..=gap {
                        row[previous + k] = start + (k as f32 / (gap + 1) as f32) * (d - start);
                    }
                }
            }
            previous = column;
        }
    });
    for (index, value) in fills {
        if depth[index] <= 0.0 {
            depth[index] = value;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::budget::Unlimited;
    use proptest::prelude::*;

    fn clean(width: usize, depth_m: Vec<f32>) -> Vec<f32> {
        let height = depth_m.len() / width;
        clean_depth(&DepthImage { width, height, depth_m }, &CleanOptions::default(), &Unlimited)
    }

    #[test]
    fn what_is_no_measurement_is_a_hole() {
        let out = clean(1, vec![f32::NAN]);
        assert_eq!(out, [0.0]);
        for bad in [f32::INFINITY, -1.0, 0.0, 20.0, f32::NEG_INFINITY] {
            assert_eq!(clean(1, vec![bad]), [0.0]);
        }
    }

    #[test]
    fn small_holes_are_filled_between_similar_depths_only() {
        assert_eq!(clean(4, vec![1.0, 0.0, 0.0, 1.003]).map_close(), [1.0, 1.001, 1.002, 1.003]);
        assert_eq!(clean(4, vec![1.0, 0.0, 0.0, 1.2]), [1.0, 0.0, 0.0, 1.2]);
        let mut wide = vec![0.0; 12];
        wide[0] = 1.0;
        wide[11] = 1.0;
        assert_eq!(clean(12, wide.clone()), wide);
        // The same along a column.
        assert_eq!(clean(1, vec![0.5, 0.0, 0.5]), [0.5, 0.5, 0.5]);
    }

    #[test]
    fn a_hole_at_the_border_stays() {
        assert_eq!(clean(3, vec![0.0, 0.7, 0.7]), [0.0, 0.7, 0.7]);
    }

    #[test]
    fn flying_pixels_go_and_edges_stay() {
        assert_eq!(clean(5, vec![0.5, 0.5, 0.7, 0.9, 0.9]), [0.5, 0.5, 0.0, 0.9, 0.9]);
        assert_eq!(clean(4, vec![0.5, 0.5, 0.9, 0.9]), [0.5, 0.5, 0.9, 0.9]);
    }

    /// A box 8 cm high on a table 0.75 m below a camera, 24 by 20 pixels, with a band of flying pixels two wide
    /// around it: one on the box, one on the table, at depths spread over all between.
    fn box_with_flying_pixels() -> (usize, Vec<f32>, Vec<bool>) {
        let (width, height) = (64, 48);
        let (left, right, top, bottom) = (20i32, 44, 14, 34);
        let mut depth = vec![0.0; width * height];
        let mut flies = vec![false; width * height];
        let mut state = 7u32;
        for (i, (depth, flies)) in depth.iter_mut().zip(&mut flies).enumerate() {
            let (x, y) = ((i % width) as i32, (i / width) as i32);
            let inside = (x - left).min(right - 1 - x).min(y - top).min(bottom - 1 - y);
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let chance = (state >> 8) as f32 / 16_777_216.0;
            (*depth, *flies) = match inside {
                0 | -1 => (0.67 + 0.08 * chance, true),
                1.. => (0.67 + 0.001 * chance, false),
                _ => (0.75 + 0.001 * chance, false),
            };
        }
        (width, depth, flies)
    }

    #[test]
    fn a_band_of_flying_pixels_around_a_box_is_removed() {
        let (width, depth, flies) = box_with_flying_pixels();
        let out = without_flying(&depth, width, &CleanOptions::default(), &Unlimited);
        // What is left must lie on the box or on the table, nearly.
        let hangs = |d: f32| (0.68..0.74).contains(&d);
        let before = depth.iter().filter(|&&d| hangs(d)).count();
        let after = out.iter().filter(|&&d| hangs(d)).count();
        assert!(before > 100 && after * 6 <= before, "{before} hung before, {after} after");
        let lost = (0..out.len()).filter(|&i| !flies[i] && out[i] == 0.0).count();
        assert_eq!(lost, 0, "pixels on the surfaces stay");
    }

    #[test]
    fn a_lone_pixel_goes_and_thin_and_steep_surfaces_stay() {
        let mut lone = vec![0.75; 49];
        lone[24] = 0.70;
        assert_eq!(without_flying(&lone, 7, &CleanOptions::default(), &Unlimited)[24], 0.0);
        // A rod one pixel wide before the table, and its end.
        let rod: Vec<f32> = (0..49).map(|i| if i % 7 == 3 && i < 35 { 0.70 } else { 0.75 }).collect();
        assert_eq!(without_flying(&rod, 7, &CleanOptions::default(), &Unlimited), rod);
        // A wall 77° from facing the camera.
        let steep: Vec<f32> = (0..49).map(|i| 0.70 + 0.0065 * (i % 7) as f32).collect();
        assert_eq!(without_flying(&steep, 7, &CleanOptions::default(), &Unlimited), steep);
        // One 84° from it, but continuous: a line of like depth goes through each pixel.
        let steeper: Vec<f32> = (0..49).map(|i| 0.70 + 0.014 * (i % 7) as f32).collect();
        let out = without_flying(&steeper, 7, &CleanOptions::default(), &Unlimited);
        assert_eq!(out[7..42], steeper[7..42], "all but the first and the last row");
    }

    #[test]
    fn a_gap_at_an_edge_gets_no_ramp() {
        // 14 mm apart: near enough for one surface, but not over a gap of one pixel.
        assert_eq!(clean(3, vec![0.75, 0.0, 0.764]), [0.75, 0.0, 0.764]);
        assert_eq!(clean(3, vec![0.75, 0.0, 0.754]).map_close(), [0.75, 0.752, 0.754]);
    }

    proptest! {
        #[test]
        fn measurements_are_kept_or_dropped_never_changed(
            depth in proptest::collection::vec(prop_oneof![Just(0.0f32), Just(f32::NAN), 0.3f32..1.5], 48),
        ) {
            let out = clean(8, depth.clone());
            for (a, b) in depth.iter().zip(&out) {
                prop_assert!(b.is_finite() && *b >= 0.0);
                if *a > 0.0 && *b > 0.0 {
                    // A dropped flying pixel may be refilled between its neighbours only when those are similar,
                    // which they are not in the direction in which it flew.
                    prop_assert!((a - b).abs() < 1.3);
                }
            }
        }
    }

    trait MapClose {
        fn map_close(self) -> Vec<f32>;
    }
    impl MapClose for Vec<f32> {
        fn map_close(self) -> Vec<f32> {
            self.into_iter().map(|v| (v * 1e4).round() / 1e4).collect()
        }
    }
}
