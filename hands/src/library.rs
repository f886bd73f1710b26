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

    #[test]
    fn every_hand_loads() {
        for id in ids() {
            let files = files(id).unwrap();
            let hand = Hand::load(id, &files).unwrap_or_else(|e| panic!("{id}: {e}"));
            println!(
                "{id}: {} joints, {} actuators, {} pads, {} candidates, {} spheres, {} pairs, opening {:?}, tool {:?}, reach {:.3}, warnings {:?}",
                hand.tree.joints.len(),
                hand.actuation.actuator_count(),
                hand.pads.len(),
                hand.candidates.len(),
                hand.spheres.len(),
                hand.self_pairs.len(),
                hand.opening,
                hand.tool_point,
                hand.reach_m(),
                hand.warnings,
            );
            let mut per = std::collections::BTreeMap::new();
            for s in &hand.spheres {
                *per.entry(&hand.tree.links[s.link].name).or_insert(0) += 1;
            }
            println!("  {per:?}");
        }
    }
}
