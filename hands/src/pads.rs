//! Pads from their description, and the contact candidates sampled on them.

use nalgebra::{Point3, Unit, Vector3};

use crate::description::{Description, PadEntry};
use crate::error::Findings;
use crate::files::TOML;
use crate::{ContactCandidate, Finger, Pad, Tree};

/// Largest half edge of a pad, metres.
const MAX_HALF_M: f64 = 0.2;
/// Smallest half edge of a pad, metres.
const MIN_HALF_M: f64 = 1e-4;

/// Builds fingers and pads.
pub(crate) fn build(
    description: &Description,
    tree: &Tree,
    findings: &mut Findings,
) -> (Vec<Finger>, Vec<Pad>) {
    let fingers: Vec<Finger> = description.fingers.iter().map(|f| Finger { name: f.name.clone() }).collect();
    unique(fingers.iter().map(|f| f.name.as_str()), "finger", findings);
    unique(description.pads.iter().map(|p| p.name.as_str()), "pad", findings);
    let pads = description.pads.iter().filter_map(|p| pad(p, &fingers, tree, findings)).collect();
    (fingers, pads)
}

fn unique<'a>(names: impl Iterator<Item = &'a str>, what: &str, findings: &mut Findings) {
    let mut seen = std::collections::HashSet::new();
    for name in names {
        if name.is_empty() || name.len() > 128 {
            findings.error(TOML, what, format!("name {name:?}"), "a name of 1 to 128 characters");
        }
        if !seen.insert(name) {
            findings.error(TOML, format!("{what} {name:?}"), "the name twice", "unique names");
        }
    }
}

fn pad(entry: &PadEntry, fingers: &[Finger], tree: &Tree, findings: &mut Findings) -> Option<Pad> {
    let field = |what: &str| format!("pad {:?} {what}", entry.name);
    let link = tree.link(&entry.link);
    if link.is_none() {
        findings.error(TOML, field("link"), format!("{:?}", entry.link), "the name of a link of hand.urdf");
    }
    let finger = fingers.iter().position(|f| f.name == entry.finger);
    if finger.is_none() {
        findings.error(TOML, field("finger"), format!("{:?}", entry.finger), "the name of a finger");
    }
    let (center, half_u, half_v) = match (entry.corners, entry.center, entry.half_u, entry.half_v) {
        (Some(corners), None, None, None) => {
            let [a, b, c, d] = corners.map(Vector3::from);
            // The rectangle that fits the four corners best: means of opposite edges.
            ((a + b + c + d) / 4.0, ((b + c) - (a + d)) / 4.0, ((c + d) - (a + b)) / 4.0)
        }
        (None, Some(center), Some(u), Some(v)) => (center.into(), u.into(), v.into()),
        _ => {
            findings.error(
                TOML,
                field("shape"),
                "neither or both of the two forms",
                "either corners, or center with half_u and half_v",
            );
            return None;
        }
    };
    let (center, half_u, half_v): (Vector3<f64>, Vector3<f64>, Vector3<f64>) = (center, half_u, half_v);
    let normal = Vector3::from(entry.normal);
    let cross = half_u.cross(&half_v);
    let finite = center.iter().chain(&half_u).chain(&half_v).chain(&normal).all(|v| v.is_finite());
    let edges = [half_u.norm(), half_v.norm()];
    if !finite || center.norm() > 2.0 || !edges.iter().all(|e| (MIN_HALF_M..=MAX_HALF_M).contains(e)) {
        findings.error(
            TOML,
            field("shape"),
            format!("center {:?}, half edges of {edges:?} m", center.as_slice()),
            "finite metres, half edges of 0.0001 to 0.2 m",
        );
        return None;
    }
    if normal.norm() < 1e-6 || cross.norm() < 0.5 * edges[0] * edges[1] {
        findings.error(
            TOML,
            field("normal"),
            format!("normal {:?}, edges {:?} and {:?}", entry.normal, half_u.as_slice(), half_v.as_slice()),
            "a normal other than zero, edges roughly at right angles",
        );
        return None;
    }
    let (normal, across) = (Unit::new_normalize(normal), cross.normalize());
    if normal.dot(&across).abs() < 0.9 {
        findings.error(
            TOML,
            field("normal"),
            format!("{:?}", entry.normal),
            format!("across both edges: ±{:.3?}", across.as_slice()),
        );
        return None;
    }
    Some(Pad {
        name: entry.name.clone(),
        link: link?,
        finger: finger?,
        center: center.into(),
        half_u,
        half_v,
        normal,
    })
}

/// Five candidates: the centre and four towards the corners. The paper's reference spreads its samples
/// over corners' convex combinations; these keep clear of the rim, where a contact would slip off.
const FIVE: [(f64, f64); 5] = [(0.0, 0.0), (-0.6, -0.6), (0.6, -0.6), (0.6, 0.6), (-0.6, 0.6)];
/// Nine candidates: a grid of three by three.
const NINE: [(f64, f64); 9] = [
    (0.0, 0.0),
    (-0.7, -0.7),
    (0.0, -0.7),
    (0.7, -0.7),
    (0.7, 0.0),
    (0.7, 0.7),
    (0.0, 0.7),
    (-0.7, 0.7),
    (-0.7, 0.0),
];

/// Samples the pads: 9 candidates each for up to three pads, else 5, unless `per_pad` says which.
pub(crate) fn candidates(pads: &[Pad], tree: &Tree, per_pad: Option<usize>) -> Vec<ContactCandidate> {
    let nine = per_pad.map_or(pads.len() <= 3, |n| n == 9);
    let pattern: &[(f64, f64)] = if nine { &NINE } else { &FIVE };
    let mut out = Vec::with_capacity(pads.len() * pattern.len());
    for (index, pad) in pads.iter().enumerate() {
        let link = &tree.links[pad.link];
        for &(u, v) in pattern {
            let point: Point3<f64> = pad.center + pad.half_u * u + pad.half_v * v;
            out.push(ContactCandidate {
                pad: index,
                body: link.body,
                point: link.body_from_link * point,
                normal: link.body_from_link.rotation * pad.normal,
            });
        }
    }
    out
}
