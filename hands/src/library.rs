//! The hands that are compiled in.

use std::sync::LazyLock;

use crate::{Hand, HandFiles};

/// One hand of the library.
struct Entry {
    id: &'static str,
    urdf: &'static str,
    toml: &'static str,
    /// Loaded when first asked for; `None` would be a fault of the library, which its tests rule out.
    hand: LazyLock<Option<Hand>>,
}

macro_rules! entries {
    ($($id:literal),* $(,)?) => {
        /// All entries, in the order in which they are listed.
        static ENTRIES: [Entry; IDS.len()] = [$(Entry {
            id: $id,
            urdf: include_str!(concat!("../library/", $id, "/hand.urdf")),
            toml: include_str!(concat!("../library/", $id, "/hand.toml")),
            hand: LazyLock::new(|| files($id).and_then(|files| Hand::load($id, &files).ok())),
        }),*];

        /// All ids, in the order in which they are listed.
        static IDS: &[&str] = &[$($id),*];
    };
}

entries!(
    "finray-2f",
    "robotiq-2f85",
    "robotiq-3f",
    "model-o",
    "finray-4f",
    "brunel",
    "leap",
    "barrett",
    "antipodal",
    "allegro",
    "panda",
);

/// The ids of all hands in the library.
pub fn ids() -> &'static [&'static str] {
    IDS
}

/// The files of a library hand: a starting point for a description of one's own.
pub fn files(id: &str) -> Option<HandFiles> {
    ENTRIES.iter().find(|e| e.id == id).map(|e| HandFiles::new(e.urdf, e.toml))
}

/// A library hand, loaded when first asked for. `None` for an unknown id.
pub fn hand(id: &str) -> Option<&'static Hand> {
    ENTRIES.iter().find(|e| e.id == id).and_then(|e| e.hand.as_ref())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::opening::{along, gap, pads_at};

    /// Fingers, joints, actuators and contact candidates: Supplementary Table 2 for the paper's seven
    /// hands, and what the others are built with. Barrett's six pads: Supplementary Table 3.
    const COUNTS: [(&str, [usize; 4]); 11] = [
        ("finray-2f", [2, 2, 1, 18]),
        ("robotiq-2f85", [2, 2, 1, 18]),
        ("robotiq-3f", [3, 11, 4, 30]),
        ("model-o", [3, 5, 4, 27]),
        ("finray-4f", [4, 4, 1, 20]),
        ("brunel", [5, 9, 4, 40]),
        ("leap", [4, 16, 16, 30]),
        ("barrett", [3, 8, 4, 30]),
        ("antipodal", [2, 2, 1, 18]),
        ("allegro", [4, 16, 16, 40]),
        ("panda", [2, 2, 1, 18]),
    ];

    #[test]
    fn every_hand_loads_with_the_published_counts() {
        assert_eq!(ids(), COUNTS.map(|(id, _)| id));
        for (id, counts) in COUNTS {
            let hand = Hand::load(id, &files(id).unwrap()).unwrap_or_else(|e| panic!("{id}: {e}"));
            let found = [
                hand.fingers.len(),
                hand.tree.joints.len(),
                hand.actuation.actuator_count(),
                hand.candidates.len(),
            ];
            assert_eq!(found, counts, "{id}");
            assert_eq!(hand.warnings, Vec::<String>::new(), "{id}");
            assert_eq!(Some(&hand), super::hand(id), "{id}: loading twice gives one hand");
        }
        assert!(files("shadow").is_none() && hand("shadow").is_none());
    }

    #[test]
    fn coverings_stay_within_the_optimizers_budget() {
        for id in ids() {
            let hand = hand(id).unwrap();
            let most = if hand.tree.joints.len() <= 2 { 45 } else { 110 };
            assert!(hand.spheres.len() <= most, "{id}: {} spheres", hand.spheres.len());
            assert!(hand.self_pairs.len() <= 256, "{id}: {} pairs", hand.self_pairs.len());
        }
    }

    #[test]
    fn openings_match_the_published_strokes() {
        let opening = |id: &str| hand(id).unwrap().opening.unwrap();
        for (id, max, tolerance) in [
            ("robotiq-2f85", 0.085, 1e-4),
            ("antipodal", 0.12, 1e-4),
            ("panda", 0.08, 1e-4),
            // The published frames let the pads stand 0.170 m apart; the datasheet names 0.155 m.
            ("robotiq-3f", 0.155, 0.02),
            ("model-o", 0.085, 0.01),
        ] {
            let found = opening(id).max_m;
            assert!((found - max).abs() < tolerance, "{id} opens to {found}, published {max}");
            assert!(opening(id).min_m < 0.005, "{id} closes to {}", opening(id).min_m);
        }
    }

    #[test]
    fn closing_brings_opposed_pads_together_face_to_face() {
        for id in ids() {
            let hand = hand(id).unwrap();
            let at =
                |t: f64| pads_at(&hand.tree, &hand.pads, &hand.actuation.joints(&along(&hand.actuation, t)));
            let (open, half) = (at(0.0), at(0.5));
            let mut opposed = 0;
            for i in 0..hand.pads.len() {
                for j in i + 1..hand.pads.len() {
                    let (a, b) = (&half[i], &half[j]);
                    if hand.pads[i].finger == hand.pads[j].finger || a.1.dot(&b.1) > -0.5 {
                        continue;
                    }
                    opposed += 1;
                    assert!(
                        (b.0 - a.0).norm() < (open[j].0 - open[i].0).norm(),
                        "{id}: {} and {} part while the hand closes",
                        hand.pads[i].name,
                        hand.pads[j].name
                    );
                    assert!(
                        gap(a, b).unwrap() > 0.0,
                        "{id}: {} and {} look away from each other",
                        hand.pads[i].name,
                        hand.pads[j].name
                    );
                }
            }
            assert!(opposed > 0, "{id}: no pads face each other half closed");
        }
    }

    #[test]
    fn one_motor_moves_what_one_motor_moves() {
        // Every joint of these hands is the same function of the only coordinate.
        for id in ["finray-2f", "finray-4f", "robotiq-2f85", "antipodal", "panda"] {
            let actuation = &hand(id).unwrap().actuation;
            assert_eq!(actuation.coordinates.len(), 1, "{id}");
            assert!(actuation.rows.iter().all(|r| *r == actuation.rows[0]), "{id}");
        }
        let barrett = hand("barrett").unwrap();
        let mut u = barrett.actuation.open();
        u[1] = 1.0;
        let q = barrett.actuation.joints(&u);
        let joint = |name: &str| q[barrett.tree.joint(name).unwrap()];
        assert!((joint("bh_j13_joint") - 0.344_262_295_082).abs() < 1e-12);
        let brunel = hand("brunel").unwrap();
        let q = brunel.actuation.joints(&[0.1, 0.2, 0.3, 0.4]);
        assert_eq!(q, [0.1, 0.2, 0.2, 0.3, 0.3, 0.4, 0.4, 0.4, 0.4]);
    }

    #[test]
    fn robotiq_3f_has_a_scissor_and_adaptive_phalanges() {
        let hand = hand("robotiq-3f").unwrap();
        let row = |name: &str| &hand.actuation.rows[hand.tree.joint(name).unwrap()];
        assert_eq!(row("palm_finger_1_joint"), row("palm_finger_2_joint"));
        assert_eq!(hand.actuation.coordinates.len(), 10);
        // Joint 2 rests at zero and joint 3 mirrors joint 1: satisfied by open and closed postures.
        assert_eq!(hand.actuation.couplings.len(), 6);
        for u in [hand.actuation.open(), hand.actuation.closed()] {
            let q = hand.actuation.joints(&u);
            for soft in &hand.actuation.couplings {
                let sum: f64 = soft.terms.iter().map(|&(j, c)| c * q[j]).sum();
                assert!((sum - soft.target).abs() < 1e-9);
            }
        }
    }
}
