//! What the emulated controller drives: joints, and what pushes on them.

use nalgebra::{Isometry3, Point3, UnitVector3, Vector3};

use super::geometry::{Six, UrModel};

/// What the controller asks of the plant in one control step.
#[derive(Debug, Clone, Copy)]
pub struct PlantTarget {
    /// Length of the step, seconds.
    pub dt_s: f64,
    /// Joint positions, radians.
    pub q: Six,
    /// Joint speeds, radians per second.
    pub qd: Six,
    /// Pose of the flange at `q`, base frame.
    pub base_from_flange: Isometry3<f64>,
    /// Pose of the active tool centre point at `q`, base frame.
    pub base_from_tcp: Isometry3<f64>,
}

/// What the plant does in that step.
#[derive(Debug, Clone, PartialEq)]
pub struct PlantState {
    /// Joint positions, radians.
    pub q: Six,
    /// Joint speeds, radians per second.
    pub qd: Six,
    /// Force and torque that the world applies to the tool, newtons and newton metres, base frame.
    pub wrench: Six,
    /// Something that makes the arm stop itself.
    pub protective_stop: Option<String>,
}

/// A body for the emulated arm, called once in each control step. A simulated world can be one.
pub trait Plant: Send {
    /// Moves by one step.
    fn step(&mut self, target: &PlantTarget) -> PlantState;
}

/// Something soft that fills the space behind a plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wall {
    /// A point on its surface, base frame, metres.
    pub point: Point3<f64>,
    /// The way out of it.
    pub normal: UnitVector3<f64>,
    /// Newtons per metre.
    pub stiffness_n_m: f64,
}

/// The built-in plant: joints that follow their targets with a lag of a few milliseconds, and an optional wall.
#[derive(Debug, Clone)]
pub struct JointServo {
    q: Six,
    /// Time constant of following, seconds.
    lag_s: f64,
    wall: Option<Wall>,
    /// Constant reading of the force sensor that no contact makes, newtons, base frame.
    bias_n: Vector3<f64>,
}

impl JointServo {
    /// Joints that stand at `q`.
    pub fn new(q: Six) -> Self {
        Self { q, lag_s: 0.004, wall: None, bias_n: Vector3::zeros() }
    }

    /// With a wall in the way of the tool centre point.
    #[must_use]
    pub fn with_wall(self, wall: Wall) -> Self {
        Self { wall: Some(wall), ..self }
    }

    /// With a force sensor that is off by so much.
    #[must_use]
    pub fn with_force_bias(self, bias_n: Vector3<f64>) -> Self {
        Self { bias_n, ..self }
    }
}

impl Plant for JointServo {
    fn step(&mut self, target: &PlantTarget) -> PlantState {
        let share = 1.0 - (-target.dt_s / self.lag_s).exp();
        let mut qd = [0.0; 6];
        for ((q, qd), target_q) in self.q.iter_mut().zip(&mut qd).zip(&target.q) {
            let way = share * (target_q - *q);
            *qd = way / target.dt_s;
            *q += way;
            // A position filter has no friction: end what has become too little to see.
            if (target_q - *q).abs() < 1e-9 {
                *q = *target_q;
            }
        }
        let pushed = self.wall.map_or(Vector3::zeros(), |wall| {
            let depth = -(target.base_from_tcp * Point3::origin() - wall.point).dot(&wall.normal);
            wall.normal.into_inner() * (depth.max(0.0) * wall.stiffness_n_m)
        });
        let force = pushed + self.bias_n;
        let wrench = [force.x, force.y, force.z, 0.0, 0.0, 0.0];
        PlantState { q: self.q, qd, wrench, protective_stop: None }
    }
}

/// Where an emulated arm stands at first: folded, tool down, in front of the base.
pub(crate) fn home(_model: UrModel) -> Six {
    use std::f64::consts::FRAC_PI_2;
    [0.0, -FRAC_PI_2, FRAC_PI_2, -FRAC_PI_2, -FRAC_PI_2, 0.0]
}
