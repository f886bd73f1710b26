//! Kinematics of the arms: forward, Jacobian, and analytic inverse with up to eight branches.

mod branch;
mod forward;
mod inverse;
mod model;

pub use branch::{JointLimits, joint_distance};
pub use inverse::{Branch, Solution};
pub use model::{Dh, Model};

/// Joint positions from base to wrist 3, radians.
pub type Joints = [f64; 6];

/// An arm's nominal kinematics. All poses are of the flange in the base frame as the controller defines it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Kinematics {
    dh: Dh,
    limits: JointLimits,
}

impl Kinematics {
    /// Those of a model, with joints limited to two turns as they are when delivered.
    pub fn new(model: Model) -> Self {
        Self { dh: model.dh(), limits: JointLimits::default() }
    }

    /// With other limits.
    #[must_use]
    pub fn with_limits(self, limits: JointLimits) -> Self {
        Self { limits, ..self }
    }

    /// The limits of the joints.
    pub fn limits(&self) -> &JointLimits {
        &self.limits
    }

    /// The geometry.
    pub fn dh(&self) -> &Dh {
        &self.dh
    }
}
