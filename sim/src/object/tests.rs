//! Tests of every family, and of users' meshes.

use std::collections::HashMap;

use proptest::prelude::*;

use super::*;

/// Every edge has one triangle on each side.
fn closed(mesh: &Mesh) -> bool {
    let mut edges: HashMap<(u32, u32), (u32, u32)> = HashMap::new();
    for t in &mesh.triangles {
        for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
            let entry = edges.entry((a.min(b), a.max(b))).or_default();
            if a < b { entry.0 += 1 } else { entry.1 += 1 }
        }
    }
    edges.values().all(|&e| e == (1, 1))
}

fn hull_volume(part: &[Point3<f64>]) -> f64 {
    crate::hull::exact(part).unwrap().mass_properties(1.0).mass()
}

#[test]
fn every_family_gives_closed_solids_of_household_size_filled_by_its_parts() {
    for &kind in Kind::ALL {
        for seed in 0..20 {
            let object = Object::sample(kind, seed);
            let name = &object.name;
            assert!(closed(&object.mesh), "{name} {seed} is open");
            let triangles = object.mesh.triangles.len();
            assert!((12..=2000).contains(&triangles), "{name} has {triangles} triangles");
            let (low, high) = object.mesh.bounds().unwrap();
            let extent = high - low;
            assert!(extent.max() <= 0.205 && extent.max() >= 0.028, "{name} {seed} is {extent} large");
            assert!(low.coords.max() < 0.0 && high.coords.min() > 0.0, "{name}: origin outside");
            assert!((MASSES_KG.0..=MASSES_KG.1).contains(&object.mass_kg), "{name}: {} kg", object.mass_kg);
            assert!((0.3..0.9).contains(&object.friction));
            let volume = object.mesh.volume();
            let parts: f64 = object.parts.iter().map(|p| hull_volume(p)).sum();
            // Joined shells count twice in both. Hollows lose what lies between the chords of their walls.
            let hollow = matches!(kind, Kind::Cup | Kind::Mug | Kind::Bowl | Kind::Nut);
            let most = if hollow { 1.4 } else { 1.06 };
            assert!(
                volume > 0.0 && (0.99..most).contains(&(parts / volume)),
                "{name}: {parts} of {volume} m³"
            );
            let center = centroid(&object.parts).norm();
            assert!(center < 1e-6, "{name}: centre of mass is off by {center} m");
        }
    }
}

#[test]
fn volumes_of_simple_families_are_the_textbook_ones() {
    let volume =
        |family| Object::from_family("x", family, 0.1, 0.5, Surface::default()).unwrap().mesh.volume();
    let pi = std::f64::consts::PI;
    let close = |a: f64, b: f64| assert!((a / b - 1.0).abs() < 0.06, "{a} is not about {b}");
    close(volume(Family::Cylinder(Cylinder { radius_m: 0.03, height_m: 0.1 })), pi * 0.03_f64.powi(2) * 0.1);
    close(volume(Family::Sphere(Ball { radius_m: 0.03 })), 4.0 / 3.0 * pi * 0.03_f64.powi(3));
    close(
        volume(Family::Capsule(Capsule { radius_m: 0.02, length_m: 0.1 })),
        pi * 0.02_f64.powi(2) * 0.1 + 4.0 / 3.0 * pi * 0.02_f64.powi(3),
    );
    close(
        volume(Family::Ring(Ring { radius_m: 0.04, tube_radius_m: 0.01 })),
        2.0 * pi * pi * 0.04 * 0.01_f64.powi(2),
    );
    let ell = Ell { legs_m: [0.1, 0.08], width_m: 0.02, height_m: 0.03 };
    close(volume(Family::Ell(ell)), (0.1 * 0.02 + 0.06 * 0.02) * 0.03);
    let tee = Tee { bar_m: 0.1, stem_m: 0.06, width_m: 0.02, height_m: 0.03 };
    close(volume(Family::Tee(tee)), (0.1 * 0.02 + 0.06 * 0.02) * 0.03);
    let side = 0.04 / 3.0_f64.sqrt();
    let nut = Nut { across_flats_m: 0.04, hole_radius_m: 0.01, height_m: 0.02 };
    close(volume(Family::Nut(nut)), (1.5 * 0.04 * side * 2.0 / 2.0 - pi * 1e-4) * 0.02);
}

#[test]
fn fingers_can_enter_a_cup_a_mug_and_a_ring() {
    for kind in [Kind::Cup, Kind::Bowl, Kind::Mug, Kind::Ring, Kind::Nut] {
        let object = Object::sample(kind, 3);
        let (_, high) = object.mesh.bounds().unwrap();
        // A point on the axis, at the rim's height.
        let at =
            convert::point(&Point3::new(if kind == Kind::Mug { -0.003 } else { 0.0 }, 0.0, high.z * 0.9));
        for part in &object.parts {
            let shape = crate::hull::exact(part).unwrap();
            assert!(!shape.contains_local_point(at), "{} is stuffed", object.name);
        }
    }
}

#[test]
fn sampling_is_deterministic_and_varies() {
    assert_eq!(Object::sample(Kind::Mug, 7), Object::sample(Kind::Mug, 7));
    assert_ne!(Object::sample(Kind::Mug, 7), Object::sample(Kind::Mug, 8));
}

#[test]
fn a_wrong_size_is_named() {
    let cup = Cup { bottom_radius_m: 0.03, top_radius_m: 0.03, height_m: 0.1, wall_m: 0.05 };
    let error = Object::from_family("cup", Family::Cup(cup), 0.1, 0.5, Surface::default()).unwrap_err();
    assert!(matches!(&error, ObjectError::Size { field, .. } if field == "cup.wall_m"), "{error}");
    let error = Object::cuboid("box", Vector3::new(0.1, f64::NAN, 0.1)).unwrap_err();
    assert!(error.to_string().contains("box.size_m: found NaN"), "{error}");
}

#[test]
fn an_l_shaped_mesh_becomes_a_few_parts_that_fill_it() {
    let ell = Object::sample(Kind::Ell, 1);
    let mut mesh = (*ell.mesh).clone();
    mesh.vertices.iter_mut().for_each(|v| *v *= 1000.0);
    // Inside out, in millimetres.
    mesh.triangles.iter_mut().for_each(|t| t.swap(0, 1));
    let options = MeshOptions { scale: 0.001, filling: Filling::Mass(0.3), ..MeshOptions::default() };
    let object = Object::from_mesh("bracket", mesh, &options).unwrap();
    assert_eq!(object.mass_kg, 0.3);
    assert!((object.mesh.volume() / ell.mesh.volume() - 1.0).abs() < 1e-9);
    assert!((2..20).contains(&object.parts.len()), "{} parts", object.parts.len());
    let parts: f64 = object.parts.iter().map(|p| hull_volume(p)).sum();
    assert!((parts / ell.mesh.volume() - 1.0).abs() < 0.15, "{parts} of {}", ell.mesh.volume());
    // The inner corner stays free.
    let Source::Family(Family::Ell(sizes)) = ell.source else { panic!("not an L") };
    let (low, _) = object.mesh.bounds().unwrap();
    let free = convert::point(&Point3::new(low.x + sizes.width_m + 0.01, low.y + sizes.width_m + 0.01, 0.0));
    for part in &object.parts {
        assert!(!crate::hull::exact(part).unwrap().contains_local_point(free));
    }
}

#[test]
fn a_convex_mesh_is_one_part() {
    let mesh = Mesh::cuboid(Vector3::new(0.02, 0.03, 0.04));
    assert_eq!(Object::from_mesh("box", mesh, &MeshOptions::default()).unwrap().parts.len(), 1);
}

#[test]
fn meshes_that_are_no_solids_are_refused() {
    let good = Mesh::cuboid(Vector3::new(0.02, 0.03, 0.04));
    let error = |mesh: Mesh| Object::from_mesh("x", mesh, &MeshOptions::default()).unwrap_err().to_string();
    assert!(error(Mesh::default()).contains("0 triangles"));
    let mut open = good.clone();
    open.triangles.pop();
    assert!(error(open).contains("3 edges"));
    let mut huge = good.clone();
    huge.vertices.iter_mut().for_each(|v| *v *= 1000.0);
    assert!(error(huge).contains("scale 0.001"));
    let mut nan = good.clone();
    nan.vertices[3].x = f64::NAN;
    assert!(error(nan).contains("NaN"));
    let mut index = good.clone();
    index.triangles[0][0] = 8;
    assert!(error(index).contains("of 8 vertices"));
    // Two sheets back to back: closed, but nothing between them.
    let corner = |x, y, z| Point3::new(x, y, z);
    let flat = Mesh {
        vertices: vec![
            corner(0.0, 0.0, 0.0),
            corner(0.1, 0.0, 0.0),
            corner(0.0, 0.1, 0.1),
            corner(0.1, 0.1, 0.1),
        ],
        triangles: vec![[0, 1, 2], [0, 2, 1], [1, 3, 2], [1, 2, 3]],
    };
    assert!(error(flat).contains("volume"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn no_mesh_makes_it_panic(
        vertices in proptest::collection::vec(proptest::array::uniform3(-0.1..0.1_f64), 4..9),
        snap in 0.001..0.1_f64,
        order in proptest::collection::vec(0..8_u32, 12..60),
    ) {
        // Coarse coordinates make degenerate solids likely; each triangle comes with its back side or in a
        // tetrahedron, so that many of the meshes are closed.
        let vertices: Vec<_> = vertices.iter().map(|v| Point3::from(v.map(|c| (c / snap).round() * snap))).collect();
        let n = vertices.len() as u32;
        let mut triangles = Vec::new();
        for c in order.chunks_exact(4) {
            let [a, b, c, d] = [c[0] % n, c[1] % n, c[2] % n, c[3] % n];
            triangles.extend([[a, b, c], [a, d, b], [b, d, c], [a, c, d]]);
        }
        let _ = Object::from_mesh("x", Mesh { vertices, triangles }, &MeshOptions::default());
    }

    #[test]
    fn no_sizes_make_a_family_panic(sizes in proptest::array::uniform6(0.0..0.3_f64)) {
        let [a, b, c, d, e, f] = sizes;
        for family in [
            Family::Can(Can { radius_m: a, height_m: b, bevel_m: c }),
            Family::Bottle(Bottle {
                body_radius_m: a,
                body_height_m: b,
                shoulder_height_m: c,
                neck_radius_m: d,
                neck_height_m: e,
            }),
            Family::Cup(Cup { bottom_radius_m: a, top_radius_m: b, height_m: c, wall_m: d }),
            Family::Bowl(Bowl { foot_radius_m: a, rim_radius_m: b, height_m: c, wall_m: d }),
            Family::Mug(Mug {
                radius_m: a,
                height_m: b,
                wall_m: c,
                handle_reach_m: d,
                handle_height_m: e,
                handle_radius_m: f / 10.0,
            }),
            Family::Hammer(Hammer { handle_radius_m: a, handle_length_m: b, head_radius_m: c, head_length_m: d }),
            Family::Superquadric(Superquadric { half_m: [a, b, c], vertical: d * 8.0, horizontal: e * 8.0 }),
            Family::Nut(Nut { across_flats_m: a, hole_radius_m: b, height_m: c }),
        ] {
            if let Ok(object) = Object::from_family("x", family, 0.1, 0.5, Surface::default()) {
                prop_assert!(closed(&object.mesh) && object.mesh.volume() > 0.0, "{:?}", object.source);
            }
        }
    }
}
