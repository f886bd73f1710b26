//! What a hand stands in where it was set down, before the engine pushes apart what overlaps.

use parry3d_f64::bounding_volume::BoundingVolume as _;
use parry3d_f64::query::contact;

use super::{HandId, Touched};
use crate::world::World;

impl World {
    /// What a hand overlaps now by more than `depth_m` metres, each once; itself left out.
    pub fn hand_overlaps(&self, id: HandId, depth_m: f64) -> Vec<Touched> {
        let Some(placed) = self.placed_hand(id) else { return Vec::new() };
        let mut out = Vec::new();
        let own = placed.body.colliders.iter().filter_map(|&(c, _)| self.physics.colliders.get(c));
        for part in own {
            let around = part.compute_aabb();
            for (handle, other) in self.physics.colliders.iter() {
                let Some(touched) = self.touched(handle) else { continue };
                let known = touched == Touched::Hand(id) || out.contains(&touched);
                if known || !around.intersects(&other.compute_aabb()) {
                    continue;
                }
                let met = contact(part.position(), part.shape(), other.position(), other.shape(), 0.0);
                // Shapes that cannot be compared are not known to overlap.
                if met.ok().flatten().is_some_and(|c| c.dist < -depth_m) {
                    out.push(touched);
                }
            }
        }
        out.sort_unstable();
        out
    }
}
