//! Small things alone on a table: hands with more fingers than there is room for still hold them, and nothing else.

#[allow(dead_code, reason = "the module also serves tests of whole clutters")]
mod clutter;

use std::collections::BTreeSet;

use clutter::{Object, look_at};
use graspd_hands::library;
use graspd_planner::budget::Unlimited;
use graspd_planner::estimator::Geometric;
use graspd_planner::frame::Frame;
use graspd_planner::grasp::Plan;
use graspd_planner::options::{PlanOptions, SceneOptions};
use graspd_planner::plan::plan;
use graspd_planner::scene::prepare;
use nalgebra::Point2;

/// A cube of 36 mm, smaller than the way between two neighbouring fingers of a large gripper.
const CUBE: Object = ([0.01, 0.02], 0.018, false);
/// Depth noise of patches of a table, metres: some voxels above its plane become solid.
const ROUGHNESS_M: f32 = 0.010;

fn plan_for(hand: &str, frame: &Frame) -> Plan {
    let scene = prepare(std::slice::from_ref(frame), &SceneOptions::default(), &Geometric, &Unlimited);
    let hand = library::hand(hand).expect("a library hand");
    plan(&scene.expect("a valid frame"), hand, &PlanOptions::default(), &Unlimited, None)
}

/// A frame whose depth is off by up to the roughness, the same for patches of 6 pixels.
fn rough(mut frame: Frame) -> Frame {
    let width = frame.image.width;
    for (i, depth) in frame.image.depth_m.iter_mut().enumerate() {
        let (column, row) = (i % width / 6, i / width / 6);
        let patch = (column * 7919 + row * 104_729) % 1000;
        *depth += ROUGHNESS_M * (patch as f32 / 500.0 - 1.0);
    }
    frame
}

#[test]
fn nothing_but_the_object_is_touched_on_a_rough_table() {
    let frame = rough(look_at(&[CUBE]));
    let ([x, y], half, _) = CUBE;
    for id in ["finray-4f", "leap", "robotiq-3f"] {
        let result = plan_for(id, &frame);
        for contact in result.grasps.iter().flat_map(|g| &g.contacts) {
            let beside = (contact.point.xy() - Point2::new(x, y)).norm() - half * 2f64.sqrt();
            assert!(beside < 0.012, "{id}: a contact {beside:.3} m beside the cube: {:?}", contact.point);
        }
    }
}

#[test]
fn a_cube_between_neighbouring_fingers_is_pinched_by_fingers_that_face_each_other() {
    let frame = look_at(&[CUBE]);
    for id in ["finray-4f", "brunel", "leap", "robotiq-3f"] {
        let result = plan_for(id, &frame);
        assert!(!result.grasps.is_empty(), "{id}: {:?} {:?}", result.no_grasp, result.stats.rejected);
        for grasp in &result.grasps {
            let fingers: BTreeSet<usize> = grasp.contacts.iter().map(|c| c.finger).collect();
            assert!(fingers.len() >= 2, "{id}");
            let facing = grasp
                .contacts
                .iter()
                .flat_map(|a| grasp.contacts.iter().map(move |b| a.normal.dot(&b.normal)))
                .fold(1.0, f64::min);
            assert!(facing < 0.0, "{id}: contacts on one side only: {:?}", grasp.contacts);
        }
    }
}
