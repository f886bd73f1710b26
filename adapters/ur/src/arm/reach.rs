//! Which motions would be refused, known before anything moves.

use graspd_adapters_core::{DeviceError, Leg, Reach};

use super::UrArm;
use crate::plan::{joint_motion, line_motion};
use crate::state::RobotState;

impl UrArm {
    /// Plans each motion from where the one before leaves the arm, as [`graspd_adapters_core::Arm::move_to`] and its like
    /// will: by the same functions, so that what is refused here would be refused there.
    pub(super) fn reach_from(&self, state: &RobotState, way: &[Leg]) -> Reach {
        let (mut joints, mut flange) = (state.joints, self.flange(state));
        for (leg, asked) in way.iter().enumerate() {
            let planned = (|| -> Result<_, DeviceError> {
                let allowed = self.check_limits(asked.limits)?;
                let goal = self.in_base(&asked.world_from_flange)?;
                let (arm, base) = (&self.kinematics, &self.world_from_base);
                let motion = if asked.straight {
                    line_motion(arm, base, (&flange, &joints), &goal, allowed)
                } else {
                    joint_motion(arm, base, &joints, &goal, allowed)
                };
                motion.map(|(joints, _)| (joints, goal)).map_err(|r| self.refused(r))
            })();
            match planned {
                Ok(at) => (joints, flange) = at,
                Err(error) => return Reach::Beyond { leg, why: error.to_string() },
            }
        }
        Reach::Reaches
    }
}
