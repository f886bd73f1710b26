//! What people are told about a hand: joints, and what a check found.

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

/// One thing that was checked.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// What was looked at, for example `motor 7 (middle_dip)`.
    pub subject: String,
    /// True when it is as it should be.
    pub ok: bool,
    /// What was found.
    pub found: String,
    /// What to do about it; empty when it is as it should be.
    pub advice: String,
}

impl Finding {
    pub(crate) fn good(subject: impl Into<String>, found: impl Into<String>) -> Self {
        Self { subject: subject.into(), ok: true, found: found.into(), advice: String::new() }
    }

    pub(crate) fn bad(
        subject: impl Into<String>,
        found: impl Into<String>,
        advice: impl Into<String>,
    ) -> Self {
        Self { subject: subject.into(), ok: false, found: found.into(), advice: advice.into() }
    }
}
