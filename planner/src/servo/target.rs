//! The object that is being approached: where it is now, and whether it is still there.

use nalgebra::Point3;

use crate::refine::CenteredCentroid;
use crate::scene::Scene;

/// A centroid this near to the target is the target, metres.
const SAME_M: f64 = 0.03;
/// A target that has left its place is looked for this far away, metres.
const FAR_M: f64 = 0.12;
/// Object voxels this near to the target are counted as its mass, metres.
const BODY_M: f64 = 0.022;
/// With less than this share of its mass the target has left its place.
const LEFT: f64 = 0.35;
/// With less than this share of its mass where it was the target has moved.
const STILL_THERE: f64 = 0.85;
/// How fast mass and position follow what is seen.
const FOLLOW: f64 = 0.4;

/// What the newest features say about the target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Sight {
    /// It is here; its centroid has moved by so much, metres.
    Here {
        /// New position less old one, world frame.
        moved: nalgebra::Vector3<f64>,
        /// Less of it is where it was: it has really moved. Otherwise only another side of it may have come to be seen.
        is_real: bool,
    },
    /// It has left its place, and there is something within reach that it may be.
    Moved {
        /// Where that is, world frame.
        to: Point3<f64>,
    },
    /// It has left its place, and there is nothing near.
    Gone,
    /// Something is in its place, but nothing says where its middle is.
    Unclear,
}

/// The target, as far as it is known.
#[derive(Debug, Clone)]
pub(super) struct Target {
    /// Its centroid, world frame.
    pub(super) position: Point3<f64>,
    /// Voxels of objects about it.
    mass: Option<f64>,
}

impl Target {
    pub(super) fn at(position: Point3<f64>) -> Self {
        Self { position, mass: None }
    }

    /// Looks for the target in new features and follows it.
    pub(super) fn follow(&mut self, scene: &Scene) -> Sight {
        let world_from_volume = scene.workspace.world_from_volume;
        let at = world_from_volume.inverse_transform_point(&self.position);
        let mass = mass(scene, &at);
        let before = *self.mass.get_or_insert(mass);
        let nearest = nearest(&scene.features.centroids, &at);
        let has_left = mass < LEFT * before;
        match nearest {
            Some((centroid, apart)) if apart <= SAME_M && !has_left => {
                let is_real = mass < STILL_THERE * before;
                self.mass = Some(before + FOLLOW * (mass - before));
                let moved = world_from_volume * (centroid - at);
                self.position += FOLLOW * moved;
                Sight::Here { moved, is_real }
            }
            Some((centroid, apart)) if has_left && apart <= FAR_M => {
                Sight::Moved { to: world_from_volume * centroid }
            }
            _ if has_left => Sight::Gone,
            _ => Sight::Unclear,
        }
    }

    /// The centroids that belong to the target, volume frame; where there is none, its last known place.
    pub(super) fn centroids(&self, scene: &Scene, out: &mut Vec<CenteredCentroid>) {
        let at = scene.workspace.world_from_volume.inverse_transform_point(&self.position);
        out.clear();
        let near = scene.features.centroids.iter().filter(|c| (c.position - at).norm() <= SAME_M);
        out.extend(near.copied());
        if out.is_empty() {
            out.push(CenteredCentroid { position: at, weight: 1.0, voxel_count: 1, label: None });
        }
        let total: f64 = out.iter().map(|c| c.weight).sum();
        for c in out.iter_mut() {
            c.weight /= total;
        }
    }
}

fn nearest(centroids: &[CenteredCentroid], at: &Point3<f64>) -> Option<(Point3<f64>, f64)> {
    let all = centroids.iter().map(|c| (c.position, (c.position - at).norm()));
    all.min_by(|a, b| a.1.total_cmp(&b.1))
}

/// Object voxels about a point.
fn mass(scene: &Scene, at: &Point3<f64>) -> f64 {
    let grid = scene.workspace.grid;
    let (n, edge) = (grid.resolution, grid.voxel_m());
    let range = |c: f64| {
        let clamp = |v: f64| (v / edge).floor().clamp(0.0, n as f64) as usize;
        clamp(c - BODY_M)..(clamp(c + BODY_M) + 1).min(n)
    };
    let mut count = 0usize;
    for x in range(at.x) {
        for y in range(at.y) {
            for z in range(at.z) {
                let near = (grid.center([x, y, z]) - at).norm_squared() <= BODY_M * BODY_M;
                count += usize::from(near && scene.objects[grid.index(x, y, z)] > 0);
            }
        }
    }
    count as f64
}
