//! Every analytic gradient against finite differences, on random hands in fields that interpolate exactly.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::*;
use crate::grid::Grid;
use crate::random_hand::{random_hand, vector};
use crate::refine::Cell;

const GRID: Grid = Grid { resolution: 24, size_m: 0.4 };

/// Channels that are linear in position: trilinear interpolation is then exact and has no kinks.
fn linear_cells(seed: u64) -> (FieldCells, Vec<f32>) {
    let rng = &mut Xoshiro256PlusPlus::seed_from_u64(seed ^ 0xF1E1D);
    let slopes: Vec<Vector3<f64>> = (0..6).map(|k| vector(rng, if k == 0 { 1.0 } else { 3.0 })).collect();
    let offsets = [0.3, 0.5, 0.3, -0.2, 0.4, 0.0];
    let (mut cells, mut distance) = (Vec::new(), Vec::new());
    for i in 0..GRID.len() {
        let p = GRID.center(GRID.voxel(i)).coords - Vector3::repeat(0.2);
        let mut cell = Cell::default();
        for k in 0..6 {
            cell.0[k] = (offsets[k] + slopes[k].dot(&p)) as f32;
        }
        cells.push(cell);
        distance.push((0.01 + slopes[5].dot(&p) * 0.3) as f32);
    }
    (FieldCells { grid: GRID, cells }, distance)
}

fn random_configuration(model: &HandModel<'_>, seed: u64) -> Configuration {
    let rng = &mut Xoshiro256PlusPlus::seed_from_u64(seed ^ 0xC0F1);
    Configuration {
        translation: Vector3::repeat(0.2) + vector(rng, 0.01),
        rotation: UnitQuaternion::from_scaled_axis(vector(rng, 1.0)),
        coordinates: (0..model.coordinate_count).map(|_| rng.random_range(-0.45..0.45)).collect(),
    }
}

/// Relative difference between the analytic gradient and central differences, with only one weight set.
fn gradient_error(seed: u64, select: impl Fn(&mut Weights)) -> f64 {
    let hand = random_hand(seed);
    let model = HandModel::new(&hand);
    let (cells, distance) = linear_cells(seed);
    let centroids = [CenteredCentroid {
        position: Point3::new(0.21, 0.19, 0.2),
        weight: 1.0,
        voxel_count: 10,
        label: None,
    }];
    let mut weights = Weights::reference();
    weights.contact_distance = 0.0;
    weights.certainty = 0.0;
    weights.orientation = 0.0;
    weights.centroid = 0.0;
    weights.independence = 0.0;
    weights.net_wrench = 0.0;
    weights.approach = 0.0;
    weights.joint_limits = 0.0;
    weights.coupling = 0.0;
    weights.penetration = 0.0;
    select(&mut weights);
    let box_pose = Isometry3::from_parts(
        Translation3::new(0.22, 0.2, 0.2),
        UnitQuaternion::from_euler_angles(0.3, 0.2, 0.1),
    );
    let objective = Objective {
        model: &model,
        cells: &cells,
        centroids: &centroids,
        obstacles: Obstacles {
            grid: GRID,
            distance: &distance,
            objects: &[],
            table_m: Some(0.2),
            boxes: vec![(box_pose, Vector3::new(0.03, 0.02, 0.04))],
        },
        weights,
    };
    let mut scratch = Scratch::new(&model);
    let rng = &mut Xoshiro256PlusPlus::seed_from_u64(seed ^ 0x5A4E);
    let shares: Vec<f64> = (0..model.points.len()).map(|_| rng.random_range(0.2..1.0)).collect();
    let total: f64 = shares.iter().sum();
    for (slot, share) in scratch.contacts.share.iter_mut().zip(&shares) {
        *slot = share / total;
    }
    let at = random_configuration(&model, seed);
    let reaching = -Vector3::z();
    let dimension = 6 + model.coordinate_count;
    let mut gradient = vec![0.0; dimension];
    objective.evaluate(&at, &reaching, true, &mut scratch, &mut gradient);
    // Shares of the push and the tolerance of the distance are held fixed by definition: where a term
    // has such a part, the difference quotient holds it too.
    let frozen = scratch.contacts.push.clone();
    // A squared ramp that begins within a step has no gradient here but a small difference quotient: where the
    // term is all but flat, its usual slope (of the order of 1) is the measure.
    let (mut worst, mut scale) = (0.0f64, if weights.independence > 0.0 { 0.1 } else { 1e-6f64 });
    let mut unused = vec![0.0; dimension];
    for k in 0..dimension {
        let mut value = |h: f64| {
            let mut moved = at.clone();
            let mut tangent = vec![0.0; dimension];
            tangent[k] = h;
            moved.step(&model, &tangent);
            let terms = objective.evaluate(&moved, &reaching, true, &mut scratch, &mut unused);
            if weights.net_wrench > 0.0 {
                return weights.net_wrench
                    * net_wrench_with(&scratch.contacts, &frozen, &centroids[0], &weights);
            }
            terms.total
        };
        let h = 2e-5;
        let numeric = (value(h) - value(-h)) / (2.0 * h);
        worst = worst.max((numeric - gradient[k]).abs());
        scale = scale.max(gradient[k].abs());
    }
    worst / scale
}

fn net_wrench_with(contacts: &Contacts, push: &[f64], centroid: &CenteredCentroid, w: &Weights) -> f64 {
    let (mut force, mut torque) = (Vector3::zeros(), Vector3::zeros());
    for (i, share) in push.iter().enumerate() {
        let f = contacts.normal[i] * *share;
        force += f;
        torque += (contacts.point[i] - centroid.position.coords).cross(&f) / w.characteristic_length_m;
    }
    force.norm_squared() + torque.norm_squared()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn certainty_gradient(seed in 0u64..1_000_000) {
        prop_assert!(gradient_error(seed, |w| w.certainty = 1.0) < 2e-3);
    }

    #[test]
    fn orientation_gradient(seed in 0u64..1_000_000) {
        prop_assert!(gradient_error(seed, |w| w.orientation = 1.0) < 5e-3);
    }

    #[test]
    fn centroid_gradient(seed in 0u64..1_000_000) {
        prop_assert!(gradient_error(seed, |w| w.centroid = 10.0) < 2e-3);
    }

    #[test]
    fn independence_gradient(seed in 0u64..1_000_000) {
        let error = gradient_error(seed, |w| { w.independence = 1.0; w.independence_floor = 0.5; });
        prop_assert!(error < 1e-2, "{error}");
    }

    #[test]
    fn net_wrench_gradient(seed in 0u64..1_000_000) {
        let error = gradient_error(seed, |w| w.net_wrench = 1.0);
        prop_assert!(error < 1e-3, "{error}");
    }

    #[test]
    fn approach_gradient(seed in 0u64..1_000_000) {
        prop_assert!(gradient_error(seed, |w| w.approach = 1.0) < 1e-3);
    }

    #[test]
    fn joint_limit_and_coupling_gradients(seed in 0u64..1_000_000) {
        let error = gradient_error(seed, |w| { w.joint_limits = 1.0; w.coupling = 1.0; });
        prop_assert!(error < 1e-3, "{error}");
    }
}

/// Share of seeds for which a term with corners (a relu) agrees with finite differences: a corner within
/// the step of the difference quotient spoils a few, a wrong gradient spoils nearly all.
fn share_within(tolerance: f64, select: impl Fn(&mut Weights) + Copy) -> f64 {
    let good = (0..100).filter(|&s| gradient_error(s, select) < tolerance).count();
    good as f64 / 100.0
}

#[test]
fn penetration_gradient() {
    let share = share_within(5e-3, |w| w.penetration = 1.0);
    assert!(share > 0.9, "{share}");
}

#[test]
fn contact_distance_gradient() {
    // The tolerance τ moves with the fingers' spread and is not differentiated: with the whole hand moved
    // rigidly it stands still.
    let hand = random_hand(7);
    let model = HandModel::new(&hand);
    let (cells, _) = linear_cells(7);
    let mut contacts = Contacts::new(model.points.len());
    let mut kinematics = Kinematics::new(&model);
    kinematics.forward(&model, &random_configuration(&model, 7));
    let mut value = |shift: Vector3<f64>| {
        for (i, p) in model.points.iter().enumerate() {
            contacts.point[i] = kinematics.point(p.body, &p.point) + shift;
            contacts.look[i] = Look::at(&cells, &contacts.point[i]);
            contacts.point_gradient[i] = Vector3::zeros();
        }
        (contact::distance(&mut contacts, 1.0), contacts.point_gradient.iter().sum::<Vector3<f64>>())
    };
    let (here, gradient) = value(Vector3::zeros());
    assert!(here > 0.0);
    for axis in 0..3 {
        let h = Vector3::ith(axis, 2e-5);
        let numeric = (value(h).0 - value(-h).0) / 4e-5;
        assert!((numeric - gradient[axis]).abs() < 1e-3 * gradient.norm(), "{numeric} {gradient:?}");
    }
}

#[test]
fn the_sampler_is_exact_inside_a_cell_of_any_field() {
    let rng = &mut Xoshiro256PlusPlus::seed_from_u64(3);
    let cells = (0..GRID.len()).map(|_| Cell([rng.random::<f32>(); 8])).collect();
    let field = FieldCells { grid: GRID, cells };
    let v = GRID.voxel_m();
    for _ in 0..200 {
        let cell = Vector3::from_fn(|_, _| rng.random_range(1..22) as f64 + 0.5);
        let p = (cell + Vector3::from_fn(|_, _| rng.random_range(0.1..0.9))) * v;
        let s = field.sample(&Point3::from(p));
        for axis in 0..3 {
            let h = Vector3::ith(axis, 0.05 * v);
            let up = field.sample(&Point3::from(p + h)).value[0];
            let down = field.sample(&Point3::from(p - h)).value[0];
            let numeric = f64::from(up - down) / (0.1 * v);
            assert!((numeric - s.gradient_of(0)[axis]).abs() < 0.02 * (1.0 + numeric.abs()), "{numeric}");
        }
    }
}

#[test]
fn outside_the_volume_distance_grows_and_pulls_back() {
    let field = FieldCells { grid: GRID, cells: vec![Cell([0.1; 8]); GRID.len()] };
    let look = Look::at(&field, &Vector3::new(-0.05, 0.2, 0.2));
    assert!((look.distance() - 0.15).abs() < 1e-6);
    assert_eq!(look.outside, Vector3::new(-0.05, 0.0, 0.0));
}
