//! Tests of the whole way: scenes by seed and shard, labels on a lone box, runs that are interrupted.

use std::io::Cursor;
use std::sync::Arc;

use graspd_planner::grid::Grid;
use graspd_sim::object::Object;
use graspd_sim::sensor::{DepthCamera, Sensor};
use graspd_sim::world::{World, WorldSettings};
use nalgebra::{Isometry3, Point3, Vector3};

use super::clutter::Clutter;
use super::contacts::{SceneContacts, contacts};
use super::families::{Split, Stock};
use super::generate::{GenerateSettings, Generator};
use super::read::Shard;
use super::recipe::Recipe;
use super::sample::{OCCUPIED, Sample};
use super::stats::Stats;
use super::{DatasetError, picture};

/// Small scenes, few grasps.
fn settings() -> GenerateSettings {
    GenerateSettings {
        stock: Stock::families(Split::Train),
        families: Split::Train,
        sensor: "pico-flexx".into(),
        recipe: Recipe {
            objects: [2, 3],
            places: [20, 60],
            approaches: 4,
            ..Recipe::for_sensor("pico-flexx")
        },
        scenes: 3,
        views: 2,
        shard: [0, 1],
        seed: 4,
        program: "test".into(),
        commit: None,
    }
}

/// A whole shard's bytes.
fn shard(settings: GenerateSettings, workers: usize) -> Vec<u8> {
    let generator = Generator::new(settings).unwrap();
    let mut bytes = generator.header().to_bytes();
    let append = |record: &[u8]| {
        bytes.extend(record);
        Ok(())
    };
    generator.generate(0, workers, append, |_, _| {}).unwrap();
    bytes
}

fn samples(bytes: &[u8]) -> Vec<Sample> {
    let mut shard = Shard::open(Cursor::new(bytes)).unwrap();
    (0..shard.len()).map(|i| shard.read(i).unwrap()).collect()
}

#[test]
fn bytes_depend_on_the_seed_alone_and_shards_are_parts_of_the_whole() {
    let whole = shard(settings(), 2);
    assert_eq!(whole, shard(settings(), 1), "workers matter");
    let all = samples(&whole);
    assert_eq!(
        all.iter().map(|s| (s.scene, s.view)).collect::<Vec<_>>(),
        [(0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (2, 1)]
    );
    let part = |i| samples(&shard(GenerateSettings { shard: [i, 2], ..settings() }, 1));
    assert_eq!(part(0), [&all[0..2], &all[4..6]].concat());
    assert_eq!(part(1), all[2..4]);
    let other = samples(&shard(GenerateSettings { seed: 5, scenes: 1, ..settings() }, 1));
    assert_ne!(other[0].tsdf, all[0].tsdf);
}

#[test]
fn an_interrupted_run_goes_on_to_the_same_bytes() {
    let generator = Generator::new(settings()).unwrap();
    let whole = shard(settings(), 1);
    let mut open = Shard::open(Cursor::new(&whole)).unwrap();
    let (all, end) = open.progress().unwrap();
    assert_eq!((all, end), (6, whole.len() as u64));
    // In the middle of the fourth record, and a bit wrong in the last one.
    let starts: Vec<usize> = {
        let mut at = generator.header().to_bytes().len();
        (0..all)
            .map(|_| {
                let start = at;
                let length = u32::from_le_bytes(whole[at..at + 4].try_into().unwrap());
                at += 8 + length as usize;
                start
            })
            .collect()
    };
    let mut garbled = whole.clone();
    let last = garbled.len() - 1;
    garbled[last] ^= 1;
    for (damaged, expected) in [(&whole[..starts[3] + 100], 3), (&garbled[..], 5)] {
        let (done, end) = Shard::open(Cursor::new(damaged)).unwrap().progress().unwrap();
        assert_eq!((done, end as usize), (expected, starts[expected]));
        let mut resumed = damaged[..end as usize].to_vec();
        let append = |record: &[u8]| {
            resumed.extend(record);
            Ok(())
        };
        generator.generate(done, 1, append, |_, _| {}).unwrap();
        assert_eq!(resumed, whole);
    }
    // Damage that no interruption leaves.
    garbled[starts[1] + 50] ^= 1;
    assert!(Shard::open(Cursor::new(&garbled)).unwrap().progress().is_err());
}

#[test]
fn a_writer_that_fails_stops_the_run() {
    let generator = Generator::new(settings()).unwrap();
    let full = |_: &[u8]| Err(std::io::Error::from(std::io::ErrorKind::StorageFull));
    assert!(matches!(generator.generate(0, 2, full, |_, _| {}), Err(DatasetError::Write(_))));
}

#[test]
fn settings_of_no_use_are_named() {
    let text = |settings| Generator::new(settings).unwrap_err().to_string();
    assert_eq!(
        text(GenerateSettings { sensor: "webcam".into(), ..settings() }),
        "sensor: found webcam, expected azure-kinect, pico-flexx, ideal"
    );
    assert!(text(GenerateSettings { shard: [2, 2], ..settings() }).starts_with("shard: found 2/2"));
    assert!(text(GenerateSettings { views: 0, ..settings() }).starts_with("views: found 0"));
    let none = Stock::Meshes(Vec::new());
    assert!(text(GenerateSettings { stock: none, ..settings() }).starts_with("objects: found none"));
}

/// Half extents of the lone box.
const HALF: [f64; 3] = [0.02, 0.03, 0.04];

/// A box alone on a table, and its contacts.
fn lone_box() -> (Clutter, SceneContacts) {
    let mut world = World::new(WorldSettings::default());
    let object = Arc::new(Object::cuboid("box", HALF.into()).unwrap());
    world.add(object, &Isometry3::new(Vector3::new(0.01, -0.01, HALF[2]), Vector3::z() * 0.3));
    let contacts = contacts(&world, &Recipe::default(), 1);
    (Clutter { world, sensor: Sensor::by_name("ideal").unwrap(), seed: 1 }, contacts)
}

#[test]
fn labels_of_a_lone_box_are_where_a_jaw_would_touch() {
    let generator = Generator::new(GenerateSettings { views: 6, ..settings() }).unwrap();
    let scene = lone_box();
    let world_from_box = scene.0.world.pose(scene.0.world.ids()[0]).unwrap();
    let mut camera = DepthCamera::new(scene.0.sensor.clone());
    let grid = Grid::default();
    let mut sides = [[0usize; 2]; 3];
    for view in 0..6 {
        let sample = generator.view(0, &scene, &mut camera, view).unwrap();
        let world_from_volume = nalgebra::Matrix4::from_row_slice(&sample.world_from_volume.map(f64::from));
        assert!(sample.contacts.len() > 200, "view {view}: {} contacts", sample.contacts.len());
        for contact in &sample.contacts {
            let index = contact.index as usize;
            assert!(!OCCUPIED.contains(&sample.tsdf[index]), "a contact in an occupied voxel");
            let center = world_from_volume.transform_point(&grid.center(grid.voxel(index)));
            let inward = world_from_box
                .inverse_transform_vector(&world_from_volume.transform_vector(&contact.inward()));
            let p = world_from_box.inverse_transform_point(&center);
            // The inward direction is against the normal of the side on which the contact lies.
            let axis = inward.iamax();
            let side = -inward[axis].signum();
            let off = p[axis] * side - HALF[axis];
            // Off by half a voxel's diagonal from where fingers were.
            assert!((-0.0045..0.0135).contains(&off), "axis {axis}: {off} m off its side");
            sides[axis][usize::from(side > 0.0)] += 1;
            // Well within a side nothing is uncertain; at an edge the voxel's mean is of two sides.
            let inner = (0..3).filter(|&a| a != axis).all(|a| p[a].abs() < HALF[a] - 0.012);
            assert!(inward[axis].abs() > if inner { 0.97 } else { 0.6 }, "{inward} at {p}");
            if inner && axis < 2 && (0.0..0.004).contains(&off) {
                assert!(contact.score() > 0.75, "{} at {p}", contact.score());
            }
        }
        let inside = sample.centroids.iter().filter(|c| {
            let center = world_from_volume.transform_point(&grid.center(grid.voxel(c.index as usize)));
            let p: Point3<f64> = world_from_box.inverse_transform_point(&center);
            (0..3).all(|a| p[a].abs() < HALF[a] + 0.004)
        });
        assert!(inside.count() == sample.centroids.len() && sample.centroids.len() > 50);
        let picture = picture::picture(&sample);
        assert!(picture.pixels.contains(&[255, 255, 255]), "no direction was drawn");
    }
    // Opposite sides are touched alike; the box stands on its base, which nobody can reach.
    for [a, b] in &sides[..2] {
        assert!(*a > 100 && *b > 100 && a.max(b) * 2 < a.min(b) * 5, "{sides:?}");
    }
    assert!(sides[2][0] == 0, "{sides:?}");
}

#[test]
fn a_small_dataset_is_sane() {
    let recipe = Recipe { places: [60, 200], ..settings().recipe };
    let bytes = shard(GenerateSettings { recipe, scenes: 4, views: 8, ..settings() }, 2);
    let mut stats = Stats::default();
    samples(&bytes).iter().for_each(|s| stats.add(s));
    assert_eq!((stats.views, stats.scenes), (32, 4));
    assert_eq!(stats.complaints(), Vec::<String>::new(), "{}", stats.text());
}
