//! Bins: where delivered objects leave the world.

use graspd_sim::world::{HandId, ObjectId, Touched, Tray, World};
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

/// A deep bin let into the table: what lies or falls in it below its rim, and is held by no hand, is taken out of
/// the world and counted as delivered. So dropped objects neither pile up nor roll back.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bin {
    /// Shown to people.
    pub name: String,
    /// Middle of its opening, world x and y, metres.
    pub center_m: [f64; 2],
    /// Half of its opening along x and y, metres.
    pub half_extents_m: [f64; 2],
    /// Height of its rim above the table, metres.
    pub rim_m: f64,
}

impl Default for Bin {
    /// A bin beside the default tray, towards +x.
    fn default() -> Self {
        Self { name: "bin".into(), center_m: [0.40, 0.0], half_extents_m: [0.15, 0.20], rim_m: 0.12 }
    }
}

impl Bin {
    /// True when an object's origin at this pose is in the bin.
    pub fn contains(&self, world_from_object: &Isometry3<f64>) -> bool {
        let p = world_from_object.translation.vector;
        let inside = |i: usize| (p[i] - self.center_m[i]).abs() <= self.half_extents_m[i];
        inside(0) && inside(1) && p.z < self.rim_m
    }

    /// True when its opening and a tray with its walls have more than an edge in common.
    pub fn overlaps(&self, tray: &Tray) -> bool {
        let half = outer_half(tray);
        (0..2).all(|i| self.center_m[i].abs() < self.half_extents_m[i] + half[i])
    }

    /// Middle of the opening at the rim: above it is where to let go.
    pub fn opening(&self) -> nalgebra::Point3<f64> {
        nalgebra::Point3::new(self.center_m[0], self.center_m[1], self.rim_m)
    }
}

/// An object that went into a bin.
#[derive(Debug, Clone, PartialEq)]
pub struct Delivered {
    /// Its id while it was in the world.
    pub id: ObjectId,
    /// Its name.
    pub name: String,
    /// Name of the bin.
    pub bin: String,
    /// When, seconds on the world's clock.
    pub time_s: f64,
}

/// Half of a tray's edges along x and y, its walls included, metres.
fn outer_half(tray: &Tray) -> [f64; 2] {
    [tray.width_m / 2.0 + tray.wall_m, tray.length_m / 2.0 + tray.wall_m]
}

/// True when a point lies in a tray, on its walls or over it.
pub(crate) fn is_over(tray: &Tray, point: &nalgebra::Vector3<f64>) -> bool {
    let half = outer_half(tray);
    point.x.abs() <= half[0] && point.y.abs() <= half[1]
}

/// Hands that touch each object, and the objects they touch.
pub(crate) fn touched_objects(world: &World) -> Vec<(HandId, ObjectId)> {
    let mut pairs: Vec<_> = world
        .hand_ids()
        .into_iter()
        .flat_map(|hand| world.hand_contacts(hand).into_iter().map(move |c| (hand, c.touched)))
        .filter_map(|(hand, touched)| match touched {
            Touched::Object(object) => Some((hand, object)),
            _ => None,
        })
        .collect();
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

/// Takes out of the world what lies in a bin, and never what lies over the tray; returns what it took.
pub(crate) fn absorb(world: &mut World, bins: &[Bin]) -> Vec<Delivered> {
    if bins.is_empty() {
        return Vec::new();
    }
    let tray = world.settings().tray;
    let within: Vec<(ObjectId, &Bin)> = world
        .ids()
        .into_iter()
        .filter_map(|id| {
            let pose = world.pose(id)?;
            if tray.is_some_and(|tray| is_over(&tray, &pose.translation.vector)) {
                return None;
            }
            bins.iter().find(|b| b.contains(&pose)).map(|b| (id, b))
        })
        .collect();
    if within.is_empty() {
        return Vec::new();
    }
    let touched = touched_objects(world);
    within
        .into_iter()
        .filter(|(id, _)| !touched.iter().any(|(_, object)| object == id))
        .filter_map(|(id, bin)| {
            let name = world.object(id)?.name.clone();
            let time_s = world.time_s();
            world.remove(id).then(|| Delivered { id, name, bin: bin.name.clone(), time_s })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use graspd_sim::object::Object;
    use graspd_sim::world::WorldSettings;
    use nalgebra::Vector3;
    use std::sync::Arc;

    #[test]
    fn what_lies_over_the_tray_is_never_taken() {
        let settings = WorldSettings { tray: Some(Tray::default()), ..WorldSettings::default() };
        let mut world = World::new(settings);
        let cuboid = Arc::new(Object::cuboid("box", Vector3::new(0.02, 0.02, 0.02)).unwrap());
        // In the tray, on its wall, beside it.
        let ids =
            [0.10, 0.185, 0.25].map(|x| world.add(cuboid.clone(), &Isometry3::translation(x, 0.0, 0.05)));
        let bin = Bin { center_m: [0.2, 0.0], ..Bin::default() };
        assert!(bin.overlaps(&Tray::default()));
        let taken = absorb(&mut world, &[bin]);
        assert_eq!(taken.iter().map(|d| d.id).collect::<Vec<_>>(), [ids[2]]);
        assert_eq!(world.ids(), ids[..2]);
    }
}
