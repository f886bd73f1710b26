//! Says precisely what is wrong with a hand's folder, and what is worth a look in one that loads.

use std::fmt;

use nalgebra::{Isometry3, Point3};

use crate::error::{Findings, Problem};
use crate::files::{TOML, URDF};
use crate::opening::{along, pads_at};
use crate::solid::Solid;
use crate::{Hand, HandFiles, load, self_collision};

/// A pad's centre may lie this far from the surface of its part, metres.
const PAD_OFF_M: f64 = 0.003;
/// How far from a pad its two sides are probed, metres.
const PROBE_M: f64 = 0.004;
/// Candidates may lie this deep inside the sphere covering, metres.
const BURIED_M: f64 = 0.002;
/// Coverings may overlap this deep with the hand open: twice the usual tolerance of one.
const OPEN_OVERLAP_M: f64 = 0.008;

/// The outcome of [`check`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Report {
    /// Problems that make the hand unusable; empty for a hand that [`Hand::load`] accepts and whose pads
    /// and motion make sense.
    pub errors: Vec<Problem>,
    /// Things worth a look.
    pub warnings: Vec<Problem>,
    /// What the hand is (its `Display`), a few lines of text; empty when it does not load.
    pub summary: String,
}

impl Report {
    /// True without errors.
    pub fn passed(&self) -> bool {
        self.errors.is_empty()
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.errors.iter().try_for_each(|p| writeln!(f, "error: {p}"))?;
        self.warnings.iter().try_for_each(|p| writeln!(f, "warning: {p}"))?;
        f.write_str(&self.summary)
    }
}

/// Checks the contents of a hand's folder: everything that [`Hand::load`] checks, and then whether pads
/// lie on the surface and face outwards, whether closing brings them together, and whether the open hand
/// is free of itself.
pub fn check(id: &str, files: &HandFiles) -> Report {
    let mut findings = Findings::default();
    if let Err(error) = load::check_id(id) {
        findings.error("", "id", format!("{id:?}"), error);
    }
    for file in [URDF, TOML] {
        if !files.files.contains_key(file) {
            findings.error(file, "file", "nothing", "hand.urdf and hand.toml in the folder");
        }
    }
    let hand = load::read(id, files, &mut findings);
    let mut text = String::new();
    if let Some(hand) = hand {
        pads(&hand, &mut findings);
        buried(&hand, &mut findings);
        closing(&hand, &mut findings);
        open_posture(&hand, &mut findings);
        text = hand.to_string();
    }
    Report { errors: findings.errors, warnings: findings.warnings, summary: text }
}

/// Pads lie on the surface of their part, with normals outwards.
fn pads(hand: &Hand, findings: &mut Findings) {
    for pad in &hand.pads {
        let link = &hand.tree.links[pad.link];
        let solids: Vec<Solid<'_>> = hand
            .collision
            .iter()
            .filter(|s| hand.tree.links[s.link].body == link.body)
            .filter_map(|s| Solid::new(hand.tree.links[s.link].body_from_link * s.link_from_shape, &s.shape))
            .collect();
        let depth = |p: &Point3<f64>| {
            let p = link.body_from_link * p;
            solids.iter().map(|s| s.depth(&p)).fold(f64::NEG_INFINITY, f64::max)
        };
        let field = format!("pad {:?}", pad.name);
        let at = depth(&pad.center);
        if at > PAD_OFF_M {
            findings.error(
                TOML,
                &field,
                format!("its centre {:.1} mm inside the part", at * 1e3),
                "a centre on the surface (within 3 mm): a buried pad never touches",
            );
        } else if at < -PAD_OFF_M {
            findings.warn(
                TOML,
                &field,
                format!("its centre {:.1} mm off the part", -at * 1e3),
                "a centre on the surface (within 3 mm)",
            );
        }
        let (outside, inside) =
            (depth(&(pad.center + *pad.normal * PROBE_M)), depth(&(pad.center - *pad.normal * PROBE_M)));
        if outside > inside {
            findings.error(
                TOML,
                format!("{field} normal"),
                format!("{:.3?}, which points into the part", pad.normal.as_slice()),
                "the outward normal: from the finger towards the object",
            );
        }
    }
}

/// Candidates are not inside the sphere covering.
fn buried(hand: &Hand, findings: &mut Findings) {
    let poses = hand.tree.body_poses(&hand.actuation.joints(&hand.actuation.open()));
    let mut told = vec![false; hand.pads.len()];
    for candidate in &hand.candidates {
        let point = poses[candidate.body] * candidate.point;
        for sphere in &hand.spheres {
            let depth = sphere.radius - (poses[sphere.body] * sphere.center - point).norm();
            // A pad is meant to be on the surface of its own part; there the height above the pad counts,
            // which the covering bounds. A sphere of another body must stay away.
            let other = !self_collision::adjacent(&hand.tree, sphere.body, candidate.body);
            if other && depth > BURIED_M && !told[candidate.pad] {
                told[candidate.pad] = true;
                findings.warn(
                    TOML,
                    format!("pad {:?}", hand.pads[candidate.pad].name),
                    format!(
                        "a candidate {:.1} mm inside link {:?} with the hand open",
                        depth * 1e3,
                        hand.tree.links[sphere.link].name
                    ),
                    "pads clear of other links",
                );
            }
        }
    }
}

/// Closing brings pads of different fingers together.
fn closing(hand: &Hand, findings: &mut Findings) {
    let pairs: Vec<(usize, usize)> = (0..hand.pads.len())
        .flat_map(|i| (i + 1..hand.pads.len()).map(move |j| (i, j)))
        .filter(|&(i, j)| hand.pads[i].finger != hand.pads[j].finger)
        .collect();
    if pairs.is_empty() {
        findings.warn(TOML, "pads", "pads of one finger only", "pads of at least two fingers");
        return;
    }
    let spread = |fraction: f64| {
        let q = hand.actuation.joints(&along(&hand.actuation, fraction));
        let at = pads_at(&hand.tree, &hand.pads, &q);
        pairs.iter().map(|&(i, j)| (at[i].0 - at[j].0).norm()).sum::<f64>() / pairs.len() as f64
    };
    let (open, least) =
        (spread(0.0), (1..=16).map(|n| spread(f64::from(n) / 16.0)).fold(f64::INFINITY, f64::min));
    if least > open - 1e-4 {
        findings.error(
            TOML,
            "actuators open and closed",
            format!(
                "pads {:.1} mm apart on average when open, never closer than {:.1} mm",
                open * 1e3,
                least * 1e3
            ),
            "a motion from open to closed that brings pads of different fingers together",
        );
    }
    if hand.opening.is_none() {
        findings.warn(
            TOML,
            "pads",
            "no two pads of different fingers that face each other with room between them while the hand closes",
            "opposed pads, and open and closed on their two sides: otherwise no opening is known",
        );
    }
}

/// The open hand does not collide with itself.
fn open_posture(hand: &Hand, findings: &mut Findings) {
    let poses: Vec<Isometry3<f64>> = hand.tree.body_poses(&hand.actuation.joints(&hand.actuation.open()));
    let mut worst = std::collections::BTreeMap::new();
    for (i, a) in hand.spheres.iter().enumerate() {
        for b in &hand.spheres[i + 1..] {
            if self_collision::adjacent(&hand.tree, a.body, b.body) {
                continue;
            }
            let depth = a.radius + b.radius - (poses[a.body] * a.center - poses[b.body] * b.center).norm();
            if depth > OPEN_OVERLAP_M {
                let deepest: &mut f64 = worst.entry((a.link, b.link)).or_insert(0.0);
                *deepest = deepest.max(depth);
            }
        }
    }
    for ((a, b), depth) in worst {
        let (a, b) = (&hand.tree.links[a].name, &hand.tree.links[b].name);
        findings.warn(
            TOML,
            "open posture",
            format!("links {a:?} and {b:?} overlap by about {:.1} mm", depth * 1e3),
            "an open hand that does not touch itself (such pairs are left out of self-collision)",
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::library;

    /// A library hand with one replacement in its description.
    fn edited(id: &str, from: &str, to: &str) -> HandFiles {
        let mut files = library::files(id).unwrap();
        let toml = String::from_utf8(files.files[TOML].clone()).unwrap();
        assert!(toml.contains(from), "{id} has {from}");
        files.files.insert(TOML.into(), toml.replacen(from, to, 1).into_bytes());
        files
    }

    #[test]
    fn the_library_passes() {
        let mut bad = String::new();
        for id in library::ids() {
            let report = check(id, &library::files(id).unwrap());
            if !(report.passed() && report.warnings.is_empty() && report.summary.contains("actuators")) {
                bad += &format!("{id}:\n{report}");
            }
        }
        assert!(bad.is_empty(), "{bad}");
    }

    #[test]
    fn finds_buried_pads_inward_normals_and_hands_that_open_when_they_close() {
        let report =
            check("panda", &edited("panda", "center = [0.0, 0.0, 0.0445]", "center = [0.0, 0.006, 0.0445]"));
        assert!(report.errors.iter().any(|p| p.found.contains("inside the part")), "{report}");
        let report =
            check("panda", &edited("panda", "normal = [0.0, -1.0, 0.0]", "normal = [0.0, 1.0, 0.0]"));
        assert!(report.errors.iter().any(|p| p.field.contains("normal")), "{report}");
        let swapped = edited("panda", "open = 0.04\nclosed = 0.0\n", "open = 0.0\nclosed = 0.04\n");
        let report = check("panda", &swapped);
        assert!(report.errors.iter().any(|p| p.field.contains("open and closed")), "{report}");
    }

    #[test]
    fn reports_several_problems_at_once() {
        let mut files = edited("panda", "finger = \"left\"", "finger = \"thumb\"");
        let toml = String::from_utf8(files.files[TOML].clone()).unwrap();
        let toml =
            toml.replace("link = \"panda_rightfinger\"", "link = \"nowhere\"").replace("effort", "efort");
        files.files.insert(TOML.into(), toml.into_bytes());
        let report = check("Panda", &files);
        assert!(report.errors.len() >= 2, "{report}");
        let report = check("panda", &HandFiles::default());
        assert_eq!(report.errors.len(), 2);
    }
}
