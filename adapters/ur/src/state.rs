//! What the controller reports: modes by name, and one frame of state.

use graspd_adapters_core::FaultKind;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use crate::kinematics::Joints;
use crate::rtde::{RtdeError, Value};

/// Mode of the robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)] // The controller's own names.
pub enum RobotMode {
    NoController,
    Disconnected,
    ConfirmSafety,
    Booting,
    PowerOff,
    PowerOn,
    Idle,
    Backdrive,
    Running,
    UpdatingFirmware,
    /// A number that is not known here.
    Other(i32),
}

impl RobotMode {
    /// From the number of RTDE.
    pub fn from_number(number: i32) -> Self {
        match number {
            -1 => Self::NoController,
            0 => Self::Disconnected,
            1 => Self::ConfirmSafety,
            2 => Self::Booting,
            3 => Self::PowerOff,
            4 => Self::PowerOn,
            5 => Self::Idle,
            6 => Self::Backdrive,
            7 => Self::Running,
            8 => Self::UpdatingFirmware,
            other => Self::Other(other),
        }
    }
}

/// State of the safety system.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)] // The controller's own names.
pub enum SafetyStatus {
    Normal,
    Reduced,
    ProtectiveStop,
    Recovery,
    SafeguardStop,
    SystemEmergencyStop,
    RobotEmergencyStop,
    Violation,
    Fault,
    ValidateJointId,
    Undefined,
    AutomaticModeSafeguardStop,
    ThreePositionEnablingStop,
    /// A number that is not known here.
    Other(i32),
}

impl SafetyStatus {
    /// From the number of RTDE.
    pub fn from_number(number: i32) -> Self {
        match number {
            1 => Self::Normal,
            2 => Self::Reduced,
            3 => Self::ProtectiveStop,
            4 => Self::Recovery,
            5 => Self::SafeguardStop,
            6 => Self::SystemEmergencyStop,
            7 => Self::RobotEmergencyStop,
            8 => Self::Violation,
            9 => Self::Fault,
            10 => Self::ValidateJointId,
            11 => Self::Undefined,
            12 => Self::AutomaticModeSafeguardStop,
            13 => Self::ThreePositionEnablingStop,
            other => Self::Other(other),
        }
    }

    /// True when the arm may move.
    pub fn allows_motion(self) -> bool {
        matches!(self, Self::Normal | Self::Reduced)
    }

    /// The kind of stop that it is; `None` when it is none.
    pub fn fault(self) -> Option<FaultKind> {
        match self {
            Self::Normal | Self::Reduced => None,
            Self::ProtectiveStop => Some(FaultKind::ProtectiveStop),
            Self::SystemEmergencyStop | Self::RobotEmergencyStop => Some(FaultKind::EmergencyStop),
            _ => Some(FaultKind::Other),
        }
    }
}

/// One frame of state.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotState {
    /// Time since the controller started, seconds.
    pub timestamp_s: f64,
    /// Joint positions, radians.
    pub joints: Joints,
    /// Joint speeds, radians per second.
    pub joint_speeds: Joints,
    /// Pose of the active tool centre point, base frame.
    pub base_from_tcp: Isometry3<f64>,
    /// Pose of the tool centre point on the flange; `None` where the software does not tell.
    pub flange_from_tcp: Option<Isometry3<f64>>,
    /// Force and torque at the tool centre point, base frame, newtons and newton metres.
    pub wrench: [f64; 6],
    /// Mode.
    pub robot_mode: RobotMode,
    /// Safety.
    pub safety: SafetyStatus,
    /// True while a program runs.
    pub program_running: bool,
    /// Share of the speed that the controller allows now.
    pub speed_scaling: f64,
    /// Registers that the control script writes.
    pub(crate) mailbox: Mailbox,
}

/// What the control script reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Mailbox {
    /// 0 no script, 1 ready, 2 busy.
    pub(crate) state: i32,
    pub(crate) accepted: i32,
    pub(crate) result: i32,
    pub(crate) done: i32,
    pub(crate) token: i32,
    /// Why the script ended: 0 it did not, 1 heartbeat, 2 asked.
    pub(crate) ended: i32,
}

/// Joints that are slower than this stand, radians per second.
const STANDING: f64 = 0.01;

impl RobotState {
    /// Fields of the recipe, in order. The last one is left out where the software does not know it.
    pub(crate) const FIELDS: [&'static str; 17] = [
        "timestamp",
        "actual_q",
        "actual_qd",
        "actual_TCP_pose",
        "actual_TCP_force",
        "robot_mode",
        "safety_mode",
        "runtime_state",
        "robot_status_bits",
        "speed_scaling",
        "output_int_register_24",
        "output_int_register_25",
        "output_int_register_26",
        "output_int_register_27",
        "output_int_register_28",
        "output_int_register_29",
        "tcp_offset",
    ];

    /// From values of those fields.
    pub(crate) fn from_values(values: &[Value]) -> Result<Self, RtdeError> {
        let wrong = |at: usize, expected: &str| RtdeError::Malformed {
            field: Self::FIELDS.get(at).copied().unwrap_or("data").to_owned(),
            found: format!("{:?}", values.get(at)),
            expected: expected.to_owned(),
        };
        let six = |at: usize| {
            let value = values.get(at).and_then(Value::vector6).filter(|v| v.iter().all(|v| v.is_finite()));
            value.ok_or_else(|| wrong(at, "six finite numbers"))
        };
        let double = |at: usize| values.get(at).and_then(Value::double).ok_or_else(|| wrong(at, "a number"));
        let integer = |at: usize| {
            values.get(at).and_then(Value::integer).map(|v| v as i32).ok_or_else(|| wrong(at, "an integer"))
        };
        let running = integer(8)? & 2 != 0 || integer(7)? == 2;
        Ok(Self {
            timestamp_s: double(0)?,
            joints: six(1)?,
            joint_speeds: six(2)?,
            base_from_tcp: pose_from(&six(3)?),
            flange_from_tcp: values.get(16).map(|_| six(16).map(|p| pose_from(&p))).transpose()?,
            wrench: six(4)?,
            robot_mode: RobotMode::from_number(integer(5)?),
            safety: SafetyStatus::from_number(integer(6)?),
            program_running: running,
            speed_scaling: double(9)?,
            mailbox: Mailbox {
                state: integer(10)?,
                accepted: integer(11)?,
                result: integer(12)?,
                done: integer(13)?,
                token: integer(14)?,
                ended: integer(15)?,
            },
        })
    }

    /// True when no joint moves.
    pub fn is_standing(&self) -> bool {
        self.joint_speeds.iter().all(|v| v.abs() < STANDING)
    }

    /// True when the arm can be moved now.
    pub fn can_move(&self) -> bool {
        self.robot_mode == RobotMode::Running && self.safety.allows_motion()
    }
}

/// A pose from position and rotation vector.
pub fn pose_from(six: &[f64; 6]) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(six[3], six[4], six[5]));
    Isometry3::from_parts(Translation3::new(six[0], six[1], six[2]), turn)
}

/// Position and rotation vector (of at most half a turn) of a pose.
pub fn pose_to(pose: &Isometry3<f64>) -> [f64; 6] {
    let (t, r) = (pose.translation.vector, pose.rotation.scaled_axis());
    [t.x, t.y, t.z, r.x, r.y, r.z]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn rotation_vectors_come_back(axis in prop::array::uniform3(-1.0..1.0f64), angle in -3.1..3.1f64) {
            let axis = Vector3::from(axis);
            prop_assume!(axis.norm() > 1e-3);
            let vector = axis.normalize() * angle;
            let pose = pose_from(&[0.1, 0.2, 0.3, vector.x, vector.y, vector.z]);
            let back = pose_to(&pose);
            prop_assert!((pose_from(&back).rotation.angle_to(&pose.rotation)) < 1e-9);
            prop_assert!((Vector3::new(back[3], back[4], back[5]) - vector).norm() < 1e-9);
        }
    }

    #[test]
    fn a_frame_with_numbers_that_are_none_is_refused_by_its_field() {
        let mut values = vec![Value::Double(0.0)];
        values.extend([Value::Vector6d([0.0; 6]); 4]);
        values.extend([Value::Int32(7), Value::Int32(1), Value::Uint32(2), Value::Uint32(3)]);
        values.push(Value::Double(1.0));
        values.extend([Value::Int32(0); 6]);
        let state = RobotState::from_values(&values).unwrap();
        assert!(state.can_move() && state.is_standing() && state.flange_from_tcp.is_none());
        values[1] = Value::Vector6d([f64::NAN; 6]);
        let error = RobotState::from_values(&values).unwrap_err().to_string();
        assert!(error.contains("actual_q: found") && error.contains("six finite numbers"), "{error}");
    }
}
