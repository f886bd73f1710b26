//! Analytic inverse kinematics. The three axes in the middle are parallel, so that the problem falls apart: shoulder
//! (two ways), wrist (two ways), elbow (two ways).

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::{Isometry3, Point3, Translation3};

use super::forward::link;
use super::{Joints, Kinematics, joint_distance};

/// Sine of wrist 2 below which its axes count as aligned: wrist 3 is then free, and taken as asked.
const ALIGNED: f64 = 1e-7;
/// A cosine this far beyond one is a pose on the boundary of the workspace, not beyond it.
const BOUNDARY: f64 = 1e-10;
/// A solution is one when it leads back to the pose this closely, metres and radians.
const RESIDUAL: f64 = 1e-6;
/// Postures closer than this are one, radians.
const SAME: f64 = 1e-7;

/// Which of the eight ways.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Branch {
    /// Shoulder on the left.
    pub shoulder_left: bool,
    /// Wrist 2 turned to the positive side.
    pub wrist_positive: bool,
    /// Elbow angle positive.
    pub elbow_positive: bool,
}

/// A posture that takes the flange to the pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solution {
    /// Joints, radians, each in (-pi, pi].
    pub joints: Joints,
    /// The way.
    pub branch: Branch,
    /// True where the axes of wrist 1 and 3 are aligned: their sum is fixed, and wrist 3 is chosen.
    pub wrist_free: bool,
}

/// The arc cosine of what may be a little beyond one.
fn acos_at_boundary(cosine: f64) -> Option<f64> {
    (cosine.abs() <= 1.0 + BOUNDARY).then(|| cosine.clamp(-1.0, 1.0).acos())
}

fn wrapped(angle: f64) -> f64 {
    let angle = angle.rem_euclid(TAU);
    if angle > PI { angle - TAU } else { angle }
}

/// Distance and angle between poses.
fn residual(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    let way = (a.translation.vector - b.translation.vector).norm();
    way.max(a.rotation.angle_to(&b.rotation))
}

impl Kinematics {
    /// Every posture that takes the flange to the pose, joints in (-pi, pi], limits not yet asked: none for a pose out
    /// of reach or not finite, up to eight else. Where wrist 3 is free it is
    /// `wrist3`, or the nearest of a few other angles where the elbow does not reach that far.
    pub fn inverse(&self, base_from_flange: &Isometry3<f64>, wrist3: f64) -> Vec<Solution> {
        let mut found: Vec<Solution> = Vec::with_capacity(8);
        let numbers =
            base_from_flange.translation.vector.iter().chain(base_from_flange.rotation.coords.iter());
        if !(wrist3.is_finite() && numbers.copied().all(f64::is_finite)) {
            return found;
        }
        let dh = &self.dh;
        let wrist = base_from_flange * Point3::new(0.0, 0.0, -dh.d6);
        let across = wrist.x.hypot(wrist.y);
        let Some(opening) = (across > 0.0).then(|| acos_at_boundary(dh.d4 / across)).flatten() else {
            return found;
        };
        for shoulder_left in [true, false] {
            let side = if shoulder_left { opening } else { -opening };
            let q1 = wrist.y.atan2(wrist.x) + side + FRAC_PI_2;
            let shoulder_from_flange = link(q1, dh.d1, 0.0, FRAC_PI_2).inverse() * base_from_flange;
            for wrist_positive in [true, false] {
                self.solve_wrist(
                    &shoulder_from_flange,
                    q1,
                    wrist_positive,
                    wrist3,
                    |q, elbow_positive, free| {
                        let joints = q.map(wrapped);
                        let same = |s: &Solution| {
                            joint_distance(&s.joints.map(f64::sin), &joints.map(f64::sin)) < SAME
                                && joint_distance(&s.joints.map(f64::cos), &joints.map(f64::cos)) < SAME
                        };
                        let reaches = residual(&self.forward(&joints), base_from_flange) < RESIDUAL;
                        if reaches && !found.iter().any(same) {
                            let branch = Branch { shoulder_left, wrist_positive, elbow_positive };
                            found.push(Solution { joints, branch, wrist_free: free });
                        }
                    },
                );
            }
        }
        found
    }

    /// The rest of a posture after its shoulder.
    fn solve_wrist(
        &self,
        shoulder_from_flange: &Isometry3<f64>,
        q1: f64,
        wrist_positive: bool,
        wrist3: f64,
        mut take: impl FnMut(Joints, bool, bool),
    ) {
        let dh = &self.dh;
        // The second axis seen from the flange: its third component is the cosine of wrist 2.
        let axis = shoulder_from_flange.rotation.inverse() * nalgebra::Vector3::z();
        let sine = axis.x.hypot(axis.y);
        let free = sine < ALIGNED;
        let sign = if wrist_positive { 1.0 } else { -1.0 };
        let q5 = (sign * sine).atan2(axis.z);
        let reach = |q6: f64| {
            let wrist_links = link(q5, dh.d5, 0.0, -FRAC_PI_2) * link(q6, dh.d6, 0.0, 0.0);
            let shoulder_from_wrist1 = shoulder_from_flange * wrist_links.inverse();
            let elbow_end = shoulder_from_wrist1 * Point3::new(0.0, -dh.d4, 0.0);
            let far2 = elbow_end.x.powi(2) + elbow_end.y.powi(2);
            let cosine = (far2 - dh.a2 * dh.a2 - dh.a3 * dh.a3) / (2.0 * dh.a2 * dh.a3);
            acos_at_boundary(cosine).map(|bend| (q6, bend, elbow_end, shoulder_from_wrist1))
        };
        let found = if free {
            // Where wrist 3 stands moves the elbow: as asked, or as near to that as the arm reaches.
            let steps = (0..=36).flat_map(|k| [1.0, -1.0].map(|s| wrist3 + s * f64::from(k) * PI / 36.0));
            steps.into_iter().find_map(reach)
        } else {
            reach((-sign * axis.y).atan2(sign * axis.x))
        };
        let Some((q6, bend, elbow_end, shoulder_from_wrist1)) = found else { return };
        let (x, y) = (elbow_end.x, elbow_end.y);
        for elbow_positive in [true, false] {
            let q3 = if elbow_positive { bend } else { -bend };
            let (s3, c3) = q3.sin_cos();
            // The planar two-link arm, with its links along negative x.
            let q2 = y.atan2(x) - (dh.a3 * s3).atan2(dh.a2 + dh.a3 * c3);
            let shoulder_from_elbow = link(q2, 0.0, dh.a2, 0.0) * link(q3, 0.0, dh.a3, 0.0);
            let rest = shoulder_from_elbow.inverse() * shoulder_from_wrist1;
            let along = rest.rotation * nalgebra::Vector3::x();
            let q4 = along.y.atan2(along.x);
            take([q1, q2, q3, q4, q5, q6], elbow_positive, free);
        }
    }

    /// The posture nearest to another one, within limits; `None` for a pose that cannot be reached. Each joint takes
    /// the turn that is nearest.
    pub fn closest(&self, base_from_flange: &Isometry3<f64>, near: &Joints) -> Option<Joints> {
        let solutions = self.inverse(base_from_flange, near[5]);
        let within = solutions.iter().filter_map(|s| self.limits.nearest_turns(&s.joints, near));
        within.min_by(|a, b| joint_distance(a, near).total_cmp(&joint_distance(b, near)))
    }

    /// True when some posture within limits takes the flange there.
    pub fn reaches(&self, base_from_flange: &Isometry3<f64>) -> bool {
        self.closest(base_from_flange, &[0.0; 6]).is_some()
    }

    /// A pose far out of reach on the same ray, for messages: how far the wrist's centre can be at most, metres.
    pub fn longest_m(&self) -> f64 {
        let dh = &self.dh;
        let plane = dh.a2.abs() + dh.a3.abs() + dh.d5;
        Translation3::new(plane, dh.d4, 0.0).vector.norm() + dh.d6
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinematics::{JointLimits, Model};
    use proptest::prelude::*;

    fn model() -> impl Strategy<Value = Model> {
        prop::sample::select(Model::ALL.to_vec())
    }

    proptest! {
        #[test]
        fn every_solution_leads_back(model in model(), q in prop::array::uniform6(-PI..PI)) {
            let arm = Kinematics::new(model);
            let pose = arm.forward(&q);
            let solutions = arm.inverse(&pose, q[5]);
            prop_assert!(!solutions.is_empty() && solutions.len() <= 8);
            for s in &solutions {
                prop_assert!(residual(&arm.forward(&s.joints), &pose) < 1e-7);
                prop_assert!(s.joints.iter().all(|q| *q > -PI - 1e-12 && *q <= PI + 1e-12));
            }
            let nearest = arm.closest(&pose, &q).unwrap();
            prop_assert!(joint_distance(&nearest, &q) < 1e-3, "{nearest:?} {q:?}");
        }

        #[test]
        fn away_from_singularities_branches_come_in_pairs_and_exactly(
            model in model(), q in prop::array::uniform6(-PI..PI)
        ) {
            let arm = Kinematics::new(model);
            let wrist = arm.forward(&q) * Point3::new(0.0, 0.0, -arm.dh().d6);
            prop_assume!(q[2].sin().abs() > 0.05 && q[4].sin().abs() > 0.05);
            prop_assume!(wrist.x.hypot(wrist.y) > 1.05 * arm.dh().d4);
            let solutions = arm.inverse(&arm.forward(&q), 0.0);
            prop_assert!(matches!(solutions.len(), 2 | 4 | 6 | 8), "{}", solutions.len());
            prop_assert!(solutions.iter().all(|s| !s.wrist_free));
            let nearest = arm.closest(&arm.forward(&q), &q).unwrap();
            prop_assert!(joint_distance(&nearest, &q) < 1e-9, "{nearest:?} {q:?}");
            for branch in solutions.iter().map(|s| s.branch) {
                let twin = Branch { elbow_positive: !branch.elbow_positive, ..branch };
                prop_assert!(solutions.iter().any(|s| s.branch == twin));
            }
        }

        #[test]
        fn a_free_wrist_is_as_asked_or_near(
            model in model(), q in prop::array::uniform6(-3.0..3.0f64), asked in -3.0..3.0f64
        ) {
            prop_assume!(q[2].abs() > 0.3 && q[2].abs() < 2.8);
            let arm = Kinematics::new(model);
            let pose = arm.forward(&[q[0], q[1], q[2], q[3], 0.0, q[5]]);
            let free = |asked| arm.inverse(&pose, asked).into_iter().filter(|s| s.wrist_free).collect::<Vec<_>>();
            prop_assert!(!free(asked).is_empty());
            for s in free(q[5]) {
                prop_assert!(wrapped(s.joints[5] - q[5]).abs() < 1e-9);
            }
        }

        #[test]
        fn any_numbers_are_survived(bits in prop::array::uniform7(any::<u64>()), model in model()) {
            let [x, y, z, a, b, c, d] = bits.map(f64::from_bits);
            let rotation = nalgebra::Quaternion::new(a, b, c, d);
            let pose = Isometry3::from_parts(
                Translation3::new(x, y, z),
                nalgebra::UnitQuaternion::new_unchecked(rotation),
            );
            prop_assert!(Kinematics::new(model).inverse(&pose, d).len() <= 8);
        }

        #[test]
        fn out_of_reach_is_no_solution(model in model(), far in 0.01..5.0f64, q in prop::array::uniform6(-PI..PI)) {
            let arm = Kinematics::new(model);
            let mut pose = arm.forward(&q);
            let out = pose.translation.vector.normalize() * (arm.longest_m() + arm.dh().d1 + far);
            pose.translation.vector = out;
            prop_assert!(arm.inverse(&pose, 0.0).is_empty());
            prop_assert!(!arm.reaches(&pose));
        }
    }

    #[test]
    fn eight_branches_where_there_are_eight() {
        let arm = Kinematics::new(Model::Ur5e);
        let q = [0.4, -1.2, 1.6, -1.9, -1.5, 0.3];
        let solutions = arm.inverse(&arm.forward(&q), 0.0);
        assert_eq!(solutions.len(), 8);
        for s in &solutions {
            assert!(residual(&arm.forward(&s.joints), &arm.forward(&q)) < 1e-12);
        }
    }

    #[test]
    fn singular_postures_have_solutions() {
        for model in Model::ALL {
            let arm = Kinematics::new(model);
            for q in [
                [0.0; 6],
                [0.3, -FRAC_PI_2, 0.0, -FRAC_PI_2, 0.0, 0.0],
                [0.3, -1.0, 0.0, -1.0, 1.0, 0.5],
                [0.3, -1.0, 1.0, -1.0, PI, 0.5],
            ] {
                let pose = arm.forward(&q);
                let nearest = arm.closest(&pose, &q).unwrap_or_else(|| panic!("{model:?} {q:?}"));
                assert!(residual(&arm.forward(&nearest), &pose) < RESIDUAL);
            }
        }
    }

    #[test]
    fn limits_drop_branches() {
        let q = [0.4, -1.2, 1.6, -1.9, -1.5, 0.3];
        let limits = JointLimits { lower: [-PI, -PI, 0.0, -PI, -PI, -PI], upper: [PI; 6] };
        let arm = Kinematics::new(Model::Ur5e).with_limits(limits);
        let pose = arm.forward(&q);
        let nearest = arm.closest(&pose, &[0.4, -1.2, -1.6, -1.9, -1.5, 0.3]).unwrap();
        assert!(nearest[2] > 0.0);
        let none = JointLimits { lower: [3.0; 6], upper: [3.1; 6] };
        assert!(!arm.with_limits(none).reaches(&pose));
    }
}
