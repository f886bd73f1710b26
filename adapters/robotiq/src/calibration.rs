//! Counts of the gripper, and the metres and radians of our descriptions.
//!
//! A 2F closes both fingers alike: its one actuator is how far each finger has come in, metres, half of what the opening
//! has lost. A 3-Finger's actuators are its scissor and the first joint of each finger, radians, in free motion: a
//! finger that lies against something bends otherwise, and its count is the truth then.

use graspd_adapters_core::check::{SettingsError, require, require_within};
use serde::{Deserialize, Serialize};

use crate::settings::Model;
use crate::wire::AxisStatus;

/// Counts of a 2F that is open and closed, and its stroke.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// Count when it is wide open.
    pub open_count: f64,
    /// Count when its pads touch, nothing between them.
    pub closed_count: f64,
    /// Opening when it is wide open, millimetres.
    pub open_mm: f64,
}

/// Largest angle of a finger's first joint, radians (70 degrees), and the count where it gets there.
const FINGER_RAD: f64 = 1.2218;
const FINGER_COUNT: f64 = 148.0;
/// Scissor: angle at one end, radians (11 degrees), the counts of both ends, and the angles that the URDF allows.
const SCISSOR_RAD: f64 = 11.0 * std::f64::consts::PI / 180.0;
const SCISSOR_COUNTS: (f64, f64) = (15.0, 240.0);
const SCISSOR_LIMITS: (f64, f64) = (-0.1784, 0.192);
/// The gripper's axes, fingers A, B, C and scissor, by the order of our actuators: scissor, finger 1, finger 2, middle.
/// Finger A is the middle one; B and C are the pair that the scissor moves.
const AXIS_OF_ACTUATOR: [usize; 4] = [3, 1, 2, 0];

impl Calibration {
    /// Published values.
    pub fn of(model: Model) -> Self {
        let open_mm = match model {
            Model::TwoFinger85 => 85.0,
            Model::TwoFinger140 => 140.0,
            // Its opening between fingertips; not used.
            Model::ThreeFinger => 155.0,
        };
        Self { open_count: 3.0, closed_count: 230.0, open_mm }
    }

    pub(crate) fn check(&self) -> Result<(), SettingsError> {
        let (open, closed) = (self.open_count, self.closed_count);
        let ok = open >= 0.0 && closed <= 255.0 && closed - open >= 10.0;
        let found = format!("{open} to {closed}");
        require("calibration.open_count", found, ok, "open before closed, within 0 to 255")?;
        require_within("calibration.open_mm", self.open_mm, 1.0, 500.0)
    }

    /// Count of an opening, millimetres.
    pub fn count(&self, opening_mm: f64) -> u8 {
        let share = opening_mm / self.open_mm;
        // A cast saturates.
        (self.closed_count - share * (self.closed_count - self.open_count)).round() as u8
    }

    /// Opening at a count, millimetres, within 0 and the stroke.
    pub fn opening_mm(&self, count: u8) -> f64 {
        let share = (self.closed_count - f64::from(count)) / (self.closed_count - self.open_count);
        (share * self.open_mm).clamp(0.0, self.open_mm)
    }
}

/// Actuators of a gripper, in the order of its description.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Actuators {
    model: Model,
    calibration: Calibration,
    /// Name, least and largest value.
    pub(crate) list: Vec<(&'static str, f64, f64)>,
}

impl Actuators {
    /// `openings_mm`: least and largest opening of a 2F.
    pub(crate) fn new(model: Model, calibration: Calibration, openings_mm: [f64; 2]) -> Self {
        let list = match model {
            Model::ThreeFinger => vec![
                ("scissor", SCISSOR_LIMITS.0, SCISSOR_LIMITS.1),
                ("finger_1", 0.0, FINGER_RAD),
                ("finger_2", 0.0, FINGER_RAD),
                ("finger_middle", 0.0, FINGER_RAD),
            ],
            Model::TwoFinger85 | Model::TwoFinger140 => {
                let come_in = |opening: f64| (calibration.open_mm - opening) / 2000.0;
                vec![("grip", come_in(openings_mm[1]), come_in(openings_mm[0]))]
            }
        };
        Self { model, calibration, list }
    }

    /// Counts of each axis of the gripper for values of the actuators. `to_contact`: an actuator at its end of range is
    /// sent on until something stops it.
    pub(crate) fn counts(&self, values: &[f64], to_contact: bool) -> Vec<u8> {
        if self.model != Model::ThreeFinger {
            let value = values.first().copied().unwrap_or(0.0);
            // An end that was set narrower than the stroke is an end.
            let at_end = value >= self.calibration.open_mm / 2000.0 - 1e-6;
            let count = self.calibration.count(self.calibration.open_mm - 2000.0 * value);
            return vec![if to_contact && at_end { 255 } else { count }];
        }
        let mut counts = vec![0; AXIS_OF_ACTUATOR.len()];
        for (i, axis) in AXIS_OF_ACTUATOR.into_iter().enumerate() {
            let value = values.get(i).copied().unwrap_or(0.0);
            counts[axis] = if i == 0 {
                let (first, last) = SCISSOR_COUNTS;
                (first + (SCISSOR_RAD - value) / (2.0 * SCISSOR_RAD) * (last - first)).round() as u8
            } else if to_contact && value >= FINGER_RAD - 1e-6 {
                255
            } else {
                (value / FINGER_RAD * FINGER_COUNT).round() as u8
            };
        }
        counts
    }

    /// Values of the actuators where the gripper's axes are.
    pub(crate) fn values(&self, axes: &[AxisStatus]) -> Vec<f64> {
        let count = |axis: usize| axes.get(axis).map_or(0, |a| a.position);
        if self.model != Model::ThreeFinger {
            return vec![(self.calibration.open_mm - self.calibration.opening_mm(count(0))) / 2000.0];
        }
        let value = |(i, axis): (usize, usize)| {
            let count = f64::from(count(axis));
            if i == 0 {
                let (first, last) = SCISSOR_COUNTS;
                let share = (count.clamp(first, last) - first) / (last - first);
                SCISSOR_RAD * (1.0 - 2.0 * share)
            } else {
                (count / FINGER_COUNT).min(1.0) * FINGER_RAD
            }
        };
        AXIS_OF_ACTUATOR.into_iter().enumerate().map(value).collect()
    }

    /// Reorders what is known of the gripper's axes to the order of the actuators.
    pub(crate) fn in_order<T: Copy>(&self, axes: &[T]) -> Vec<T> {
        if self.model != Model::ThreeFinger {
            return axes.to_vec();
        }
        AXIS_OF_ACTUATOR.iter().filter_map(|axis| axes.get(*axis).copied()).collect()
    }
}

/// A value's count between a least (0) and a most (255).
pub(crate) fn share_count(value: f64, (least, most): (f64, f64)) -> u8 {
    (255.0 * (value - least) / (most - least)).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::Motion;
    use proptest::prelude::*;

    fn actuators(model: Model) -> Actuators {
        let calibration = Calibration::of(model);
        Actuators::new(model, calibration, [0.0, calibration.open_mm])
    }

    fn at(counts: &[u8]) -> Vec<AxisStatus> {
        let axis = |position: &u8| AxisStatus {
            requested: 0,
            position: *position,
            current: 0,
            motion: Motion::Reached,
        };
        counts.iter().map(axis).collect()
    }

    #[test]
    fn actuators_are_those_of_the_descriptions() {
        for (model, id) in [(Model::TwoFinger85, "robotiq-2f85"), (Model::ThreeFinger, "robotiq-3f")] {
            let hand = graspd_hands::library::hand(id).unwrap();
            let described = hand
                .actuation
                .coordinates
                .iter()
                .filter(|c| c.kind == graspd_hands::CoordinateKind::Actuator);
            let ours = actuators(model).list;
            assert_eq!(described.clone().count(), ours.len());
            for ((name, lower, upper), c) in ours.into_iter().zip(described) {
                assert_eq!(name, c.name);
                assert!((lower - c.lower).abs() < 1e-9 && (upper - c.upper).abs() < 1e-9, "{name} {c:?}");
            }
        }
    }

    #[test]
    fn a_2f_counts_what_its_opening_has_lost() {
        let calibration = Calibration::of(Model::TwoFinger85);
        assert_eq!((calibration.count(85.0), calibration.count(0.0)), (3, 230));
        assert!((calibration.opening_mm(3) - 85.0).abs() < 1e-9 && calibration.opening_mm(255) == 0.0);
        let a = actuators(Model::TwoFinger85);
        assert_eq!((a.counts(&[0.0], true), a.counts(&[0.0425], false)), (vec![3], vec![230]));
        assert_eq!(a.counts(&[0.0425], true), [255], "until something stops it");
        assert!((a.values(&at(&[230]))[0] - 0.0425).abs() < 1e-9);
        // A narrower range is not sent on.
        let narrow = Actuators::new(Model::TwoFinger85, calibration, [20.0, 60.0]);
        assert!((narrow.list[0].1 - 0.0125).abs() < 1e-9 && (narrow.list[0].2 - 0.0325).abs() < 1e-9);
        assert_eq!(narrow.counts(&[0.0325], true), [177]);
    }

    #[test]
    fn a_3_finger_is_counted_by_finger() {
        let a = actuators(Model::ThreeFinger);
        // Fingers A (middle), B (1), C (2), scissor.
        assert_eq!(a.counts(&[0.0, 0.2, 0.4, 0.6], false), [73, 24, 48, 128]);
        assert_eq!(a.counts(&[0.0, FINGER_RAD, 0.0, FINGER_RAD], true), [255, 255, 0, 128]);
        let values = a.values(&at(&[73, 24, 48, 128]));
        for (value, expected) in values.iter().zip([0.0, 0.2, 0.4, 0.6]) {
            assert!((value - expected).abs() < 0.006, "{values:?}");
        }
        assert_eq!(a.in_order(&['a', 'b', 'c', 's']), ['s', 'b', 'c', 'a']);
    }

    proptest! {
        #[test]
        fn counts_come_back(value in 0.0..0.0425f64, finger in 0.0..1.22f64, scissor in -0.17..0.19f64) {
            let a = actuators(Model::TwoFinger85);
            prop_assert!((a.values(&at(&a.counts(&[value], false)))[0] - value).abs() < 1.1e-4);
            let a = actuators(Model::ThreeFinger);
            let values = a.values(&at(&a.counts(&[scissor, finger, 0.0, finger], false)));
            prop_assert!((values[0] - scissor).abs() < 1e-3 && (values[1] - finger).abs() < 5e-3);
        }

        #[test]
        fn no_numbers_panic(value in any::<f64>(), count in any::<u8>()) {
            for model in [Model::TwoFinger85, Model::TwoFinger140, Model::ThreeFinger] {
                let a = actuators(model);
                a.counts(&[value; 4], true);
                prop_assert!(a.values(&at(&[count; 4])).iter().all(|v| v.is_finite()));
            }
        }
    }
}
