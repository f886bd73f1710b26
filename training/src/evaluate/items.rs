//! The objects that are grasped: the same for every hand, none wider than the narrowest hand opens. The bounding box
//! decides, so that five of the twenty families never come: see [`fits`].

use std::sync::Arc;

use graspd_sim::clutter::Sizes;
use graspd_sim::object::Object;

use super::seeds::derive;

/// True when a hand that opens to `opening_m` and closes completely can take the object from above in each of its
/// steady poses; see [`Sizes::allow`].
///
/// With an opening of 78 mm, the narrowest of the paper's hands, `plate` and `disc` (6 to 16 mm thin)
/// and `ring`, `bowl` and `mug` (their boxes are wider than 68 mm both ways) never fit; `can`, `cup`, `tee` and
/// `hammer` seldom do. What is measured on the rest says nothing about them.
pub fn fits(object: &Object, opening_m: f64) -> bool {
    Sizes::up_to(opening_m).allow(object)
}

/// `count` objects that [`fits`] allows, drawn by seed from all families (those that never fit are drawn in vain);
/// fewer where the opening is too small for any.
pub fn draw(count: usize, opening_m: f64, seed: u64) -> Vec<Arc<Object>> {
    Sizes::up_to(opening_m).draw(count, |round| derive(seed, &[round]))
}

#[cfg(test)]
mod tests {
    use graspd_sim::object::Kind;

    use super::*;

    /// How far the narrowest of the paper's seven hands opens, metres.
    const NARROWEST_M: f64 = 0.078;

    #[test]
    fn the_families_that_never_fit_are_those_that_the_documentation_names() {
        let share = |kind: Kind| {
            let fitting = (0..400).filter(|&seed| fits(&Object::sample(kind, seed), NARROWEST_M)).count();
            fitting as f64 / 400.0
        };
        let shares: Vec<(&str, f64)> = Kind::ALL.iter().map(|&kind| (kind.name(), share(kind))).collect();
        let mut never: Vec<&str> =
            shares.iter().filter(|(_, share)| *share == 0.0).map(|(name, _)| *name).collect();
        never.sort_unstable();
        assert_eq!(never, ["bowl", "disc", "mug", "plate", "ring"], "{shares:?}");
    }

    #[test]
    fn what_is_drawn_fits_and_is_the_same_again() {
        let items = draw(25, NARROWEST_M, 1);
        assert!(items.len() == 25 && items.iter().all(|o| fits(o, NARROWEST_M)));
        assert_eq!(items, draw(25, NARROWEST_M, 1));
        assert!(draw(3, 0.02, 1).is_empty());
    }
}
