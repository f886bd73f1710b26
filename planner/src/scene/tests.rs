//! Synthetic scenes, ray cast here, through the whole front half of the pipeline.

use super::*;
use crate::budget::{Stop, Unlimited};
use crate::estimator::Geometric;
use crate::frame::{DepthImage, Intrinsics};
use nalgebra::UnitQuaternion;
use proptest::prelude::*;

/// An upright box on the table z = 0: centre, half extents in the plane, height.
struct Block {
    center: [f64; 2],
    half: [f64; 2],
    height: f64,
}

/// Optical frame at `eye` that looks at `at`.
fn look_at(eye: Point3<f64>, at: Point3<f64>) -> Isometry3<f64> {
    let z = (at - eye).normalize();
    let side = if z.cross(&Vector3::z()).norm() > 1e-6 { z.cross(&Vector3::z()) } else { Vector3::x() };
    let x = side.normalize();
    let y = z.cross(&x);
    let rotation = nalgebra::Rotation3::from_matrix_unchecked(nalgebra::Matrix3::from_columns(&[x, y, z]));
    Isometry3::from_parts(eye.coords.into(), UnitQuaternion::from_rotation_matrix(&rotation))
}

/// Casts one ray per pixel at the table and the blocks.
fn cast(world_from_camera: Isometry3<f64>, blocks: &[Block], posed: bool) -> Frame {
    let (width, height) = (320, 240);
    let intrinsics =
        Intrinsics { fx_px: 300.0, fy_px: 300.0, cx_px: 159.5, cy_px: 119.5, distortion: [0.0; 8] };
    let mut depth_m = Vec::new();
    let mut labels = Vec::new();
    for row in 0..height {
        for column in 0..width {
            let [x, y] = intrinsics.ray([column as f64, row as f64]).unwrap();
            let o = world_from_camera.translation.vector;
            let d = world_from_camera * Vector3::new(x, y, 1.0);
            let mut best = (f64::INFINITY, 0u8);
            if d.z < 0.0 {
                best = (-o.z / d.z, 0);
            }
            for (k, b) in blocks.iter().enumerate() {
                let low = [b.center[0] - b.half[0], b.center[1] - b.half[1], 0.0];
                let high = [b.center[0] + b.half[0], b.center[1] + b.half[1], b.height];
                let (mut near, mut far) = (0.0f64, f64::INFINITY);
                for a in 0..3 {
                    let (s, t) = ((low[a] - o[a]) / d[a], (high[a] - o[a]) / d[a]);
                    near = near.max(s.min(t));
                    far = far.min(s.max(t));
                }
                if near <= far && near < best.0 {
                    best = (near, k as u8 + 1);
                }
            }
            depth_m.push(if best.0 < 3.0 { best.0 as f32 } else { 0.0 });
            labels.push(best.1);
        }
    }
    Frame {
        image: DepthImage { width, height, depth_m },
        intrinsics,
        world_from_camera: posed.then_some(world_from_camera),
        labels: Some(labels),
    }
}

fn blocks() -> Vec<Block> {
    vec![
        Block { center: [-0.08, 0.02], half: [0.02, 0.05], height: 0.08 },
        Block { center: [0.08, -0.03], half: [0.03, 0.02], height: 0.05 },
    ]
}

fn tilted() -> Isometry3<f64> {
    look_at(Point3::new(0.0, -0.45, 0.6), Point3::origin())
}

fn run(frames: &[Frame]) -> Scene {
    prepare(frames, &SceneOptions::default(), &Geometric, &Unlimited).unwrap()
}

/// Centroids in the table's frame, given where the camera really was.
fn centroids_on_table(scene: &Scene, truth: &Isometry3<f64>, posed: bool) -> Vec<(Point3<f64>, Option<u8>)> {
    let table_from_world = if posed { Isometry3::identity() } else { *truth };
    let t = table_from_world * scene.workspace.world_from_volume;
    scene.features.centroids.iter().map(|c| (t * c.position, c.label)).collect()
}

#[test]
fn a_look_shows_what_an_estimator_is_shown() {
    let frames = [cast(tilted(), &blocks(), true)];
    let scene = run(&frames);
    let (workspace, volume) = look(&frames, &SceneOptions::default()).unwrap();
    assert_eq!(workspace, scene.workspace);
    assert_eq!((&volume.tsdf, &volume.state), (&scene.volume.tsdf, &scene.volume.state));
    assert!(volume.count(VoxelState::Surface) > 1000);
    assert_eq!(look(&[], &SceneOptions::default()).unwrap_err(), SceneError::NoFrames);
}

#[test]
fn every_block_gets_a_centroid_and_contacts_lie_on_sides() {
    for posed in [false, true] {
        let scene = run(&[cast(tilted(), &blocks(), posed)]);
        assert!(matches!(scene.observation, Observation::Objects { voxels } if voxels > 500));
        let centroids = centroids_on_table(&scene, &tilted(), posed);
        for (k, b) in blocks().iter().enumerate() {
            let own: Vec<_> = centroids.iter().filter(|(_, l)| *l == Some(k as u8 + 1)).collect();
            assert!((1..=3).contains(&own.len()), "block {k}: {centroids:?}");
            for (p, _) in own {
                assert!((p.x - b.center[0]).abs() < b.half[0] && (p.y - b.center[1]).abs() < b.half[1]);
                assert!(p.z > 0.0 && p.z < b.height, "{p}");
            }
        }
        let grid = scene.features.grid;
        let table = scene.workspace.table_m.unwrap();
        assert!(scene.features.focal_contacts.len() > 100);
        for &i in &scene.features.focal_contacts {
            let inward = scene.contact_field.inward[i as usize];
            assert!(grid.center(grid.voxel(i as usize)).z > table + 0.5 * grid.voxel_m());
            assert!(inward[2].abs() < 0.7, "a contact on a top: {inward:?}");
            let [.., scene_distance, _, _] = scene.features.cells.cells[i as usize].0;
            // Contacts are at voxels that are free at their centres; the surface may run a little outside.
            assert!(scene_distance > -0.002 && scene_distance < 0.01, "{scene_distance}");
        }
        let down = scene.workspace.world_from_volume * scene.view_direction.into_inner();
        let expected = if posed { tilted() * Vector3::z() } else { Vector3::z() };
        assert!(down.angle(&expected) < 0.1);
    }
}

#[test]
fn an_empty_table_and_nothing_seen_are_told_apart() {
    let empty = run(&[cast(tilted(), &[], true)]);
    assert_eq!(empty.observation, Observation::EmptyTable);
    assert!(empty.features.centroids.is_empty() && empty.features.focal_contacts.is_empty());
    let mut blind = cast(tilted(), &[], true);
    blind.image.depth_m.fill(f32::NAN);
    let blind = run(&[blind]);
    assert_eq!(blind.observation, Observation::NothingSeen);
    assert!(blind.features.centroids.is_empty());
    assert_eq!(blind.workspace.table_m, None);
}

#[test]
fn a_second_view_sees_the_back() {
    let front = cast(tilted(), &blocks(), true);
    let back = cast(look_at(Point3::new(0.1, 0.45, 0.6), Point3::origin()), &blocks(), true);
    let one = run(std::slice::from_ref(&front));
    let both = run(&[front.clone(), back.clone()]);
    assert!(both.volume.count(VoxelState::Unseen) < one.volume.count(VoxelState::Unseen));
    let blind_second = Frame { world_from_camera: None, ..back };
    let error =
        prepare(&[front, blind_second], &SceneOptions::default(), &Geometric, &Unlimited).unwrap_err();
    assert_eq!(error, SceneError::MissingPose { index: 1, count: 2 });
    assert!(error.to_string().contains("frames[1].world_from_camera"));
}

#[test]
fn the_same_frame_twice_changes_nothing() {
    let frame = cast(tilted(), &blocks(), true);
    let one = run(std::slice::from_ref(&frame));
    let two = run(&[frame.clone(), frame]);
    assert_eq!(one.volume.tsdf, two.volume.tsdf);
    assert_eq!(one.volume.state, two.volume.state);
    assert_eq!(one.volume.voxel_labels(), two.volume.voxel_labels());
    assert_eq!(one.features.centroids, two.features.centroids);
}

#[test]
fn placed_workspaces_find_their_table() {
    let frame = cast(tilted(), &blocks(), true);
    let world_from_volume = Isometry3::translation(-0.2, -0.2, -0.08);
    let workspace = WorkspaceRequest::Placed { world_from_volume, table_m: None };
    let options = SceneOptions { workspace, ..SceneOptions::default() };
    let scene = prepare(std::slice::from_ref(&frame), &options, &Geometric, &Unlimited).unwrap();
    assert!((scene.workspace.table_m.unwrap() - 0.08).abs() < 0.002);
    assert!(scene.features.centroids.len() >= 2);
    let workspace = WorkspaceRequest::Placed { world_from_volume, table_m: Some(f64::NAN) };
    let options = SceneOptions { workspace, ..options };
    let error = prepare(&[frame], &options, &Geometric, &Unlimited).unwrap_err();
    assert!(matches!(error, SceneError::Workspace { field: "table_m", .. }));
}

#[test]
fn outside_the_region_nothing_is_an_object_but_everything_is_solid() {
    let frame = cast(tilted(), &blocks(), true);
    let all = run(std::slice::from_ref(&frame));
    let world = |scene: &Scene, p: &Point3<f64>| scene.workspace.world_from_volume * p;
    // The half of the table with the second block.
    let half_extents_m = Vector3::new(0.1, 0.2, 0.2);
    let region = Region { world_from_box: Isometry3::translation(0.1, 0.0, 0.0), half_extents_m };
    let options = SceneOptions { region: Some(region), ..SceneOptions::default() };
    let some = prepare(std::slice::from_ref(&frame), &options, &Geometric, &Unlimited).unwrap();
    let east = |scene: &Scene| {
        scene.features.centroids.iter().map(|c| world(scene, &c.position).x > 0.0).collect::<Vec<_>>()
    };
    assert!(east(&all).contains(&false) && east(&all).contains(&true));
    assert!(!east(&some).is_empty() && !east(&some).contains(&false));
    for &i in &some.features.focal_contacts {
        let voxel = some.features.grid.voxel(i as usize);
        assert!(region.contains(&world(&some, &some.features.grid.center(voxel))));
    }
    assert_eq!(some.features.scene_distance_m, all.features.scene_distance_m);
    let nowhere = Region { world_from_box: Isometry3::translation(5.0, 0.0, 0.0), ..region };
    let options = SceneOptions { region: Some(nowhere), ..options };
    let none = prepare(std::slice::from_ref(&frame), &options, &Geometric, &Unlimited).unwrap();
    assert_eq!(none.observation, Observation::EmptyTable);
    for bad in [Vector3::new(0.1, 0.0, 0.1), Vector3::new(0.1, f64::NAN, 0.1)] {
        let region = Some(Region { half_extents_m: bad, ..region });
        let options = SceneOptions { region, ..SceneOptions::default() };
        let error = prepare(std::slice::from_ref(&frame), &options, &Geometric, &Unlimited).unwrap_err();
        assert!(matches!(error, SceneError::Region { field: "half_extents_m", .. }), "{error}");
    }
}

#[test]
fn encodings_are_the_papers() {
    let scene = run(&[cast(tilted(), &blocks(), true)]);
    let volume = &scene.volume;
    let tsdf = volume.network_input(crate::options::VolumeKind::Tsdf);
    let occupancy = volume.network_input(crate::options::VolumeKind::Occupancy);
    for i in 0..volume.grid.len() {
        assert!((0.0..1.0).contains(&tsdf[i]) && (occupancy[i] == 0.0 || occupancy[i] == 1.0));
        match volume.state[i] {
            VoxelState::Free => assert!(tsdf[i] == 0.0 || tsdf[i] > 0.5),
            VoxelState::Surface => assert!(tsdf[i] > 0.0 && tsdf[i] <= 0.5 && occupancy[i] == 1.0),
            VoxelState::Unseen => assert!(tsdf[i] < 0.5 && occupancy[i] == 1.0),
        }
    }
}

#[test]
fn a_loaded_field_keeps_its_table_and_its_sizes_are_checked() {
    let made = run(&[cast(tilted(), &blocks(), true)]);
    let solid = made.volume.solid();
    let options = SceneOptions::default();
    let loaded = from_contact_field(made.contact_field.clone(), &solid, &options, &Unlimited).unwrap();
    assert!((loaded.workspace.table_m.unwrap() - 0.1).abs() < 1e-9);
    assert_eq!(loaded.features.focal_contacts, made.features.focal_contacts);
    // The depth image that told where surfaces lie within voxels is not there any more.
    let voxel = made.workspace.grid.voxel_m() as f32;
    let distances = loaded.features.scene_distance_m.iter().zip(&made.features.scene_distance_m);
    assert!(distances.clone().all(|(loaded, made)| (loaded - made).abs() < voxel));
    assert!(distances.clone().any(|(loaded, made)| loaded != made));
    let error = from_contact_field(made.contact_field, &solid[1..], &options, &Unlimited).unwrap_err();
    assert!(matches!(error, SceneError::SolidSize { .. }));
}

#[test]
fn stops_when_asked() {
    struct Over;
    impl Budget for Over {
        fn elapsed(&self) -> Duration {
            Duration::from_secs(1)
        }
        fn stop(&self) -> Option<Stop> {
            Some(Stop::Deadline)
        }
    }
    let frame = cast(tilted(), &blocks(), true);
    let error = prepare(&[frame], &SceneOptions::default(), &Geometric, &Over).unwrap_err();
    assert_eq!(error, SceneError::Stopped(Stop::Deadline));
    let error = prepare(&[], &SceneOptions::default(), &Geometric, &Unlimited).unwrap_err();
    assert_eq!(error, SceneError::NoFrames);
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let frame = cast(tilted(), &blocks(), false);
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run(std::slice::from_ref(&frame)))
    };
    let (one, three) = (on(1), on(3));
    assert_eq!(one.contact_field, three.contact_field);
    assert_eq!(one.features.focal_contacts, three.features.focal_contacts);
    assert_eq!(one.features.centroids, three.features.centroids);
    assert_eq!(one.features.cells.cells, three.features.cells.cells);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]
    #[test]
    fn noise_and_garbage_make_a_scene_or_an_error(
        seed in 0u32..1000, hole in 1usize..20, scale in prop_oneof![Just(0.0f32), 0.001f32..0.05, Just(f32::NAN)],
    ) {
        let mut frame = cast(tilted(), &blocks(), true);
        let mut state = seed.wrapping_mul(747_796_405).wrapping_add(1);
        for (i, d) in frame.image.depth_m.iter_mut().enumerate() {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let noise = (state >> 8) as f32 / 16_777_216.0 - 0.5;
            *d = if i % hole == 1 { f32::NAN } else { *d + scale * noise };
        }
        let scene = run(&[frame]);
        prop_assert!(scene.contact_field.certainty.iter().all(|c| (0.0..=1.0).contains(c)));
        prop_assert!(scene.contact_field.centroid.iter().all(|c| (0.0..=1.0).contains(c)));
        prop_assert!(scene.features.cells.cells.iter().all(|c| c.0.iter().all(|v| v.is_finite())));
    }
}
