//! How far a hand opens, and where its tool point is: both from the motion of its pads.

use nalgebra::{Isometry3, Point3, Unit, Vector3};

use crate::{Actuation, Opening, Pad, Tree};

/// Steps between open and closed.
const STEPS: usize = 48;
/// Pads that are never farther apart while they face each other do not open, metres.
const LEAST_OPENING_M: f64 = 0.001;
/// Pads oppose each other when their normals differ by more than this cosine (about 110°).
const OPPOSED: f64 = -0.35;

/// Coordinates at a fraction of the way from open to closed.
pub(crate) fn along(actuation: &Actuation, fraction: f64) -> Vec<f64> {
    actuation.coordinates.iter().map(|c| c.open + fraction * (c.closed - c.open)).collect()
}

/// Centres and normals of the pads in the hand frame.
pub(crate) fn pads_at(tree: &Tree, pads: &[Pad], q: &[f64]) -> Vec<(Point3<f64>, Unit<Vector3<f64>>)> {
    let links: Vec<Isometry3<f64>> = tree.link_poses(&tree.body_poses(q));
    pads.iter().map(|p| (links[p.link] * p.center, links[p.link].rotation * p.normal)).collect()
}

/// Largest and smallest gap between opposed pads of different fingers while the hand closes; `None`
/// when no two pads face each other with room between them.
///
/// The gap is measured along the direction in which the two pads face each other, and counts from open
/// until the pads meet. Pads that have faced each other and then curl on (wrapping fingers) still come
/// closer: for the smallest gap the distance of their centres counts from there on.
pub(crate) fn opening(tree: &Tree, actuation: &Actuation, pads: &[Pad]) -> Option<Opening> {
    /// What two pads have done so far.
    #[derive(Clone, Copy, PartialEq)]
    enum Pair {
        Apart,
        Facing,
        Met,
    }
    let mut range: Option<(f64, f64)> = None;
    let mut pairs = vec![Pair::Apart; pads.len() * pads.len()];
    for step in 0..=STEPS {
        let u = along(actuation, step as f64 / STEPS as f64);
        let at = pads_at(tree, pads, &actuation.joints(&u));
        for i in 0..pads.len() {
            for j in i + 1..pads.len() {
                let pair = &mut pairs[i * pads.len() + j];
                if pads[i].finger == pads[j].finger || *pair == Pair::Met {
                    continue;
                }
                let (low, high) = range.unwrap_or((f64::INFINITY, 0.0));
                if let Some(gap) = gap(&at[i], &at[j]) {
                    *pair = if gap > 0.0 { Pair::Facing } else { Pair::Met };
                    range = Some((low.min(gap.max(0.0)), high.max(gap)));
                } else if *pair == Pair::Facing {
                    range = Some((low.min((at[j].0 - at[i].0).norm()), high));
                }
            }
        }
    }
    range.filter(|&(_, most)| most > LEAST_OPENING_M).map(|(min_m, max_m)| Opening { min_m, max_m })
}

/// Gap between two pads that face each other; negative when they have passed each other.
pub(crate) fn gap(
    a: &(Point3<f64>, Unit<Vector3<f64>>),
    b: &(Point3<f64>, Unit<Vector3<f64>>),
) -> Option<f64> {
    if a.1.dot(&b.1) > OPPOSED {
        return None;
    }
    let direction = (a.1.into_inner() - b.1.into_inner()).normalize();
    Some((b.0 - a.0).dot(&direction))
}

/// The middle of the space between the pads with the hand half closed: of the box that their centres span.
///
/// Not their mean: a hand with two fingers against one closes on the middle, not nearer to the two.
pub(crate) fn tool_point(tree: &Tree, actuation: &Actuation, pads: &[Pad]) -> Point3<f64> {
    let at = pads_at(tree, pads, &actuation.joints(&along(actuation, 0.5)));
    let Some(&(first, _)) = at.first() else { return Point3::origin() };
    let (low, high) = at.iter().fold((first, first), |(low, high), (p, _)| (low.inf(p), high.sup(p)));
    nalgebra::center(&low, &high)
}

#[cfg(test)]
mod tests {
    use crate::{HandFiles, check, library};

    #[test]
    fn a_hand_that_never_stands_open_has_no_opening() {
        // Pads that face each other, but never more than 0.6 mm apart.
        let files = library::files("panda").unwrap();
        let toml = String::from_utf8(files.files["hand.toml"].clone()).unwrap();
        let toml = toml.replace("open = 0.04", "open = 0.0003");
        let report = check("panda", &HandFiles::new(files.files["hand.urdf"].clone(), toml));
        assert!(report.warnings.iter().any(|p| p.found.contains("room between them")), "{report}");
        assert!(
            report.summary.contains("no opposed pads") && !report.summary.contains("opens from"),
            "{report}"
        );
    }
}
