//! Seeds from one seed: every draw of an evaluation has its own, and none depends on the order of the work.

/// A seed for one purpose: the same parts give the same seed, other parts give one that looks unrelated.
pub(crate) fn derive(seed: u64, parts: &[u64]) -> u64 {
    parts.iter().fold(mix(seed), |state, &part| mix(state ^ mix(part.wrapping_add(1))))
}

/// The finalizer of SplitMix64.
fn mix(x: u64) -> u64 {
    let x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn other_parts_give_other_seeds() {
        let seeds: BTreeSet<u64> = (0..20)
            .flat_map(|a| (0..20).map(move |b| derive(7, &[a, b])))
            .chain([derive(7, &[]), derive(8, &[])])
            .collect();
        assert_eq!(seeds.len(), 402);
        assert_eq!(derive(7, &[1, 2]), derive(7, &[1, 2]));
    }
}
