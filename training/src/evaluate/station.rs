//! The place where grasps are measured: a tray on a table, a calibrated depth camera above it
//! (Supplementary Note 7).

use std::sync::Arc;

use graspd_planner::frame::{DepthImage, Frame, Intrinsics};
use graspd_planner::options::{KeepOut, Region, SceneOptions, VolumeKind, WorkspaceRequest};
use graspd_planner::workspace::TABLE_HEIGHT_M;
use graspd_sim::camera::look_at;
use graspd_sim::clutter::{Arrangement, arrange};
use graspd_sim::object::Object;
use graspd_sim::render::capture;
use graspd_sim::sensor::Sensor;
use graspd_sim::world::{Tray, World, WorldSettings};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};

use super::EvaluationError;
use super::seeds::derive;

/// How often objects are poured anew where some find no rest.
const POURINGS: u64 = 5;
/// Depth noise smears walls by about this much, metres.
const WALL_NOISE_M: f64 = 0.008;
/// Nothing in a tray reaches higher, metres.
const HIGHEST_M: f64 = 0.3;

/// What lies between a tray's walls.
fn inside(tray: &Tray) -> Region {
    let side = |inner: f64| 0.5 * inner - WALL_NOISE_M;
    Region {
        world_from_box: Isometry3::translation(0.0, 0.0, 0.5 * HIGHEST_M),
        half_extents_m: Vector3::new(side(tray.width_m), side(tray.length_m), 0.5 * HIGHEST_M),
    }
}

/// A world's settings and the camera that looks at it.
#[derive(Debug, Clone, PartialEq)]
pub struct Station {
    /// Table and tray.
    pub world: WorldSettings,
    /// The depth camera, with its faults.
    pub sensor: Sensor,
    /// Its pose, world frame; known exactly.
    pub world_from_camera: Isometry3<f64>,
}

impl Station {
    /// A tray, and an Azure Kinect 0.75 m above its front edge that looks at its middle.
    pub fn tray() -> Self {
        let world = WorldSettings { tray: Some(Tray::default()), ..WorldSettings::default() };
        Self::new(world, &Point3::new(0.0, -0.2, 0.75))
    }

    /// A bare table, and an Azure Kinect at `eye` that looks at the middle of what stands on it.
    pub fn table(eye: &Point3<f64>) -> Self {
        Self::new(WorldSettings { tray: None, ..WorldSettings::default() }, eye)
    }

    fn new(world: WorldSettings, eye: &Point3<f64>) -> Self {
        let world_from_camera = look_at(eye, &Point3::new(0.0, 0.0, 0.02), &Vector3::z());
        Self { world, sensor: Sensor::azure_kinect(), world_from_camera }
    }

    /// The station's world with objects poured into it. Where they find no rest with a seed, others follow from it.
    ///
    /// # Errors
    /// [`EvaluationError::Arrange`] when they find none with any of [`POURINGS`].
    pub(crate) fn poured(&self, objects: &[Arc<Object>], seed: u64) -> Result<World, EvaluationError> {
        let mut pouring = 0;
        loop {
            // The first pouring is that of the seed itself.
            let seed = if pouring == 0 { seed } else { derive(seed, &[pouring]) };
            match arrange(&self.world, objects, Arrangement::Pile, seed) {
                Ok(world) => return Ok(world),
                Err(error) if pouring + 1 == POURINGS => return Err(error.into()),
                Err(_) => pouring += 1,
            }
        }
    }

    /// One noisy depth frame of a world, as the planner reads it.
    pub fn frame(&self, world: &World, noise_seed: u64) -> Frame {
        let lens = self.sensor.lens;
        let view = capture(world, &lens, &self.world_from_camera);
        let seen = self.sensor.observe(&view, noise_seed);
        Frame {
            image: DepthImage { width: seen.width, height: seen.height, depth_m: seen.depth_m },
            intrinsics: Intrinsics {
                fx_px: lens.fx_px,
                fy_px: lens.fy_px,
                cx_px: lens.cx_px,
                cy_px: lens.cy_px,
                distortion: [0.0; 8],
            },
            world_from_camera: Some(self.world_from_camera),
            labels: None,
        }
    }

    /// How the planner reads the station's frames: the cube stands centred on the tray, its table height is
    /// looked for in the frame (a depth camera's bias moves it), only what lies inside the tray's walls may be
    /// grasped.
    pub fn scene_options(&self, volume: VolumeKind) -> SceneOptions {
        let options = SceneOptions { volume, ..SceneOptions::default() };
        let half = 0.5 * options.grid.size_m;
        let world_from_volume = Isometry3::translation(-half, -half, -TABLE_HEIGHT_M);
        let workspace = WorkspaceRequest::Placed { world_from_volume, table_m: None };
        SceneOptions { workspace, region: self.world.tray.as_ref().map(inside), ..options }
    }

    /// Boxes around the tray's walls, in which no part of a hand may be: walls this thin drown in the noise of their
    /// edges, so that a frame shows them with gaps.
    pub fn keep_out(&self) -> Vec<KeepOut> {
        let walls = self.world.tray.as_ref().map(Tray::walls).into_iter().flatten();
        let around = |(center, half): (Vector3<f64>, Vector3<f64>)| KeepOut {
            world_from_box: Isometry3::from_parts(center.into(), UnitQuaternion::identity()),
            half_extents_m: half,
        };
        walls.map(around).collect()
    }

    /// True when a point lies over the tray's floor (over the table's middle, without a tray), not more than
    /// `margin_m` outside.
    pub fn holds(&self, point: &Point3<f64>, margin_m: f64) -> bool {
        let (x, y) = match &self.world.tray {
            Some(tray) => (0.5 * tray.width_m, 0.5 * tray.length_m),
            None => (0.2, 0.2),
        };
        point.x.abs() <= x + margin_m && point.y.abs() <= y + margin_m && point.z > -0.01
    }
}
