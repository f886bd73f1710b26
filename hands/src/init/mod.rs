//! Proposes a `hand.toml` for a URDF: fingers, closing motion, pads and approach from geometry alone.
//!
//! What can be known is taken (mimic tags, limits); the rest is derived and says in a comment how, so
//! that a person can correct it.

mod fingers;
mod motion;
mod pads;
mod text;

use nalgebra::{Point3, Unit, Vector3};

use crate::error::{Findings, Problems};
use crate::files::URDF;
use crate::solid::Solid;
use crate::urdf::Model;
use crate::{HandError, HandFiles, check, urdf};

/// A derived approach this close to an axis of the hand frame is taken to be that axis.
const SNAP: f64 = 0.9;

/// Derives the text of a `hand.toml` for a URDF.
///
/// `meshes` holds the mesh files that the URDF names (other files are ignored). The proposal loads with
/// [`crate::Hand::load`] and passes [`check`].
///
/// # Errors
/// [`HandError::Invalid`] when the URDF cannot be read, when it has no finger, or when no sensible
/// motion or pads can be derived from it (with what is wrong with the attempt).
pub fn propose(urdf: &str, meshes: &HandFiles) -> Result<String, HandError> {
    let mut findings = Findings::default();
    let Some(model) = urdf::read(urdf.as_bytes(), meshes, &mut findings) else {
        return Err(HandError::Invalid(Problems(findings.errors)));
    };
    let fingers = fingers::find(&model);
    if fingers.is_empty() {
        findings.error(
            URDF,
            "links",
            "no finger",
            "a movable part at the end of a chain of joints, with collision geometry",
        );
        return Err(HandError::Invalid(Problems(findings.errors)));
    }
    let mut motion = motion::derive(&model, &fingers);
    let palm = palm(&model, &fingers);
    let pads = pads::find(&model, &fingers, &motion, &palm);
    if pads.is_empty() {
        findings.error(URDF, "links", "no surface that closes on something", "fingers with an inner face");
        return Err(HandError::Invalid(Problems(findings.errors)));
    }
    motion::stop_at_contact(&model, &mut motion, &pads);
    let approach = approach(&model, &motion, &pads, &palm);
    let toml = text::write(&model, &fingers, &motion, &pads, &approach);

    let mut files = meshes.clone();
    files.files.extend(HandFiles::new(urdf, toml.as_str()).files);
    let report = check("proposal", &files);
    if report.passed() { Ok(toml) } else { Err(HandError::Invalid(Problems(report.errors))) }
}

/// The middle of the palm in the hand frame: of the root's shapes, or of the fingers' first joints.
fn palm(model: &Model, fingers: &[fingers::Chain]) -> Point3<f64> {
    if let Some((low, high)) = fingers::bounds(model, 0) {
        return nalgebra::center(&low, &high);
    }
    let firsts = fingers.iter().filter_map(|f| f.bodies.first());
    let bases: Vec<Point3<f64>> =
        firsts.map(|&b| Point3::from(model.tree.bodies[b].parent_from_joint.translation.vector)).collect();
    middle(&bases)
}

/// The middle of the box that some points span.
fn middle(points: &[Point3<f64>]) -> Point3<f64> {
    let Some(&first) = points.first() else { return Point3::origin() };
    let (low, high) = points.iter().fold((first, first), |(l, h), p| (l.inf(p), h.sup(p)));
    nalgebra::center(&low, &high)
}

/// The approach, and whether it was snapped to an axis.
struct Approach {
    direction: Unit<Vector3<f64>>,
    snapped: bool,
}

/// From the palm to the middle of the pads with the hand half closed.
fn approach(model: &Model, motion: &motion::Motion, pads: &[pads::PadGuess], palm: &Point3<f64>) -> Approach {
    let links = model.tree.link_poses(&model.tree.body_poses(&motion.joints(&model.mimics, 0.5)));
    let centres: Vec<Point3<f64>> = pads.iter().map(|p| links[p.link] * p.center).collect();
    let raw = middle(&centres) - palm;
    let raw = if raw.norm() > 1e-6 { raw.normalize() } else { Vector3::z() };
    let axis = raw.iamax();
    if raw[axis].abs() > SNAP {
        let mut direction = Vector3::zeros();
        direction[axis] = raw[axis].signum();
        return Approach { direction: Unit::new_unchecked(direction), snapped: true };
    }
    Approach { direction: Unit::new_normalize(raw), snapped: false }
}

/// Solids of a body, in the body frame, with the link of each.
fn solids(model: &Model, body: usize) -> Vec<(usize, &crate::CollisionShape, Solid<'_>)> {
    model
        .collision
        .iter()
        .filter(|s| model.tree.links[s.link].body == body)
        .filter_map(|s| {
            let pose = model.tree.links[s.link].body_from_link * s.link_from_shape;
            Some((s.link, s, Solid::new(pose, &s.shape)?))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Hand, library};

    fn proposal(id: &str) -> Hand {
        let files = library::files(id).unwrap();
        let urdf = String::from_utf8(files.files[URDF].clone()).unwrap();
        let toml = propose(&urdf, &HandFiles::default()).unwrap_or_else(|e| panic!("{id}: {e}"));
        let files = HandFiles::new(urdf, toml.as_str());
        Hand::load(id, &files).unwrap_or_else(|e| panic!("{id}: {e}\n{toml}"))
    }

    /// Proposals are derived once: loading is the dear part.
    static PROPOSALS: std::sync::LazyLock<std::collections::BTreeMap<&'static str, Hand>> =
        std::sync::LazyLock::new(|| library::ids().iter().map(|&id| (id, proposal(id))).collect());

    #[test]
    fn every_library_hand_can_be_proposed_from_its_urdf() {
        for id in library::ids() {
            let hand = &PROPOSALS[id];
            let known = library::hand(id).unwrap();
            assert_eq!(hand.fingers.len(), known.fingers.len(), "{id}: fingers");
            let half = |h: &Hand, t: f64| {
                let u = crate::opening::along(&h.actuation, t);
                crate::opening::pads_at(&h.tree, &h.pads, &h.actuation.joints(&u))
            };
            let spread = |t: f64| {
                let at = half(hand, t);
                at.iter().flat_map(|a| at.iter().map(|b| (a.0 - b.0).norm())).sum::<f64>()
            };
            assert!(spread(1.0) < spread(0.0), "{id}: closing brings the pads together");
        }
    }

    #[test]
    fn approach_and_opening_agree_with_the_library() {
        for id in
            ["robotiq-2f85", "finray-2f", "model-o", "panda", "leap", "finray-4f", "robotiq-3f", "antipodal"]
        {
            let (hand, known) = (&PROPOSALS[id], library::hand(id).unwrap());
            let angle = hand.approach.angle(&known.approach).to_degrees();
            assert!(angle < 25.0, "{id}: the approach is off by {angle} degrees");
            let opening = hand.opening.unwrap_or_else(|| panic!("{id}: no opposed pads"));
            assert!(opening.min_m < 0.6 * opening.max_m, "{id}: {opening:?}");
        }
        let close = |id: &str| PROPOSALS[id].opening.unwrap();
        for id in ["robotiq-2f85", "panda", "antipodal"] {
            let (found, known) = (close(id), library::hand(id).unwrap().opening.unwrap());
            assert!((found.max_m - known.max_m).abs() < 0.002, "{id}: {found:?}, known {known:?}");
        }
    }

    #[test]
    fn mimic_tags_are_kept_and_hopeless_urdfs_refused() {
        assert_eq!(PROPOSALS["panda"].actuation.coordinates.len(), 1);
        assert_eq!(PROPOSALS["barrett"].actuation.coordinates.len(), 4);
        for urdf in ["", "<robot name=\"x\"/>", "<robot name=\"x\"><link name=\"a\"/></robot>"] {
            assert!(propose(urdf, &HandFiles::default()).is_err());
        }
    }
}
