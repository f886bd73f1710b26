//! Means of orientations and of axes, in which q and −q (or an axis and its opposite) are the same.
//!
//! The mean of unit quaternions with weights w is the eigenvector to the largest eigenvalue of Σ w q qᵀ (Markley et al.
//! 2007): it minimizes the weighted sum of squared chordal distances between rotations, and as q enters by q qᵀ only its
//! sign cannot matter, nor the order of the terms. A running mean that flips each q to the side of the last, as the
//! reference implementation's, depends on the order where orientations spread widely, as approaches around one
//! closing direction do.

use nalgebra::{SMatrix, SVector, UnitQuaternion, Vector3};

/// The matrix is squared this often: components along other eigenvectors shrink by (λ₂ / λ₁)²⁵⁶.
const SQUARINGS: usize = 8;

/// Sum of w v vᵀ, whose main direction is the mean of the v up to their signs.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Moment<const N: usize>(SMatrix<f64, N, N>);

impl<const N: usize> Moment<N> {
    fn new() -> Self {
        Self(SMatrix::zeros())
    }

    fn add(&mut self, v: &SVector<f64, N>, weight: f64) {
        self.0 += v * v.transpose() * weight;
    }

    /// Eigenvector to the largest eigenvalue, of unit length and either sign; one of them where several are largest.
    /// `None` for a sum of nothing.
    fn main(&self) -> Option<SVector<f64, N>> {
        let mut power = self.0;
        for _ in 0..SQUARINGS {
            let trace = power.trace();
            if !(trace > 0.0 && trace.is_finite()) {
                return None;
            }
            power /= trace;
            power *= power;
        }
        // Every column is a multiple of the eigenvector; the longest is the most exact.
        let longest = power.diagonal().imax();
        power.column(longest).into_owned().try_normalize(0.0)
    }
}

/// Mean of orientations with weights of at least 0; `None` when all weights are 0, or for none.
pub fn mean_orientation<'a>(
    orientations: impl IntoIterator<Item = (&'a UnitQuaternion<f64>, f64)>,
) -> Option<UnitQuaternion<f64>> {
    let mut moment = Moment::<4>::new();
    for (q, weight) in orientations {
        moment.add(&q.coords, weight);
    }
    let main = moment.main()?;
    // w ≥ 0, so that equal orientations are equal numbers.
    let main = if main.w < 0.0 { -main } else { main };
    Some(UnitQuaternion::new_normalize(main.into()))
}

/// Mean of axes: unit vectors that count the same as their opposites. `None` for none.
pub fn mean_axis<'a>(axes: impl IntoIterator<Item = &'a Vector3<f64>>) -> Option<Vector3<f64>> {
    let mut moment = Moment::<3>::new();
    for axis in axes {
        moment.add(axis, 1.0);
    }
    moment.main()
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix4, SymmetricEigen, Unit};
    use proptest::prelude::*;

    use super::*;

    fn any_orientation() -> impl Strategy<Value = UnitQuaternion<f64>> {
        prop::array::uniform4(-1.0..1.0f64)
            .prop_filter("too short", |q| q.iter().map(|x| x * x).sum::<f64>() > 0.01)
            .prop_map(|[x, y, z, w]| UnitQuaternion::new_normalize(nalgebra::Quaternion::new(w, x, y, z)))
    }

    /// Orientations within `spread` radians of one, with weights.
    fn cluster(spread: f64) -> impl Strategy<Value = Vec<(UnitQuaternion<f64>, f64)>> {
        let offset = prop::array::uniform3(-1.0..1.0f64);
        (any_orientation(), prop::collection::vec((offset, 0.1..1.0f64), 1..12)).prop_map(move |(q, all)| {
            let turned = |o: [f64; 3]| q * UnitQuaternion::new(Vector3::from(o) * spread / 3f64.sqrt());
            all.into_iter().map(|(o, w)| (turned(o), w)).collect()
        })
    }

    fn mean(all: &[(UnitQuaternion<f64>, f64)]) -> UnitQuaternion<f64> {
        mean_orientation(all.iter().map(|(q, w)| (q, *w))).unwrap()
    }

    proptest! {
        #[test]
        fn signs_and_order_do_not_matter(all in cluster(1.0), signs in any::<u16>()) {
            let flip = |(i, (q, w)): (usize, &(UnitQuaternion<f64>, f64))| {
                let flipped = UnitQuaternion::new_unchecked(-q.into_inner());
                (if signs >> i & 1 == 1 { flipped } else { *q }, *w)
            };
            let mut other: Vec<_> = all.iter().enumerate().map(flip).collect();
            other.reverse();
            prop_assert!(mean(&all).angle_to(&mean(&other)) < 1e-6);
        }

        #[test]
        fn the_mean_of_one_is_that_one(q in any_orientation(), n in 1..5usize) {
            prop_assert!(mean(&vec![(q, 0.3); n]).angle_to(&q) < 1e-7);
        }

        #[test]
        fn turning_all_turns_the_mean(all in cluster(1.0), turn in any_orientation()) {
            let turned: Vec<_> = all.iter().map(|(q, w)| (turn * q, *w)).collect();
            prop_assert!((turn * mean(&all)).angle_to(&mean(&turned)) < 1e-6);
        }

        #[test]
        fn it_is_the_eigenvector_that_a_decomposition_finds(all in cluster(1.2)) {
            let mut m = Matrix4::zeros();
            for (q, w) in &all {
                m += q.coords * q.coords.transpose() * *w;
            }
            let eigen = SymmetricEigen::new(m);
            let best = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
            prop_assert!(mean(&all).coords.dot(&best).abs() > 1.0 - 1e-9);
        }

        #[test]
        fn no_other_orientation_is_nearer_to_all(all in cluster(1.0), o in prop::array::uniform3(-0.3..0.3f64)) {
            let cost = |m: &UnitQuaternion<f64>| -> f64 {
                all.iter().map(|(q, w)| w * (m.inverse() * q).angle().mul_add(0.5, 0.0).sin().powi(2)).sum()
            };
            let best = mean(&all);
            prop_assert!(cost(&best) <= cost(&(best * UnitQuaternion::new(Vector3::from(o)))) + 1e-9);
        }
    }

    #[test]
    fn half_way_between_two_and_nearer_to_the_heavier() {
        let at = |angle: f64| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), angle);
        assert!(mean(&[(at(0.2), 1.0), (at(1.0), 1.0)]).angle_to(&at(0.6)) < 1e-9);
        assert!(mean(&[(at(0.2), 3.0), (at(1.0), 1.0)]).angle_to(&at(0.2)) < 0.25);
        // On either side of a half turn, where a plain mean of the numbers gives nonsense.
        let around = mean(&[(at(3.0), 1.0), (at(-3.0), 1.0)]);
        assert!(around.angle_to(&at(std::f64::consts::PI)) < 1e-9);
    }

    #[test]
    fn approaches_all_around_keep_the_closing_direction() {
        // Twelve approaches evenly over the upper half, as a jaw has them that closes along y.
        let closing = UnitQuaternion::rotation_between(&Vector3::z(), &Vector3::y()).unwrap();
        let turned = |k: usize| {
            let turn = std::f64::consts::PI * (k as f64 / 11.0 - 0.5);
            (closing * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn), 1.0)
        };
        let all: Vec<_> = (0..12).map(turned).collect();
        assert!((mean(&all) * Vector3::z() - Vector3::y()).norm() < 1e-9);
        assert!(mean(&all).angle_to(&closing) < 1e-9);
    }

    #[test]
    fn nothing_has_no_mean_and_axes_have_no_sign() {
        assert_eq!(mean_orientation([]), None);
        assert_eq!(mean_orientation([(&UnitQuaternion::identity(), 0.0)]), None);
        assert_eq!(mean_axis([]), None);
        let axis = Unit::new_normalize(Vector3::new(1.0, 2.0, -0.5)).into_inner();
        let mean = mean_axis([&axis, &-axis, &axis]).unwrap();
        assert!((mean.dot(&axis).abs() - 1.0).abs() < 1e-12);
    }
}
