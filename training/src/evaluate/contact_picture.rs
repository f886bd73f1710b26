//! Contacts and centroids of a view from above, as labelled and as networks find them: the cells of a picture laid out
//! like Supplementary Fig. 1. One pixel is one column of voxels.

use graspd_inference::Output;
use graspd_planner::grid::Grid;
use graspd_sim::render::RgbImage;
use nalgebra::Vector3;

use crate::dataset::panel::{compass, heat, heights};
use crate::dataset::sample::Sample;

/// What is less certain is not drawn.
const LEAST: f32 = 0.1;

/// One voxel of a field: its place, how certain it is, and into which direction a finger would press there.
type Marked = (usize, f32, Vector3<f64>);

/// Labelled contacts (left) and centroids (right).
pub fn labelled(view: &Sample) -> RgbImage {
    let contacts = view.contacts.iter().map(|c| (c.index as usize, c.score(), c.inward()));
    let centroids = view.centroids.iter().map(|c| (c.index as usize, c.score()));
    cell(view, contacts, centroids)
}

/// The same of what a network answers for the view.
pub fn found(view: &Sample, answer: &Output) -> RgbImage {
    let inward = |i| Vector3::from(answer.orientation.inward(i)).cast::<f64>();
    let contacts = answer.certainty.iter().enumerate().filter(|(_, p)| **p >= LEAST);
    let contacts = contacts.map(|(i, p)| (i, *p, inward(i)));
    cell(view, contacts, answer.centroid.iter().copied().enumerate())
}

/// Both fields over the surface, the most certain voxel of every column: contacts in the colour of their direction, the
/// fuller the more certain; centroids from blue to red.
fn cell(
    view: &Sample,
    contacts: impl Iterator<Item = Marked>,
    centroids: impl Iterator<Item = (usize, f32)>,
) -> RgbImage {
    let grid = Grid { resolution: view.resolution as usize, size_m: 1.0 };
    let n = grid.resolution;
    let ground: Vec<[u8; 3]> = heights(view, &grid).into_iter().map(Option::unwrap_or_default).collect();
    let column = |i: usize| {
        let [x, y, _] = grid.voxel(i);
        x * n + y
    };
    let mut surest: Vec<Option<Marked>> = vec![None; n * n];
    for marked in contacts.filter(|m| m.1 >= LEAST && m.0 < grid.len()) {
        let own = &mut surest[column(marked.0)];
        if own.is_none_or(|other| other.1 < marked.1) {
            *own = Some(marked);
        }
    }
    let mut likeliest = vec![0.0f32; n * n];
    for (i, p) in centroids.filter(|c| c.1 >= LEAST && c.0 < grid.len()) {
        let own = &mut likeliest[column(i)];
        *own = own.max(p);
    }
    let left =
        |at: usize| surest[at].map_or(ground[at], |(_, p, inward)| mixed(ground[at], compass(&inward), p));
    let right = |at: usize| if likeliest[at] > 0.0 { heat(likeliest[at]) } else { ground[at] };
    let mut pixels = Vec::with_capacity(2 * n * n);
    for y in (0..n).rev() {
        pixels.extend((0..n).map(|x| left(x * n + y)));
        pixels.extend((0..n).map(|x| right(x * n + y)));
    }
    RgbImage { width: 2 * n, height: n, pixels }
}

fn mixed(ground: [u8; 3], color: [u8; 3], share: f32) -> [u8; 3] {
    let share = share.clamp(0.0, 1.0);
    [0, 1, 2].map(|c| (f32::from(ground[c]) * (1.0 - share) + f32::from(color[c]) * share) as u8)
}

#[cfg(test)]
mod tests {
    use graspd_inference::Orientations;
    use proptest::prelude::*;

    use super::*;
    use crate::dataset::sample::samples::any_sample;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        #[test]
        fn every_view_can_be_drawn_and_an_answer_equal_to_the_labels_looks_like_them(view in any_sample()) {
            let voxels = (view.resolution as usize).pow(3);
            let mut answer = Output {
                certainty: vec![0.0; voxels],
                orientation: Orientations::Quaternion(vec![[0.0, 0.0, 0.0, 1.0]; voxels]),
                centroid: vec![0.0; voxels],
            };
            let Orientations::Quaternion(q) = &mut answer.orientation else { unreachable!() };
            for c in &view.contacts {
                answer.certainty[c.index as usize] = c.score();
                q[c.index as usize] = c.quaternion().coords.cast::<f32>().into();
            }
            for c in &view.centroids {
                answer.centroid[c.index as usize] = c.score();
            }
            let (labels, same) = (labelled(&view), found(&view, &answer));
            prop_assert_eq!(labels.pixels.len(), labels.width * labels.height);
            // The last bit of a direction may differ, and of two equal scores in one column either may be shown.
            let apart = |a: &[u8; 3], b: &[u8; 3]| (0..3).any(|c| a[c].abs_diff(b[c]) > 2);
            let differ = labels.pixels.iter().zip(&same.pixels).filter(|(a, b)| apart(a, b)).count();
            prop_assert_eq!(differ, 0);
        }
    }
}
