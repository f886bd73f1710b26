//! How far grasps spread: the space that touching pads reach, the directions that they point in, and how much of one
//! source's grasps the other's also reach.

use std::collections::BTreeSet;

use nalgebra::{Point3, Vector3};

use super::pattern::{Pattern, Touch};

/// Edge of the cells that reached space is counted in, metres.
const CELL_M: f64 = 0.01;
/// Two touches of a pad are at the same place within this, metres.
const SAME_M: f64 = 0.01;
/// Two directions are the same within this, radians (15°).
const SAME_RAD: f64 = 0.262;
/// Directions that the sphere is looked at in.
const DIRECTIONS: usize = 1000;
/// A touch covers the directions within this angle, radians (10°).
const COVERS_RAD: f64 = 0.175;
/// Share of touches that are left out as far from all others (Supplementary Figs. 3 and 4: 5 %).
const OUTLIERS: f64 = 0.05;

/// Touches with the scene of each.
pub(super) type Touches<'a> = Vec<(usize, &'a Touch)>;

/// All touches of some grasps that fit.
pub(super) fn touches<'a>(patterns: &'a [Pattern], fits: impl Fn(&Touch) -> bool) -> Touches<'a> {
    let all = patterns.iter().flat_map(|p| p.touches.iter().map(|t| (p.scene, t)));
    all.filter(|(_, t)| fits(t)).collect()
}

/// Space that pads reach, cubic metres: cells of [`CELL_M`] with a touch in them, of each pad for itself, without the
/// [`OUTLIERS`] farthest from the pad's mean.
pub(super) fn reached_m3(patterns: &[Pattern], pads: usize) -> f64 {
    let of_pad = |pad: usize| {
        let mut points: Vec<Point3<f64>> =
            touches(patterns, |t| t.pad == pad).iter().map(|(_, t)| Point3::from(t.at)).collect();
        let mean = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len().max(1) as f64;
        points.sort_by(|a, b| (a.coords - mean).norm().total_cmp(&(b.coords - mean).norm()));
        points.truncate(kept(points.len()));
        let cells: BTreeSet<[i64; 3]> =
            points.iter().map(|p| [p.x, p.y, p.z].map(|v| (v / CELL_M).floor() as i64)).collect();
        cells.len()
    };
    (0..pads).map(of_pad).sum::<usize>() as f64 * CELL_M.powi(3)
}

fn kept(count: usize) -> usize {
    ((1.0 - OUTLIERS) * count as f64).ceil() as usize
}

/// Share of all directions that a finger's pads touch in, to within [`COVERS_RAD`].
pub(super) fn directions_share(patterns: &[Pattern], finger: usize) -> f64 {
    let pointed = touches(patterns, |t| t.finger == finger);
    let pointed: Vec<Vector3<f64>> = pointed.iter().map(|(_, t)| Vector3::from(t.direction)).collect();
    let least = COVERS_RAD.cos();
    let covered = sphere().filter(|d| pointed.iter().any(|p| p.dot(d) >= least)).count();
    covered as f64 / DIRECTIONS as f64
}

/// Directions spread evenly over the sphere: a spiral of golden angles.
fn sphere() -> impl Iterator<Item = Vector3<f64>> {
    (0..DIRECTIONS).map(|i| {
        let z = 1.0 - (2 * i + 1) as f64 / DIRECTIONS as f64;
        let (sin, cos) = (i as f64 * 2.399_963_229_728_653).sin_cos();
        let r = (1.0 - z * z).sqrt();
        Vector3::new(r * cos, r * sin, z)
    })
}

/// Share of `these` touches that have one of `others` from another scene with the same pad at the same place.
pub(super) fn same_places(these: &[Pattern], others: &[Pattern]) -> f64 {
    share(these, others, |a, b| {
        a.pad == b.pad && (Vector3::from(a.at) - Vector3::from(b.at)).norm() <= SAME_M
    })
}

/// The same for the finger's direction.
pub(super) fn same_directions(these: &[Pattern], others: &[Pattern]) -> f64 {
    let least = SAME_RAD.cos();
    share(these, others, |a, b| {
        a.finger == b.finger && Vector3::from(a.direction).dot(&Vector3::from(b.direction)) >= least
    })
}

fn share(these: &[Pattern], others: &[Pattern], same: impl Fn(&Touch, &Touch) -> bool) -> f64 {
    let others = touches(others, |_| true);
    let these = touches(these, |_| true);
    let met = these.iter().filter(|(scene, t)| others.iter().any(|(other, o)| other != scene && same(t, o)));
    met.count() as f64 / these.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn touch(pad: usize, at: [f64; 3], direction: [f64; 3]) -> Touch {
        Touch { pad, finger: pad, share: 1.0, at, direction }
    }

    fn pattern(scene: usize, touches: Vec<Touch>) -> Pattern {
        Pattern { scene, area: 0.5, touches }
    }

    const UP: [f64; 3] = [0.0, 0.0, 1.0];

    #[test]
    fn cells_are_counted_once_for_each_pad() {
        let mid = |i: usize| [0.005 + 0.01 * i as f64, 0.005, 0.005];
        // 20 touches in 4 cells; nothing is far from all others but by the width of a cell.
        let near: Vec<Touch> = (0..20).map(|i| touch(0, mid(i % 4), UP)).collect();
        assert!((reached_m3(&[pattern(0, near.clone())], 1) - 4e-6).abs() < 1e-12);
        let two = [pattern(0, near.clone()), pattern(1, vec![touch(1, mid(0), UP); 20])];
        assert!((reached_m3(&two, 2) - 5e-6).abs() < 1e-12);
        // One in 21 that is far away is left out.
        let mut far = near;
        far.push(touch(0, [9.0, 0.0, 0.0], UP));
        assert!((reached_m3(&[pattern(0, far)], 1) - 4e-6).abs() < 1e-12);
        assert_eq!(reached_m3(&[], 2), 0.0);
    }

    #[test]
    fn a_cap_covers_its_share_of_the_sphere() {
        let one = [pattern(0, vec![touch(0, [0.0; 3], UP)])];
        let cap = 0.5 * (1.0 - COVERS_RAD.cos());
        assert!((directions_share(&one, 0) - cap).abs() < 0.003, "{}", directions_share(&one, 0));
        assert_eq!(directions_share(&one, 1), 0.0);
        let all: Vec<Touch> = sphere().map(|d| touch(0, [0.0; 3], d.into())).collect();
        assert_eq!(directions_share(&[pattern(0, all)], 0), 1.0);
    }

    #[test]
    fn only_other_scenes_count_as_met() {
        let a = [pattern(0, vec![touch(0, [0.0; 3], UP), touch(1, [0.05, 0.0, 0.0], UP)])];
        assert_eq!((same_places(&a, &a), same_directions(&a, &a)), (0.0, 0.0));
        let b = [pattern(1, vec![touch(0, [0.009, 0.0, 0.0], [0.0, 0.2, 0.98])])];
        assert_eq!((same_places(&a, &b), same_directions(&a, &b)), (0.5, 0.5));
        assert_eq!(same_places(&b, &a), 1.0);
        let c = [pattern(1, vec![touch(0, [0.011, 0.0, 0.0], [0.0, 0.6, 0.8])])];
        assert_eq!((same_places(&a, &c), same_directions(&a, &c)), (0.0, 0.0));
    }
}
