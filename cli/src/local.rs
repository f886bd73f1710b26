//! Planning in this process, without a server.

use std::time::Duration;

use anyhow::Context as _;
use graspd_hands::Hand;
use graspd_planner::budget::Budget as _;
use graspd_planner::estimator::Geometric;
use graspd_planner::frame::Frame;
use graspd_planner::options::{PlanOptions, SceneOptions};
use graspd_planner::plan;
use graspd_planner::scene::{self, Scene};

use crate::clock::StdBudget;
use crate::input::npz::LoadedField;
use crate::outcome::Outcome;

/// What is planned from.
#[derive(Debug, Clone)]
pub(crate) enum Observed {
    /// A depth frame.
    Frame(Box<Frame>),
    /// A contact field that was made elsewhere.
    Field(Box<LoadedField>),
}

impl Observed {
    /// The frame, if there is one.
    pub(crate) fn frame(&self) -> Option<&Frame> {
        match self {
            Self::Frame(frame) => Some(frame),
            Self::Field(_) => None,
        }
    }

    /// Reads the scene, once for all hands.
    ///
    /// # Errors
    /// For a frame or options that cannot be read.
    pub(crate) fn scene(&self, options: &SceneOptions) -> anyhow::Result<Scene> {
        let budget = StdBudget::new(None);
        let scene = match self {
            Self::Frame(frame) => scene::prepare(std::slice::from_ref(frame), options, &Geometric, &budget),
            Self::Field(field) => {
                scene::from_contact_field(field.field.clone(), &field.solid, options, &budget)
            }
        };
        scene.context("the scene cannot be read")
    }
}

/// Plans for one hand in a scene; the budget counts for this hand alone.
pub(crate) fn plan_hand(
    scene: &Scene,
    hand: &Hand,
    options: &PlanOptions,
    limit: Option<Duration>,
) -> Outcome {
    let budget = StdBudget::new(limit);
    let plan = plan::plan(scene, hand, options, &budget, None);
    tracing::debug!(hand = hand.id, elapsed_ms = budget.elapsed().as_secs_f64() * 1e3, "planned");
    Outcome::from_plan(hand, plan)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo_scene;
    use graspd_hands::library;
    use graspd_planner::options::Scheme;

    /// The demo frame, read once for all tests of this module.
    fn demo() -> (Frame, Scene) {
        let (depth, file) = demo_scene::bundled().unwrap();
        let frame = file.frame(&depth, None).unwrap();
        let scene = Observed::Frame(Box::new(frame.clone())).scene(&SceneOptions::default()).unwrap();
        (frame, scene)
    }

    #[test]
    fn the_demo_frame_has_objects_on_a_table_where_they_were_put() {
        let (_, scene) = demo();
        // The world's origin is on the table top: a point of the volume at the table's height maps to z = 0.
        let table = scene.workspace.table_m.unwrap();
        let on_table = scene.workspace.world_from_volume * nalgebra::Point3::new(0.2, 0.2, table);
        assert!(on_table.z.abs() < 0.004, "{on_table}");
        assert!(on_table.coords.xy().norm() < 0.1, "the volume stands around the objects: {on_table}");
        assert!(scene.features.focal_contacts.len() > 50);
        assert!(!scene.features.centroids.is_empty());
    }

    #[test]
    fn a_gripper_finds_grasps_on_the_demo_frame() {
        let (_, scene) = demo();
        let hand = library::hand("robotiq-2f85").unwrap();
        let options = PlanOptions { batch: 24, scheme: Scheme::BALANCED, ..PlanOptions::default() };
        let outcome = plan_hand(&scene, hand, &options, None);
        assert!(!outcome.grasps.is_empty(), "{outcome:?}");
        assert!(outcome.grasps.windows(2).all(|pair| pair[0].score >= pair[1].score));
        assert!(outcome.stage_ms("optimize").unwrap() > 0.0);
    }

    #[test]
    fn an_empty_table_has_no_grasp_and_says_why() {
        let camera = demo_scene::empty_table(5);
        let file = crate::input::intrinsics::FrameFile::parse("f.json", camera.to_json().as_bytes()).unwrap();
        let depth = crate::input::depth::RawDepth::from_png("d.png", &camera.to_png().unwrap()).unwrap();
        let frame = file.frame(&depth, None).unwrap();
        let scene = Observed::Frame(Box::new(frame)).scene(&SceneOptions::default()).unwrap();
        let hand = library::hand("robotiq-2f85").unwrap();
        let outcome = plan_hand(&scene, hand, &PlanOptions::default(), None);
        assert!(outcome.grasps.is_empty());
        let (reason, fix) = outcome.no_grasp.unwrap();
        assert!(["empty_table", "no_contacts", "nothing_seen"].contains(&reason.as_str()), "{reason}");
        assert!(!fix.is_empty());
    }
}
