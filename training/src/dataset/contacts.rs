//! Grasps of a scene, decomposed into the contacts that fingers make and the middles between them.
//!
//! Everything here is in the world frame and holds for all views of the scene.

use std::f64::consts::TAU;

use graspd_sim::world::World;
use nalgebra::{
    Isometry3, Point3, Rotation3, Translation3, Unit, UnitQuaternion, Vector3, convert as converted,
};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::antipodal::{Pair, across, pairs};
use super::lines::Lines;
use super::recipe::Recipe;
use super::surroundings::{Surroundings, is_free, reach_m};
use crate::evaluate::ap::{BEHIND_M, DEPTH_M, JawGrasp};
use crate::evaluate::seeds::derive;

/// Part of a finger's length, at its tip, that makes contacts (the reference implementation: the last fifth).
const TIP_SHARE: f64 = 0.2;
/// Contacts along it lie this far apart, metres: one voxel, as in the reference implementation.
const STEP_M: f64 = 0.005;
/// The pair of contacts lies at least this far behind the tips, metres.
const LEAST_TIP_M: f64 = 0.002;
/// A finger's place makes contact when the surface before it is no further than the clearance and this, metres.
const GIVE_M: f64 = 0.003;
/// And when the surface faces the finger by at least this cosine (30°).
const FACING: f64 = 0.866;

/// Where a finger may touch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// The finger's place before the jaws close, just off the surface.
    pub point: Point3<f32>,
    /// z from the finger into the object, x along the approach.
    pub orientation: UnitQuaternion<f32>,
    /// Score of its grasp.
    pub score: f32,
}

/// The middle between two contacts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Centroid {
    /// The middle.
    pub point: Point3<f32>,
    /// Score of its grasp.
    pub score: f32,
}

/// All that is known of a scene's contacts.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SceneContacts {
    /// Contacts.
    pub contacts: Vec<Contact>,
    /// Centroids.
    pub centroids: Vec<Centroid>,
    /// Pairs of contacts that were tried.
    pub pairs: usize,
    /// Grasps that touch nothing before they close.
    pub grasps: usize,
}

/// Samples grasps on every object of a world.
pub fn contacts(world: &World, recipe: &Recipe, seed: u64) -> SceneContacts {
    let surroundings = Surroundings::of(world);
    let mut out = SceneContacts::default();
    for (i, id) in world.ids().into_iter().enumerate() {
        let (Some(object), Some(pose)) = (world.object(id), world.pose(id)) else { continue };
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(derive(seed, &[7, i as u64]));
        let lines = Lines::new(&object.mesh);
        let found = pairs(&object.mesh, &lines, recipe, &mut rng);
        out.pairs += found.len();
        let thing = Thing { lines, pose };
        for pair in &found {
            thing.approach(&pair.at(&pose), &surroundings, recipe, &mut rng, &mut out);
        }
    }
    out
}

/// An object where it lies.
struct Thing {
    lines: Lines,
    pose: Isometry3<f64>,
}

impl Thing {
    /// Tries approaches all around a pair's closing direction.
    fn approach(
        &self,
        pair: &Pair,
        surroundings: &Surroundings,
        recipe: &Recipe,
        rng: &mut Xoshiro256PlusPlus,
        out: &mut SceneContacts,
    ) {
        let middle = pair.middle();
        let mut near = Vec::new();
        surroundings.near(&middle, reach_m(pair.width_m + 2.0 * recipe.clearance_m[1]), &mut near);
        let [u, v] = across(&pair.closing);
        let phase = rng.random::<f64>();
        let steepest = recipe.from_below_deg.to_radians().sin();
        for k in 0..recipe.approaches {
            let turn = TAU * (k as f64 + phase) / recipe.approaches as f64;
            let [clearance, behind, offset]: [f64; 3] = [0, 1, 2].map(|_| rng.random::<f64>());
            let approach = u * turn.cos() + v * turn.sin();
            if approach.z > steepest {
                continue;
            }
            let clearance_m =
                recipe.clearance_m[0] + clearance * (recipe.clearance_m[1] - recipe.clearance_m[0]);
            let tip_m = LEAST_TIP_M + behind * (TIP_SHARE * (DEPTH_M + BEHIND_M) - LEAST_TIP_M);
            let grasp = jaw(pair, &approach, tip_m, clearance_m);
            if is_free(&grasp, &near) {
                out.grasps += 1;
                self.sweep(&grasp, pair, offset, clearance_m + GIVE_M, out);
            }
        }
    }

    /// Contacts and centroids along the tips of a grasp, one voxel apart, where the object is before the finger.
    fn sweep(&self, grasp: &JawGrasp, pair: &Pair, offset: f64, reach_m: f64, out: &mut SceneContacts) {
        let pose = &grasp.world_from_jaw;
        let [approach, closing] = [Vector3::z(), Vector3::y()].map(|axis| pose.rotation * axis);
        let orientations = [closing, -closing].map(|inward| frame(&approach, &inward));
        let half = 0.5 * grasp.width_m;
        let tip = TIP_SHARE * (DEPTH_M + BEHIND_M);
        let mut back = offset * STEP_M;
        while back < tip {
            let z = DEPTH_M - back;
            let fingers = [-half, half].map(|y| pose * Point3::new(0.0, y, z));
            let touches = [0, 1].map(|i| self.faces(&fingers[i], &[closing, -closing][i], reach_m));
            for i in 0..2 {
                if touches[i] {
                    out.contacts.push(Contact {
                        point: fingers[i].cast(),
                        orientation: converted(orientations[i]),
                        score: pair.score as f32,
                    });
                }
            }
            if touches[0] && touches[1] {
                let point = (pose * Point3::new(0.0, 0.0, z)).cast();
                out.centroids.push(Centroid { point, score: pair.score as f32 });
            }
            back += STEP_M;
        }
    }

    /// True when the object's surface faces a finger's place and is near.
    fn faces(&self, place: &Point3<f64>, inward: &Vector3<f64>, reach_m: f64) -> bool {
        let origin = self.pose.inverse_transform_point(place);
        let inward = Unit::new_unchecked(self.pose.inverse_transform_vector(inward));
        let first = self.lines.first(&origin, &inward);
        first.is_some_and(|c| c.at_m <= reach_m && -c.normal.dot(&inward) >= FACING)
    }
}

/// The gripper at a pair, whose line crosses its fingers `tip_m` behind their tips.
fn jaw(pair: &Pair, approach: &Vector3<f64>, tip_m: f64, clearance_m: f64) -> JawGrasp {
    let y = pair.closing.into_inner();
    let rotation = Rotation3::from_basis_unchecked(&[y.cross(approach), y, *approach]);
    let middle = pair.middle();
    let origin = middle - approach * (DEPTH_M - tip_m);
    let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
    JawGrasp {
        world_from_jaw: Isometry3::from_parts(Translation3::from(origin.coords), rotation),
        width_m: pair.width_m + 2.0 * clearance_m,
        expected: middle,
    }
}

/// A contact's orientation: z into the object, x along the approach; both of unit length and across each other.
fn frame(approach: &Vector3<f64>, inward: &Vector3<f64>) -> UnitQuaternion<f64> {
    let rotation = Rotation3::from_basis_unchecked(&[*approach, inward.cross(approach), *inward]);
    UnitQuaternion::from_rotation_matrix(&rotation)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use graspd_sim::object::Object;
    use graspd_sim::world::WorldSettings;

    use super::*;
    use crate::evaluate::ap::{Target, Verdict, judge, sample, table_points};

    #[test]
    fn frames_point_where_they_should() {
        let (approach, inward) = (-Vector3::z(), Vector3::y());
        let q = frame(&approach, &inward);
        assert!((q * Vector3::z() - inward).norm() < 1e-12 && (q * Vector3::x() - approach).norm() < 1e-12);
        assert!((q.to_rotation_matrix().matrix().determinant() - 1.0).abs() < 1e-12);
    }

    /// The evaluation's judge, which knows nothing of how grasps were sampled, agrees with what is kept.
    #[test]
    fn every_grasp_holds_before_the_judge_of_the_evaluation() {
        let half = Vector3::new(0.02, 0.03, 0.04);
        let object = Arc::new(Object::cuboid("box", half).unwrap());
        let pose = Isometry3::translation(0.02, 0.01, 0.0401);
        let mut world = World::new(WorldSettings::default());
        world.add(object.clone(), &pose);
        let recipe = Recipe { places: [60, 60], max_friction: 0.2, ..Recipe::default() };
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(3);
        let lines = Lines::new(&object.mesh);
        let surroundings = Surroundings::of(&world);
        let mut points: Vec<_> = sample(&object.mesh).iter().map(|p| pose * p).collect();
        points.extend(table_points());
        let (mut near, mut judged, mut held) = (Vec::new(), 0, 0);
        for pair in pairs(&object.mesh, &lines, &recipe, &mut rng) {
            let pair = pair.at(&pose);
            let [u, v] = across(&pair.closing);
            for turn in [0.1, 1.7, 3.3, 4.9] {
                let grasp = jaw(&pair, &(u * f64::cos(turn) + v * f64::sin(turn)), 0.008, 0.004);
                surroundings.near(&pair.middle(), reach_m(grasp.width_m), &mut near);
                if !is_free(&grasp, &near) {
                    continue;
                }
                judged += 1;
                let verdict = judge(&grasp, &points, &Target { mesh: &object.mesh, world_from_mesh: pose });
                assert_ne!(verdict, Verdict::Collision);
                held += usize::from(verdict.holds_at(0.4));
            }
        }
        // A tilted jaw may close on another line than the sampled one.
        assert!(judged > 20 && held * 10 >= judged * 9, "{held} of {judged}");
    }

    #[test]
    fn contacts_of_a_scene_lie_off_surfaces_above_the_table_and_repeat_themselves() {
        let mut world = World::new(WorldSettings::default());
        let object = Arc::new(Object::cuboid("box", Vector3::new(0.02, 0.03, 0.04)).unwrap());
        world.add(object, &Isometry3::translation(0.0, 0.0, 0.0401));
        let recipe = Recipe::default();
        let found = contacts(&world, &recipe, 5);
        assert_eq!(found, contacts(&world, &recipe, 5));
        assert_ne!(found, contacts(&world, &recipe, 6));
        assert!(found.grasps > 100 && found.contacts.len() > found.grasps, "{} grasps", found.grasps);
        for c in &found.contacts {
            let p: Point3<f64> = converted(c.point);
            let outside = (p.x.abs() - 0.02).max(p.y.abs() - 0.03).max((p.z - 0.0401).abs() - 0.04);
            assert!((0.0..0.01).contains(&outside), "{p}: {outside} m");
            assert!(p.z > 0.0 && (0.69..=1.0 + 1e-6).contains(&f64::from(c.score)));
            // Into the object.
            let inward = c.orientation * Vector3::z();
            assert!(inward.dot(&(Point3::new(0.0, 0.0, 0.0401f32) - c.point)) > 0.0);
        }
        for c in &found.centroids {
            let p: Point3<f64> = converted(c.point);
            assert!(p.x.abs() < 0.02 && p.y.abs() < 0.03 && (p.z - 0.0401).abs() < 0.04, "{p}");
        }
    }
}
