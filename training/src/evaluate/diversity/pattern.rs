//! What a grasp touches: which pads, how much of them, where they are and where they point, in the hand frame.

use graspd_hands::{Hand, Pad};
use graspd_planner::grasp::Grasp;
use nalgebra::{Isometry3, Point3, Vector3};
use serde::{Deserialize, Serialize};

use super::geometry::ExactScene;

/// A pad touches where it is this near to an object, metres: a voxel.
const TOUCH_M: f64 = 0.005;
/// Along each edge a pad is looked at in so many places.
const PLACES: usize = 5;

/// A pad that touches.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Touch {
    /// Index into the hand's pads.
    pub pad: usize,
    /// Index into the hand's fingers.
    pub finger: usize,
    /// Share of the pad's area that touches, 0 to 1.
    pub share: f64,
    /// Middle of what touches, hand frame, metres.
    pub at: [f64; 3],
    /// The pad's outward normal, hand frame.
    pub direction: [f64; 3],
}

/// What a grasp touches with the fingers at contact, by the exact objects.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Pattern {
    /// The scene that it is of.
    pub scene: usize,
    /// Share of the area of all pads that touches, 0 to 1.
    pub area: f64,
    /// The pads that touch.
    pub touches: Vec<Touch>,
}

impl Pattern {
    /// Looks at a planned grasp.
    pub(super) fn of(scene: usize, exact: &ExactScene, hand: &Hand, grasp: &Grasp) -> Self {
        let links = hand.tree.link_poses(&hand.tree.body_poses(&grasp.joints.contact));
        let (mut touched, mut all) = (0.0, 0.0);
        let mut touches = Vec::new();
        for (index, pad) in hand.pads.iter().enumerate() {
            let area = pad.half_u.cross(&pad.half_v).norm();
            all += area;
            let hand_from_link = links[pad.link];
            let near: Vec<Point3<f64>> = places(pad)
                .map(|p| hand_from_link * p)
                .filter(|p| exact.nearest(&(grasp.world_from_hand * p), TOUCH_M).is_some())
                .collect();
            let Some(at) = middle(&near) else { continue };
            let share = near.len() as f64 / (PLACES * PLACES) as f64;
            touched += share * area;
            let direction = (hand_from_link.rotation * pad.normal).into_inner();
            touches.push(Touch {
                pad: index,
                finger: pad.finger,
                share,
                at: at.into(),
                direction: direction.into(),
            });
        }
        Self { scene, area: touched / all.max(f64::MIN_POSITIVE), touches }
    }

    /// Fingers that touch.
    pub fn fingers(&self) -> usize {
        let mut fingers: Vec<usize> = self.touches.iter().map(|t| t.finger).collect();
        fingers.sort_unstable();
        fingers.dedup();
        fingers.len()
    }
}

/// Where a pad is looked at, link frame: middles of equal parts.
fn places(pad: &Pad) -> impl Iterator<Item = Point3<f64>> + '_ {
    let along = |i: usize| (2 * i + 1) as f64 / PLACES as f64 - 1.0;
    (0..PLACES * PLACES)
        .map(move |i| pad.center + pad.half_u * along(i % PLACES) + pad.half_v * along(i / PLACES))
}

fn middle(points: &[Point3<f64>]) -> Option<Vector3<f64>> {
    let sum: Vector3<f64> = points.iter().map(|p| p.coords).sum();
    (!points.is_empty()).then(|| sum / points.len() as f64)
}

/// The hand's collision spheres with the fingers open: centres in the hand frame and radii.
pub(super) fn outline(hand: &Hand) -> Vec<(Point3<f64>, f64)> {
    let poses: Vec<Isometry3<f64>> = hand.tree.body_poses(&hand.actuation.joints(&hand.actuation.open()));
    hand.spheres.iter().map(|s| (poses[s.body] * s.center, s.radius)).collect()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use graspd_hands::library;
    use graspd_planner::grasp::{GraspContact, ObjectiveTerms, Postures, ScoreParts};
    use graspd_sim::object::Object;
    use graspd_sim::world::{World, WorldSettings};

    use super::*;

    fn grasp(hand: &Hand, world_from_hand: Isometry3<f64>, contact: Vec<f64>) -> Grasp {
        let no_contacts: Vec<GraspContact> = Vec::new();
        Grasp {
            world_from_hand,
            camera_from_hand: world_from_hand,
            world_from_pregrasp: world_from_hand,
            joints: Postures { contact, ..Postures::default() },
            actuators: Postures { open: hand.actuation.open(), ..Postures::default() },
            contacts: no_contacts,
            jaw_width_m: None,
            score: 1.0,
            parts: ScoreParts::default(),
            objective: ObjectiveTerms::default(),
            epsilon: 0.0,
            clearance_m: 0.0,
            centroid: Point3::origin(),
            label: None,
        }
    }

    /// A parallel jaw whose pads are 3 mm from the sides of a wide, tall box: all of both pads touches. From a lower
    /// box they touch with a part; from one that is far away, not at all.
    #[test]
    fn pads_touch_where_an_object_is_within_a_voxel() {
        let hand = library::hand("panda").unwrap();
        let open = hand.actuation.joints(&hand.actuation.open());
        let links = hand.tree.link_poses(&hand.tree.body_poses(&open));
        let centers: Vec<Point3<f64>> = hand.pads.iter().map(|p| links[p.link] * p.center).collect();
        let apart = (centers[0] - centers[1]).norm();
        let middle = nalgebra::center(&centers[0], &centers[1]);
        let down = nalgebra::UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        // The middle between the pads goes to (0, 0, 0.1).
        let turned = down * middle;
        let at = Isometry3::from_parts((Point3::new(0.0, 0.0, 0.1) - turned).into(), down);
        let pattern = |half: Vector3<f64>, x: f64| {
            let mut world = World::new(WorldSettings::default());
            let cuboid = Arc::new(Object::cuboid("box", half).unwrap());
            world.add(cuboid, &Isometry3::translation(x, 0.0, half.z + 1e-4));
            Pattern::of(7, &ExactScene::of(&world), hand, &grasp(hand, at, open.clone()))
        };
        let side = 0.5 * apart - 0.003;
        let whole = pattern(Vector3::new(0.05, side, 0.09), 0.0);
        assert_eq!((whole.scene, whole.touches.len(), whole.fingers()), (7, 2, 2));
        assert!((whole.area - 1.0).abs() < 1e-9 && whole.touches.iter().all(|t| t.share == 1.0));
        // Where they touch is the pads' middle, and they point at each other.
        for touch in &whole.touches {
            assert!((Point3::from(touch.at) - centers[touch.pad]).norm() < 1e-9);
        }
        let [a, b] = [0, 1].map(|i| Vector3::from(whole.touches[i].direction));
        assert!((a + b).norm() < 1e-9);
        let part = pattern(Vector3::new(0.05, side, 0.5 * 0.1), 0.0);
        assert!(part.area > 0.2 && part.area < 0.9, "{part:?}");
        let nothing = pattern(Vector3::new(0.02, side, 0.09), 0.2);
        assert_eq!((nothing.area, nothing.touches.len(), nothing.fingers()), (0.0, 0, 0));
    }
}
