//! Bounds of a motion before it begins: is the goal reachable, is the path inside the workspace, how fast may it be.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use crate::config::UrLimits;
use crate::kinematics::{Joints, Kinematics, joint_distance};

/// Points at which a path in joint space is looked at.
const SAMPLES: usize = 64;
/// What lies between the points may be so much worse than at them.
const MARGIN: f64 = 1.1;
/// A line that must be slower than this share of what was asked leads past a singularity.
const SLOWEST: f64 = 0.05;
/// Joints that go farther than this between points of a line jump to another posture, radians.
const JUMP: f64 = 0.6;

/// The base of an arm whose shoulder changes sides turns by about half a turn: cosine of 135 degrees.
const SHOULDER_COS: f64 = -0.7;

/// Why a motion is refused: field, found, expected.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Refusal {
    pub(crate) field: &'static str,
    pub(crate) found: String,
    pub(crate) expected: String,
}

fn refuse<T>(field: &'static str, found: String, expected: impl Into<String>) -> Result<T, Refusal> {
    Err(Refusal { field, found, expected: expected.into() })
}

/// How fast a motion goes, as the controller wants to be told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Pace {
    /// Of the leading joint or of the flange, per second.
    pub(crate) speed: f64,
    /// The same per second squared.
    pub(crate) acceleration: f64,
    /// Instead of both, where not 0: the time of the whole motion, seconds.
    pub(crate) time_s: f64,
}

/// What a caller allows, within what is configured.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Allowed<'c> {
    pub(crate) speed_m_s: f64,
    pub(crate) acceleration_m_s2: f64,
    pub(crate) limits: &'c UrLimits,
}

/// A joint motion to a pose: the posture that it ends in, and its pace.
pub(crate) fn joint_motion(
    arm: &Kinematics,
    world_from_base: &Isometry3<f64>,
    from: &Joints,
    base_from_flange: &Isometry3<f64>,
    allowed: Allowed<'_>,
) -> Result<(Joints, Pace), Refusal> {
    let solutions = arm.inverse(base_from_flange, from[5]);
    let mut goals: Vec<Joints> =
        solutions.iter().filter_map(|s| arm.limits().nearest_turns(&s.joints, from)).collect();
    // A posture that is turned over, even where it is nearer, is one in which the arm reaches less: it is left for what
    // the posture it is in does not reach.
    goals.sort_by(|a, b| {
        let turned = turns_over(a, from).cmp(&turns_over(b, from));
        turned.then(joint_distance(a, from).total_cmp(&joint_distance(b, from)))
    });
    let at = base_from_flange.translation.vector;
    if goals.is_empty() {
        let found = format!("{:.3} m from the base at {:.3?}", at.norm(), at.as_slice());
        return refuse("world_from_flange", found, "a pose that the arm reaches within its joint limits");
    }
    let mut first = None;
    for goal in goals {
        match joint_pace(arm, world_from_base, from, &goal, allowed) {
            Ok(pace) => return Ok((goal, pace)),
            Err(refusal) => first = first.or(Some(refusal)),
        }
    }
    let none = || Refusal { field: "world_from_flange", found: "no way".into(), expected: "a way".into() };
    Err(first.unwrap_or_else(none))
}

/// True when elbow, wrist or shoulder stand the other way round.
fn turns_over(to: &Joints, from: &Joints) -> bool {
    // The base goes half round when the shoulder changes sides.
    let shoulder = (to[0] - from[0]).cos() < SHOULDER_COS;
    shoulder || [2, 4].into_iter().any(|i| to[i].sin() * from[i].sin() < 0.0)
}

/// The pace of a motion straight in joint space.
pub(crate) fn joint_pace(
    arm: &Kinematics,
    world_from_base: &Isometry3<f64>,
    from: &Joints,
    to: &Joints,
    allowed: Allowed<'_>,
) -> Result<Pace, Refusal> {
    let limits = allowed.limits;
    let at = |s: f64| -> Vector3<f64> {
        let q: Joints = std::array::from_fn(|i| from[i] + s * (to[i] - from[i]));
        arm.forward(&q).translation.vector
    };
    let step = 1.0 / SAMPLES as f64;
    let path: Vec<Vector3<f64>> = (0..=SAMPLES).map(|i| at(i as f64 * step)).collect();
    stays_inside(world_from_base, &path, limits)?;
    let far = joint_distance(from, to).max(1e-6);
    let slope = path.windows(2).map(|w| (w[1] - w[0]).norm() / step).fold(0.0, f64::max) * MARGIN;
    let bends = path.windows(3).map(|w| (w[2] - 2.0 * w[1] + w[0]).norm() / (step * step));
    let bend = bends.fold(0.0, f64::max) * MARGIN;
    // The flange's acceleration is slope times that along the path, and bend times the speed squared: half for each.
    let acceleration = 0.5 * allowed.acceleration_m_s2;
    let mut rate = (limits.joint_speed_rad_s / far).min(allowed.speed_m_s / slope.max(1e-9));
    rate = rate.min((acceleration / bend.max(1e-9)).sqrt());
    let gain = (limits.joint_acceleration_rad_s2 / far).min(acceleration / slope.max(1e-9));
    Ok(Pace { speed: rate * far, acceleration: gain * far, time_s: 0.0 })
}

/// A straight line: the posture that it ends in, and its pace.
pub(crate) fn line_motion(
    arm: &Kinematics,
    world_from_base: &Isometry3<f64>,
    from: (&Isometry3<f64>, &Joints),
    to: &Isometry3<f64>,
    allowed: Allowed<'_>,
) -> Result<(Joints, Pace), Refusal> {
    let limits = allowed.limits;
    let (start, joints) = from;
    let way = to.translation.vector - start.translation.vector;
    let turn = (to.rotation * start.rotation.inverse()).scaled_axis();
    let (length, angle) = (way.norm(), turn.norm());
    let count = (length / 0.01).max(angle / 0.05).ceil().clamp(8.0, 300.0) as usize;
    let step = 1.0 / count as f64;
    let mut at = *joints;
    let mut steepest: f64 = 0.0;
    let mut path = vec![start.translation.vector];
    for i in 1..=count {
        let s = i as f64 * step;
        let rotation = UnitQuaternion::from_scaled_axis(turn * s) * start.rotation;
        let pose = Isometry3::from_parts((start.translation.vector + way * s).into(), rotation);
        let Some(next) = arm.closest(&pose, &at) else {
            let found = format!("out of reach {:.0} % along the line", 100.0 * s);
            return refuse("world_from_flange", found, "a line that the arm reaches all along");
        };
        let far = joint_distance(&at, &next);
        // The first step also makes up for what the nominal table and the real arm differ by.
        if far > JUMP {
            let found = format!("a singularity {:.0} % along the line", 100.0 * s);
            return refuse("world_from_flange", found, "a line in one posture of the arm");
        }
        if i > 1 {
            steepest = steepest.max(far / step);
        }
        at = next;
        path.push(pose.translation.vector);
    }
    stays_inside(world_from_base, &path, limits)?;
    let asked = (allowed.speed_m_s / length.max(1e-9)).min(limits.turn_rad_s / angle.max(1e-9));
    let rate = asked.min(limits.joint_speed_rad_s / (MARGIN * steepest).max(1e-9));
    if rate < SLOWEST * asked {
        let found = format!("next to a singularity: {:.0} % of the speed", 100.0 * rate / asked);
        return refuse("world_from_flange", found, format!("at least {:.0} %", 100.0 * SLOWEST));
    }
    if rate * angle <= rate * length * limits.turn_rad_s / allowed.speed_m_s && length > 1e-3 {
        let pace = Pace { speed: rate * length, acceleration: allowed.acceleration_m_s2, time_s: 0.0 };
        return Ok((at, pace));
    }
    // Mostly a turn, which the controller does not pace by metres: told as time, for a quarter of it speeding up and a
    // quarter braking, within the same bounds.
    let gain = (allowed.acceleration_m_s2 / length.max(1e-9))
        .min(limits.turn_rad_s * allowed.acceleration_m_s2 / allowed.speed_m_s / angle.max(1e-9));
    let time_s = (1.0 / (0.75 * rate)).max((4.0 / 0.75 / gain).sqrt()).max(0.05);
    Ok((at, Pace { speed: allowed.speed_m_s, acceleration: allowed.acceleration_m_s2, time_s }))
}

/// A path may begin outside the workspace, but not leave it, nor end outside.
fn stays_inside(
    world_from_base: &Isometry3<f64>,
    path: &[Vector3<f64>],
    limits: &UrLimits,
) -> Result<(), Refusal> {
    let mut inside = false;
    for (i, point) in path.iter().enumerate() {
        let world = world_from_base * nalgebra::Point3::from(*point);
        let contained = limits.workspace.contains(&world.coords);
        if !contained && (inside || i + 1 == path.len()) {
            let found = format!("the flange at {:.3?} m", world.coords.as_slice());
            let w = &limits.workspace;
            return refuse("workspace", found, format!("within {:?} to {:?}", w.lower_m, w.upper_m));
        }
        inside |= contained;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;
    use crate::config::Workspace;
    use crate::kinematics::Model;
    use proptest::prelude::*;

    const HOME: Joints = [0.0, -FRAC_PI_2, FRAC_PI_2, -FRAC_PI_2, -FRAC_PI_2, 0.0];

    fn allowed(limits: &UrLimits) -> Allowed<'_> {
        Allowed { speed_m_s: 0.2, acceleration_m_s2: 1.0, limits }
    }

    fn everywhere() -> UrLimits {
        let workspace = Workspace { lower_m: [-3.0; 3], upper_m: [3.0; 3] };
        UrLimits { workspace, ..UrLimits::default() }
    }

    proptest! {
        #[test]
        fn flange_and_joints_keep_their_bounds_along_a_joint_motion(
            from in prop::array::uniform6(-2.0..2.0f64), to in prop::array::uniform6(-2.0..2.0f64)
        ) {
            let (arm, limits) = (Kinematics::new(Model::Ur5e), everywhere());
            let pace = joint_pace(&arm, &Isometry3::identity(), &from, &to, allowed(&limits)).unwrap();
            prop_assert!(pace.speed <= limits.joint_speed_rad_s + 1e-12);
            prop_assert!(pace.acceleration <= limits.joint_acceleration_rad_s2 + 1e-12);
            // At full speed anywhere on the path, seen more closely than it was planned.
            let rate = pace.speed / joint_distance(&from, &to);
            let at = |s: f64| {
                let q = std::array::from_fn(|i| from[i] + s * (to[i] - from[i]));
                arm.forward(&q).translation.vector
            };
            for i in 0..1000 {
                let s = f64::from(i) / 1000.0;
                let speed = (at(s + 1e-4) - at(s)).norm() / 1e-4 * rate;
                prop_assert!(speed <= 0.2 * 1.02, "{}", speed);
            }
        }
    }

    #[test]
    fn lines_are_paced_refused_at_singularities_and_out_of_reach() {
        let (arm, limits) = (Kinematics::new(Model::Ur5e), everywhere());
        let start = arm.forward(&HOME);
        let line = |to: &Isometry3<f64>| {
            line_motion(&arm, &Isometry3::identity(), (&start, &HOME), to, allowed(&limits))
                .map(|(_, pace)| pace)
        };
        let mut down = start;
        down.translation.vector.z -= 0.1;
        let pace = line(&down).unwrap();
        assert_eq!((pace.speed, pace.time_s), (0.2, 0.0));
        let turned = start * UnitQuaternion::from_scaled_axis(Vector3::z() * 1.0);
        let pace = line(&turned).unwrap();
        // A radian at no more than 1.5 rad/s of a joint with peaks at 4/3 of the mean.
        assert!(pace.time_s > 0.88 && pace.time_s < 3.0, "{pace:?}");
        let mut far = start;
        far.translation.vector.x -= 2.0;
        assert!(line(&far).unwrap_err().found.contains("out of reach"));
        // Nearer to the base's axis than the wrist's offset: nothing reaches there.
        let mut across = start;
        across.translation.vector.x = -across.translation.vector.x;
        across.translation.vector.y = 0.1;
        let refusal = line(&across).unwrap_err();
        assert!(
            refusal.found.contains("singularity") || refusal.found.contains("out of reach"),
            "{refusal:?}"
        );
    }

    #[test]
    fn postures_are_kept_where_they_reach() {
        let (arm, limits) = (Kinematics::new(Model::Ur5e), everywhere());
        let goal_at = |yaw: f64| {
            let mut goal = arm.forward(&HOME);
            goal.rotation *= UnitQuaternion::from_scaled_axis(Vector3::z() * yaw);
            goal
        };
        // More than half a turn of the tool is nearer with the wrist turned over, but it stays as it is.
        for yaw in [-3.0, -1.5, 0.0, 1.5, 3.0, 3.3] {
            let goal = goal_at(yaw);
            let (joints, _) =
                joint_motion(&arm, &Isometry3::identity(), &HOME, &goal, allowed(&limits)).unwrap();
            assert!(!turns_over(&joints, &HOME), "{yaw}: {joints:?}");
            assert!(joint_distance(&joints, &HOME) < 3.2, "{yaw}: {joints:?}");
        }
    }

    #[test]
    fn paths_stay_in_the_workspace_but_may_come_into_it() {
        let arm = Kinematics::new(Model::Ur5e);
        let start = arm.forward(&HOME);
        let z = start.translation.vector.z;
        let boxed = |lower, upper| {
            let workspace = Workspace { lower_m: [-3.0, -3.0, lower], upper_m: [3.0, 3.0, upper] };
            UrLimits { workspace, ..UrLimits::default() }
        };
        let mut down = start;
        down.translation.vector.z -= 0.1;
        let go = |limits: &UrLimits| {
            line_motion(&arm, &Isometry3::identity(), (&start, &HOME), &down, allowed(limits))
        };
        assert!(go(&boxed(z - 0.2, z + 0.1)).is_ok());
        assert!(go(&boxed(z - 0.2, z - 0.05)).is_ok());
        assert_eq!(go(&boxed(z - 0.05, z + 0.1)).unwrap_err().field, "workspace");
        let limits = everywhere();
        let (goal, _) = joint_motion(&arm, &Isometry3::identity(), &HOME, &down, allowed(&limits)).unwrap();
        assert!(joint_distance(&goal, &HOME) < 0.5);
        let beyond = Isometry3::translation(2.0, 0.0, 0.0);
        let refusal =
            joint_motion(&arm, &Isometry3::identity(), &HOME, &beyond, allowed(&limits)).unwrap_err();
        assert!(refusal.expected.contains("reaches"));
    }
}
