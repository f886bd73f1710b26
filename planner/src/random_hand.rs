//! A random hand for property tests: three fingers of two joints, coupled, adaptive, prismatic.

use graspd_hands::{
    Actuation, Body, CollisionSphere, ContactCandidate, Coordinate, CoordinateKind, Finger, Hand, Joint,
    JointKind, JointRow, Link, Pad, SoftCoupling, Tree,
};
use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use rand::{RngExt as _, SeedableRng as _};
use rand_distr::StandardNormal;
use rand_xoshiro::Xoshiro256PlusPlus;

pub(crate) fn vector(rng: &mut Xoshiro256PlusPlus, scale: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| scale * rng.sample::<f64, _>(StandardNormal))
}

pub(crate) fn direction(rng: &mut Xoshiro256PlusPlus) -> Unit<Vector3<f64>> {
    Unit::new_normalize(vector(rng, 1.0) + Vector3::repeat(1e-3))
}

/// Three fingers of two joints; the last finger's second joint is prismatic; one coordinate moves two
/// joints, one joint is adaptive and softly coupled.
pub(crate) fn random_hand(seed: u64) -> Hand {
    let rng = &mut Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut links =
        vec![Link { name: "palm".into(), body: 0, body_from_link: Isometry3::identity(), parent: None }];
    let mut joints = Vec::new();
    let mut bodies = vec![Body { parent: None, parent_from_joint: Isometry3::identity(), joint: None }];
    let (mut pads, mut candidates, mut spheres) = (Vec::new(), Vec::new(), Vec::new());
    for finger in 0..3usize {
        for k in 0..2usize {
            let parent = if k == 0 { 0 } else { bodies.len() - 1 };
            let kind = if finger == 2 && k == 1 { JointKind::Prismatic } else { JointKind::Revolute };
            let name = format!("f{finger}j{k}");
            joints.push(Joint {
                name: name.clone(),
                kind,
                axis: direction(rng),
                lower: -0.3,
                upper: 0.3,
                effort: 1.0,
                velocity: 1.0,
            });
            let turn = UnitQuaternion::from_scaled_axis(vector(rng, 1.0));
            bodies.push(Body {
                parent: Some(parent),
                parent_from_joint: Isometry3::from_parts(Translation3::from(vector(rng, 0.03)), turn),
                joint: Some(joints.len() - 1),
            });
            let body = bodies.len() - 1;
            links.push(Link { name, body, body_from_link: Isometry3::identity(), parent: Some(parent) });
            spheres.push(CollisionSphere {
                body,
                link: body,
                center: Point3::from(vector(rng, 0.02)),
                radius: 0.02,
            });
        }
        let body = bodies.len() - 1;
        let normal = direction(rng);
        pads.push(Pad {
            name: format!("pad{finger}"),
            link: body,
            finger,
            center: Point3::from(vector(rng, 0.02)),
            half_u: Vector3::x() * 0.01,
            half_v: Vector3::y() * 0.01,
            normal,
        });
        for _ in 0..4 {
            let point = Point3::from(vector(rng, 0.02));
            candidates.push(ContactCandidate { pad: finger, body, point, normal });
        }
    }
    let coordinate = |name: &str, kind| Coordinate {
        name: name.into(),
        kind,
        lower: -0.3,
        upper: 0.3,
        open: -0.2,
        closed: 0.2,
        effort: 1.0,
    };
    let coordinates = vec![
        coordinate("a", CoordinateKind::Actuator),
        coordinate("b", CoordinateKind::Actuator),
        coordinate("c", CoordinateKind::Actuator),
        coordinate("d", CoordinateKind::Adaptive),
        coordinate("e", CoordinateKind::Actuator),
    ];
    let row = |terms: Vec<(usize, f64)>, offset| JointRow { terms, offset };
    let rows = vec![
        row(vec![(0, 1.0)], 0.0),
        row(vec![(0, 0.34)], 0.05),
        row(vec![(1, 1.0)], 0.0),
        row(vec![(3, 1.0)], 0.0),
        row(vec![(2, -1.0)], 0.0),
        row(vec![(4, 0.1), (2, 0.2)], 0.0),
    ];
    let couplings = vec![SoftCoupling { terms: vec![(2, 1.0), (3, 1.0)], target: 0.1, weight: 1.0 }];
    Hand {
        id: "random".into(),
        display_name: "random".into(),
        revision: String::new(),
        tree: Tree { links, joints, bodies },
        actuation: Actuation { coordinates, rows, couplings },
        approach: direction(rng),
        tool_point: Point3::origin(),
        start_offset_m: 0.05,
        confidence: graspd_hands::Confidence::GENERIC,
        fingers: (0..3).map(|i| Finger { name: format!("f{i}") }).collect(),
        pads,
        candidates,
        collision: Vec::new(),
        visuals: Vec::new(),
        spheres,
        self_pairs: vec![(1, 3), (1, 5), (3, 5), (0, 4)],
        opening: None,
        warnings: Vec::new(),
    }
}
