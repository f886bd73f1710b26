//! What is rendered is what geometry says.

use std::sync::Arc;

use graspd_hands::Shape;
use nalgebra::{Point3, Vector3};
use proptest::prelude::*;

use super::*;
use crate::camera::look_at;
use crate::object::{Object, Source};
use crate::world::{Tray, WorldSettings};

const LENS: Pinhole =
    Pinhole { width: 160, height: 120, fx_px: 140.0, fy_px: 150.0, cx_px: 81.3, cy_px: 57.9 };

fn instance(mesh: &Mesh, id: u16) -> Instance<'_> {
    Instance { mesh, world_from_mesh: Isometry3::identity(), id, surface: Surface::default() }
}

fn eyes() -> [Isometry3<f64>; 4] {
    [[0.0, 0.0, 1.0], [0.5, -0.3, 0.6], [-0.9, 0.1, 0.2], [0.05, 0.6, 2.5]]
        .map(|eye| look_at(&Point3::from(eye), &Point3::new(0.02, -0.01, 0.0), &Vector3::z()))
}

/// A sphere of many small faces.
fn ball(radius: f64, rings: u32) -> Mesh {
    let (sides, mut mesh) = (2 * rings, Mesh::default());
    for ring in 0..=rings {
        for side in 0..sides {
            let tilt = std::f64::consts::PI * f64::from(ring) / f64::from(rings);
            let turn = std::f64::consts::TAU * f64::from(side) / f64::from(sides);
            let (sin, cos) = tilt.sin_cos();
            mesh.vertices.push(Point3::new(sin * turn.cos(), sin * turn.sin(), cos) * radius);
            if ring < rings {
                let (here, next) = (ring * sides + side, ring * sides + (side + 1) % sides);
                mesh.triangles.push([here, here + sides, next + sides]);
                mesh.triangles.push([here, next + sides, next]);
            }
        }
    }
    mesh
}

#[test]
fn a_large_table_has_the_depth_of_its_plane() {
    let table = Mesh::cuboid(Vector3::new(50.0, 50.0, 0.5));
    for eye in eyes() {
        let mut instance = instance(&table, 0);
        instance.world_from_mesh = Isometry3::translation(0.0, 0.0, -0.5);
        let view = render(&LENS, &eye, &[instance]);
        let mut seen = 0;
        for v in 0..LENS.height {
            for u in 0..LENS.width {
                let ray = eye.rotation * LENS.ray(u as f64, v as f64);
                let depth = -eye.translation.z / ray.z;
                if !(0.0..40.0).contains(&depth) {
                    continue;
                }
                let i = v * LENS.width + u;
                seen += 1;
                let error = (f64::from(view.depth_m[i]) - depth).abs();
                assert!(error < 5e-5 * depth.max(1.0).powi(2), "{error} m at {depth} m");
                let cos = -ray.z / ray.norm();
                assert!((f64::from(view.cos_incidence[i]) - cos).abs() < 1e-5);
                assert_eq!((view.instance[i], view.albedo[i]), (0, 0.6));
            }
        }
        assert!(seen > LENS.width * LENS.height / 4);
    }
}

#[test]
fn a_sphere_has_the_depth_of_a_sphere() {
    let (radius, center) = (0.2, Point3::new(0.05, -0.02, 0.01));
    let mesh = ball(radius, 200);
    for eye in eyes() {
        let mut instance = instance(&mesh, 7);
        instance.world_from_mesh = Isometry3::translation(center.x, center.y, center.z);
        let view = render(&LENS, &eye, &[instance]);
        let center = (eye.inverse() * center).coords;
        let mut seen = 0;
        for i in 0..view.depth_m.len() {
            let ray = LENS.ray((i % LENS.width) as f64, (i / LENS.width) as f64);
            let (a, b) = (ray.norm_squared(), ray.dot(&center));
            let c = center.norm_squared() - radius * radius;
            let root = b * b - a * c;
            // Within a thousandth of the silhouette, the facets decide.
            if root.abs() < 1e-3 * b * b {
                continue;
            }
            if root < 0.0 {
                assert!(view.depth_m[i].is_nan() && view.instance[i] == BACKGROUND);
                continue;
            }
            seen += 1;
            let depth = (b - root.sqrt()) / a;
            assert_eq!(view.instance[i], 7);
            let cos = f64::from(view.cos_incidence[i]);
            let error = (f64::from(view.depth_m[i]) - depth).abs();
            assert!(error < 1e-4 / cos.max(0.1), "{error} m at {depth} m, cos {cos}");
            let expected = (ray * depth - center).dot(&-ray) / (radius * ray.norm());
            assert!((cos - expected).abs() < 0.02, "cos {cos}, expected {expected}");
        }
        assert!(seen > 50, "{seen}");
    }
}

#[test]
fn neighbouring_triangles_leave_no_hole() {
    let mesh = ball(5.0, 57);
    for (i, eye) in eyes().iter().enumerate() {
        // From within, every pixel must be covered.
        let view = render(&LENS, eye, &[instance(&mesh, 1)]);
        assert!(view.depth_m.iter().all(|z| (0.0..8.0).contains(z)), "eye {i}");
        assert!(view.cos_incidence.iter().all(|c| (0.0..=1.0).contains(c)));
    }
}

#[test]
fn the_nearest_thing_is_seen_whatever_the_order() {
    let (near, far) = (Mesh::cuboid(Vector3::repeat(0.05)), Mesh::cuboid(Vector3::new(0.3, 0.3, 0.02)));
    let eye = look_at(&Point3::new(0.0, 0.0, 1.0), &Point3::origin(), &Vector3::z());
    let (a, b) = (instance(&near, 3), instance(&far, 4));
    let view = render(&LENS, &eye, &[a, b]);
    assert_eq!(render(&LENS, &eye, &[b, a]).instance, view.instance);
    for (i, id) in view.instance.iter().enumerate() {
        let ray = LENS.ray((i % LENS.width) as f64, (i / LENS.width) as f64);
        // Half extents of the upper faces, as seen at their depths of 0.95 and 0.98.
        let within = |half: f64| ray.x.abs() < half && ray.y.abs() < half;
        let expected = if within(0.05 / 0.95) {
            3
        } else if within(0.3 / 0.98) {
            4
        } else {
            BACKGROUND
        };
        assert_eq!(*id, expected);
    }
}

#[test]
fn a_world_is_seen_with_its_table_tray_and_objects() {
    let mut world = World::new(WorldSettings { tray: Some(Tray::default()), ..Default::default() });
    let mesh = Mesh::cuboid(Vector3::new(0.04, 0.03, 0.02));
    let parts = vec![mesh.vertices.clone()];
    let surface = Surface { albedo: 0.3, specular: 0.2 };
    let object = Arc::new(Object {
        name: "box".into(),
        mesh: mesh.into(),
        parts,
        mass_kg: 0.1,
        friction: 0.5,
        surface,
        source: Source::Mesh,
    });
    let gone = world.add(object.clone(), &Isometry3::translation(0.1, 0.0, 0.02));
    let id = world.add(object, &Isometry3::translation(0.0, 0.0, 0.02));
    assert!(world.remove(gone));
    let eye = look_at(&Point3::new(0.0, 0.0, 0.8), &Point3::origin(), &Vector3::z());
    let view = capture(&world, &LENS, &eye);
    let at = |x: f64, y: f64, z: f64| {
        let ([u, v], depth) = LENS.project(&(eye.inverse() * Point3::new(x, y, z))).unwrap();
        let i = v.round() as usize * LENS.width + u.round() as usize;
        (
            view.instance[i],
            (f64::from(view.depth_m[i]) - depth).abs() < 1e-6,
            view.albedo[i],
            view.specular[i],
        )
    };
    assert_eq!(at(0.0, 0.0, 0.04), (id.number() as u16, true, 0.3, 0.2));
    assert_eq!(at(0.1, 0.0, 0.0), (BACKGROUND, true, 0.6, 0.0));
    assert_eq!(at(0.184, 0.0, 0.03), (BACKGROUND, true, 0.6, 0.0));
    let objects = view.instance.iter().filter(|i| **i == id.number() as u16).count() as f64;
    let expected = 0.08 * 0.06 * LENS.fx_px * LENS.fy_px / 0.76f64.powi(2);
    assert!((objects / expected - 1.0).abs() < 0.1, "{objects} pixels, expected {expected}");
    let image = picture(&world, &LENS, &eye);
    assert_eq!((image.width, image.height, image.pixels.len()), (160, 120, 160 * 120));
    // The object is drawn in its own colour, on a table that is grey.
    let saturation = |x: f64, y: f64| {
        let [u, v] = LENS.project(&(eye.inverse() * Point3::new(x, y, 0.0))).unwrap().0;
        let [r, g, b] = image.pixels[v as usize * 160 + u as usize];
        r.max(g).max(b) - r.min(g).min(b)
    };
    assert!(saturation(0.0, 0.0) > 80 && saturation(0.12, 0.05) < 40);
}

#[test]
fn nothing_is_seen_behind_the_camera_or_in_no_pixels() {
    let mesh = ball(0.1, 10);
    let away = look_at(&Point3::new(0.0, 0.0, 1.0), &Point3::new(0.0, 0.0, 2.0), &Vector3::z());
    assert!(render(&LENS, &away, &[instance(&mesh, 1)]).depth_m.iter().all(|z| z.is_nan()));
    for (width, height) in [(0, 0), (0, 5), (5, 0)] {
        let lens = Pinhole { width, height, ..LENS };
        assert!(render(&lens, &away, &[instance(&mesh, 1)]).depth_m.is_empty());
        let world = World::new(WorldSettings::default());
        assert!(picture(&world, &lens, &away).pixels.is_empty());
    }
}

#[test]
fn a_depth_picture_is_bright_near_and_black_without_a_return() {
    let image = crate::sensor::DepthImage { width: 4, height: 1, depth_m: vec![0.5, 1.0, 0.0, f32::NAN] };
    let picture = depth_picture(&image, [0.5, 1.0]);
    let [near, far, none, nan] = picture.pixels[..] else { panic!("{picture:?}") };
    assert!(near[0] > 200 && far[0] < 100 && far != [0; 3]);
    assert_eq!((none, nan), ([0; 3], [0; 3]));
}

fn coordinate() -> impl Strategy<Value = f64> {
    prop_oneof![
        8 => -1.0..1.0f64,
        1 => Just(0.0),
        1 => prop_oneof![Just(f64::NAN), Just(f64::INFINITY), Just(-1e300), Just(1e18), Just(1e-300)],
    ]
}

fn point() -> impl Strategy<Value = Point3<f64>> {
    [coordinate(), coordinate(), coordinate()].prop_map(Point3::from)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn any_mesh_from_anywhere_gives_a_view(
        vertices in prop::collection::vec(point(), 0..12),
        triangles in prop::collection::vec([0..14u32, 0..14, 0..14], 0..20),
        eye in point(),
        target in point(),
        size in (0..20usize, 0..20usize),
        focal in prop_oneof![4 => 1.0..500.0f64, 1 => coordinate()],
    ) {
        let mesh = Mesh { vertices, triangles };
        let lens = Pinhole { width: size.0, height: size.1, fx_px: focal, fy_px: focal, cx_px: 8.0, cy_px: 8.0 };
        let view = render(&lens, &look_at(&eye, &target, &Vector3::z()), &[instance(&mesh, 9)]);
        prop_assert_eq!(view.depth_m.len(), size.0 * size.1);
        for (z, id) in view.depth_m.iter().zip(&view.instance) {
            prop_assert!(z.is_nan() || (*z > 0.0 && *id == 9), "{} {}", z, id);
        }
        let image = crate::sensor::Sensor::azure_kinect().observe(&view, 1);
        prop_assert!(image.depth_m.iter().all(|z| *z == 0.0 || (0.15..3.87).contains(z)));
    }

    #[test]
    fn shapes_are_seen_where_they_are(x in -0.2..0.2f64, y in -0.2..0.2f64, radius in 0.02..0.1f64) {
        let shape = Shape::Sphere { radius };
        let mesh = solids::triangulate(&shape).into_mesh();
        let mut instance = instance(&mesh, 2);
        instance.world_from_mesh = Isometry3::translation(x, y, 0.0);
        let eye = look_at(&Point3::new(0.0, 0.0, 1.0), &Point3::origin(), &Vector3::z());
        let view = render(&LENS, &eye, &[instance]);
        let [u, v] = LENS.project(&(eye.inverse() * Point3::new(x, y, 0.0))).unwrap().0;
        let depth = view.depth_m[v.round() as usize * LENS.width + u.round() as usize];
        prop_assert!((f64::from(depth) - (1.0 - radius)).abs() < 0.1 * radius, "{} {}", depth, radius);
    }
}
