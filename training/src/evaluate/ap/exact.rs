//! What really lies on the table, and the verdicts that it gives on grasps.

use std::sync::Arc;

use graspd_sim::object::Object;
use graspd_sim::world::World;
use nalgebra::{Isometry3, Point3};

use super::jaw::{DEPTH_M, JawGrasp, Target, Verdict, judge};
use super::precision::{select, suppress};
use super::surface::{sample, table_points};

/// An object that really lies on the table.
struct Lying {
    object: Arc<Object>,
    world_from_object: Isometry3<f64>,
    /// Points of its surface, world frame.
    points: Vec<Point3<f64>>,
}

/// What really lies on the table.
pub(super) struct Exact {
    objects: Vec<Lying>,
    /// Points of all objects and of the table, world frame.
    points: Vec<Point3<f64>>,
}

impl Exact {
    pub(super) fn of(world: &World) -> Self {
        let objects: Vec<Lying> = world
            .ids()
            .into_iter()
            .filter_map(|id| {
                let (object, world_from_object) = (Arc::clone(world.object(id)?), world.pose(id)?);
                let points = sample(&object.mesh).iter().map(|p| world_from_object * p).collect();
                Some(Lying { object, world_from_object, points })
            })
            .collect();
        let points = objects.iter().flat_map(|o| o.points.iter().copied()).chain(table_points()).collect();
        Self { objects, points }
    }

    /// The object nearest to the middle of the jaws; none in an empty scene.
    ///
    /// The benchmark takes the gripper's origin, which lies 1 to 4 cm behind its tips; here it lies 6 cm behind
    /// them, nearer to a neighbour than to what is between the jaws.
    fn nearest(&self, grasp: &JawGrasp) -> Option<usize> {
        let middle = grasp.world_from_jaw * Point3::new(0.0, 0.0, 0.5 * DEPTH_M);
        let distance = |points: &[Point3<f64>]| {
            points.iter().map(|p| (p - middle).norm_squared()).fold(f64::INFINITY, f64::min)
        };
        let distances = self.objects.iter().map(|o| distance(&o.points));
        distances.enumerate().min_by(|a, b| a.1.total_cmp(&b.1)).map(|(i, _)| i)
    }

    /// Verdicts of the grasps that are scored, best first.
    pub(super) fn judge(&self, grasps: &[JawGrasp]) -> Vec<Verdict> {
        let poses: Vec<Isometry3<f64>> = grasps.iter().map(|g| g.world_from_jaw).collect();
        let kept: Vec<&JawGrasp> = suppress(&poses).into_iter().map(|i| &grasps[i]).collect();
        let nearest: Vec<usize> = kept.iter().filter_map(|g| self.nearest(g)).collect();
        select(&nearest)
            .into_iter()
            .map(|i| {
                let Lying { object, world_from_object, .. } = &self.objects[nearest[i]];
                let target = Target { mesh: &object.mesh, world_from_mesh: *world_from_object };
                judge(kept[i], &self.points, &target)
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use graspd_hands::library;
    use graspd_planner::grasp::{Grasp, GraspContact, ObjectiveTerms, Postures, ScoreParts};
    use graspd_sim::world::WorldSettings;
    use nalgebra::{Unit, UnitQuaternion, Vector3};

    use super::super::planned::jaw_grasp;
    use super::super::precision::average_precision;
    use super::*;

    /// What a planner would say who knew all: from above on a box of 3 x 4 x 5 cm at `x`, jaws parallel to its sides,
    /// tips 1 cm over the table, moved aside by `aside`.
    fn from_above(x: f64, aside: f64) -> Grasp {
        let hand = library::hand("antipodal").unwrap();
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let at = Isometry3::from_parts(Vector3::new(x, aside, 0.01 + DEPTH_M).into(), down);
        let contact = |side: f64, finger| GraspContact {
            point: Point3::new(x, 0.02 * side, 0.025),
            normal: Unit::new_normalize(Vector3::y() * side),
            pad: finger,
            finger,
            certainty: 1.0,
        };
        // 8 cm apart: open but for what is missing to the largest opening.
        let c = &hand.actuation.coordinates[0];
        let opening = hand.opening.unwrap();
        let share = (opening.max_m - 0.08) / (opening.max_m - opening.min_m);
        let open = vec![c.open + share * (c.closed - c.open)];
        let actuators = Postures { open, ..Postures::default() };
        Grasp {
            world_from_hand: at,
            camera_from_hand: at,
            world_from_pregrasp: at,
            joints: Postures::default(),
            actuators,
            contacts: vec![contact(1.0, 0), contact(-1.0, 1)],
            jaw_width_m: Some(0.04),
            score: 1.0,
            parts: ScoreParts::default(),
            objective: ObjectiveTerms::default(),
            epsilon: 0.5,
            clearance_m: 0.01,
            centroid: Point3::new(x, 0.0, 0.025),
            label: None,
        }
    }

    #[test]
    fn a_perfect_grasp_holds_at_every_friction_wherever_its_object_stands() {
        let hand = library::hand("antipodal").unwrap();
        let cube = Arc::new(Object::cuboid("box", Vector3::new(0.015, 0.02, 0.025)).unwrap());
        let mut world = World::new(WorldSettings::default());
        for x in [-0.1, 0.1] {
            world.add(Arc::clone(&cube), &Isometry3::translation(x, 0.0, 0.0251));
        }
        let exact = Exact::of(&world);
        let judged = |grasps: &[Grasp]| {
            let jaws: Vec<JawGrasp> = grasps.iter().filter_map(|g| jaw_grasp(hand, g)).collect();
            exact.judge(&jaws)
        };
        let best = Verdict::Holds { friction: 0.2 };
        let (left, right, again) = (from_above(-0.1, 0.0), from_above(0.1, 0.0), from_above(0.1, 0.01));
        // The third is the second once more.
        assert_eq!(judged(&[left, right.clone(), again]), [best, best]);
        // Precision at 1 is perfect: what is missing of 50 grasps is all that costs.
        let harmonic: f64 = (1..=50).map(|k| 1.0 / f64::from(k)).sum();
        assert!((average_precision(&judged(&[right]), 0.2) - harmonic / 50.0).abs() < 1e-12);
        // A jaw in the box, and one beside all boxes.
        assert_eq!(judged(&[from_above(0.1, 0.04)]), [Verdict::Collision]);
        assert_eq!(judged(&[from_above(0.0, 0.0)]), [Verdict::Empty]);
    }
}
