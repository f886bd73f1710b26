//! Draws the objects of a scene.

use std::sync::Arc;

use rand::{Rng, RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::object::{Kind, Object};

/// `count` objects of all families, drawn by seed: no family comes twice before every one has come.
/// Objects of one family are named apart (`mug`, `mug 2`).
pub fn assortment(count: usize, seed: u64) -> Vec<Arc<Object>> {
    assortment_of(Kind::ALL, count, seed)
}

/// As [`assortment`], of these families only; nothing of none.
pub fn assortment_of(kinds: &[Kind], count: usize, seed: u64) -> Vec<Arc<Object>> {
    if kinds.is_empty() {
        return Vec::new();
    }
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut deck: Vec<Kind> = Vec::new();
    let mut out: Vec<Arc<Object>> = Vec::with_capacity(count);
    for round in 0..count {
        if deck.is_empty() {
            deck.extend(kinds);
        }
        let kind = deck.swap_remove(rng.random_range(0..deck.len()));
        let mut object = Object::sample(kind, rng.next_u64());
        let number = round / kinds.len() + 1;
        if number > 1 {
            object.name = format!("{} {number}", object.name);
        }
        out.push(Arc::new(object));
    }
    out
}
