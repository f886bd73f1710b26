//! Cleaning of a depth image: what is no measurement becomes a hole, and small holes are filled.
//!
//! The reference implementation inpaints every hole. Here a hole is filled only where it is so small that its
//! border says what is inside: along a row or column, at most [`CleanOptions::fill_gap_px`] wide, between two
//! measurements of similar depth, linearly between them. Larger holes (shiny or dark objects, occlusion between
//! projector and imager) stay unknown, and the volume treats them as not seen.

use rayon::prelude::*;

use super::DepthImage;

/// Depths beyond this are no measurement of a workspace, metres.
pub const MAX_DEPTH_M: f32 = 10.0;

/// How a depth image is cleaned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CleanOptions {
    /// Widest gap that is filled, pixels; 0 fills nothing.
    pub fill_gap_px: usize,
    /// Remove pixels that hang between a near and a far surface, as time-of-flight sensors give at edges.
    pub drop_flying: bool,
}

impl Default for CleanOptions {
    fn default() -> Self {
        Self { fill_gap_px: 6, drop_flying: true }
    }
}

/// Depths that differ by no more belong to one surface: 1 cm, or 2 % of the distance where that is more.
#[inline]
fn similar(a: f32, b: f32) -> bool {
    (a - b).abs() <= (0.02 * a.min(b)).max(0.01)
}

/// Depth in metres, row major, 0 where there is none: NaN, infinities, values ≤ 0 or above [`MAX_DEPTH_M`]
/// are holes; flying pixels are removed, then small holes are filled.
pub fn clean_depth(image: &DepthImage, options: &CleanOptions) -> Vec<f32> {
    let width = image.width;
    let mut depth: Vec<f32> =
        image.depth_m.par_iter().map(|&d| if d > 0.0 && d <= MAX_DEPTH_M { d } else { 0.0 }).collect();
    if options.drop_flying {
        depth = without_flying(&depth, width);
    }
    if options.fill_gap_px > 0 && depth.contains(&0.0) {
        fill_gaps(&mut depth, width, options.fill_gap_px);
    }
    depth
}

/// A pixel flies when, along its row or column, one neighbour is clearly nearer and the opposite one clearly
/// further: no surface that a sensor sees is so steep.
fn without_flying(depth: &[f32], width: usize) -> Vec<f32> {
    let height = depth.len() / width;
    let mut out = depth.to_vec();
    out.par_chunks_mut(width).enumerate().for_each(|(row, out)| {
        let here = &depth[row * width..(row + 1) * width];
        let flies = |d: f32, a: f32, b: f32| {
            let t = (0.02 * d).max(0.01);
            a > 0.0 && b > 0.0 && ((a < d - t && b > d + t) || (a > d + t && b < d - t))
        };
        for (column, w) in here.windows(3).enumerate() {
            if flies(w[1], w[0], w[2]) {
                out[column + 1] = 0.0;
            }
        }
        if row > 0 && row + 1 < height {
            let above = &depth[(row - 1) * width..row * width];
            let below = &depth[(row + 1) * width..(row + 2) * width];
            for column in 0..width {
                if flies(here[column], above[column], below[column]) {
                    out[column] = 0.0;
                }
            }
        }
    });
    out
}

/// Fills rows first, then, from what was measured (not from what was filled), columns.
fn fill_gaps(depth: &mut [f32], width: usize, gap_px: usize) {
    let height = depth.len() / width;
    // Column gaps are found on the measurements, before rows are filled.
    let mut fills: Vec<(usize, f32)> = Vec::new();
    let mut last = vec![usize::MAX; width];
    for row in 0..height {
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
            if similar(start, d) {
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
                if gap > 0 && gap <= gap_px && similar(row[previous], d) {
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
    use proptest::prelude::*;

    fn clean(width: usize, depth_m: Vec<f32>) -> Vec<f32> {
        let height = depth_m.len() / width;
        clean_depth(&DepthImage { width, height, depth_m }, &CleanOptions::default())
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
