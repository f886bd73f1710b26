//! Durations of the stages that run once per frame, on a synthetic clutter of ten blocks and balls.

#[path = "../tests/clutter/mod.rs"]
mod clutter;

use clutter::{look_at, ten_objects};
use divan::{Bencher, black_box};
use graspd_planner::budget::Unlimited;
use graspd_planner::estimator::{ContactEstimator, Geometric};
use graspd_planner::frame::{CleanOptions, Frame, clean_depth};
use graspd_planner::grid::Grid;
use graspd_planner::options::{SceneOptions, VolumeKind};
use graspd_planner::refine::{distance_to, refine, signed_distance_m};
use graspd_planner::scene::prepare;
use graspd_planner::volume::{View, Volume};
use graspd_planner::workspace::{Workspace, frame_points};
use nalgebra::Isometry3;

fn main() {
    divan::main();
}

fn observed() -> (Frame, Vec<f32>, Workspace, Volume) {
    let frame = look_at(&ten_objects());
    let depth = clean_depth(&frame.image, &CleanOptions::default(), &Unlimited);
    let request = SceneOptions::default().workspace;
    let workspace = Workspace::place(&request, Grid::default(), &frame_points(&frame, &depth, &Unlimited));
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
    let frame = look_at(&ten_objects());
    let request = SceneOptions::default().workspace;
    bencher.bench(|| {
        let depth = clean_depth(&frame.image, &CleanOptions::default(), &Unlimited);
        Workspace::place(&request, Grid::default(), &frame_points(&frame, &depth, &Unlimited))
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

#[divan::bench(name = "volume.surface")]
fn surface(bencher: Bencher) {
    let (frame, depth, workspace, volume) = observed();
    let solid = volume.solid();
    let view = View::of(&frame, &depth, &workspace.world_from_volume);
    bencher.bench(|| volume.surface(black_box(&solid), &[view]));
}

#[divan::bench(name = "estimate.geometric")]
fn geometric(bencher: Bencher) {
    let (.., volume) = observed();
    bencher.bench(|| Geometric.estimate(black_box(&volume), &Unlimited));
}

#[divan::bench(name = "refine")]
fn refinement(bencher: Bencher) {
    let (frame, depth, workspace, volume) = observed();
    let Ok(field) = Geometric.estimate(&volume, &Unlimited) else { return };
    let solid = volume.solid();
    let surface = volume.surface(&solid, &[View::of(&frame, &depth, &workspace.world_from_volume)]);
    let options = SceneOptions::default();
    bencher.bench(|| refine(black_box(&field), &solid, &surface, volume.table_m, None, &options));
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
    let frames = [look_at(&ten_objects())];
    let options = SceneOptions::default();
    bencher.bench(|| {
        prepare(black_box(&frames), &options, &Geometric, &Unlimited).map(|s| s.features.centroids)
    });
}
