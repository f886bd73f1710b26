//! What is measured.

use std::path::Path;
use std::time::Duration;

use graspd_hands::{Hand, library};
use graspd_planner::budget::Unlimited;
use graspd_planner::contact_field::ContactField;
use graspd_planner::estimator::{ContactEstimator as _, Geometric};
use graspd_planner::frame::{CleanOptions, Frame, clean_depth};
use graspd_planner::options::{PlanOptions, SceneOptions, Scheme, VolumeKind, WorkspaceRequest};
use graspd_planner::plan;
use graspd_planner::refine::refine;
use graspd_planner::scene::Scene;
use graspd_planner::volume::View;
use graspd_planner::workspace::{Workspace, frame_points};

use super::stats::time;
use crate::clock::StdBudget;
use crate::demo_scene;
use crate::estimators::EstimatorArgs;
use crate::input::npz;
use crate::local::Observed;

/// One measurement.
pub(super) struct Case {
    /// Its name.
    pub(super) name: String,
    /// One run: the time that counts.
    #[allow(clippy::type_complexity, reason = "a boxed closure over the bench is what a case is")]
    pub(super) run: Box<dyn Fn(&Bench) -> Duration>,
}

/// What all measurements share.
pub(super) struct Bench {
    frame: Frame,
    /// From the bundled frame: volume, estimation, refinement and whole pipelines.
    framed: Scene,
    /// Of a contact field, where optimizations run instead of in the framed scene.
    loaded: Option<Scene>,
    source: String,
}

impl Bench {
    /// Reads the bundled frame and, if asked for, a contact field.
    ///
    /// # Errors
    /// If the contact field cannot be read.
    pub(super) fn new(contact_field: Option<&Path>) -> anyhow::Result<Self> {
        let (depth, file) = demo_scene::bundled()?;
        let frame = file.frame(&depth, None)?;
        let framed = Observed::Frame(Box::new(frame.clone()))
            .scene(&SceneOptions::default(), &EstimatorArgs::default())?;
        let (loaded, source) = match contact_field {
            Some(path) => {
                let scene = Observed::Field(Box::new(npz::open(path)?))
                    .scene(&SceneOptions::default(), &EstimatorArgs::default())?;
                (Some(scene), path.display().to_string())
            }
            None => (None, "the bundled frame".to_owned()),
        };
        Ok(Self { frame, framed, loaded, source })
    }

    /// Where optimizations run.
    fn scene(&self) -> &Scene {
        self.loaded.as_ref().unwrap_or(&self.framed)
    }

    /// The scene of the optimizations in words.
    pub(super) fn describe(&self) -> String {
        let f = &self.scene().features;
        format!(
            "optimized in {}: N_fc {}, N_fe {}, N_ee {}",
            self.source,
            f.focal_contacts.len(),
            f.focal_centroid_count,
            f.centroids.len()
        )
    }

    /// All measurements in the order of the pipeline.
    pub(super) fn cases(&self) -> Vec<Case> {
        let mut cases = vec![
            case("frame", Self::place),
            case("volume.tsdf", |b| b.volume(VolumeKind::Tsdf)),
            case("volume.occupancy", |b| b.volume(VolumeKind::Occupancy)),
            case("volume.solid", |b| time(|| b.framed.volume.object_groups(&b.framed.volume.solid()))),
            case("estimate.geometric", |b| time(|| Geometric.estimate(&b.framed.volume, &Unlimited))),
            case("refine", |b| b.refine(&b.framed, &SceneOptions::default())),
        ];
        let hands = || library::ids().iter().filter_map(|id| library::hand(id));
        for hand in hands() {
            cases.push(case(&format!("optimize.{}", hand.id), |b| {
                optimize(b.scene(), hand, &PlanOptions::default())
            }));
        }
        if let Some(antipodal) = library::hand("antipodal") {
            // As Supplementary Note 3 and the reference's measurement: without penetration.
            let scheme = Scheme { iterations: 100, with_penetration: 0 };
            let options = PlanOptions { batch: 500, scheme, ..PlanOptions::default() };
            cases.push(case("optimize.antipodal.500x100", move |b| optimize(b.scene(), antipodal, &options)));
        }
        for hand in ["robotiq-2f85", "robotiq-3f", "leap"].iter().filter_map(|id| library::hand(id)) {
            cases.push(case(&format!("rank.{}", hand.id), |b| {
                stages(b.scene(), hand, &PlanOptions::default(), &["rank"])
            }));
        }
        for hand in hands() {
            cases.push(case(&format!("plan.{}", hand.id), |b| b.pipeline(&[hand])));
        }
        let three: Vec<&'static Hand> =
            ["robotiq-2f85", "model-o", "robotiq-3f"].iter().filter_map(|id| library::hand(id)).collect();
        if three.len() == 3 {
            cases.push(case("plan.three-hands", move |b| b.pipeline(&three)));
        }
        if let Some(hand) = library::hand("robotiq-3f") {
            for batch in [12, 24, 48, 96] {
                let options = PlanOptions { batch, ..PlanOptions::default() };
                cases.push(case(&format!("scaling.batch.{batch}"), move |b| {
                    optimize(b.scene(), hand, &options)
                }));
            }
            for iterations in [50, 100, 200, 400] {
                // The same share with penetration as in [200, 40]: else short schemes would be dearer by the iteration.
                let scheme = Scheme { iterations, with_penetration: iterations / 5 };
                let options = PlanOptions { scheme, ..PlanOptions::default() };
                cases.push(case(&format!("scaling.iterations.{iterations}"), move |b| {
                    optimize(b.scene(), hand, &options)
                }));
            }
            cases.extend(self.focal_contact_cases(hand));
        }
        cases
    }

    /// The same scene with fewer and with more focal contacts, by moving the threshold `T_fc`.
    fn focal_contact_cases(&self, hand: &'static Hand) -> Vec<Case> {
        let mut cases: Vec<Case> = Vec::new();
        for t_fc in [0.95, 0.85, 0.7, 0.5, 0.3, 0.1] {
            let options = SceneOptions { focal_contact_threshold: t_fc, ..SceneOptions::default() };
            let count = self.features(self.scene(), &options).focal_contacts.len();
            let name = format!("scaling.focal-contacts.{count}");
            if cases.iter().all(|c| c.name != name) {
                // The scene is made when it is measured: at most one of them is held at a time.
                cases.push(case(&name, move |b| {
                    let features = b.features(b.scene(), &options);
                    let scene = Scene { features, ..b.scene().clone() };
                    optimize(&scene, hand, &PlanOptions::default())
                }));
            }
        }
        cases
    }

    fn features(&self, scene: &Scene, options: &SceneOptions) -> graspd_planner::refine::Features {
        let field: &ContactField = &scene.contact_field;
        refine(field, &scene.volume.solid(), &[], scene.volume.table_m, scene.volume.voxel_labels(), options)
    }

    fn refine(&self, scene: &Scene, options: &SceneOptions) -> Duration {
        let solid = scene.volume.solid();
        let (table, labels) = (scene.volume.table_m, scene.volume.voxel_labels());
        let world_from_volume = &scene.workspace.world_from_volume;
        let surface = scene
            .volume
            .surface(&solid, &[View::of(&self.frame, &self.frame.image.depth_m, world_from_volume)]);
        time(|| refine(&scene.contact_field, &solid, &surface, table, labels, options))
    }

    /// The encoding of the bundled frame as a volume: fusion, and the array that an estimator's network reads.
    fn volume(&self, kind: VolumeKind) -> Duration {
        let mut volume =
            graspd_planner::volume::Volume::empty(self.framed.volume.grid, self.framed.volume.table_m);
        let camera_from_volume =
            self.framed.world_from_camera.inverse() * self.framed.workspace.world_from_volume;
        time(|| {
            volume.integrate(&self.frame, &self.frame.image.depth_m, &camera_from_volume);
            volume.network_input(kind)
        })
    }

    /// Cleaning the bundled frame, finding its table and placing the volume on it.
    fn place(&self) -> Duration {
        time(|| {
            let depth = clean_depth(&self.frame.image, &CleanOptions::default(), &Unlimited);
            let points = frame_points(&self.frame, &depth, &Unlimited);
            Workspace::place(&WorkspaceRequest::Auto, self.framed.workspace.grid, &points)
        })
    }

    /// From a frame to grasps, one scene for all hands.
    fn pipeline(&self, hands: &[&Hand]) -> Duration {
        let observed = Observed::Frame(Box::new(self.frame.clone()));
        time(|| {
            let scene = observed.scene(&SceneOptions::default(), &EstimatorArgs::default());
            scene.map(|scene| {
                hands
                    .iter()
                    .map(|hand| {
                        plan::plan(&scene, hand, &PlanOptions::default(), &StdBudget::new(None), None)
                    })
                    .collect::<Vec<_>>()
            })
        })
    }
}

fn case(name: &str, run: impl Fn(&Bench) -> Duration + 'static) -> Case {
    Case { name: name.to_owned(), run: Box::new(run) }
}

/// The optimization alone: what the plan's own clock says of its stages `initialize` and `optimize`.
fn optimize(scene: &Scene, hand: &Hand, options: &PlanOptions) -> Duration {
    stages(scene, hand, options, &["initialize", "optimize"])
}

/// The time that some stages of a plan take, by the plan's own clock.
fn stages(scene: &Scene, hand: &Hand, options: &PlanOptions, wanted: &[&str]) -> Duration {
    let plan = plan::plan(scene, hand, options, &StdBudget::new(None), None);
    plan.stats.stages.iter().filter(|(name, _)| wanted.contains(name)).map(|(_, d)| *d).sum()
}
