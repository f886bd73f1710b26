//! Pictures and pages of a scene and its grasps.

pub(crate) mod lettering;
pub(crate) mod mesh;
pub(crate) mod page;
pub(crate) mod picture;
pub(crate) mod raster;
mod sheet;
pub(crate) mod surface;

use graspd_hands::Hand;
use graspd_planner::frame::Frame;
use graspd_planner::scene::Scene;
use graspd_planner::volume::VoxelState;
use graspd_planner::workspace::Workspace;
use nalgebra::{Isometry3, Point3, Vector3};

use crate::outcome::{GraspOutcome, Outcome};

/// What of a scene is drawn.
#[derive(Debug, Clone)]
pub(crate) struct ViewScene {
    /// The depth frame, unless the scene came as a contact field.
    pub(crate) frame: Option<Frame>,
    /// Pose of the first camera.
    pub(crate) world_from_camera: Isometry3<f64>,
    /// Where the volume stands.
    pub(crate) workspace: Workspace,
    /// Focal contacts.
    pub(crate) contacts: Vec<FieldPoint>,
    /// Centred centroids and their weights, world frame.
    pub(crate) centroids: Vec<(Point3<f64>, f64)>,
    /// Centres of seen voxels, world frame; for scenes without a frame.
    pub(crate) voxels: Vec<Point3<f64>>,
}

/// A focal contact, world frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FieldPoint {
    /// Voxel centre.
    pub(crate) point: Point3<f64>,
    /// From the finger into the object.
    pub(crate) inward: Vector3<f64>,
    /// Certainty, 0 to 1, relative to the field's largest.
    pub(crate) certainty: f64,
}

/// A hand and what was planned for it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct HandView<'a> {
    /// The hand.
    pub(crate) hand: &'a Hand,
    /// Its answer.
    pub(crate) outcome: &'a Outcome,
}

/// One of the three moments of a grasp.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Moment {
    /// Open, at the pre-grasp pose.
    PreGrasp,
    /// At the grasp, pads touching.
    Contact,
    /// At the grasp, pressing.
    Squeezed,
}

impl Moment {
    /// In the order of a grasp.
    pub(crate) const ALL: [Self; 3] = [Self::PreGrasp, Self::Contact, Self::Squeezed];
}

impl ViewScene {
    /// Gathers what is drawn.
    pub(crate) fn new(scene: &Scene, frame: Option<&Frame>) -> Self {
        let to_world = scene.workspace.world_from_volume;
        let grid = scene.features.grid;
        let field = &scene.contact_field;
        let largest = field.certainty.iter().copied().fold(f32::MIN_POSITIVE, f32::max);
        let contacts = scene.features.focal_contacts.iter().map(|&i| {
            let i = i as usize;
            let inward = field.inward[i].map(f64::from);
            FieldPoint {
                point: to_world * grid.center(grid.voxel(i)),
                inward: to_world.rotation * Vector3::from(inward),
                certainty: f64::from(field.certainty[i] / largest),
            }
        });
        let voxels = if frame.is_none() {
            let seen = scene.volume.state.iter().enumerate().filter(|(_, s)| **s == VoxelState::Surface);
            seen.map(|(i, _)| to_world * grid.center(grid.voxel(i))).collect()
        } else {
            Vec::new()
        };
        Self {
            frame: frame.cloned(),
            world_from_camera: scene.world_from_camera,
            workspace: scene.workspace,
            contacts: contacts.collect(),
            centroids: scene.features.centroids.iter().map(|c| (to_world * c.position, c.weight)).collect(),
            voxels,
        }
    }

    /// Middle of the table in the volume (of its bottom, without a table), world frame.
    pub(crate) fn middle(&self) -> Point3<f64> {
        let half = self.workspace.grid.size_m / 2.0;
        self.workspace.world_from_volume * Point3::new(half, half, self.workspace.table_m.unwrap_or(0.0))
    }

    /// Up: away from the table, world frame.
    pub(crate) fn up(&self) -> Vector3<f64> {
        self.workspace.world_from_volume.rotation * Vector3::z()
    }
}

/// Pose of every body of a hand at a moment of a grasp, world frame.
///
/// Empty when the grasp's joints are not those of the hand (a server with another revision of it).
pub(crate) fn body_poses(hand: &Hand, grasp: &GraspOutcome, moment: Moment) -> Vec<Isometry3<f64>> {
    let values = &grasp.joints.values;
    let (wrist, joints) = match moment {
        Moment::PreGrasp => (grasp.world_from_pregrasp, &values.open),
        Moment::Contact => (grasp.world_from_hand, &values.contact),
        Moment::Squeezed => (grasp.world_from_hand, &values.squeezed),
    };
    if joints.len() != hand.tree.joints.len() {
        return Vec::new();
    }
    hand.tree.body_poses(joints).iter().map(|pose| wrist * pose).collect()
}

/// A colour for each hand, linear red, green, blue: of equal lightness, apart in hue.
pub(crate) fn accent(index: usize) -> [f32; 3] {
    const COLORS: [[f32; 3]; 12] = [
        [0.85, 0.30, 0.08],
        [0.05, 0.42, 0.72],
        [0.10, 0.52, 0.22],
        [0.62, 0.16, 0.52],
        [0.78, 0.50, 0.04],
        [0.03, 0.52, 0.52],
        [0.76, 0.13, 0.20],
        [0.28, 0.25, 0.78],
        [0.44, 0.52, 0.05],
        [0.78, 0.22, 0.44],
        [0.14, 0.50, 0.40],
        [0.50, 0.32, 0.16],
    ];
    COLORS[index % COLORS.len()]
}

/// A colour for a certainty between 0 and 1: from violet over magenta to yellow; linear red, green, blue.
pub(crate) fn certainty_color(certainty: f64) -> [f32; 3] {
    const STOPS: [[f32; 3]; 4] =
        [[0.07, 0.02, 0.30], [0.52, 0.04, 0.36], [0.90, 0.24, 0.08], [0.98, 0.82, 0.14]];
    let t = (certainty.clamp(0.0, 1.0) * 3.0) as f32;
    let low = (t as usize).min(2);
    let share = t - low as f32;
    [0, 1, 2].map(|k| STOPS[low][k] + (STOPS[low + 1][k] - STOPS[low][k]) * share)
}

#[cfg(test)]
pub(crate) mod fixtures;
