//! Tests of refinement as a whole.

use super::*;
use proptest::prelude::*;

fn empty_field(grid: Grid) -> ContactField {
    let n = grid.len();
    ContactField { grid, certainty: vec![0.0; n], inward: vec![[0.0; 3]; n], centroid: vec![0.0; n] }
}

/// A wall of contacts at x = 5 pointing along +x into solid x ≥ 6, and two balls of centroids.
fn wall() -> (ContactField, Vec<bool>) {
    let grid = Grid { resolution: 24, size_m: 0.12 };
    let mut field = empty_field(grid);
    let mut solid = vec![false; grid.len()];
    for (i, solid) in solid.iter_mut().enumerate() {
        let [x, y, z] = grid.voxel(i);
        *solid = x >= 6;
        if x == 5 && (8..16).contains(&y) {
            field.certainty[i] = if z % 2 == 0 { 0.5 } else { 0.3 };
            field.inward[i] = [1.0, 0.0, 0.0];
        }
        let ball = |c: [i64; 3], r: i64| {
            (x as i64 - c[0]).pow(2) + (y as i64 - c[1]).pow(2) + (z as i64 - c[2]).pow(2) <= r * r
        };
        if ball([12, 6, 6], 2) || ball([12, 18, 18], 3) {
            field.centroid[i] = 0.9;
        }
    }
    (field, solid)
}

#[test]
fn thresholds_clusters_and_weights() {
    let (field, solid) = wall();
    let mut labels = vec![0u8; field.grid.len()];
    labels[field.grid.index(12, 6, 7)] = 7;
    labels[field.grid.index(12, 18, 17)] = 9;
    let features = refine(&field, &solid, &[], Some(0.01), Some(&labels), &SceneOptions::default());
    // 0.3 is below 0.7 of 0.5.
    assert_eq!(features.focal_contacts.len(), 8 * 12);
    assert_eq!(features.centroids.len(), 2);
    let [large, small] = [features.centroids[0], features.centroids[1]];
    assert_eq!((large.voxel_count, small.voxel_count), (123, 33));
    assert_eq!((large.label, small.label), (Some(9), Some(7)));
    assert!((large.weight + small.weight - 1.0).abs() < 1e-12);
    assert!((large.position - field.grid.center([12, 18, 18])).norm() < 1e-9);
    assert_eq!(features.focal_centroid_count, 156);
}

#[test]
fn directions_lead_into_the_object_on_both_sides() {
    let (field, solid) = wall();
    let features = refine(&field, &solid, &[], None, None, &SceneOptions::default());
    for x in [0, 2, 4, 5, 6, 7, 9] {
        let cell = features.cells.cells[field.grid.index(x, 12, 12)].0;
        assert!((cell[2] - 1.0).abs() < 1e-5, "x = {x}: {cell:?}");
        assert!((cell[0] - (x as f32 - 5.0).abs() * 0.005).abs() < 1e-6);
        assert!((cell[5] - (5.5 - x as f32) * 0.005).abs() < 1e-6, "x = {x}: {cell:?}");
    }
}

#[test]
fn empty_fields_give_empty_features() {
    let field = empty_field(Grid { resolution: 10, size_m: 0.1 });
    let features = refine(&field, &[], &[], None, None, &SceneOptions::default());
    assert!(features.focal_contacts.is_empty() && features.centroids.is_empty());
    assert!(features.cells.cells.iter().all(|c| c.0[0] == 0.1 && c.0[5] == 0.1));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn hostile_fields_give_finite_cells(
        values in proptest::collection::vec(
            prop_oneof![Just(f32::NAN), Just(f32::INFINITY), Just(-1.0f32), 0.0f32..1.0], 512),
        solid in proptest::collection::vec(any::<bool>(), 512),
    ) {
        let grid = Grid { resolution: 8, size_m: 0.04 };
        let inward = values.iter().map(|&v| [v, -v, v * 1e30]).collect();
        let field = ContactField { grid, certainty: values.clone(), inward, centroid: values };
        let features = refine(&field, &solid, &[], None, None, &SceneOptions::default());
        prop_assert!(features.cells.cells.iter().all(|c| c.0.iter().all(|v| v.is_finite())));
        prop_assert!(features.cells.cells.iter().all(|c| (0.0..=1.0).contains(&c.0[1])));
        let sum: f64 = features.centroids.iter().map(|c| c.weight).sum();
        prop_assert!(features.centroids.is_empty() || (sum - 1.0).abs() < 1e-9);
    }
}
