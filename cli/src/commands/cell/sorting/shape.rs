//! The bodies of arms, by their kinematics: for the space that they reserve, and for who sees them collide.

use std::f64::consts::FRAC_PI_2;

use anyhow::Context as _;
use graspd_adapters_ur::kinematics::{Joints, Kinematics, Model, joint_distance};
use graspd_assign::Capsule;
use graspd_cell::sort::config::ArmStation;
use graspd_cell::sort::way::{ArmShape, Posture};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

/// A posture that changes by more than this between neighbouring poses of a way is another branch, radians.
const JUMP_RAD: f64 = 1.2;

/// An arm that stands somewhere.
#[derive(Debug, Clone)]
pub(super) struct UrShape {
    arm: Kinematics,
    model: Model,
    world_from_base: Isometry3<f64>,
}

impl UrShape {
    pub(super) fn new(station: &ArmStation) -> anyhow::Result<Self> {
        let name = station.kinematics.to_lowercase();
        let model = Model::ALL.into_iter().find(|m| m.name().to_lowercase() == name);
        let model = model.with_context(|| {
            let known: Vec<String> = Model::ALL.iter().map(|m| m.name().to_lowercase()).collect();
            format!(
                "arms ({}): kinematics: found {name:?}, expected one of {}",
                station.name,
                known.join(", ")
            )
        })?;
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), station.base_yaw_rad);
        let [x, y, z] = station.base_m;
        let world_from_base = Isometry3::from_parts(Translation3::new(x, y, z), turn);
        Ok(Self { arm: Kinematics::new(model), model, world_from_base })
    }

    pub(super) fn model(&self) -> Model {
        self.model
    }

    pub(super) fn world_from_base(&self) -> &Isometry3<f64> {
        &self.world_from_base
    }

    /// The posture that the arm has with its hand at a pose, elbow up where it can be; `None` out of reach.
    pub(super) fn usual(&self, world_from_flange: &Isometry3<f64>) -> Option<Joints> {
        let goal = self.world_from_base.inverse() * world_from_flange;
        let towards = goal.translation.vector.y.atan2(goal.translation.vector.x) + 2.0 * FRAC_PI_2;
        let towards = if towards > 2.0 * FRAC_PI_2 { towards - 4.0 * FRAC_PI_2 } else { towards };
        let usual = [towards, -FRAC_PI_2, FRAC_PI_2, -FRAC_PI_2, -FRAC_PI_2, 0.0];
        let postures = self.arm.inverse(&goal, 0.0);
        let near = postures.iter().filter_map(|s| self.arm.limits().nearest_turns(&s.joints, &usual));
        near.min_by(|a, b| joint_distance(a, &usual).total_cmp(&joint_distance(b, &usual)))
    }

    /// The posture next to another one.
    pub(super) fn next(&self, world_from_flange: &Isometry3<f64>, near: &Joints) -> Option<Joints> {
        self.arm.closest(&(self.world_from_base.inverse() * world_from_flange), near)
    }

    /// Bodies of a posture: column, upper arm, lower arm, wrist.
    pub(super) fn posture(&self, joints: &Joints) -> Posture {
        let (bones, axis) = self.arm.bones(joints);
        let dh = self.arm.dh();
        // Thickness goes with length: about 0.055 m for a UR3e, 0.065 m for a UR5e.
        let thick = 0.045 + 0.05 * dh.a2.abs();
        let beside = axis * dh.d4;
        let world = |p: Point3<f64>| self.world_from_base * p;
        let body = |a: Point3<f64>, b: Point3<f64>, radius_m| Capsule { a: world(a), b: world(b), radius_m };
        let stretch = (bones[3] - bones[1]).norm() / (dh.a2.abs() + dh.a3.abs());
        let bodies = vec![
            body(bones[0], bones[1], thick + 0.01),
            body(bones[1], bones[1] + beside, thick),
            body(bones[1] + beside, bones[2] + beside, thick),
            body(bones[2] + beside, bones[2], thick - 0.01),
            body(bones[2], bones[3], thick - 0.01),
            body(bones[3], bones[4], thick - 0.015),
            body(bones[4], bones[5], thick - 0.015),
            body(bones[5], bones[6], thick - 0.015),
        ];
        Posture { bodies, stretch }
    }
}

impl ArmShape for UrShape {
    fn along(&self, way: &[Isometry3<f64>]) -> Result<Vec<Posture>, String> {
        let mut out = Vec::with_capacity(way.len());
        let mut last: Option<Joints> = None;
        let mut turned: Option<UnitQuaternion<f64>> = None;
        for pose in way {
            let at = pose.translation.vector;
            let joints = match &last {
                None => self.usual(pose),
                Some(near) => self.next(pose, near),
            };
            let Some(joints) = joints else {
                let base = self.world_from_base.translation.vector;
                let far = (at - base).norm();
                return Err(format!(
                    "the {} does not reach the flange pose at {:.3?}, {far:.3} m from its base",
                    self.model.name(),
                    at.as_slice()
                ));
            };
            // Only where the hand keeps its orientation is the way a straight line in any case: arms turn over in the air.
            if let (Some(near), true) =
                (&last, turned.is_some_and(|before| pose.rotation.angle_to(&before) < 1e-6))
            {
                let turns = joints.iter().zip(near).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                if turns > JUMP_RAD {
                    return Err(format!(
                        "a joint turns by {turns:.1} rad on a short way to {:.3?}",
                        at.as_slice()
                    ));
                }
            }
            out.push(self.posture(&joints));
            last = Some(joints);
            turned = Some(pose.rotation);
        }
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bodies_hang_together_and_end_at_the_flange() {
        let text = include_str!("../../../../../examples/sort.toml");
        let config = graspd_cell::sort::config::SortConfig::parse(text).unwrap();
        for station in &config.arms {
            let shape = UrShape::new(station).unwrap();
            let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
            let [x, y, z] = station.home_m;
            let pose = Isometry3::from_parts(Translation3::new(x, y, z + 0.15), down);
            let posture = shape.posture(&shape.usual(&pose).unwrap());
            for pair in posture.bodies.windows(2) {
                assert!((pair[0].b - pair[1].a).norm() < 1e-9);
            }
            assert!((posture.bodies[7].b.coords - pose.translation.vector).norm() < 1e-6);
        }
    }
}
