//! Everything that is computed once per frame and shared by all hands.

use std::time::Duration;

use nalgebra::{Isometry3, Point3, Unit, Vector3};

use crate::budget::{Budget, Unlimited};
use crate::contact_field::{ContactField, ContactFieldError};
use crate::estimator::ContactEstimator;
use crate::frame::{CleanOptions, Frame, FrameError, MAX_TRANSLATION_M, clean_depth};
use crate::grid::{Grid, GridError};
use crate::options::{Region, SceneOptions, WorkspaceRequest};
use crate::refine::{Features, refine, refine_within};
use crate::volume::{View, Volume, VoxelState};
use crate::workspace::{FramePoints, Workspace, frame_points};

/// One observation, refined: the input of every hand's optimization.
#[derive(Debug, Clone)]
pub struct Scene {
    /// Where the volume stands.
    pub workspace: Workspace,
    /// What was seen.
    pub volume: Volume,
    /// What the estimator made of it.
    pub contact_field: ContactField,
    /// What the optimizer reads.
    pub features: Features,
    /// Pose of the first camera, world frame (identity when the caller gave none).
    pub world_from_camera: Isometry3<f64>,
    /// From the first camera towards the middle of what it sees, volume frame.
    pub view_direction: Unit<Vector3<f64>>,
    /// What stands in the workspace.
    pub observation: Observation,
    /// Connected group of object voxels that each voxel belongs to, counted from 1, 0 for none; see
    /// [`Volume::object_groups`].
    pub objects: Vec<u16>,
    /// Durations of the stages so far, in order: `frame`, `volume`, `estimate`, `refine`.
    pub stages: Vec<(&'static str, Duration)>,
}

/// What the frames show in the workspace.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Observation {
    /// No surface was seen in the workspace.
    NothingSeen,
    /// A table was seen, and nothing that stands on it.
    EmptyTable,
    /// Objects.
    Objects {
        /// Voxels of objects, completed down to the table.
        voxels: usize,
    },
}

/// Why frames do not make a scene.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// There is no frame.
    #[error("frames: empty, expected at least one depth frame")]
    NoFrames,
    /// A frame cannot be read.
    #[error("frames[{index}].{source}")]
    Frame {
        /// Position of the frame.
        index: usize,
        /// What is wrong with it.
        source: FrameError,
    },
    /// One of several frames has no pose, so that nobody knows how they fit together.
    #[error("frames[{index}].world_from_camera: missing, expected a pose on every one of {count} frames")]
    MissingPose {
        /// Position of the first frame without a pose.
        index: usize,
        /// Number of frames.
        count: usize,
    },
    /// The grid is of no use.
    #[error("{0}")]
    Grid(#[from] GridError),
    /// A pose of the workspace has a value that is not a number, or a table height outside the cube.
    #[error("workspace.{field}: found {found}, expected {expected}")]
    Workspace {
        /// `world_from_volume` or `table_m`.
        field: &'static str,
        /// Found value.
        found: String,
        /// What is expected.
        expected: String,
    },
    /// A threshold is not a share.
    #[error("{field}: found {found}, expected a share from 0 to 1")]
    Threshold {
        /// `focal_contact_threshold` or `focal_centroid_threshold`.
        field: &'static str,
        /// Found value.
        found: f64,
    },
    /// A contact field's arrays do not fit its grid.
    #[error("{0}")]
    ContactField(#[from] ContactFieldError),
    /// The region is not a box.
    #[error("region.{field}: found {found}, expected {expected}")]
    Region {
        /// `world_from_box` or `half_extents_m`.
        field: &'static str,
        /// Found value.
        found: String,
        /// What is expected.
        expected: &'static str,
    },
    /// The solid voxels do not fit the contact field's grid.
    #[error("solid: found {found} entries, expected one per voxel = {expected}")]
    SolidSize {
        /// Found entries.
        found: usize,
        /// Expected entries.
        expected: usize,
    },
    /// Work had to stop.
    #[error("stopped: {0:?}")]
    Stopped(crate::budget::Stop),
}

/// Runs frame → volume → contact field → features, once for any number of hands.
///
/// With several frames every one needs a pose; a single frame without a pose makes its camera frame the world.
///
/// # Errors
/// [`SceneError`] for frames or options that cannot be read, and when the budget ended. A frame in which nothing
/// is seen is not an error: it gives a scene with empty features.
pub fn prepare(
    frames: &[Frame],
    options: &SceneOptions,
    estimator: &dyn ContactEstimator,
    budget: &dyn Budget,
) -> Result<Scene, SceneError> {
    let mut stages = Stages::new(budget);
    let Placed { depths, points, workspace } = place(frames, options, budget)?;
    stages.end("frame")?;

    let (volume, views) = fuse(frames, &depths, &workspace, options, budget)?;
    read(volume, &views, &workspace, &points.world_from_camera, options, estimator, stages)
}

/// From a fused volume to a scene; `views` are the frames that tell where surfaces lie within voxels, and
/// `world_from_camera` is where it is looked at from.
pub(crate) fn of_volume(
    volume: Volume,
    views: &[View<'_>],
    workspace: &Workspace,
    world_from_camera: &Isometry3<f64>,
    options: &SceneOptions,
    estimator: &dyn ContactEstimator,
    budget: &dyn Budget,
) -> Result<Scene, SceneError> {
    read(volume, views, workspace, world_from_camera, options, estimator, Stages::new(budget))
}

fn read(
    volume: Volume,
    views: &[View<'_>],
    workspace: &Workspace,
    world_from_camera: &Isometry3<f64>,
    options: &SceneOptions,
    estimator: &dyn ContactEstimator,
    mut stages: Stages<'_>,
) -> Result<Scene, SceneError> {
    let budget = stages.budget;
    budget.check().map_err(SceneError::Stopped)?;
    let solid = volume.solid_within(budget);
    budget.check().map_err(SceneError::Stopped)?;
    let surface = volume.surface_within(&solid, views, budget);
    budget.check().map_err(SceneError::Stopped)?;
    let objects = volume.object_groups(&solid);
    budget.check().map_err(SceneError::Stopped)?;
    let observation = observe(&volume, &objects);
    stages.end("volume")?;

    let mut contact_field =
        estimator.estimate_known(&volume, &solid, &objects, budget).map_err(SceneError::Stopped)?;
    contact_field.validate()?;
    if let Some(region) = &volume.region {
        contact_field.keep_only(region);
    }
    stages.end("estimate")?;

    budget.check().map_err(SceneError::Stopped)?;
    let labels = volume.voxel_labels();
    let features = refine_within(&contact_field, &solid, &surface, volume.table_m, labels, options, budget)
        .map_err(SceneError::Stopped)?;
    let eye = (workspace.world_from_volume.inverse() * world_from_camera) * Point3::origin();
    let view_direction = view_direction(&workspace.grid, &objects, &eye);
    stages.end("refine")?;
    Ok(Scene {
        workspace: *workspace,
        volume,
        contact_field,
        features,
        world_from_camera: *world_from_camera,
        view_direction,
        observation,
        objects,
        stages: stages.done,
    })
}

/// Frames made ready for a volume, and where it stands.
struct Placed {
    /// Cleaned depth images.
    depths: Vec<Vec<f32>>,
    /// Points of the first frame.
    points: FramePoints,
    workspace: Workspace,
}

/// Checks frames and options, cleans the depth images and places the volume.
fn place(frames: &[Frame], options: &SceneOptions, budget: &dyn Budget) -> Result<Placed, SceneError> {
    let goes_on = || budget.check().map_err(SceneError::Stopped);
    let first = frames.first().ok_or(SceneError::NoFrames)?;
    for (index, frame) in frames.iter().enumerate() {
        frame.validate().map_err(|source| SceneError::Frame { index, source })?;
    }
    if frames.len() > 1
        && let Some(index) = frames.iter().position(|f| f.world_from_camera.is_none())
    {
        return Err(SceneError::MissingPose { index, count: frames.len() });
    }
    validate(options)?;
    let mut depths = Vec::with_capacity(frames.len());
    for frame in frames {
        depths.push(clean_depth(&frame.image, &CleanOptions::of_lens(&frame.intrinsics), budget));
        goes_on()?;
    }
    let points = frame_points(first, &depths[0], budget);
    goes_on()?;
    let workspace = Workspace::place(&options.workspace, options.grid, &points);
    Ok(Placed { depths, points, workspace })
}

/// The frames in one volume, and how each looked at it.
fn fuse<'a>(
    frames: &'a [Frame],
    depths: &'a [Vec<f32>],
    workspace: &Workspace,
    options: &SceneOptions,
    budget: &dyn Budget,
) -> Result<(Volume, Vec<View<'a>>), SceneError> {
    let mut volume = Volume::empty(workspace.grid, workspace.table_m);
    volume.kind = options.volume;
    volume.region = region_in_volume(options, workspace);
    let seen = frames.iter().zip(depths);
    let views: Vec<View<'_>> =
        seen.map(|(frame, depth)| View::of(frame, depth, &workspace.world_from_volume)).collect();
    for view in &views {
        volume.integrate_within(view.frame, view.depth, &view.camera_from_volume, budget);
        budget.check().map_err(SceneError::Stopped)?;
    }
    Ok((volume, views))
}

/// What [`prepare`] shows to an estimator, and no more: cleaned, placed and fused by the same code. For those who make
/// data for estimators.
///
/// # Errors
/// As [`prepare`], for frames and options that cannot be read.
pub fn look(frames: &[Frame], options: &SceneOptions) -> Result<(Workspace, Volume), SceneError> {
    let placed = place(frames, options, &Unlimited)?;
    let (volume, _) = fuse(frames, &placed.depths, &placed.workspace, options, &Unlimited)?;
    Ok((placed.workspace, volume))
}

/// A scene from a contact field that was made elsewhere, with the solid voxels that came with it.
///
/// The volume's frame is the world frame, the camera looks down from above its middle. The field brings its own
/// grid; of the options the thresholds count, and the table height of a placed workspace. Without one, the table is
/// the top of the lowest layers that are solid nearly all over, if there are such.
///
/// # Errors
/// [`SceneError`] for arrays that do not fit the grid, for options out of range and when the budget ended.
pub fn from_contact_field(
    mut field: ContactField,
    solid: &[bool],
    options: &SceneOptions,
    budget: &dyn Budget,
) -> Result<Scene, SceneError> {
    let mut stages = Stages::new(budget);
    let grid = field.grid;
    grid.validate()?;
    validate(options)?;
    field.validate()?;
    if solid.len() != grid.len() {
        return Err(SceneError::SolidSize { found: solid.len(), expected: grid.len() });
    }
    let table_m = match options.workspace {
        WorkspaceRequest::Placed { table_m: Some(table_m), .. } => Some(table_m),
        _ => solid_floor(&grid, solid),
    };
    let workspace = Workspace { world_from_volume: Isometry3::identity(), grid, table_m };
    let mut volume = Volume::from_solid(grid, table_m, solid);
    volume.region = region_in_volume(options, &workspace);
    if let Some(region) = &volume.region {
        field.keep_only(region);
    }
    let objects = volume.object_groups(solid);
    let observation = observe(&volume, &objects);
    stages.end("volume")?;
    let features = refine(&field, solid, &[], table_m, None, options);
    stages.end("refine")?;
    // Above the middle by the cube's own height, looking down.
    let eye = Point3::new(0.5 * grid.size_m, 0.5 * grid.size_m, 2.0 * grid.size_m);
    let rotation = nalgebra::UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    Ok(Scene {
        workspace,
        volume,
        contact_field: field,
        features,
        world_from_camera: Isometry3::from_parts(eye.coords.into(), rotation),
        view_direction: -Vector3::z_axis(),
        observation,
        objects,
        stages: stages.done,
    })
}

fn region_in_volume(options: &SceneOptions, workspace: &Workspace) -> Option<Region> {
    options.region.map(|region| Region {
        world_from_box: workspace.world_from_volume.inverse() * region.world_from_box,
        ..region
    })
}

/// Stage durations from a budget's clock.
struct Stages<'a> {
    budget: &'a dyn Budget,
    since: Duration,
    done: Vec<(&'static str, Duration)>,
}

impl<'a> Stages<'a> {
    fn new(budget: &'a dyn Budget) -> Self {
        Self { budget, since: budget.elapsed(), done: Vec::new() }
    }

    /// Ends a stage; an error when work has to stop.
    fn end(&mut self, name: &'static str) -> Result<(), SceneError> {
        let now = self.budget.elapsed();
        self.done.push((name, now.saturating_sub(self.since)));
        self.since = now;
        self.budget.stop().map_or(Ok(()), |stop| Err(SceneError::Stopped(stop)))
    }
}

fn validate(options: &SceneOptions) -> Result<(), SceneError> {
    options.grid.validate()?;
    for (field, found) in [
        ("focal_contact_threshold", options.focal_contact_threshold),
        ("focal_centroid_threshold", options.focal_centroid_threshold),
    ] {
        if !(0.0..=1.0).contains(&found) {
            return Err(SceneError::Threshold { field, found });
        }
    }
    if let Some(Region { world_from_box, half_extents_m: half }) = &options.region {
        if let Some(found) = wrong_pose(world_from_box) {
            return Err(SceneError::Region { field: "world_from_box", found, expected: A_POSE });
        }
        if !half.iter().all(|h| h.is_finite() && *h > 0.0) {
            let found = format!("({}, {}, {})", half.x, half.y, half.z);
            return Err(SceneError::Region {
                field: "half_extents_m",
                found,
                expected: "three lengths above 0 m",
            });
        }
    }
    if let WorkspaceRequest::Placed { world_from_volume, table_m } = options.workspace {
        let size = options.grid.size_m;
        if let Some(found) = wrong_pose(&world_from_volume) {
            let expected = A_POSE.into();
            return Err(SceneError::Workspace { field: "world_from_volume", found, expected });
        }
        if let Some(table) = table_m
            && !(0.0..size).contains(&table)
        {
            return Err(SceneError::Workspace {
                field: "table_m",
                found: table.to_string(),
                expected: format!("a height inside the cube, 0 to {size} m"),
            });
        }
    }
    Ok(())
}

const A_POSE: &str = "a translation within 1e6 m and a unit quaternion";

/// What is wrong with a pose, for an error text.
fn wrong_pose(pose: &Isometry3<f64>) -> Option<String> {
    let t = pose.translation.vector;
    let norm = pose.rotation.as_ref().norm();
    (!t.iter().all(|v| v.abs() <= MAX_TRANSLATION_M) || norm.is_nan() || (norm - 1.0).abs() > 1e-3)
        .then(|| format!("translation ({}, {}, {}), quaternion of length {norm}", t.x, t.y, t.z))
}

fn observe(volume: &Volume, objects: &[u16]) -> Observation {
    let voxels = objects.iter().filter(|&&o| o > 0).count();
    if voxels > 0 {
        Observation::Objects { voxels }
    } else if volume.state.contains(&VoxelState::Surface) {
        Observation::EmptyTable
    } else {
        Observation::NothingSeen
    }
}

/// From `eye` (volume frame) towards the mean of the object voxels, or the cube's middle without objects.
fn view_direction(grid: &Grid, objects: &[u16], eye: &Point3<f64>) -> Unit<Vector3<f64>> {
    let (mut count, mut sum) = (0usize, [0usize; 3]);
    for i in (0..objects.len()).filter(|&i| objects[i] > 0) {
        let voxel = grid.voxel(i);
        count += 1;
        for a in 0..3 {
            sum[a] += voxel[a];
        }
    }
    let middle = if count > 0 {
        Point3::from(sum.map(|s| (s as f64 / count as f64 + 0.5) * grid.voxel_m()))
    } else {
        let half = 0.5 * grid.size_m;
        Point3::new(half, half, half)
    };
    Unit::try_new(middle - eye, 1e-9).unwrap_or_else(|| -Vector3::z_axis())
}

/// Top of the lowest layers that are solid to nine tenths.
fn solid_floor(grid: &Grid, solid: &[bool]) -> Option<f64> {
    let n = grid.resolution;
    let mut filled = vec![0usize; n];
    for (i, _) in solid.iter().enumerate().filter(|&(_, &s)| s) {
        filled[i % n] += 1;
    }
    let layers = filled.iter().take_while(|&&f| 10 * f >= 9 * n * n).count();
    // A cube that is solid to the top has no table.
    (layers > 0 && layers < n).then(|| layers as f64 * grid.voxel_m())
}

#[cfg(test)]
mod tests;
