//! One view of a scene: where the camera stands, what it delivers, and what the planner's own code makes of it.

use std::f64::consts::{PI, TAU};

use graspd_planner::frame::{DepthImage, Frame, Intrinsics};
use graspd_planner::grid::Grid;
use graspd_planner::options::{SceneOptions, WorkspaceRequest};
use graspd_planner::scene::look;
use graspd_planner::volume::Volume;
use graspd_planner::workspace::{TABLE_HEIGHT_M, Workspace};
use graspd_sim::camera::look_at;
use graspd_sim::sensor::DepthCamera;
use graspd_sim::world::World;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::DatasetError;
use super::recipe::Recipe;
use crate::evaluate::seeds::derive;

/// The golden angle: azimuths of any number of views are spread evenly.
const GOLDEN_RAD: f64 = 2.399_963_229_728_653;
/// Height of the middle of what stands on the table, metres.
const MIDDLE_M: f64 = 0.03;
/// Most pixels along a side of a preview.
const PREVIEW_PX: usize = 96;

/// Where a camera and its volume stand.
#[derive(Debug, Clone, Copy)]
pub struct Viewpoint {
    /// Pose of the optical frame, world frame.
    pub world_from_camera: Isometry3<f64>,
    /// Where a calibrated caller puts the volume.
    pub placed: WorkspaceRequest,
    /// Whether the planner places it instead.
    pub auto: bool,
}

/// A small depth image, for people.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Preview {
    /// Width, pixels.
    pub width: u16,
    /// Height, pixels.
    pub height: u16,
    /// Millimetres, row major, 0 where there is no return.
    pub depth_mm: Vec<u16>,
}

/// What a view shows.
#[derive(Debug, Clone)]
pub struct Observation {
    /// The camera's pose, world frame.
    pub world_from_camera: Isometry3<f64>,
    /// Where the volume stands.
    pub workspace: Workspace,
    /// What was seen.
    pub volume: Volume,
    /// The depth image, small.
    pub preview: Preview,
}

/// Viewpoint `view` of `views` around a scene with this seed.
pub fn viewpoint(recipe: &Recipe, grid: &Grid, seed: u64, view: u32, views: u32) -> Viewpoint {
    let turn = TAU * Xoshiro256PlusPlus::seed_from_u64(derive(seed, &[4])).random::<f64>();
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(derive(seed, &[5, u64::from(view)]));
    let mut within = |[low, high]: [f64; 2]| low + (high - low) * rng.random::<f64>();
    // Azimuths are spread; tilts too, but in an order that has nothing to do with the azimuths'.
    let azimuth = turn + f64::from(view) * GOLDEN_RAD;
    let rank = (u64::from(view) * 37 + derive(seed, &[6])) % u64::from(views.max(1));
    let share = (rank as f64 + within([0.0, 1.0])) / f64::from(views.max(1));
    let tilt = (recipe.tilt_deg[0] + share * (recipe.tilt_deg[1] - recipe.tilt_deg[0])).to_radians();
    let distance = within(recipe.distance_m);
    let mut aside = |most: f64| within([-most, most]);
    let target = Point3::new(aside(recipe.aim_m), aside(recipe.aim_m), MIDDLE_M + 0.4 * aside(recipe.aim_m));
    let towards = Vector3::new(tilt.sin() * azimuth.cos(), tilt.sin() * azimuth.sin(), tilt.cos());
    let any_roll = within([0.0, 1.0]) < recipe.any_roll_share;
    let half = 0.5 * grid.size_m;
    let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), within([-PI, PI]));
    let mut aside = |most: f64| within([-most, most]);
    let (x, y) = (aside(recipe.shift_m), aside(recipe.shift_m));
    let floor = -TABLE_HEIGHT_M + aside(recipe.lift_m);
    let corner = Translation3::new(x, y, floor) * yaw * Translation3::new(-half, -half, 0.0);
    let placed = WorkspaceRequest::Placed { world_from_volume: corner, table_m: None };
    let auto = within([0.0, 1.0]) < recipe.auto_share;
    let roll = if any_roll {
        within([-PI, PI])
    } else {
        Normal::new(0.0, recipe.roll_deg.to_radians()).map_or(0.0, |n| n.sample(&mut rng))
    };
    let upright = look_at(&(target + distance * towards), &target, &Vector3::z());
    let world_from_camera = upright * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll);
    Viewpoint { world_from_camera, placed, auto }
}

/// Takes the view's depth frame and fuses it exactly as [`graspd_planner::scene::prepare`] does.
///
/// Where the planner finds no table to place the volume on, the calibrated pose stands in.
///
/// # Errors
/// [`DatasetError::Frame`] for what the planner refuses.
pub fn observe(
    camera: &mut DepthCamera,
    world: &World,
    viewpoint: &Viewpoint,
    grid: Grid,
    noise_seed: u64,
) -> Result<Observation, DatasetError> {
    let lens = camera.sensor().lens;
    let shot = camera.take(world, &viewpoint.world_from_camera, noise_seed);
    let preview = preview(shot.image.width, shot.image.height, &shot.image.depth_m);
    let frame = Frame {
        image: DepthImage {
            width: shot.image.width,
            height: shot.image.height,
            depth_m: shot.image.depth_m.clone(),
        },
        intrinsics: Intrinsics {
            fx_px: lens.fx_px,
            fy_px: lens.fy_px,
            cx_px: lens.cx_px,
            cy_px: lens.cy_px,
            distortion: [0.0; 8],
        },
        world_from_camera: Some(viewpoint.world_from_camera),
        labels: None,
    };
    let frames = std::slice::from_ref(&frame);
    let look = |workspace| look(frames, &SceneOptions { grid, workspace, ..SceneOptions::default() });
    let (workspace, volume) = match viewpoint.auto.then(|| look(WorkspaceRequest::Auto)).transpose()? {
        Some((workspace, volume)) if workspace.table_m.is_some() => (workspace, volume),
        _ => look(viewpoint.placed)?,
    };
    Ok(Observation { world_from_camera: viewpoint.world_from_camera, workspace, volume, preview })
}

/// Every k-th pixel.
fn preview(width: usize, height: usize, depth_m: &[f32]) -> Preview {
    let step = width.max(height).div_ceil(PREVIEW_PX).max(1);
    let (columns, rows) = (width / step, height / step);
    let depth_mm = (0..rows * columns)
        .map(|i| {
            let at = (i / columns * step + step / 2) * width + i % columns * step + step / 2;
            // A cast of what is no number gives 0.
            depth_m.get(at).map_or(0, |d| (d * 1000.0).round() as u16)
        })
        .collect();
    Preview { width: columns as u16, height: rows as u16, depth_mm }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn viewpoints_are_all_around_within_the_recipe() {
        let (recipe, grid) = (Recipe::default(), Grid::default());
        let views = 64;
        let (mut quadrants, mut low, mut auto) = ([0; 4], 0, 0);
        for view in 0..views {
            let v = viewpoint(&recipe, &grid, 11, view, views);
            let eye = v.world_from_camera.translation.vector;
            let away = (eye - Vector3::new(0.0, 0.0, MIDDLE_M)).norm();
            assert!((recipe.distance_m[0] - 0.08..recipe.distance_m[1] + 0.08).contains(&away));
            let tilt = (v.world_from_camera.rotation * Vector3::z()).dot(&-Vector3::z()).acos().to_degrees();
            assert!(tilt <= recipe.tilt_deg[1] + 1e-9, "{tilt}");
            quadrants[usize::from(eye.x > 0.0) + 2 * usize::from(eye.y > 0.0)] += 1;
            low += usize::from(tilt > 40.0);
            auto += usize::from(v.auto);
            let WorkspaceRequest::Placed { world_from_volume, .. } = v.placed else { panic!("{v:?}") };
            let middle = world_from_volume * Point3::new(0.2, 0.2, 0.1);
            assert!(middle.coords.amax() <= 0.03 + 1e-9, "{middle}");
        }
        assert!(quadrants.iter().all(|&n| n > 8), "{quadrants:?}");
        assert!((15..35).contains(&low) && (16..48).contains(&auto), "{low} low, {auto} auto");
    }

    #[test]
    fn a_preview_is_small_and_in_millimetres() {
        let depth: Vec<f32> = (0..640 * 576).map(|i| if i % 2 == 0 { 0.7501 } else { f32::NAN }).collect();
        let p = preview(640, 576, &depth);
        assert_eq!((p.width, p.height, p.depth_mm.len()), (91, 82, 91 * 82));
        assert!(p.depth_mm.iter().all(|d| [0, 750].contains(d)));
        assert_eq!(preview(0, 0, &[]), Preview::default());
    }
}
