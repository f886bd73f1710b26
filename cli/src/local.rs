//! Planning in this process, without a server.

use std::time::Duration;

use anyhow::Context as _;
use graspd_hands::Hand;
use graspd_planner::budget::Budget as _;
use graspd_planner::estimator::ContactEstimator;
use graspd_planner::frame::Frame;
use graspd_planner::options::{PlanOptions, SceneOptions};
use graspd_planner::plan;
use graspd_planner::scene::{self, Scene, SceneError};

use crate::clock::StdBudget;
use crate::estimators::EstimatorArgs;
use crate::input::npz::LoadedField;
use crate::outcome::{Origin, Outcome};

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

    /// Reads the scene, however long that takes.
    ///
    /// # Errors
    /// For a frame or options that cannot be read.
    pub(crate) fn scene(&self, options: &SceneOptions, estimator: &EstimatorArgs) -> anyhow::Result<Scene> {
        self.read(options, &*estimator.chosen()?, &StdBudget::new(None)).context("the scene cannot be read")
    }

    fn read(
        &self,
        options: &SceneOptions,
        estimator: &dyn ContactEstimator,
        budget: &StdBudget,
    ) -> Result<Scene, SceneError> {
        match self {
            Self::Frame(frame) => scene::prepare(std::slice::from_ref(frame), options, estimator, budget),
            Self::Field(field) => {
                scene::from_contact_field(field.field.clone(), &field.solid, options, budget)
            }
        }
    }
}

/// How scenes are read and grasps are searched.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Settings<'a> {
    /// How the scene is read.
    pub(crate) scene: &'a SceneOptions,
    /// How grasps are searched.
    pub(crate) search: &'a PlanOptions,
    /// The contact estimators, and which of them.
    pub(crate) estimator: &'a EstimatorArgs,
    /// Time from the arrival of the request, the reading of the scene included, to the last answer.
    pub(crate) budget: Option<Duration>,
}

/// Reads the scene once and plans for every hand, as a server does with a request for several hands.
///
/// The scene is `None` when the budget ended before it was read; the hands' answers say so.
///
/// # Errors
/// For a frame or options that cannot be read, and an unknown estimator.
pub(crate) fn plan(
    observed: &Observed,
    hands: &[Hand],
    settings: &Settings<'_>,
) -> anyhow::Result<(Option<Scene>, Vec<Outcome>)> {
    let budget = StdBudget::new(settings.budget);
    let estimator = settings.estimator.chosen()?;
    let used = match observed {
        Observed::Frame(_) => estimator.name(),
        // The contacts came with the file.
        Observed::Field(_) => "",
    };
    let origin = |hand: &Hand, scene: Option<&Scene>| Origin {
        workspace: scene.map(|s| s.workspace),
        estimator: used.to_owned(),
        seed: settings.search.seed,
        hand_revision: hand.revision.clone(),
    };
    let scene = match observed.read(settings.scene, &*estimator, &budget) {
        Ok(scene) => scene,
        Err(SceneError::Stopped(_)) => {
            let late = |hand| Outcome::out_of_time(hand, origin(hand, None), budget.elapsed());
            return Ok((None, hands.iter().map(late).collect()));
        }
        Err(error) => return Err(anyhow::Error::new(error).context("the scene cannot be read")),
    };
    let outcomes = hands
        .iter()
        .map(|hand| {
            let plan = plan::plan(&scene, hand, settings.search, &budget, None);
            tracing::debug!(hand = hand.id, elapsed_ms = budget.elapsed().as_secs_f64() * 1e3, "planned");
            Outcome::from_plan(hand, plan, origin(hand, Some(&scene)), budget.elapsed())
        })
        .collect();
    Ok((Some(scene), outcomes))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo_scene;
    use graspd_hands::library;
    use graspd_planner::options::Scheme;

    fn demo_frame() -> Observed {
        let (depth, file) = demo_scene::bundled().unwrap();
        Observed::Frame(Box::new(file.frame(&depth, None).unwrap()))
    }

    /// The answer for a parallel gripper.
    fn planned(observed: &Observed, budget: Option<Duration>) -> Outcome {
        let hand = library::hand("robotiq-2f85").unwrap().clone();
        let search = PlanOptions { batch: 24, scheme: Scheme::BALANCED, ..PlanOptions::default() };
        let (scene, estimator) = (SceneOptions::default(), EstimatorArgs::default());
        let settings = Settings { scene: &scene, search: &search, estimator: &estimator, budget };
        plan(observed, &[hand], &settings).unwrap().1.remove(0)
    }

    #[test]
    fn a_budget_counts_from_the_request_and_may_end_with_the_scene() {
        let outcome = planned(&demo_frame(), Some(Duration::from_nanos(1)));
        assert_eq!(outcome.no_grasp.unwrap().0, "out_of_time");
        assert!(outcome.stopped && outcome.origin.workspace.is_none() && outcome.grasps.is_empty());
    }

    #[test]
    fn the_demo_frame_has_objects_on_a_table_where_they_were_put() {
        let scene = demo_frame().scene(&SceneOptions::default(), &EstimatorArgs::default()).unwrap();
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
        let outcome = planned(&demo_frame(), None);
        assert_eq!(outcome.origin.estimator, "geometric");
        assert_eq!(outcome.origin.hand_revision, library::hand("robotiq-2f85").unwrap().revision);
        assert!(outcome.origin.workspace.is_some() && outcome.total > Duration::ZERO);
        for g in &outcome.grasps {
            let camera_from_world = g.camera_from_hand * g.world_from_hand.inverse();
            let off = (camera_from_world * g.world_from_pregrasp).inverse() * g.camera_from_pregrasp;
            assert!(off.translation.vector.norm() < 1e-9 && off.rotation.angle() < 1e-6);
        }
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
        let outcome = planned(&Observed::Frame(Box::new(frame)), None);
        assert!(outcome.grasps.is_empty());
        let (reason, fix) = outcome.no_grasp.unwrap();
        assert!(["empty_table", "no_contacts", "nothing_seen"].contains(&reason.as_str()), "{reason}");
        assert!(!fix.is_empty());
    }
}
