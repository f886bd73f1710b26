//! Options from the wire: how the scene is read and how grasps are searched.

use std::time::Duration;

use graspd_planner::grid::Grid;
use graspd_planner::options::{
    KeepOut, OrientationLimits, PlanOptions, Reaching, Region, SceneOptions, Scheme, Target, VolumeKind,
    WorkspaceRequest,
};
use graspd_proto::v1;
use nalgebra::{Isometry3, Vector3};

use super::geometry::{direction, point, pose, vector};
use super::{count, join, known_enum, number_within, positive_up_to};
use crate::error::FieldError;
use crate::pool::Priority;

/// At most this many keep-out boxes.
pub(super) const MOST_KEEP_OUT_BOXES: usize = 64;
/// At most this many candidates.
const LARGEST_BATCH: i32 = 4096;
/// At most this many iterations.
const MOST_ITERATIONS: i32 = 10_000;
/// Smallest and largest edge length of a volume, metres.
const VOLUME_SIZE_M: (f64, f64) = (0.1, 2.0);
/// Smallest and largest number of voxels along an edge: 128 keep a frame's fields under 150 MB.
const VOLUME_RESOLUTION: (i32, i32) = (16, 128);
/// At most this many grasps.
const MOST_GRASPS: i32 = 1000;

/// How the scene is read, and the name of the estimator (`None`: the server's default).
pub(super) fn scene_options(
    wire: Option<v1::SceneOptions>,
    path: &str,
) -> Result<(SceneOptions, Option<String>), FieldError> {
    let defaults = SceneOptions::default();
    let Some(wire) = wire else { return Ok((defaults, None)) };
    let grid = Grid {
        resolution: resolution(wire.volume_resolution, &join(path, "volume_resolution"))?,
        size_m: number_within(
            wire.volume_size_m,
            defaults.grid.size_m,
            VOLUME_SIZE_M,
            &join(path, "volume_size_m"),
        )?,
    };
    let volume = match known_enum(wire.volume_kind, &join(path, "volume_kind"))? {
        v1::VolumeKind::Unspecified | v1::VolumeKind::Tsdf => VolumeKind::Tsdf,
        v1::VolumeKind::Occupancy => VolumeKind::Occupancy,
    };
    let workspace = match wire.workspace {
        None => WorkspaceRequest::Auto,
        Some(placed) => {
            let path = join(path, "workspace");
            WorkspaceRequest::Placed {
                world_from_volume: pose(placed.pose.as_ref(), &join(&path, "pose"))?,
                table_m: (placed.table_height_m)
                    .map(|height| table_height(height, grid.size_m, &join(&path, "table_height_m")))
                    .transpose()?,
            }
        }
    };
    let threshold = |value, default, name| positive_up_to(value, default, 1.0, &join(path, name));
    let options = SceneOptions {
        volume,
        grid,
        workspace,
        region: (wire.grasp_region)
            .map(|region| {
                let path = join(path, "grasp_region");
                let (world_from_box, half_extents_m) =
                    solid_box(region.pose.as_ref(), region.half_extents_m, &path)?;
                Ok::<_, FieldError>(Region { world_from_box, half_extents_m })
            })
            .transpose()?,
        focal_contact_threshold: threshold(
            wire.focal_contact_threshold,
            defaults.focal_contact_threshold,
            "focal_contact_threshold",
        )?,
        focal_centroid_threshold: threshold(
            wire.focal_centroid_threshold,
            defaults.focal_centroid_threshold,
            "focal_centroid_threshold",
        )?,
    };
    Ok((options, Some(wire.estimator).filter(|name| !name.is_empty())))
}

/// A height in the cube: at the very top there would be nothing above the table.
fn table_height(height_m: f64, size_m: f64, path: &str) -> Result<f64, FieldError> {
    if (0.0..size_m).contains(&height_m) {
        return Ok(height_m);
    }
    Err(FieldError::value(path, height_m, format!("at least 0 and less than {size_m}, the volume's size")))
}

fn resolution(wire: i32, path: &str) -> Result<usize, FieldError> {
    let (low, high) = VOLUME_RESOLUTION;
    match wire {
        0 => Ok(Grid::default().resolution),
        n if (low..=high).contains(&n) => Ok(n.unsigned_abs() as usize),
        n => Err(FieldError::value(path, n, format!("{low} to {high} voxels, or 0 for 80"))),
    }
}

/// How grasps are searched, and how the search is treated.
#[derive(Debug, Clone, Default)]
pub(super) struct Asked {
    pub(super) options: PlanOptions,
    /// `None`: the call's deadline alone.
    pub(super) budget: Option<Duration>,
    /// The caller named the scheme.
    pub(super) scheme_is_fixed: bool,
    /// Less than the whole search is no answer.
    pub(super) require_complete: bool,
    /// How urgent it is.
    pub(super) priority: Priority,
}

/// How grasps are searched.
pub(super) fn plan_options(wire: Option<v1::PlanOptions>, path: &str) -> Result<Asked, FieldError> {
    let defaults = PlanOptions::default();
    let Some(wire) = wire else { return Ok(Asked::default()) };
    let priority = match known_enum(wire.priority, &join(path, "priority"))? {
        v1::Priority::Unspecified | v1::Priority::Normal => Priority::Normal,
        v1::Priority::Low => Priority::Low,
        v1::Priority::High => Priority::High,
        v1::Priority::Servo => Priority::Servo,
    };
    let (scheme_is_fixed, require_complete) = (wire.scheme.is_some(), wire.require_complete);
    let at = |name: &str| join(path, name);
    let reaching = reaching(&wire, path)?;
    let default_orientation = default_orientation(&reaching);
    let budget = wire.budget.map(|d| budget(d, &at("budget"))).transpose()?;
    let keep_out_count = wire.keep_out_boxes.len();
    if keep_out_count > MOST_KEEP_OUT_BOXES {
        return Err(FieldError::value(
            at("keep_out_boxes"),
            format!("{keep_out_count} boxes"),
            format!("at most {MOST_KEEP_OUT_BOXES} boxes"),
        ));
    }
    let options = PlanOptions {
        batch: count(wire.batch_size, defaults.batch, LARGEST_BATCH, &at("batch_size"))?,
        scheme: wire.scheme.map_or(Ok(defaults.scheme), |s| scheme(s, &at("scheme")))?,
        reaching,
        orientation: wire.orientation_limits.map_or(Ok(default_orientation), |l| {
            orientation(l, default_orientation, &at("orientation_limits"))
        })?,
        keep_out: (wire.keep_out_boxes.iter().enumerate())
            .map(|(i, b)| keep_out(b, &at(&format!("keep_out_boxes[{i}]"))))
            .collect::<Result<_, _>>()?,
        target: wire.target.map(|t| target(t, path)).transpose()?,
        seed: wire.seed,
        max_grasps: count(wire.max_grasp_count, defaults.max_grasps, MOST_GRASPS, &at("max_grasp_count"))?,
        min_score: number_within(wire.min_score, defaults.min_score, (0.0, 1.0), &at("min_score"))?,
        opening_fraction: positive_up_to(
            wire.opening_fraction,
            defaults.opening_fraction,
            1.0,
            &at("opening_fraction"),
        )?,
        friction: positive_up_to(wire.friction, defaults.friction, 5.0, &at("friction"))?,
        pregrasp_offset_m: number_within(
            wire.pregrasp_offset_m,
            defaults.pregrasp_offset_m,
            (0.0, 1.0),
            &at("pregrasp_offset_m"),
        )?,
        trace: wire.trace,
    };
    Ok(Asked { options, budget, scheme_is_fixed, require_complete, priority })
}

fn reaching(wire: &v1::PlanOptions, path: &str) -> Result<Reaching, FieldError> {
    let asked: v1::Reaching = known_enum(wire.reaching, &join(path, "reaching"))?;
    let direction_path = join(path, "reaching_direction");
    if asked == v1::Reaching::Direction {
        return direction(wire.reaching_direction, &direction_path).map(Reaching::Direction);
    }
    if wire.reaching_direction.is_some() {
        return Err(FieldError::value(
            direction_path,
            "a direction",
            "none unless reaching is REACHING_DIRECTION",
        ));
    }
    Ok(match asked {
        v1::Reaching::CameraRay => Reaching::CameraRay,
        v1::Reaching::Free => Reaching::Free,
        v1::Reaching::Unspecified | v1::Reaching::TopDown | v1::Reaching::Direction => Reaching::TopDown,
    })
}

fn scheme(wire: v1::Scheme, path: &str) -> Result<Scheme, FieldError> {
    let within = |value: i32, low: i32, high: i32, name: &str| {
        usize::try_from(value)
            .ok()
            .filter(|_| (low..=high).contains(&value))
            .ok_or_else(|| FieldError::value(join(path, name), value, format!("{low} to {high}")))
    };
    Ok(Scheme {
        iterations: within(wire.iteration_count, 1, MOST_ITERATIONS, "iteration_count")?,
        with_penetration: within(
            wire.penetration_iteration_count,
            0,
            wire.iteration_count,
            "penetration_iteration_count",
        )?,
    })
}

/// Limits where the caller names none: a hand that may reach from anywhere may also tilt as far.
fn default_orientation(reaching: &Reaching) -> OrientationLimits {
    OrientationLimits {
        cone_rad: OrientationLimits::default_cone_rad(reaching),
        ..OrientationLimits::default()
    }
}

fn orientation(
    wire: v1::OrientationLimits,
    defaults: OrientationLimits,
    path: &str,
) -> Result<OrientationLimits, FieldError> {
    use std::f64::consts::{PI, TAU};

    let cone_rad =
        number_within(wire.max_tilt_rad, defaults.cone_rad, (0.0, PI), &join(path, "max_tilt_rad"))?;
    let roll_rad = match wire.roll {
        None => None,
        Some(range) => {
            let path = join(path, "roll");
            let min = number_within(Some(range.min_rad), 0.0, (-TAU, TAU), &join(&path, "min_rad"))?;
            let max = number_within(Some(range.max_rad), 0.0, (min, TAU), &join(&path, "max_rad"))?;
            Some((min, max))
        }
    };
    Ok(OrientationLimits { cone_rad, roll_rad })
}

fn keep_out(wire: &v1::KeepOutBox, path: &str) -> Result<KeepOut, FieldError> {
    let (world_from_box, half_extents_m) = solid_box(wire.pose.as_ref(), wire.half_extents_m, path)?;
    Ok(KeepOut { world_from_box, half_extents_m })
}

/// A box by its pose and half extents.
pub(super) fn solid_box(
    wire_pose: Option<&v1::Pose>,
    wire_half: Option<v1::Vector3>,
    path: &str,
) -> Result<(Isometry3<f64>, Vector3<f64>), FieldError> {
    let world_from_box = pose(wire_pose, &join(path, "pose"))?;
    let path = join(path, "half_extents_m");
    let half_extents_m = vector(wire_half, &path)?;
    for (name, value) in ["x", "y", "z"].into_iter().zip(half_extents_m.iter()) {
        if *value <= 0.0 {
            return Err(FieldError::value(join(&path, name), value, "more than 0"));
        }
    }
    Ok((world_from_box, half_extents_m))
}

fn target(wire: v1::plan_options::Target, path: &str) -> Result<Target, FieldError> {
    match wire {
        v1::plan_options::Target::TargetLabel(label) => match u8::try_from(label) {
            Ok(label) if label > 0 => Ok(Target::Label(label)),
            _ => Err(FieldError::value(join(path, "target_label"), label, "1 to 255")),
        },
        v1::plan_options::Target::TargetPoint(target) => {
            let path = join(path, "target_point");
            Ok(Target::Point {
                point: point(target.point, &join(&path, "point"))?,
                radius_m: positive_up_to(Some(target.radius_m), 0.0, 1e4, &join(&path, "radius_m"))?,
            })
        }
    }
}

fn budget(wire: prost_types::Duration, path: &str) -> Result<Duration, FieldError> {
    const LONGEST: Duration = Duration::from_secs(3600);
    match Duration::try_from(wire) {
        Ok(budget) if !budget.is_zero() && budget <= LONGEST => Ok(budget),
        _ => Err(FieldError::value(
            path,
            format!("{} s and {} ns", wire.seconds, wire.nanos),
            "more than 0, at most 3600 s",
        )),
    }
}
