//! What a caller may ask for: how the scene is read, and how a hand's grasps are searched.

use nalgebra::{Isometry3, Point3, Unit, Vector3};

use crate::grid::Grid;

/// How a volume is read: what the estimator sees, and what counts as solid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub enum VolumeKind {
    /// Truncated signed distance, 0 where unseen. Solid is what was seen, completed downwards to the table.
    #[default]
    Tsdf,
    /// Occupancy: 1 unless seen to be free (the paper's "Voxel"). All of that is solid, shadows too.
    Occupancy,
}

/// Where the volume comes from.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum WorkspaceRequest {
    /// Find the table in the first frame and stand the cube on it, around what is there.
    #[default]
    Auto,
    /// This pose of the volume in the world.
    Placed {
        /// Takes volume coordinates (origin at the corner, z up) to world coordinates.
        world_from_volume: Isometry3<f64>,
        /// Height of the table top in the volume, metres; `None`: look for it, else assume there is none.
        table_m: Option<f64>,
    },
}

/// Where things may be grasped: an upright or tilted box in the world. What is outside stays an obstacle, but is no
/// object: the walls of a tray, the neighbour's bin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Region {
    /// Takes box coordinates (origin at the centre) to world coordinates.
    pub world_from_box: Isometry3<f64>,
    /// Half extents, metres.
    pub half_extents_m: Vector3<f64>,
}

impl Region {
    /// True when the point, given in the frame in which the box stands, is in the box.
    pub fn contains(&self, point: &Point3<f64>) -> bool {
        let local = self.world_from_box.inverse_transform_point(point);
        (0..3).all(|a| local[a].abs() <= self.half_extents_m[a])
    }
}

/// How the scene is read, once per frame.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneOptions {
    /// TSDF or occupancy.
    pub volume: VolumeKind,
    /// Size and resolution of the cube.
    pub grid: Grid,
    /// Where it stands.
    pub workspace: WorkspaceRequest,
    /// Where things may be grasped; `None`: anywhere in the volume.
    pub region: Option<Region>,
    /// `T_fc`: focal contacts exceed this share of the largest certainty (Supplementary Note 3: 0.7).
    pub focal_contact_threshold: f64,
    /// `T_fe`: focal centroids exceed this share of the largest centroid score (Supplementary Note 3: 0.95).
    pub focal_centroid_threshold: f64,
}

impl Default for SceneOptions {
    fn default() -> Self {
        Self {
            volume: VolumeKind::default(),
            grid: Grid::default(),
            workspace: WorkspaceRequest::Auto,
            region: None,
            focal_contact_threshold: 0.7,
            focal_centroid_threshold: 0.95,
        }
    }
}

/// Iterations of an optimization, `[iterations, of which the last with penetration]` (Supplementary Table 2).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Scheme {
    /// All iterations.
    pub iterations: usize,
    /// The last so many check penetration too; at most `iterations`.
    pub with_penetration: usize,
}

impl Scheme {
    /// `[200, 40]`, the paper's hardware setting.
    pub const THOROUGH: Self = Self { iterations: 200, with_penetration: 40 };
    /// `[100, 40]`.
    pub const BALANCED: Self = Self { iterations: 100, with_penetration: 40 };
    /// `[60, 60]`.
    pub const QUICK: Self = Self { iterations: 60, with_penetration: 60 };
}

impl Default for Scheme {
    fn default() -> Self {
        Self::THOROUGH
    }
}

/// The reaching direction `v_hg` (Supplementary Note 4): along it the hand approaches the objects.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Reaching {
    /// Against the volume's z axis, onto the table.
    #[default]
    TopDown,
    /// Along the ray from the camera to the middle of what it sees.
    CameraRay,
    /// This direction, world frame.
    Direction(Unit<Vector3<f64>>),
    /// Any direction within 1.3 rad of straight down (the volume's −z), drawn anew for each candidate.
    Free,
}

/// With a free reaching direction: largest angle from straight down, radians.
pub(crate) const FREE_CONE_RAD: f64 = 1.3;

/// What orientations a returned grasp may have; holds for every one of them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OrientationLimits {
    /// Largest angle between the hand's approach axis and the reaching direction, radians. 0 leaves only
    /// the rotation about the reaching direction (a 4-DoF SCARA). With [`Reaching::Free`] both limits are
    /// measured about straight down (the volume's −z).
    pub cone_rad: f64,
    /// Allowed rotation, radians, right-handed about the reaching direction (for top-down: opposite to a yaw
    /// seen from above); `None`: any. Zero where the hand's lateral axis (x of the hand frame, or y where the
    /// approach is along x) and the world's x axis (y where the hand reaches along x), both projected onto the
    /// plane normal to the reaching direction, coincide.
    pub roll_rad: Option<(f64, f64)>,
}

impl Default for OrientationLimits {
    fn default() -> Self {
        Self { cone_rad: Self::default_cone_rad(&Reaching::default()), roll_rad: None }
    }
}

impl OrientationLimits {
    /// The cone where the caller names none: π/3, or with a free direction all that it is drawn from, 1.3 rad.
    pub fn default_cone_rad(reaching: &Reaching) -> f64 {
        if matches!(reaching, Reaching::Free) { FREE_CONE_RAD } else { std::f64::consts::FRAC_PI_3 }
    }
}

/// A box that no part of the hand may enter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KeepOut {
    /// Takes box coordinates (origin at the centre) to world coordinates.
    pub world_from_box: Isometry3<f64>,
    /// Half extents, metres.
    pub half_extents_m: Vector3<f64>,
}

/// Which object to grasp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Target {
    /// The object with this label in the frames' label images.
    Label(u8),
    /// Whatever is within `radius_m` of this point of the world.
    Point {
        /// World frame, metres.
        point: Point3<f64>,
        /// Metres.
        radius_m: f64,
    },
}

/// How grasps of one hand are searched.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanOptions {
    /// Candidates, `N_batch` (the paper's hardware setting: 48).
    pub batch: usize,
    /// Iterations.
    pub scheme: Scheme,
    /// Reaching direction.
    pub reaching: Reaching,
    /// Orientations that the robot can take.
    pub orientation: OrientationLimits,
    /// Where the hand must not be.
    pub keep_out: Vec<KeepOut>,
    /// What to grasp; `None`: anything.
    pub target: Option<Target>,
    /// Same seed, same scene, same hand: same answer.
    pub seed: u64,
    /// At most this many grasps are returned.
    pub max_grasps: usize,
    /// Grasps that score less are left out.
    pub min_score: f64,
    /// `γ_j`: initial joints lie within this share of the closing range (Supplementary Note 3: 0.2).
    pub opening_fraction: f64,
    /// Coulomb friction between pads and objects.
    pub friction: f64,
    /// Distance of the pre-grasp from the grasp along the approach, metres.
    pub pregrasp_offset_m: f64,
    /// Keep the objective's terms of every iteration.
    pub trace: bool,
}

impl Default for PlanOptions {
    fn default() -> Self {
        Self {
            batch: 48,
            scheme: Scheme::default(),
            reaching: Reaching::default(),
            orientation: OrientationLimits::default(),
            keep_out: Vec::new(),
            target: None,
            seed: 0,
            max_grasps: 10,
            min_score: 0.0,
            opening_fraction: 0.2,
            friction: 0.5,
            pregrasp_offset_m: 0.10,
            trace: false,
        }
    }
}
