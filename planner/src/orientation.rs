//! Reaching directions, and keeping a hand's orientation within what the robot can do.

use nalgebra::{Isometry3, Rotation3, Unit, UnitQuaternion, Vector3};
use rand::RngExt;

use crate::configuration::Configuration;
use crate::hand_model::HandModel;
use crate::options::{FREE_CONE_RAD, OrientationLimits, Reaching};

/// Largest angle between approach axis and reaching direction at initialization (Supplementary Note 4).
pub(crate) const INITIAL_CONE_RAD: f64 = std::f64::consts::FRAC_PI_6;

/// The limits of one request, in the volume frame.
#[derive(Debug, Clone)]
pub(crate) struct Allowed {
    cone_rad: f64,
    cone_cos: f64,
    roll_rad: Option<(f64, f64)>,
    /// What limits are measured about, where it is not the candidate's own reaching direction.
    about: Option<Vector3<f64>>,
    /// World x and y in the volume frame: the zero of the roll.
    references: [Vector3<f64>; 2],
}

impl Allowed {
    pub(crate) fn new(
        limits: &OrientationLimits,
        reaching: &Reaching,
        world_from_volume: &Isometry3<f64>,
    ) -> Self {
        let volume_from_world = world_from_volume.rotation.inverse();
        let cone_rad = limits.cone_rad.clamp(0.0, std::f64::consts::PI);
        Self {
            cone_rad,
            cone_cos: cone_rad.cos(),
            roll_rad: limits.roll_rad,
            // A random direction that nobody returns is nothing that a robot could have limits about.
            about: matches!(reaching, Reaching::Free).then(|| -Vector3::z()),
            references: [volume_from_world * Vector3::x(), volume_from_world * Vector3::y()],
        }
    }

    /// Turns `configuration` about its pivot by the least that brings it within the limits.
    pub(crate) fn enforce(
        &self,
        model: &HandModel<'_>,
        reaching: &Vector3<f64>,
        configuration: &mut Configuration,
    ) {
        let reaching = &self.about.unwrap_or(*reaching);
        let axis = configuration.rotation * model.approach;
        if axis.dot(reaching) < self.cone_cos {
            let angle = axis.angle(reaching);
            let about = Unit::try_new(axis.cross(reaching), 1e-9).unwrap_or_else(|| perpendicular(reaching));
            turn(model, configuration, UnitQuaternion::from_axis_angle(&about, angle - self.cone_rad));
        }
        let Some((low, high)) = self.roll_rad else { return };
        let Some(roll) = self.roll(model, reaching, configuration) else { return };
        let over = off_range(roll, low, high);
        if over != 0.0 {
            let about = Unit::new_unchecked(*reaching);
            turn(model, configuration, UnitQuaternion::from_axis_angle(&about, -over));
        }
    }

    /// True when the configuration is within the limits, to 1e-6 rad.
    pub(crate) fn holds(
        &self,
        model: &HandModel<'_>,
        reaching: &Vector3<f64>,
        configuration: &Configuration,
    ) -> bool {
        let reaching = &self.about.unwrap_or(*reaching);
        let axis = configuration.rotation * model.approach;
        if axis.angle(reaching) > self.cone_rad + 1e-6 {
            return false;
        }
        match (self.roll_rad, self.roll(model, reaching, configuration)) {
            (Some((low, high)), Some(roll)) => off_range(roll, low, high).abs() < 1e-6,
            _ => true,
        }
    }

    /// Rotation about the reaching direction from the reference axis to the hand's lateral axis, radians.
    fn roll(
        &self,
        model: &HandModel<'_>,
        reaching: &Vector3<f64>,
        configuration: &Configuration,
    ) -> Option<f64> {
        let flat = |v: Vector3<f64>| Unit::try_new(v - reaching * v.dot(reaching), 1e-3);
        let reference = flat(self.references[0]).or_else(|| flat(self.references[1]))?;
        let lateral = flat(configuration.rotation * lateral_axis(&model.approach))?;
        Some(reference.cross(&lateral).dot(reaching).atan2(reference.dot(&lateral)))
    }
}

/// The axis of the hand frame whose direction the roll measures: x, or y where the approach is along x.
pub(crate) fn lateral_axis(approach: &Vector3<f64>) -> Vector3<f64> {
    if approach.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() }
}

/// How far `angle` is outside `[low, high]` (modulo a turn), signed: what to subtract to get inside.
fn off_range(angle: f64, low: f64, high: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    if high - low >= TAU {
        return 0.0;
    }
    let middle = 0.5 * (low + high);
    let half = 0.5 * (high - low).max(0.0);
    let from_middle = (angle - middle + PI).rem_euclid(TAU) - PI;
    from_middle - from_middle.clamp(-half, half)
}

fn turn(model: &HandModel<'_>, configuration: &mut Configuration, rotation: UnitQuaternion<f64>) {
    let pivot = configuration.rotation * model.pivot;
    configuration.translation += pivot - rotation * pivot;
    configuration.rotation = rotation * configuration.rotation;
}

fn perpendicular(v: &Vector3<f64>) -> Unit<Vector3<f64>> {
    let other = if v.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
    Unit::new_normalize(v.cross(&other))
}

/// The reaching direction of one candidate, volume frame.
pub(crate) fn reaching_direction(
    reaching: &Reaching,
    world_from_volume: &Isometry3<f64>,
    view: &Unit<Vector3<f64>>,
    rng: &mut impl rand::Rng,
) -> Vector3<f64> {
    match reaching {
        Reaching::TopDown => -Vector3::z(),
        Reaching::CameraRay => view.into_inner(),
        Reaching::Direction(d) => world_from_volume.rotation.inverse() * d.into_inner(),
        Reaching::Free => cone_sample(&-Vector3::z(), FREE_CONE_RAD, rng),
    }
}

/// A direction drawn uniformly from the cone of half angle `cone_rad` about `axis`.
pub(crate) fn cone_sample(axis: &Vector3<f64>, cone_rad: f64, rng: &mut impl rand::Rng) -> Vector3<f64> {
    let z = 1.0 - rng.random::<f64>() * (1.0 - cone_rad.cos());
    let around = rng.random::<f64>() * std::f64::consts::TAU;
    let r = (1.0 - z * z).max(0.0).sqrt();
    let local = Vector3::new(r * around.cos(), r * around.sin(), z);
    align(&Vector3::z(), axis) * local
}

/// A rotation that takes unit vector `from` to unit vector `to`.
pub(crate) fn align(from: &Vector3<f64>, to: &Vector3<f64>) -> Rotation3<f64> {
    Rotation3::rotation_between(from, to)
        .unwrap_or_else(|| Rotation3::from_axis_angle(&perpendicular(from), std::f64::consts::PI))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rand::SeedableRng;
    use rand_xoshiro::Xoshiro256PlusPlus;

    use super::*;
    use crate::random_hand::{direction, random_hand, vector};

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(128))]

        #[test]
        fn enforced_limits_hold(
            seed in 0u64..1_000_000,
            cone in 0.0..1.5f64,
            low in -4.0..4.0f64,
            width in 0.0..3.0f64,
            with_roll: bool,
        ) {
            let rng = &mut Xoshiro256PlusPlus::seed_from_u64(seed);
            let hand = random_hand(seed);
            let model = HandModel::new(&hand);
            let reaching = direction(rng).into_inner();
            let limits = OrientationLimits { cone_rad: cone, roll_rad: with_roll.then_some((low, low + width)) };
            let allowed = Allowed::new(&limits, &Reaching::TopDown, &Isometry3::identity());
            let mut configuration = Configuration {
                translation: vector(rng, 0.1),
                rotation: UnitQuaternion::from_scaled_axis(vector(rng, 2.0)),
                coordinates: vec![0.0; model.coordinate_count],
            };
            let pivot = configuration.volume_from_hand() * nalgebra::Point3::from(model.pivot);
            allowed.enforce(&model, &reaching, &mut configuration);
            prop_assert!(allowed.holds(&model, &reaching, &configuration));
            let after = configuration.volume_from_hand() * nalgebra::Point3::from(model.pivot);
            prop_assert!((pivot - after).norm() < 1e-9, "the hand turns about its pivot");
        }

        #[test]
        fn cone_samples_stay_in_the_cone(seed in 0u64..1_000_000, cone in 0.0..3.0f64) {
            let rng = &mut Xoshiro256PlusPlus::seed_from_u64(seed);
            let axis = direction(rng).into_inner();
            let sample = cone_sample(&axis, cone, rng);
            prop_assert!((sample.norm() - 1.0).abs() < 1e-9);
            prop_assert!(sample.angle(&axis) <= cone + 1e-6);
        }
    }

    #[test]
    fn a_scara_only_yaws() {
        let hand = random_hand(1);
        let model = HandModel::new(&hand);
        let limits = OrientationLimits { cone_rad: 0.0, roll_rad: None };
        let allowed = Allowed::new(&limits, &Reaching::TopDown, &Isometry3::identity());
        let rng = &mut Xoshiro256PlusPlus::seed_from_u64(5);
        let mut configuration = Configuration {
            translation: Vector3::zeros(),
            rotation: UnitQuaternion::from_scaled_axis(vector(rng, 1.0)),
            coordinates: vec![0.0; model.coordinate_count],
        };
        allowed.enforce(&model, &-Vector3::z(), &mut configuration);
        assert!((configuration.rotation * model.approach + Vector3::z()).norm() < 1e-9);
    }
}
