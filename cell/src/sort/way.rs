//! The way of a pick, and the space that arm and hand sweep on it.

use graspd_assign::Capsule;
use nalgebra::{Isometry3, Point3, Vector3};

use crate::plan::PlannedGrasp;
use crate::pose::raised_to;

/// Poses of a way are at most so far apart where the arm's body is looked at, metres.
const SPACING_M: f64 = 0.04;
/// Turning counts as the way of a point this far from the hand's root link, metres.
const TURNING_M: f64 = 0.15;
/// What goes farther than twice this between two such poses is an arm that turns over: where it is meanwhile nobody knows.
const MOST_SLACK_M: f64 = 0.06;
/// How far arcs between two such poses are from straight lines, metres.
const ARC_M: f64 = 0.002;

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
#[derive(Debug, Clone, PartialEq)]
pub struct HandShape {
    /// Point between the fingers, hand frame.
    pub tool_point: Point3<f64>,
    /// Bodies that hold all of it however its fingers stand, hand frame.
    pub bodies: Vec<Capsule>,
}

impl HandShape {
    /// A hand of which no more is known than that everything is within a radius of the line from its root link to its tool
    /// point.
    pub fn thick_line(tool_point: Point3<f64>, radius_m: f64) -> Self {
        Self { tool_point, bodies: vec![Capsule { a: Point3::origin(), b: tool_point, radius_m }] }
    }

    /// The hand at a pose.
    pub fn at(&self, pose: &Isometry3<f64>) -> impl Iterator<Item = Capsule> {
        self.bodies.iter().map(move |c| Capsule { a: pose * c.a, b: pose * c.b, radius_m: c.radius_m })
    }
}

/// Poses from one to another, the first left out, none farther from the next than the spacing, as a place in the hand goes
/// that is [`TURNING_M`] from its root link.
fn between(from: &Isometry3<f64>, to: &Isometry3<f64>, out: &mut Vec<Isometry3<f64>>) {
    let way = (to.translation.vector - from.translation.vector).norm();
    let far = way.max(TURNING_M * from.rotation.angle_to(&to.rotation));
    let count = (far / SPACING_M).ceil().max(1.0) as usize;
    out.extend((1..=count).map(|i| from.lerp_slerp(to, i as f64 / count as f64)));
}

/// Poses on straight lines from each to the next, the first and all of them included.
pub fn through(poses: &[Isometry3<f64>]) -> Vec<Isometry3<f64>> {
    let mut way: Vec<_> = poses.iter().take(1).copied().collect();
    for pair in poses.windows(2) {
        between(&pair[0], &pair[1], &mut way);
    }
    way
}

/// How high arms travel, and how far they lift at least.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Heights {
    /// Of the tool point when travelling, world frame, metres.
    pub travel_m: f64,
    /// How far a grasp is lifted in any case, metres.
    pub lift_m: f64,
}

impl Heights {
    /// Where the hand is once it has lifted what it grasped.
    pub(super) fn lifted(&self, grasp: &PlannedGrasp, tool: &Vector3<f64>) -> Isometry3<f64> {
        let mut up = grasp.world_from_hand.isometry();
        up.translation.vector.z += self.lift_m;
        raised_to(&up, tool, self.travel_m)
    }
}

/// The poses of the hand's root link on the way of a pick: from home above the pre-grasp, down to the grasp, up again, and
/// to where it lets go.
pub fn way_of(
    grasp: &PlannedGrasp,
    hand: &HandShape,
    home: &Isometry3<f64>,
    drop: &Isometry3<f64>,
    heights: &Heights,
) -> Vec<Isometry3<f64>> {
    let tool = hand.tool_point.coords;
    let (pregrasp, at) = (grasp.world_from_pregrasp.isometry(), grasp.world_from_hand.isometry());
    let above = raised_to(&pregrasp, &tool, heights.travel_m);
    // The way is symmetric: what leads to the pre-grasp leads back.
    through(&[
        raised_to(home, &tool, heights.travel_m),
        above,
        pregrasp,
        at,
        heights.lifted(grasp, &tool),
        raised_to(drop, &tool, heights.travel_m),
        *drop,
    ])
}

/// How many of the last poses of a way are those from where the object has been lifted on.
pub fn from_lifted_on(
    grasp: &PlannedGrasp,
    hand: &HandShape,
    drop: &Isometry3<f64>,
    heights: &Heights,
) -> usize {
    let tool = hand.tool_point.coords;
    through(&[heights.lifted(grasp, &tool), raised_to(drop, &tool, heights.travel_m), *drop]).len()
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
    let stretch = postures.iter().map(|p| p.stretch).fold(0.0, f64::max);
    let all: Vec<Vec<Capsule>> = (postures.into_iter().zip(way))
        .map(|(posture, pose)| posture.bodies.into_iter().chain(hand.at(pose)).collect())
        .collect();
    let mut out = Vec::with_capacity(all.iter().map(Vec::len).sum());
    let mut begin = 0;
    for (i, bodies) in all.iter().enumerate() {
        if i + tail == all.len() {
            begin = out.len();
        }
        for (k, body) in bodies.iter().enumerate() {
            let beside =
                [i.checked_sub(1), Some(i + 1)].into_iter().flatten().filter_map(|n| all.get(n)?.get(k));
            let step = beside.map(|n| (n.a - body.a).norm().max((n.b - body.b).norm())).fold(0.0, f64::max);
            // A ball of radius r that goes a straight way of 2 d is nowhere outside of balls of radius √(r² + d²) at both ends
            // of it; so is each point of a body's axis, but for the arc that it makes.
            let half = (step / 2.0).min(MOST_SLACK_M);
            out.push(Capsule { radius_m: body.radius_m.hypot(half) + ARC_M, ..*body });
        }
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
    use nalgebra::UnitQuaternion;

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
        let hand = HandShape::thick_line(Point3::new(0.0, 0.0, 0.15), 0.05);
        let heights = Heights { travel_m: 0.3, lift_m: 0.15 };
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let at = |x: f64, z: f64| Isometry3::from_parts(Vector3::new(x, 0.2, z).into(), down);
        let way = way_of(&grasp(0.1), &hand, &at(-0.4, 0.4), &at(-0.4, 0.4), &heights);
        for pair in way.windows(2) {
            assert!((pair[1].translation.vector - pair[0].translation.vector).norm() < SPACING_M + 1e-9);
        }
        let (swept, stretch) = sweep(&Stick, &hand, &way).unwrap();
        assert_eq!(comfort(stretch), 1.0);
        for pair in way.windows(2) {
            for s in 0..=10 {
                let pose = pair[0].lerp_slerp(&pair[1], f64::from(s) / 10.0);
                for share in [0.0, 0.3, 1.0] {
                    // Points of the surface all around.
                    for out in [Vector3::x(), Vector3::y(), Vector3::z()].iter().flat_map(|v| [*v, -v]) {
                        let point = pose * Point3::from(share * hand.tool_point.coords) + 0.05 * out;
                        let ball = Capsule { a: point, b: point, radius_m: 0.0 };
                        assert!(swept.iter().any(|c| c.distance(&ball) <= 0.0), "{point}");
                    }
                }
            }
        }
        assert_eq!(
            sweep(&Stick, &hand, &way_of(&grasp(0.6), &hand, &at(-0.4, 0.4), &at(-0.4, 0.4), &heights)),
            Err("too far".to_owned())
        );
        assert!((comfort(0.95) - 0.75).abs() < 1e-12 && comfort(2.0) == 0.5);
    }
}
