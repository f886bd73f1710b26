//! What people are told about the joints of a hand.

/// A joint and its motor, as measured.
#[derive(Debug, Clone, PartialEq)]
pub struct JointReport {
    /// Name of the actuator.
    pub actuator: String,
    /// Address of the motor.
    pub id: u8,
    /// Angle, radians.
    pub position_rad: f64,
    /// Speed, radians per second.
    pub velocity_rad_s: f64,
    /// Current, milliamperes, positive where it closes.
    pub current_ma: f64,
    /// Temperature, degrees Celsius.
    pub temperature_c: f64,
    /// Supply, volts.
    pub voltage_v: f64,
    /// Hardware errors by name; empty for a healthy motor.
    pub errors: Vec<String>,
}
