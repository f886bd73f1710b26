//! Durations of the stages that run once per frame, on a synthetic clutter of ten blocks and balls.

use divan::{Bencher, black_box};
use graspd_planner::budget::Unlimited;
use graspd_planner::estimator::{ContactEstimator, Geometric};
use graspd_planner::frame::{CleanOptions, DepthImage, Frame, Intrinsics, clean_depth};
use graspd_planner::grid::Grid;
use graspd_planner::options::{SceneOptions, VolumeKind};
use graspd_planner::refine::{distance_to, refine, signed_distance_m};
use graspd_planner::scene::prepare;
use graspd_planner::volume::Volume;
use graspd_planner::workspace::{Workspace, frame_points};
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

fn main() {
    divan::main();
}

/// Distance along a ray to a ball or to an upright box on the table z = 0.
fn hit(origin: &Point3<f64>, ray: &Vector3<f64>, object: &([f64; 2], f64, bool)) -> Option<f64> {
    let &([x, y], radius, is_ball) = object;
    let center = Vector3::new(x, y, radius);
    if is_ball {
        let o = origin.coords - center;
        let (a, b, c) = (ray.norm_squared(), o.dot(ray), o.norm_squared() - radius * radius);
        let root = b * b - a * c;
        return (root >= 0.0).then(|| (-b - root.sqrt()) / a);
    }
    let (mut near, mut far) = (0.0f64, f64::INFINITY);
    for k in 0..3 {
        let (s, t) = ((center[k] - radius - origin[k]) / ray[k], (center[k] + radius - origin[k]) / ray[k]);
        near = near.max(s.min(t));
        far = far.min(s.max(t));
    }
    (near <= far).then_some(near)
}

/// 640 × 480 pixels from 0.75 m, tilted by 37 degrees.
fn clutter() -> Frame {
    let eye = Point3::new(0.0, -0.45, 0.6);
    let z = -eye.coords.normalize();
    let x = z.cross(&Vector3::z()).normalize();
    let axes = Matrix3::from_columns(&[x, z.cross(&x), z]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    let world_from_camera = Isometry3::from_parts(eye.coords.into(), rotation);
    let objects: Vec<([f64; 2], f64, bool)> = (0..10)
        .map(|k| {
            let at = [0.085 * f64::from(k % 4) - 0.13, 0.1 * f64::from(k / 4) - 0.1];
            (at, 0.02 + 0.003 * f64::from(k % 5), k % 2 == 0)
        })
        .collect();
    let (width, height) = (640, 480);
    let intrinsics =
        Intrinsics { fx_px: 610.0, fy_px: 610.0, cx_px: 319.5, cy_px: 239.5, distortion: [0.0; 8] };
    let depth_m = (0..width * height)
        .map(|i| {
            let u = ((i % width) as f64 - intrinsics.cx_px) / intrinsics.fx_px;
            let v = ((i / width) as f64 - intrinsics.cy_px) / intrinsics.fy_px;
            let ray = world_from_camera * Vector3::new(u, v, 1.0);
            let table = if ray.z < 0.0 { -eye.z / ray.z } else { f64::INFINITY };
            let depth = objects.iter().filter_map(|o| hit(&eye, &ray, o)).fold(table, f64::min);
            if depth < 3.0 { depth as f32 } else { 0.0 }
        })
        .collect();
    let image = DepthImage { width, height, depth_m };
    Frame { image, intrinsics, world_from_camera: Some(world_from_camera), labels: None }
}

fn observed() -> (Frame, Vec<f32>, Workspace, Volume) {
    let frame = clutter();
    let depth = clean_depth(&frame.image, &CleanOptions::default());
    let request = SceneOptions::default().workspace;
    let workspace = Workspace::place(&request, Grid::default(), &frame_points(&frame, &depth));
    let mut volume = Volume::empty(workspace.grid, workspace.table_m);
    volume.integrate(&frame, &depth, &camera_from_volume(&frame, &workspace));
    (frame, depth, workspace, volume)
}

fn camera_from_volume(frame: &Frame, workspace: &Workspace) -> Isometry3<f64> {
    let world_from_camera = frame.world_from_camera.unwrap_or_else(Isometry3::identity);
    world_from_camera.inverse() * workspace.world_from_volume
}

#[divan::bench(name = "frame.clean_and_place")]
fn frame_stage(bencher: Bencher) {
    let frame = clutter();
    let request = SceneOptions::default().workspace;
    bencher.bench(|| {
        let depth = clean_depth(&frame.image, &CleanOptions::default());
        Workspace::place(&request, Grid::default(), &frame_points(&frame, &depth))
    });
}

fn volume_stage(bencher: Bencher, kind: VolumeKind) {
    let (frame, depth, workspace, _) = observed();
    let pose = camera_from_volume(&frame, &workspace);
    bencher.bench(|| {
        let mut volume = Volume::empty(workspace.grid, workspace.table_m);
        volume.integrate(black_box(&frame), &depth, &pose);
        volume.network_input(kind)
    });
}

#[divan::bench(name = "volume.tsdf")]
fn tsdf(bencher: Bencher) {
    volume_stage(bencher, VolumeKind::Tsdf);
}

#[divan::bench(name = "volume.occupancy")]
fn occupancy(bencher: Bencher) {
    volume_stage(bencher, VolumeKind::Occupancy);
}

#[divan::bench(name = "volume.solid")]
fn solid(bencher: Bencher) {
    let (.., volume) = observed();
    bencher.bench(|| volume.objects(&volume.solid()));
}

#[divan::bench(name = "estimate.geometric")]
fn geometric(bencher: Bencher) {
    let (.., volume) = observed();
    bencher.bench(|| Geometric.estimate(black_box(&volume), &Unlimited));
}

#[divan::bench(name = "refine")]
fn refinement(bencher: Bencher) {
    let (.., volume) = observed();
    let Ok(field) = Geometric.estimate(&volume, &Unlimited) else { return };
    let solid = volume.solid();
    let options = SceneOptions::default();
    bencher.bench(|| refine(black_box(&field), &solid, volume.table_m, None, &options));
}

#[divan::bench(name = "refine.distance_to_contacts")]
fn contact_distance(bencher: Bencher) {
    let (.., volume) = observed();
    let Ok(field) = Geometric.estimate(&volume, &Unlimited) else { return };
    bencher.bench(|| distance_to(&volume.grid, |i| field.certainty[i] > 0.7));
}

#[divan::bench(name = "refine.signed_distance")]
fn scene_distance(bencher: Bencher) {
    let (.., volume) = observed();
    let solid = volume.solid();
    bencher.bench(|| signed_distance_m(&volume.grid, black_box(&solid)));
}

#[divan::bench(name = "prepare")]
fn whole(bencher: Bencher) {
    let frames = [clutter()];
    let options = SceneOptions::default();
    bencher.bench(|| {
        prepare(black_box(&frames), &options, &Geometric, &Unlimited).map(|s| s.features.centroids)
    });
}
