//! What scenes are made of: object families, or a user's meshes, some of which are held out for tests.

use std::sync::Arc;

use graspd_sim::clutter::assortment_of;
use graspd_sim::object::{Kind, Object, Surface};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::{Deserialize, Serialize};

use crate::evaluate::seeds::derive;

/// Families that no training scene shows: one of each group of shapes (revolved twice), so that a test asks for more
/// than other sizes of what was learnt.
pub const HELD_OUT: [Kind; 5] = [Kind::Frustum, Kind::Bottle, Kind::Mug, Kind::Tee, Kind::Nut];
/// Of a user's meshes in the order of their names, every fourth is held out.
const MESH_STRIDE: usize = 4;

/// Which objects scenes show.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Split {
    /// Those to learn from.
    #[default]
    Train,
    /// Those that are kept for tests.
    HeldOut,
    /// All.
    All,
}

impl Split {
    /// Every split by its name.
    pub const NAMES: [(&'static str, Self); 3] =
        [("train", Self::Train), ("held-out", Self::HeldOut), ("all", Self::All)];

    fn takes(self, held_out: bool) -> bool {
        match self {
            Self::Train => !held_out,
            Self::HeldOut => held_out,
            Self::All => true,
        }
    }
}

/// What objects are drawn from.
#[derive(Debug, Clone)]
pub enum Stock {
    /// Procedural families: every object is another.
    Families(Vec<Kind>),
    /// A user's meshes: the same objects again and again, with other surfaces.
    Meshes(Vec<Arc<Object>>),
}

impl Stock {
    /// The families of a split.
    pub fn families(split: Split) -> Self {
        Self::Families(Kind::ALL.iter().copied().filter(|k| split.takes(HELD_OUT.contains(k))).collect())
    }

    /// The meshes of a split, out of all in the order of their names.
    pub fn meshes(all: &[Arc<Object>], split: Split) -> Self {
        let of_split =
            all.iter().enumerate().filter(|(i, _)| split.takes(i % MESH_STRIDE == MESH_STRIDE - 1));
        Self::Meshes(of_split.map(|(_, object)| Arc::clone(object)).collect())
    }

    /// Names of the families or meshes.
    pub fn names(&self) -> Vec<String> {
        match self {
            Self::Families(kinds) => kinds.iter().map(|k| k.name().to_owned()).collect(),
            Self::Meshes(objects) => objects.iter().map(|o| o.name.clone()).collect(),
        }
    }

    /// True when there is nothing to draw.
    pub fn is_empty(&self) -> bool {
        match self {
            Self::Families(kinds) => kinds.is_empty(),
            Self::Meshes(objects) => objects.is_empty(),
        }
    }

    /// `count` objects, drawn by seed; none comes twice before every family or mesh has come.
    pub fn draw(&self, count: usize, seed: u64) -> Vec<Arc<Object>> {
        match self {
            Self::Families(kinds) => assortment_of(kinds, count, seed),
            Self::Meshes(objects) => draw_meshes(objects, count, seed),
        }
    }
}

fn draw_meshes(objects: &[Arc<Object>], count: usize, seed: u64) -> Vec<Arc<Object>> {
    if objects.is_empty() {
        return Vec::new();
    }
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(derive(seed, &[0]));
    let mut deck: Vec<usize> = Vec::new();
    (0..count)
        .map(|_| {
            if deck.is_empty() {
                deck.extend(0..objects.len());
            }
            let object = &objects[deck.swap_remove(rng.random_range(0..deck.len()))];
            let surface =
                Surface { albedo: rng.random_range(0.15..0.9), specular: rng.random_range(0.0..0.15) };
            // Mesh and parts are large, the mesh is shared.
            Arc::new(Object { surface, ..Object::clone(object) })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use nalgebra::Vector3;

    use super::*;

    #[test]
    fn splits_share_no_family_and_no_mesh_and_leave_none_out() {
        let cube = |i: usize| Arc::new(Object::cuboid(format!("m{i}"), Vector3::repeat(0.02)).unwrap());
        let meshes: Vec<_> = (0..9).map(cube).collect();
        let names = |split, of_meshes| -> BTreeSet<String> {
            let stock = if of_meshes { Stock::meshes(&meshes, split) } else { Stock::families(split) };
            stock.names().into_iter().collect()
        };
        for (of_meshes, held_out) in [(false, HELD_OUT.len()), (true, 2)] {
            let [train, test, all] = [Split::Train, Split::HeldOut, Split::All].map(|s| names(s, of_meshes));
            assert!(train.is_disjoint(&test));
            assert_eq!(test.len(), held_out);
            assert_eq!(train.union(&test).cloned().collect::<BTreeSet<_>>(), all);
        }
    }

    #[test]
    fn what_is_drawn_is_of_the_stock_and_the_same_again() {
        let stock = Stock::families(Split::HeldOut);
        let drawn = stock.draw(12, 3);
        assert_eq!(drawn, stock.draw(12, 3));
        let names = stock.names();
        assert!(drawn.iter().all(|o| names.iter().any(|n| o.name.starts_with(n.as_str()))), "{drawn:?}");
        let cube = Arc::new(Object::cuboid("cube", Vector3::repeat(0.02)).unwrap());
        let meshes = Stock::Meshes(vec![cube.clone(), cube]);
        assert_eq!(meshes.draw(5, 1).len(), 5);
        assert_ne!(meshes.draw(5, 1)[0].surface, meshes.draw(5, 2)[0].surface);
        assert!(Stock::Meshes(Vec::new()).draw(5, 1).is_empty() && Stock::Meshes(Vec::new()).is_empty());
    }
}
