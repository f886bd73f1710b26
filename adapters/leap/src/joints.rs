//! Joints of the LEAP Hand: which motor turns which joint of our description, and how far.

use std::f64::consts::TAU;

use graspd_adapters_dynamixel::table::PULSES_PER_TURN;
use serde::{Deserialize, Serialize};

/// Pulses of a straight joint: the middle of a turn.
const STRAIGHT: f64 = PULSES_PER_TURN / 2.0;

/// A motor and the joint that it turns.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Joint {
    /// Name of the actuator in the hand's description; their order is that of every actuator vector.
    pub actuator: String,
    /// Name of the joint in the URDF.
    pub joint: String,
    /// Address of its motor.
    pub id: u8,
    /// Which finger it belongs to: when one joint of a finger is held, the whole finger stops closing.
    pub finger: u8,
    /// Least angle, radians.
    pub lower_rad: f64,
    /// Largest angle, radians.
    pub upper_rad: f64,
    /// Pulses where the angle is zero.
    #[serde(default = "straight")]
    pub zero_pulse: f64,
    /// True for a motor that turns against its joint.
    #[serde(default)]
    pub reversed: bool,
    /// Share of the gains that its motor gets: joints that carry little need less.
    #[serde(default = "whole")]
    pub gain: f64,
}

fn straight() -> f64 {
    STRAIGHT
}

fn whole() -> f64 {
    1.0
}

impl Joint {
    /// Goal of its motor for an angle, pulses.
    pub fn pulses(&self, angle_rad: f64) -> i32 {
        let turned = if self.reversed { -angle_rad } else { angle_rad };
        // Angles are finite and within limits when they come here; a cast saturates whatever else comes.
        (self.zero_pulse + turned * PULSES_PER_TURN / TAU).round() as i32
    }

    /// Angle of the joint, radians.
    pub fn angle_rad(&self, pulses: f64) -> f64 {
        let turned = (pulses - self.zero_pulse) * TAU / PULSES_PER_TURN;
        if self.reversed { -turned } else { turned }
    }

    /// The same sign for currents and speeds.
    pub(crate) fn sign(&self) -> f64 {
        if self.reversed { -1.0 } else { 1.0 }
    }
}

/// The joints of the LEAP Hand, in the order of the actuators of its description (`leap` of the hand library). Motors
/// carry the joints' numbers as addresses. Limits are the published ones; angles grow when fingers close.
pub fn leap() -> Vec<Joint> {
    const SIDE: (f64, f64) = (-1.047, 1.047);
    const FLEX: (f64, f64) = (-0.314, 2.23);
    const PIP: (f64, f64) = (-0.506, 1.885);
    const DIP: (f64, f64) = (-0.366, 2.042);
    let mut joints = Vec::with_capacity(16);
    let mut add = |actuator: String, id: u8, finger: u8, (lower_rad, upper_rad): (f64, f64), gain: f64| {
        let (joint, zero_pulse) = (id.to_string(), STRAIGHT);
        joints.push(Joint {
            actuator,
            joint,
            id,
            finger,
            lower_rad,
            upper_rad,
            zero_pulse,
            reversed: false,
            gain,
        });
    };
    for (finger, name) in (0u8..).zip(["index", "middle", "ring"]) {
        // In the URDF the joint that bends is the parent of the one that spreads.
        add(format!("{name}_flex"), 4 * finger + 1, finger, FLEX, 1.0);
        add(format!("{name}_abduction"), 4 * finger, finger, SIDE, 0.75);
        add(format!("{name}_pip"), 4 * finger + 2, finger, PIP, 1.0);
        add(format!("{name}_dip"), 4 * finger + 3, finger, DIP, 1.0);
    }
    for (id, name, limits) in [
        (12, "thumb_cmc", (-0.349, 2.094)),
        (13, "thumb_axl", (-0.47, 2.443)),
        (14, "thumb_mcp", (-1.20, 1.90)),
        (15, "thumb_ip", (-1.34, 1.88)),
    ] {
        add(name.to_owned(), id, 3, limits, 1.0);
    }
    joints
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joints_are_those_of_the_description_by_name_order_and_limit() {
        let hand = graspd_hands::library::hand("leap").unwrap();
        let joints = leap();
        assert_eq!((joints.len(), hand.actuation.coordinates.len()), (16, 16));
        for (i, (joint, coordinate)) in joints.iter().zip(&hand.actuation.coordinates).enumerate() {
            assert_eq!(joint.actuator, coordinate.name);
            let row = hand.actuation.rows.iter().position(|r| r.terms == [(i, 1.0)]).unwrap();
            assert_eq!(joint.joint, hand.tree.joints[row].name);
            // Motors carry the joints' names as addresses.
            assert_eq!(joint.id.to_string(), joint.joint);
            assert!((joint.lower_rad - coordinate.lower).abs() < 1e-9, "{joint:?}");
            assert!((joint.upper_rad - coordinate.upper).abs() < 1e-9, "{joint:?}");
        }
    }

    #[test]
    fn motors_stand_in_the_published_order_of_the_simulation() {
        // Of the hand's published simulation: which motor turns each of its joints, which follow the URDF's tree.
        let published = [1, 0, 2, 3, 12, 13, 14, 15, 5, 4, 6, 7, 9, 8, 10, 11];
        let back = [1, 0, 2, 3, 9, 8, 10, 11, 13, 12, 14, 15, 4, 5, 6, 7];
        for (simulated, motor) in published.into_iter().enumerate() {
            assert_eq!(back[usize::from(motor)], simulated);
        }
        // Ours keeps the order within each finger, the thumb last.
        let ids: Vec<u8> = leap().iter().map(|j| j.id).collect();
        let fingers =
            |ids: &[u8]| ids.chunks(4).map(<[u8]>::to_vec).collect::<std::collections::BTreeSet<_>>();
        assert_eq!(fingers(&ids), fingers(&published));
        let of = |id: u8| leap().into_iter().find(|j| j.id == id).unwrap();
        for (id, lower, upper) in [
            (0, -1.047, 1.047),
            (5, -0.314, 2.23),
            (10, -0.506, 1.885),
            (3, -0.366, 2.042),
            (12, -0.349, 2.094),
            (13, -0.47, 2.443),
            (14, -1.2, 1.9),
            (15, -1.34, 1.88),
        ] {
            assert_eq!((of(id).lower_rad, of(id).upper_rad, of(id).zero_pulse), (lower, upper, 2048.0));
        }
    }

    #[test]
    fn angles_are_counted_from_the_middle_of_a_turn() {
        let joint = &leap()[0];
        assert_eq!((joint.id, joint.pulses(0.0), joint.pulses(TAU / 4.0)), (1, 2048, 3072));
        assert!((joint.angle_rad(1024.0) + TAU / 4.0).abs() < 1e-12);
        let reversed = Joint { reversed: true, ..joint.clone() };
        assert_eq!(reversed.pulses(TAU / 4.0), 1024);
        assert!((reversed.angle_rad(1024.0) - TAU / 4.0).abs() < 1e-12);
    }
}
