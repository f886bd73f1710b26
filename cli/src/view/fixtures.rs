//! A two-finger toy hand and one grasp, for the tests of pictures and pages.

use graspd_hands::{
    Actuation, Body, CollisionShape, Coordinate, CoordinateKind, Finger, Hand, Joint, JointKind, JointRow,
    Link, Shape, Tree,
};
use graspd_planner::grasp::{Postures, ScoreParts};
use graspd_planner::grid::Grid;
use graspd_planner::workspace::Workspace;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

use super::{FieldPoint, ViewScene};
use crate::outcome::{ContactOutcome, GraspOutcome, Named, Outcome};

/// A palm and two sliding fingers; approaches along +z.
pub(crate) fn toy_hand() -> Hand {
    let body = |joint: usize, x: f64| Body {
        parent: Some(0),
        parent_from_joint: Isometry3::translation(x, 0.0, 0.05),
        joint: Some(joint),
    };
    let joint = |name: &str, axis: Vector3<f64>| Joint {
        name: name.into(),
        kind: JointKind::Prismatic,
        axis: nalgebra::Unit::new_normalize(axis),
        lower: 0.0,
        upper: 0.04,
        effort: 0.0,
        velocity: 0.0,
    };
    let link = |name: &str, body: usize| Link {
        name: name.into(),
        body,
        body_from_link: Isometry3::identity(),
        parent: (body > 0).then_some(0),
    };
    let shape = |link: usize, half: Vector3<f64>, z: f64| CollisionShape {
        link,
        link_from_shape: Isometry3::translation(0.0, 0.0, z),
        shape: Shape::Box { half_extents: half },
    };
    let finger = Vector3::new(0.006, 0.012, 0.03);
    let visuals = vec![
        shape(0, Vector3::new(0.06, 0.02, 0.025), 0.025),
        shape(1, finger, 0.03),
        shape(2, finger, 0.03),
    ];
    Hand {
        id: "toy".into(),
        display_name: "Toy <Hand> & \"co\"".into(),
        revision: "0".into(),
        tree: Tree {
            links: vec![link("palm", 0), link("left", 1), link("right", 2)],
            joints: vec![joint("left_slide", Vector3::x()), joint("right_slide", -Vector3::x())],
            bodies: vec![
                Body { parent: None, parent_from_joint: Isometry3::identity(), joint: None },
                body(0, -0.05),
                body(1, 0.05),
            ],
        },
        actuation: Actuation {
            coordinates: vec![Coordinate {
                name: "grip".into(),
                kind: CoordinateKind::Actuator,
                lower: 0.0,
                upper: 0.04,
                open: 0.0,
                closed: 0.04,
                effort: 0.0,
            }],
            rows: vec![JointRow { terms: vec![(0, 1.0)], offset: 0.0 }; 2],
            couplings: Vec::new(),
        },
        approach: Vector3::z_axis(),
        tool_point: Point3::new(0.0, 0.0, 0.1),
        start_offset_m: 0.05,
        confidence: graspd_hands::Confidence::GENERIC,
        fingers: vec![Finger { name: "left".into() }, Finger { name: "right".into() }],
        pads: Vec::new(),
        candidates: Vec::new(),
        collision: visuals.clone(),
        visuals,
        spheres: Vec::new(),
        self_pairs: Vec::new(),
        opening: None,
        warnings: Vec::new(),
    }
}

/// The toy hand over the demo's ball.
pub(crate) fn toy_outcome() -> Outcome {
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let at = |z: f64| Isometry3::from_parts(Translation3::new(0.023, 0.012, z), down);
    let contact = |x: f64, normal: Vector3<f64>| ContactOutcome {
        point: Point3::new(0.023 + x, 0.012, 0.031),
        normal: nalgebra::Unit::new_normalize(normal),
        pad: "pad".into(),
        finger: "left".into(),
        link: "left_link".into(),
        certainty: 0.8,
    };
    let grasp = GraspOutcome {
        wrist_link: "base".into(),
        world_from_hand: at(0.13),
        camera_from_hand: at(0.13),
        world_from_pregrasp: at(0.23),
        camera_from_pregrasp: at(0.23),
        joints: Named {
            names: vec!["left_slide".into(), "right_slide".into()],
            values: Postures { open: vec![0.0; 2], contact: vec![0.013; 2], squeezed: vec![0.02; 2] },
        },
        actuators: Named {
            names: vec!["grip".into()],
            values: Postures { open: vec![0.0], contact: vec![0.013], squeezed: vec![0.02] },
        },
        contacts: vec![contact(-0.031, -Vector3::x()), contact(0.031, Vector3::x())],
        jaw_width_m: Some(0.062),
        score: 0.81,
        parts: ScoreParts { objective: 0.9, force_closure: 0.7, clearance: 0.8, certainty: 0.8 },
        objective: 1.25,
        epsilon: 0.12,
        clearance_m: 0.011,
        centroid: Point3::new(0.023, 0.012, 0.031),
        label: None,
    };
    Outcome {
        hand: "toy".into(),
        grasps: vec![grasp],
        focal_contacts: 2,
        centered_centroids: 1,
        ..Outcome::default()
    }
}

/// The demo frame in a volume on its table, with a few focal contacts.
pub(crate) fn toy_scene() -> ViewScene {
    let (depth, file) = crate::demo_scene::bundled().unwrap();
    let frame = file.frame(&depth, None).unwrap();
    let contacts = (0..20)
        .map(|i| {
            let angle = f64::from(i) * 0.314;
            let out = Vector3::new(angle.cos(), angle.sin(), 0.0);
            FieldPoint {
                point: Point3::new(0.023, 0.012, 0.031) + out * 0.031,
                inward: -out,
                certainty: f64::from(i) / 19.0,
            }
        })
        .collect();
    ViewScene {
        world_from_camera: frame.world_from_camera.unwrap(),
        frame: Some(frame),
        workspace: Workspace {
            world_from_volume: Isometry3::translation(-0.2, -0.2, -0.1),
            grid: Grid::default(),
            table_m: Some(0.1),
        },
        contacts,
        centroids: vec![(Point3::new(0.023, 0.012, 0.031), 1.0)],
        voxels: Vec::new(),
    }
}
