//! Forward kinematics against recorded points: published pad corners carried through the published chains.
//!
//! Each file holds points in link frames, and for a few postures where they end up. The points are those
//! of the published models, not of this library's pads, so frames are tested on their own.

use graspd_hands::library;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;

#[derive(Deserialize)]
struct Golden {
    /// The link whose frame the base pose places.
    root: String,
    joints: Vec<String>,
    points: Vec<Anchor>,
    cases: Vec<Case>,
}

#[derive(Deserialize)]
struct Anchor {
    link: String,
    point: [f64; 3],
}

#[derive(Deserialize)]
struct Case {
    translation: [f64; 3],
    rotation: [[f64; 3]; 3],
    q: Vec<f64>,
    points: Vec<[f64; 3]>,
}

fn check(id: &str, text: &str) {
    let golden: Golden = serde_json::from_str(text).unwrap_or_else(|e| panic!("{id}: {e}"));
    let tree = &library::hand(id).unwrap_or_else(|| panic!("{id} does not load")).tree;
    assert_eq!(golden.joints.len(), tree.joints.len(), "{id}: every joint is recorded");
    assert!(!golden.cases.is_empty() && !golden.points.is_empty(), "{id}: something is recorded");
    let link = |name: &str| tree.link(name).unwrap_or_else(|| panic!("{id}: no link {name}"));
    for case in &golden.cases {
        let mut q = vec![0.0; tree.joints.len()];
        for (name, value) in golden.joints.iter().zip(&case.q) {
            q[tree.joint(name).unwrap_or_else(|| panic!("{id}: no joint {name}"))] = *value;
        }
        let rows: Matrix3<f64> = Matrix3::from_fn(|r, c| case.rotation[r][c]);
        let base = Isometry3::from_parts(
            Translation3::from(Vector3::from(case.translation)),
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix(&rows)),
        );
        let links = tree.link_poses(&tree.body_poses(&q));
        let world = base * links[link(&golden.root)].inverse();
        for (anchor, expected) in golden.points.iter().zip(&case.points) {
            let found = world * links[link(&anchor.link)] * Point3::from(anchor.point);
            let off = (found - Point3::from(*expected)).amax();
            // The recorded points are rounded to 1e-5 m in each coordinate.
            assert!(off < 1e-5, "{id}: {} is off by {off} m", anchor.link);
        }
    }
}

macro_rules! golden {
    ($($name:ident: $id:literal),* $(,)?) => {
        $(#[test]
        fn $name() {
            check($id, include_str!(concat!("golden/", $id, ".json")));
        })*
    };
}

golden! {
    robotiq_2f85: "robotiq-2f85",
    robotiq_3f: "robotiq-3f",
    leap: "leap",
    antipodal: "antipodal",
    finray_2f: "finray-2f",
    // Without finger 4: the published model turns it wrongly.
    finray_4f: "finray-4f",
    model_o: "model-o",
    brunel: "brunel",
    barrett: "barrett",
    allegro: "allegro",
}
