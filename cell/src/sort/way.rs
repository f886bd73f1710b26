//! The way of a pick, and the space that arm and hand sweep on it.

use graspd_assign::Capsule;
use nalgebra::{Isometry3, Point3};

use crate::plan::PlannedGrasp;
use crate::pose::raised_to;

/// Poses of a way are at most so far apart where the arm's body is looked at, metres.
const SPACING_M: f64 = 0.06;

/// The space that an arm takes, by its kinematics.
pub trait ArmShape: Send + Sync + std::fmt::Debug {
    /// The bodies of the arm, without its hand, at each pose of the hand's root link on a way, as one posture follows the
    /// other; or why it cannot go it.
    ///
    /// # Errors
    /// For people: the first pose that is out of reach.
    fn along(&self, way: &[Isometry3<f64>]) -> Result<Vec<Posture>, String>;
}

/// An arm at one pose.
#[derive(Debug, Clone, PartialEq)]
pub struct Posture {
    /// Its bodies, world frame.
    pub bodies: Vec<Capsule>,
    /// How far it is stretched: 1 for as far as it goes.
    pub stretch: f64,
}

/// What the hand is, as a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandShape {
    /// Point between the fingers, hand frame.
    pub tool_point: Point3<f64>,
    /// Everything is within this of the line from its root link to the tool point, metres.
    pub radius_m: f64,
}

impl HandShape {
    /// The hand at a pose.
    pub fn at(&self, pose: &Isometry3<f64>) -> Capsule {
        let a = Point3::from(pose.translation.vector);
        Capsule { a, b: pose * self.tool_point, radius_m: self.radius_m }
    }
}

/// Poses from one to another, the first left out, none farther from the next than the spacing.
fn between(from: &Isometry3<f64>, to: &Isometry3<f64>, out: &mut Vec<Isometry3<f64>>) {
    let far = (to.translation.vector - from.translation.vector).norm();
    let count = (far / SPACING_M).ceil().max(1.0) as usize;
    out.extend((1..=count).map(|i| from.lerp_slerp(to, i as f64 / count as f64)));
}

/// The poses of the hand's root link on the way of a pick: from home above the pre-grasp, down to the grasp, up again, and
/// to where it lets go.
pub fn way_of(
    grasp: &PlannedGrasp,
    hand: &HandShape,
    home: &Isometry3<f64>,
    drop: &Isometry3<f64>,
    travel_m: f64,
) -> Vec<Isometry3<f64>> {
    let tool = hand.tool_point.coords;
    let (pregrasp, at) = (grasp.world_from_pregrasp.isometry(), grasp.world_from_hand.isometry());
    let above = raised_to(&pregrasp, &tool, travel_m);
    let lifted = raised_to(&at, &tool, travel_m);
    let mut way = vec![raised_to(home, &tool, travel_m)];
    // The way is symmetric: what leads to the pre-grasp leads back.
    let first = way[0];
    between(&first, &above, &mut way);
    between(&above, &pregrasp, &mut way);
    between(&pregrasp, &at, &mut way);
    between(&at, &lifted, &mut way);
    between(&lifted, &raised_to(drop, &tool, travel_m), &mut way);
    way.push(*drop);
    way
}

/// How many of the last poses of a way are those from where the object has been lifted on.
pub fn from_lifted_on(grasp: &PlannedGrasp, hand: &HandShape, drop: &Isometry3<f64>, travel_m: f64) -> usize {
    let tool = hand.tool_point.coords;
    let lifted = raised_to(&grasp.world_from_hand.isometry(), &tool, travel_m);
    let mut way = vec![lifted];
    between(&lifted, &raised_to(drop, &tool, travel_m), &mut way);
    way.len() + 1
}

/// What a way takes, and how far the arm is stretched on it at most.
///
/// # Errors
/// Why the arm cannot go it.
pub fn sweep(
    shape: &dyn ArmShape,
    hand: &HandShape,
    way: &[Isometry3<f64>],
) -> Result<(Vec<Capsule>, f64), String> {
    let (swept, _, stretch) = sweep_with_tail(shape, hand, way, 0)?;
    Ok((swept, stretch))
}

/// As [`sweep`], and where in it what the last `tail` poses take begins.
///
/// # Errors
/// Why the arm cannot go it.
pub fn sweep_with_tail(
    shape: &dyn ArmShape,
    hand: &HandShape,
    way: &[Isometry3<f64>],
    tail: usize,
) -> Result<(Vec<Capsule>, usize, f64), String> {
    let postures = shape.along(way)?;
    let mut out = Vec::with_capacity(way.len() * 6);
    let (mut stretch, mut begin) = (0.0f64, 0);
    for (i, posture) in postures.iter().enumerate() {
        stretch = stretch.max(posture.stretch);
        if i + tail == way.len() {
            begin = out.len();
        }
        let next = way.get(i + 1).unwrap_or(&way[i]);
        // Between two poses the arm is within half of the way that its flange goes.
        let step = (next.translation.vector - way[i].translation.vector).norm().min(SPACING_M);
        out.extend(posture.bodies.iter().map(|c| Capsule { radius_m: c.radius_m + step / 2.0, ..*c }));
        let (here, there) = (hand.at(&way[i]), hand.at(next));
        out.push(here);
        out.push(Capsule { a: here.b, b: there.b, ..here });
        out.push(Capsule { a: here.a, b: there.a, ..here });
    }
    Ok((out, begin, stretch))
}

/// How comfortable a stretch is: 1 up to 90 % of the arm's reach, then down to a half.
pub fn comfort(stretch: f64) -> f64 {
    1.0 - 0.5 * ((stretch - 0.9) / 0.1).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{UnitQuaternion, Vector3};

    /// An arm that is a straight line from its base.
    #[derive(Debug)]
    struct Stick;

    impl ArmShape for Stick {
        fn along(&self, way: &[Isometry3<f64>]) -> Result<Vec<Posture>, String> {
            let posture = |pose: &Isometry3<f64>| {
                let b = Point3::from(pose.translation.vector);
                if b.x > 0.5 {
                    return Err("too far".to_owned());
                }
                let body = Capsule { a: Point3::new(-0.6, 0.0, 0.3), b, radius_m: 0.05 };
                Ok(Posture { bodies: vec![body], stretch: 0.5 })
            };
            way.iter().map(posture).collect()
        }
    }

    fn grasp(x: f64) -> PlannedGrasp {
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let at = |z: f64| {
            crate::pose::PoseRecord::from(&Isometry3::from_parts(Vector3::new(x, 0.0, z).into(), down))
        };
        PlannedGrasp {
            world_from_pregrasp: at(0.25),
            world_from_hand: at(0.15),
            actuators: vec![],
            open: vec![],
            contact: vec![],
            squeezed: vec![],
            centroid_m: [x, 0.0, 0.03],
            score: 0.5,
            epsilon: 0.1,
            clearance_m: 0.01,
        }
    }

    #[test]
    fn every_pose_of_the_way_is_in_what_it_sweeps_and_no_two_are_far_apart() {
        let hand = HandShape { tool_point: Point3::new(0.0, 0.0, 0.15), radius_m: 0.05 };
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let at = |x: f64, z: f64| Isometry3::from_parts(Vector3::new(x, 0.2, z).into(), down);
        let way = way_of(&grasp(0.1), &hand, &at(-0.4, 0.4), &at(-0.4, 0.4), 0.3);
        for pair in way.windows(2) {
            assert!((pair[1].translation.vector - pair[0].translation.vector).norm() < SPACING_M + 0.06);
        }
        let (swept, stretch) = sweep(&Stick, &hand, &way).unwrap();
        assert_eq!(comfort(stretch), 1.0);
        for pair in way.windows(2) {
            for s in 0..=10 {
                let pose = pair[0].lerp_slerp(&pair[1], f64::from(s) / 10.0);
                for point in [Point3::from(pose.translation.vector), pose * hand.tool_point] {
                    let ball = Capsule { a: point, b: point, radius_m: 0.0 };
                    assert!(swept.iter().any(|c| c.distance(&ball) <= -0.04), "{point}");
                }
            }
        }
        assert_eq!(
            sweep(&Stick, &hand, &way_of(&grasp(0.6), &hand, &at(-0.4, 0.4), &at(-0.4, 0.4), 0.3)),
            Err("too far".to_owned())
        );
        assert!((comfort(0.95) - 0.75).abs() < 1e-12 && comfort(2.0) == 0.5);
    }
}
