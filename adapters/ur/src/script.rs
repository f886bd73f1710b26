//! The control script that is uploaded to the controller, and the mailbox of registers through which it is told what
//! to do.
//!
//! Registers are of the range 24 to 47, which the manufacturer leaves to RTDE clients.
//!
//! | input | | output | |
//! |---|---|---|---|
//! | int 24 | number of the command; a new number is a new command | int 24 | 1 ready, 2 busy |
//! | int 25 | kind of the command | int 25 | number of the command taken last |
//! | int 26 | heartbeat: must change | int 26 | result of the command done last |
//! | int 27 | counts targets of a stream | int 27 | number of the command done last |
//! | double 24-29 | target: joints or pose | int 28 | token: which upload this is |
//! | double 30-35 | joints near the target | int 29 | why it ended: 1 no heartbeat, 2 asked to |
//! | double 36-41 | speed, acceleration, time, force, look-ahead, gain | | |
//!
//! Forces count from what the sensor says when a motion begins, since sensors drift; no more than `limits.force_n` is
//! taken for drift, so that motions that begin pressed do not add up; those may go on while the force gets less. A guarded motion that met something goes back to
//! where it was when it felt that: braking takes it on by some millimetres, and it does not stay pressed by them.
//!
//! The tool centre point is set to the flange while the script runs, so that speeds on lines are those of the flange,
//! and put back when it ends in order.
//!
//! What `servoj` is given in a stream is not the target but a point on the way to it (`g_toward`), step by step. The way is
//! straight in joint space; it is gone no faster than joints and flange may be, no faster than lets them brake before its end
//! with `g_braking` of their accelerations, and in curves no faster than costs half the flange's acceleration. Then the
//! change of all joints' speeds since the step before is cut down, by one share for all, until no joint changes its speed faster than
//! `limits.joint_acceleration_rad_s2`, nor the flange its own, as seen by forward kinematics from step to step, faster than
//! the caller allows. What is kept of the reserve lets an arm that is on its way elsewhere turn round.

use std::fmt::Write;

use crate::config::UrConfig;
use crate::program::{BODY, LOOP};
use crate::rtde::Value;

/// Fields of the heartbeat.
pub(crate) const BEAT_FIELDS: [&str; 1] = ["input_int_register_26"];
/// Fields of a command.
pub(crate) const COMMAND_FIELDS: [&str; 20] = [
    "input_double_register_24",
    "input_double_register_25",
    "input_double_register_26",
    "input_double_register_27",
    "input_double_register_28",
    "input_double_register_29",
    "input_double_register_30",
    "input_double_register_31",
    "input_double_register_32",
    "input_double_register_33",
    "input_double_register_34",
    "input_double_register_35",
    "input_double_register_36",
    "input_double_register_37",
    "input_double_register_38",
    "input_double_register_39",
    "input_double_register_40",
    "input_double_register_41",
    "input_int_register_25",
    "input_int_register_24",
];
/// Fields of a target of a stream.
pub(crate) const STREAM_FIELDS: [&str; 7] = [
    "input_double_register_24",
    "input_double_register_25",
    "input_double_register_26",
    "input_double_register_27",
    "input_double_register_28",
    "input_double_register_29",
    "input_int_register_27",
];

/// What the script can be told to do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum CommandKind {
    /// Joints to joints.
    Joints = 1,
    /// Joints to a pose, by the controller's own (calibrated) inverse kinematics.
    Pose = 2,
    /// A straight line to a pose.
    Line = 3,
    /// A straight line to a pose or to a force.
    Contact = 4,
    /// A stream of joints.
    ServoJoints = 5,
    /// A stream of poses.
    ServoPose = 6,
    /// Brake.
    Stop = 9,
    /// End the script.
    End = 99,
}

/// Results of commands.
pub(crate) mod result {
    pub(crate) const GOAL: i32 = 1;
    pub(crate) const CONTACT: i32 = 2;
    pub(crate) const STOPPED: i32 = 3;
    pub(crate) const STALE: i32 = 4;
    pub(crate) const FORCE: i32 = 6;
}

/// A command with its numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Command {
    pub(crate) kind: CommandKind,
    pub(crate) target: [f64; 6],
    pub(crate) near: [f64; 6],
    pub(crate) speed: f64,
    pub(crate) acceleration: f64,
    pub(crate) time_s: f64,
    pub(crate) force_n: f64,
    pub(crate) lookahead_s: f64,
    pub(crate) gain: f64,
}

impl Command {
    pub(crate) fn new(kind: CommandKind) -> Self {
        Self {
            kind,
            target: [0.0; 6],
            near: [0.0; 6],
            speed: 0.0,
            acceleration: 0.0,
            time_s: 0.0,
            force_n: 0.0,
            lookahead_s: 0.1,
            gain: 300.0,
        }
    }

    /// Values of [`COMMAND_FIELDS`].
    pub(crate) fn values(&self, number: i32) -> Vec<Value> {
        let rest = [self.speed, self.acceleration, self.time_s, self.force_n, self.lookahead_s, self.gain];
        let doubles = self.target.iter().chain(&self.near).chain(&rest);
        let mut values: Vec<Value> = doubles.map(|v| Value::Double(*v)).collect();
        values.extend([Value::Int32(self.kind as i32), Value::Int32(number)]);
        values
    }
}

/// The script's text.
pub(crate) fn control_script(config: &UrConfig, token: i32) -> String {
    let step_s = if config.model.is_e_series() { 0.002 } else { 0.008 };
    let steps = |time_s: f64| (time_s / step_s).ceil() as i64;
    let (limits, heartbeat) = (&config.limits, &config.heartbeat);
    let mut text = String::with_capacity(6000);
    text.push_str("def graspd_control():\n");
    // Writing to a String does not fail.
    let _ = writeln!(text, "  global g_stop_joint = {:e}", limits.stop_rad_s2);
    let _ = writeln!(text, "  global g_stop_line = {:e}", limits.stop_m_s2);
    let _ = writeln!(text, "  global g_missed_most = {}", steps(heartbeat.timeout_s));
    let _ = writeln!(text, "  global g_stale_most = {}", steps(heartbeat.stream_s));
    let _ = writeln!(text, "  global g_rest_most = {:e}", limits.force_n);
    let _ = writeln!(text, "  global g_joint_speed = {:e}", limits.joint_speed_rad_s);
    let _ = writeln!(text, "  global g_joint_acceleration = {:e}", limits.joint_acceleration_rad_s2);
    text.push_str(BODY);
    if let Some(payload) = &config.payload {
        let [x, y, z] = payload.center_m;
        let _ = writeln!(text, "  set_payload({:e}, [{x:e}, {y:e}, {z:e}])", payload.mass_kg);
    }
    let _ = writeln!(text, "  write_output_integer_register(28, {token})");
    text.push_str(LOOP);
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_script_has_the_configured_bounds_and_blocks_that_close() {
        let config = UrConfig { host: "h".into(), ..UrConfig::default() };
        let text = control_script(&config, 77);
        assert!(text.contains("g_stop_joint = 6e0") && text.contains("g_missed_most = 100"), "{text}");
        assert!(text.contains("write_output_integer_register(28, 77)"));
        assert!(
            text.contains("g_joint_speed = 1.5e0") && text.contains("g_joint_acceleration = 4e0"),
            "{text}"
        );
        let words = |word: &str| text.split_whitespace().filter(|w| *w == word).count();
        let opened = words("def") + words("thread") + words("if") + words("while");
        assert_eq!(opened, words("end"));
        assert!(text.is_ascii() && !text.contains("NaN") && !text.contains("inf,"));
        assert_eq!(Command::new(CommandKind::Stop).values(5).len(), COMMAND_FIELDS.len());
    }
}
