//! Tests of fusion, completion and encodings on surfaces whose distances are known.

use super::*;
use crate::frame::{DepthImage, Frame, Intrinsics};
use nalgebra::Isometry3;
use proptest::prelude::*;

const WIDTH: usize = 200;
const HEIGHT: usize = 160;

fn lens(distortion: [f64; 8]) -> Intrinsics {
    Intrinsics { fx_px: 190.0, fy_px: 190.0, cx_px: 99.5, cy_px: 79.5, distortion }
}

/// A wall at `depth_m`, square to the optical axis.
fn wall(depth_m: f32, distortion: [f64; 8]) -> Frame {
    Frame {
        image: DepthImage { width: WIDTH, height: HEIGHT, depth_m: vec![depth_m; WIDTH * HEIGHT] },
        intrinsics: lens(distortion),
        world_from_camera: None,
        labels: None,
    }
}

/// The cube half a metre in front of the camera, its axes along the camera's.
fn ahead() -> Isometry3<f64> {
    Isometry3::translation(-0.2, -0.2, 0.5)
}

fn fused(frame: &Frame) -> Volume {
    let mut volume = Volume::empty(Grid { resolution: 40, size_m: 0.4 }, None);
    volume.integrate(frame, &frame.image.depth_m, &ahead());
    volume
}

#[test]
fn distances_are_along_the_ray_and_truncated() {
    let volume = fused(&wall(0.703, [0.0; 8]));
    let truncation = TRUNCATION_VOXELS * 0.01;
    let mut seen = 0;
    for i in 0..volume.grid.len() {
        let p = ahead() * volume.grid.center(volume.grid.voxel(i));
        let along = (0.703 - p.z) * p.coords.norm() / p.z;
        if volume.weight[i] == 0 {
            // Outside the image, or too far behind the wall.
            let pixel = lens([0.0; 8]).project([p.x, p.y, p.z]).unwrap();
            let inside = pixel[0] >= 0.0 && pixel[1] >= 0.0 && pixel[0] <= 199.0 && pixel[1] <= 159.0;
            assert!(!inside || along < -truncation + 1e-4);
            continue;
        }
        seen += 1;
        let expected = (along / truncation).clamp(-1.0, 1.0);
        assert!((f64::from(volume.tsdf[i]) - expected).abs() < 1e-3);
        let state = match along {
            a if a > 1e-5 => VoxelState::Free,
            a if a > -0.02 + 1e-5 => VoxelState::Surface,
            a if a < -0.02 - 1e-5 => VoxelState::Unseen,
            _ => continue,
        };
        assert_eq!(volume.state[i], state);
    }
    assert!(seen > 20_000);
}

#[test]
fn a_bent_lens_sees_the_same_wall() {
    let straight = fused(&wall(0.7, [0.0; 8]));
    let bent = fused(&wall(0.7, [-0.12, 0.03, 1e-3, -5e-4, 0.0, 0.0, 0.0, 0.0]));
    let mut both = 0;
    for i in 0..straight.grid.len() {
        if straight.weight[i] > 0 && bent.weight[i] > 0 {
            both += 1;
            assert!((straight.tsdf[i] - bent.tsdf[i]).abs() < 1e-5);
        }
    }
    assert!(both > 20_000);
}

#[test]
fn labels_are_voted() {
    let mut frame = wall(0.7, [0.0; 8]);
    frame.labels = Some(vec![3; WIDTH * HEIGHT]);
    let mut volume = fused(&frame);
    volume.integrate(&frame, &frame.image.depth_m, &ahead());
    let other = Frame { labels: Some(vec![5; WIDTH * HEIGHT]), ..frame.clone() };
    volume.integrate(&other, &other.image.depth_m, &ahead());
    let labels = volume.voxel_labels().unwrap();
    for (&label, &state) in labels.iter().zip(&volume.state) {
        assert_eq!(label, if state == VoxelState::Surface { 3 } else { 0 });
    }
}

/// A volume of one column kind: states from the floor up.
fn columns(states: &dyn Fn(usize, usize, usize) -> VoxelState) -> Volume {
    let grid = Grid { resolution: 12, size_m: 0.06 };
    let mut volume = Volume::empty(grid, Some(0.015));
    for i in 0..grid.len() {
        let [x, y, z] = grid.voxel(i);
        volume.state[i] = states(x, y, z);
    }
    volume
}

#[test]
fn objects_are_completed_downwards_and_shadows_are_not_solid() {
    use VoxelState::{Free, Surface, Unseen};
    // A roof at layer 8 over x in 3..9; free above it and for x < 3; shadow elsewhere.
    let volume = columns(&|x, _, z| match (x, z) {
        (3..9, 8) => Surface,
        (3..9, 0..8) => Unseen,
        (9.., 0..8) => Unseen,
        _ => Free,
    });
    let solid = volume.solid();
    let at = |x, y, z| solid[volume.grid.index(x, y, z)];
    assert!(at(5, 5, 8) && at(5, 5, 4) && at(5, 5, 3), "completed to the table");
    assert!(!at(10, 5, 5), "the shadow beside stays open");
    assert!(at(0, 0, 2) && !at(0, 0, 3), "solid below the table top only");
    let objects = volume.objects(&solid);
    assert!(objects[volume.grid.index(5, 5, 4)] && !objects[volume.grid.index(5, 5, 3)]);
    assert!(!objects[volume.grid.index(0, 0, 2)]);
}

#[test]
fn free_space_under_a_roof_ends_the_completion_and_pits_are_filled() {
    use VoxelState::{Free, Surface, Unseen};
    let volume = columns(&|x, y, z| match (x, y, z) {
        // A shaft of which nothing was seen.
        (5, 5, _) => Unseen,
        (_, _, 9) => Surface,
        (_, 0..3, 5..9) => Free,
        _ => Unseen,
    });
    let solid = volume.solid();
    let at = |x, y, z| solid[volume.grid.index(x, y, z)];
    assert!(!at(6, 1, 4), "what is under seen free space is unknown");
    assert!(at(6, 7, 4));
    assert!(at(5, 5, 7), "the shaft is filled");
    assert!(!at(5, 5, 11), "but not above its rim");
}

#[test]
fn a_wide_hole_in_an_object_is_filled_and_a_valley_is_not() {
    use VoxelState::{Free, Surface, Unseen};
    // A block with a hole of four by four voxels without a return, and the same open to one side.
    let with_hole = |open: bool| {
        let volume = columns(&move |x, y, z| match (x, y, z) {
            (4..8, 4..8, _) => Unseen,
            (8.., 4..8, _) if open => Free,
            (_, _, 9..) => Free,
            (_, _, 8) => Surface,
            _ => Unseen,
        });
        let solid = volume.solid();
        solid[volume.grid.index(5, 6, 6)]
    };
    assert!(with_hole(false));
    assert!(!with_hole(true), "what is enclosed on three sides only may be free");
}

#[test]
fn shadows_of_an_occupancy_volume_are_solid_but_no_objects() {
    use VoxelState::{Free, Surface, Unseen};
    let mut volume = columns(&|x, y, z| match (x, y, z) {
        (3..6, _, 8) => Surface,
        (3..6, _, 0..8) => Unseen,
        // The shadow, five voxels wide.
        (6..11, _, 0..8) => Unseen,
        // The ray of a pixel without a return.
        (1, 6, _) => Unseen,
        _ => Free,
    });
    volume.kind = crate::options::VolumeKind::Occupancy;
    let solid = volume.solid();
    let groups = volume.object_groups(&solid);
    let at = |x, y, z| volume.grid.index(x, y, z);
    assert!(solid[at(4, 4, 6)] && groups[at(4, 4, 6)] > 0);
    assert!(solid[at(9, 4, 6)] && groups[at(9, 4, 6)] == 0);
    assert!(!solid[at(1, 6, 9)], "a streak is no wall");
    assert!(!solid[at(0, 0, 6)]);
}

#[test]
fn specks_are_no_objects() {
    let volume = columns(&|x, y, z| {
        if (x, y, z) == (4, 4, 8) { VoxelState::Surface } else { VoxelState::Free }
    });
    let solid = volume.solid();
    assert!(solid[volume.grid.index(4, 4, 8)]);
    assert!(!volume.objects(&solid).contains(&true));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn any_camera_any_depth_keeps_the_volume_sound(
        depth in prop_oneof![Just(0.0f32), Just(1e-6f32), 0.01f32..10.0],
        t in proptest::array::uniform3(-1.0f64..1.0), r in proptest::array::uniform3(-3.0f64..3.0),
        distortion in proptest::array::uniform8(-2.0f64..2.0),
    ) {
        let frame = wall(depth, distortion);
        let pose = Isometry3::new(t.into(), r.into());
        let mut volume = Volume::empty(Grid { resolution: 16, size_m: 0.4 }, None);
        volume.integrate(&frame, &frame.image.depth_m, &pose);
        let once = volume.clone();
        volume.integrate(&frame, &frame.image.depth_m, &pose);
        prop_assert!(volume.tsdf.iter().all(|d| (-1.0..=1.0).contains(d)));
        prop_assert_eq!(&once.tsdf, &volume.tsdf);
        prop_assert_eq!(&once.state, &volume.state);
        if depth == 0.0 {
            prop_assert_eq!(volume.count(VoxelState::Unseen), volume.grid.len());
        }
    }
}

#[test]
fn surface_voxels_are_filled_to_where_the_wall_stands() {
    for depth_m in [0.7005_f32, 0.703, 0.7055, 0.7081] {
        let frame = wall(depth_m, [0.0; 8]);
        let volume = fused(&frame);
        let solid = volume.solid();
        let view = View { frame: &frame, depth: &frame.image.depth_m, camera_from_volume: ahead() };
        let surface = volume.surface(&solid, &[view]);
        // The layer of voxels from 0.70 m to 0.71 m is cut by the wall: its back part is solid. Of the last free and the
        // first solid layer both are at the surface, so the sums over both are known.
        let layers = |surface: &[SurfaceVoxel], z: usize| {
            let own = surface.iter().filter(|s| volume.grid.voxel(s.index as usize)[2] == z);
            let all: Vec<f64> = own.map(|s| f64::from(s.filled)).collect();
            (all.len(), all.iter().sum::<f64>() / all.len().max(1) as f64)
        };
        let behind = (0.71 - f64::from(depth_m)) / 0.01;
        let (before, cut, after) = (layers(&surface, 19), layers(&surface, 20), layers(&surface, 21));
        assert!(cut.0 > 900, "{depth_m}: {cut:?}");
        assert!((cut.1 - behind).abs() < 0.02, "{depth_m}: {cut:?}, {behind}");
        assert!(before.1 < 0.02 && (after.0 == 0 || after.1 > 0.98), "{depth_m}: {before:?} {after:?}");
        // Where no view shows it, what was fused before tells the same.
        let strange = View { depth: &frame.image.depth_m[1..], ..view };
        let remembered = layers(&volume.surface(&solid, &[strange]), 20);
        assert!(
            remembered.0 > 900 && (remembered.1 - behind).abs() < 0.02,
            "{depth_m}: {remembered:?}, {behind}"
        );
        assert!(volume.surface(&solid[1..], &[view]).is_empty());
    }
}

#[test]
fn what_nobody_saw_is_no_part_of_an_object() {
    // A board in front of a wall that is out of reach: behind the board nothing is known.
    let mut frame = wall(0.9, [0.0; 8]);
    for v in 60..100 {
        frame.image.depth_m[v * WIDTH + 80..][..40].fill(0.603);
    }
    let volume = fused(&frame);
    let solid = volume.solid();
    let view = View { frame: &frame, depth: &frame.image.depth_m, camera_from_volume: ahead() };
    let surface = volume.surface(&solid, &[view]);
    let unknown = |i: usize| !solid[i] && volume.state[i] == VoxelState::Unseen;
    assert!((0..volume.grid.len()).any(unknown) && !surface.is_empty());
    assert!(surface.iter().all(|s| !unknown(s.index as usize)));
}
