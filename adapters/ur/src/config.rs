//! Settings of an arm, as a table that a configuration file can hold.

use graspd_adapters_core::check::SettingsError;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use serde::{Deserialize, Serialize};

use crate::kinematics::Model;

/// Everything about one arm. Only `host` has no default that works.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct UrConfig {
    /// Name for logs and errors.
    pub name: String,
    /// Address or name of the controller.
    pub host: String,
    /// Model.
    pub model: Model,
    /// True for motion to be allowed at all. Without it state is read and nothing else.
    pub armed: bool,
    /// Ports of the controller.
    pub ports: Ports,
    /// Where the base stands in the world.
    pub world_from_base: BasePose,
    /// How the hand's root link is mounted on the flange: callers' poses are those of the root link.
    pub flange_from_hand: BasePose,
    /// Bounds of every motion.
    pub limits: UrLimits,
    /// How the arm knows that its client lives.
    pub heartbeat: Heartbeat,
    /// What hangs on the flange: hand and cables. Left out: as set on the pendant.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub payload: Option<Payload>,
    /// Frames of state a second; 0: as many as the controller gives (125 or 500).
    pub frequency_hz: f64,
    /// Time for each step of connecting, seconds.
    pub connect_timeout_s: f64,
    /// A link without a frame for so long is taken to be broken, seconds.
    pub silence_s: f64,
    /// First pause before connecting again, seconds; doubled each time.
    pub first_pause_s: f64,
    /// Longest pause before connecting again, seconds.
    pub longest_pause_s: f64,
    /// True when software may unlock protective stops. The manufacturer wants the cause inspected by a person first.
    pub unlock_protective_stop: bool,
    /// True when software may switch power on and release brakes (the arm may sag a little).
    pub power_up: bool,
    /// How close to its goal a motion must end: metres and radians.
    pub arrival: Arrival,
}

/// Ports of the controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Ports {
    /// RTDE.
    pub rtde: u16,
    /// Dashboard server.
    pub dashboard: u16,
    /// Primary interface: takes the control script, tells errors.
    pub primary: u16,
}

impl Default for Ports {
    fn default() -> Self {
        Self { rtde: 30004, dashboard: 29999, primary: 30001 }
    }
}

/// A pose in a configuration file.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BasePose {
    /// Metres.
    pub position_m: [f64; 3],
    /// Unit quaternion x, y, z, w.
    pub orientation: [f64; 4],
}

impl BasePose {
    /// As a pose; the orientation is made a unit quaternion.
    fn isometry(&self) -> Isometry3<f64> {
        let ([x, y, z], [i, j, k, w]) = (self.position_m, self.orientation);
        let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
        Isometry3::from_parts(Translation3::new(x, y, z), turn)
    }
}

impl Default for BasePose {
    fn default() -> Self {
        Self { position_m: [0.0; 3], orientation: [0.0, 0.0, 0.0, 1.0] }
    }
}

/// Bounds of every motion. What is asked beyond them is refused; what a path would need beyond them is slowed down.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct UrLimits {
    /// Largest speed of the flange, metres per second.
    pub speed_m_s: f64,
    /// Largest acceleration of the flange, metres per second squared.
    pub acceleration_m_s2: f64,
    /// Largest angular speed of the flange on lines, radians per second.
    pub turn_rad_s: f64,
    /// Largest speed of any joint, radians per second.
    pub joint_speed_rad_s: f64,
    /// Largest acceleration of any joint, radians per second squared.
    pub joint_acceleration_rad_s2: f64,
    /// Deceleration of a stop, joints, radians per second squared.
    pub stop_rad_s2: f64,
    /// Deceleration of a stop on a line, metres per second squared.
    pub stop_m_s2: f64,
    /// Force at the flange at which any motion stops, newtons.
    pub force_n: f64,
    /// Where the flange may be, world frame.
    pub workspace: Workspace,
}

impl Default for UrLimits {
    fn default() -> Self {
        Self {
            speed_m_s: 0.5,
            acceleration_m_s2: 2.0,
            turn_rad_s: 2.0,
            joint_speed_rad_s: 1.5,
            joint_acceleration_rad_s2: 4.0,
            stop_rad_s2: 6.0,
            stop_m_s2: 3.0,
            force_n: 80.0,
            workspace: Workspace::default(),
        }
    }
}

/// A box, world frame, metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Workspace {
    /// Lowest corner.
    pub lower_m: [f64; 3],
    /// Highest corner.
    pub upper_m: [f64; 3],
}

impl Default for Workspace {
    /// As far as any arm reaches, and not below the base.
    fn default() -> Self {
        Self { lower_m: [-1.5, -1.5, 0.0], upper_m: [1.5, 1.5, 1.8] }
    }
}

impl Workspace {
    /// True when a point is inside.
    pub fn contains(&self, point: &nalgebra::Vector3<f64>) -> bool {
        (0..3).all(|i| point[i] >= self.lower_m[i] && point[i] <= self.upper_m[i])
    }
}

/// How the arm knows that its client lives.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Heartbeat {
    /// Time between beats, seconds.
    pub period_s: f64,
    /// Time without a beat after which the control script stops the arm, seconds.
    pub timeout_s: f64,
    /// Time without a new target after which a stream of targets ends and the arm stops, seconds.
    pub stream_s: f64,
}

impl Default for Heartbeat {
    fn default() -> Self {
        Self { period_s: 0.02, timeout_s: 0.2, stream_s: 0.1 }
    }
}

/// What hangs on the flange.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Payload {
    /// Kilograms.
    pub mass_kg: f64,
    /// Its centre, flange frame, metres.
    pub center_m: [f64; 3],
}

/// How close to its goal a motion must end.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Arrival {
    /// Metres.
    pub position_m: f64,
    /// Radians.
    pub angle_rad: f64,
    /// Time in which an arm settles there, after the controller has called the motion done, seconds.
    pub settle_s: f64,
}

impl Default for Arrival {
    fn default() -> Self {
        Self { position_m: 0.002, angle_rad: 0.02, settle_s: 2.0 }
    }
}

impl Default for UrConfig {
    fn default() -> Self {
        Self {
            name: "arm".into(),
            host: String::new(),
            model: Model::Ur5e,
            armed: false,
            ports: Ports::default(),
            world_from_base: BasePose::default(),
            flange_from_hand: BasePose::default(),
            limits: UrLimits::default(),
            heartbeat: Heartbeat::default(),
            payload: None,
            frequency_hz: 0.0,
            connect_timeout_s: 2.0,
            silence_s: 0.5,
            first_pause_s: 0.1,
            longest_pause_s: 5.0,
            unlock_protective_stop: false,
            power_up: false,
            arrival: Arrival::default(),
        }
    }
}

impl UrConfig {
    /// Refuses what cannot be.
    ///
    /// # Errors
    /// [`SettingsError`].
    pub fn check(&self) -> Result<(), SettingsError> {
        let refuse = |field: &str, found: String, expected: &str| {
            Err(SettingsError { field: field.into(), found, expected: expected.into() })
        };
        if self.host.trim().is_empty() {
            return refuse("host", format!("{:?}", self.host), "the controller's address");
        }
        let (l, h) = (&self.limits, &self.heartbeat);
        // The largest values are those that the controller accepts at all.
        let numbers = [
            ("limits.speed_m_s", l.speed_m_s, 3.0),
            ("limits.acceleration_m_s2", l.acceleration_m_s2, 150.0),
            ("limits.turn_rad_s", l.turn_rad_s, 6.3),
            ("limits.joint_speed_rad_s", l.joint_speed_rad_s, 6.3),
            ("limits.joint_acceleration_rad_s2", l.joint_acceleration_rad_s2, 40.0),
            ("limits.stop_rad_s2", l.stop_rad_s2, 40.0),
            ("limits.stop_m_s2", l.stop_m_s2, 20.0),
            ("limits.force_n", l.force_n, 250.0),
            ("heartbeat.period_s", h.period_s, 0.1),
            ("heartbeat.timeout_s", h.timeout_s, 1.0),
            ("heartbeat.stream_s", h.stream_s, 1.0),
            ("connect_timeout_s", self.connect_timeout_s, 60.0),
            ("silence_s", self.silence_s, 10.0),
            ("first_pause_s", self.first_pause_s, 60.0),
            ("longest_pause_s", self.longest_pause_s, 600.0),
            ("arrival.position_m", self.arrival.position_m, 0.05),
            ("arrival.angle_rad", self.arrival.angle_rad, 0.5),
            ("arrival.settle_s", self.arrival.settle_s, 60.0),
        ];
        for (field, value, most) in numbers {
            if !(value > 0.0 && value <= most) {
                return refuse(field, value.to_string(), &format!("above 0, at most {most}"));
            }
        }
        if h.timeout_s < 3.0 * h.period_s {
            return refuse("heartbeat.timeout_s", h.timeout_s.to_string(), "at least three periods");
        }
        if !(self.frequency_hz == 0.0 || (1.0..=500.0).contains(&self.frequency_hz)) {
            return refuse("frequency_hz", self.frequency_hz.to_string(), "0, or 1 to 500");
        }
        let w = &l.workspace;
        if !(0..3).all(|i| w.lower_m[i] < w.upper_m[i] && (w.upper_m[i] - w.lower_m[i]).is_finite()) {
            return refuse("limits.workspace", format!("{w:?}"), "lower_m below upper_m, finite");
        }
        if let Some(p) = &self.payload
            && !(p.mass_kg >= 0.0 && p.mass_kg <= 50.0 && p.center_m.iter().all(|v| v.abs() < 2.0))
        {
            return refuse("payload", format!("{p:?}"), "0 to 50 kg within 2 m");
        }
        for (field, pose) in
            [("world_from_base", &self.world_from_base), ("flange_from_hand", &self.flange_from_hand)]
        {
            let norm = pose.orientation.iter().map(|v| v * v).sum::<f64>().sqrt();
            // Written so that NaN is refused.
            let near_one = (norm - 1.0).abs() < 1e-3;
            if !(near_one && pose.position_m.iter().all(|v| v.abs() <= 100.0)) {
                return refuse(field, format!("{pose:?}"), "finite, orientation a unit quaternion");
            }
        }
        Ok(())
    }

    /// Pose of the base in the world.
    pub fn world_from_base(&self) -> Isometry3<f64> {
        self.world_from_base.isometry()
    }

    /// How the hand's root link is mounted on the flange.
    pub fn flange_from_hand(&self) -> Isometry3<f64> {
        self.flange_from_hand.isometry()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_example_shows_the_defaults() {
        let example: UrConfig = toml::from_str(include_str!("../examples/ur5e.toml")).unwrap();
        example.check().unwrap();
        assert!(!example.armed && !example.unlock_protective_stop && !example.power_up);
        let expected =
            UrConfig { host: example.host.clone(), payload: example.payload, ..UrConfig::default() };
        assert_eq!(example, expected);
        let written = toml::to_string(&example).unwrap();
        assert_eq!(toml::from_str::<UrConfig>(&written).unwrap(), example);
    }

    #[test]
    fn what_cannot_be_is_refused_by_its_field() {
        for (text, expected) in [
            ("", "host: found \"\", expected the controller's address"),
            (
                "host = 'h'\n[limits]\nspeed_m_s = 9.0",
                "limits.speed_m_s: found 9, expected above 0, at most 3",
            ),
            ("host = 'h'\n[limits]\nforce_n = nan", "limits.force_n: found NaN"),
            ("host = 'h'\n[heartbeat]\nperiod_s = 0.1", "heartbeat.timeout_s: found 0.2, expected at least"),
            ("host = 'h'\n[limits.workspace]\nlower_m = [2.0, 0.0, 0.0]", "limits.workspace: found"),
            ("host = 'h'\nfrequency_hz = 1000.0", "frequency_hz: found 1000"),
            ("host = 'h'\n[world_from_base]\norientation = [0.0, 0.0, 0.0, 2.0]", "world_from_base: found"),
            ("host = 'h'\n[payload]\nmass_kg = -1.0\ncenter_m = [0.0, 0.0, 0.0]", "payload: found"),
        ] {
            let error = toml::from_str::<UrConfig>(text).unwrap().check().unwrap_err().to_string();
            assert!(error.starts_with(expected), "{error}");
        }
        let unknown = toml::from_str::<UrConfig>("host = 'h'\nspeed = 1").unwrap_err();
        assert!(unknown.to_string().contains("unknown field `speed`"), "{unknown}");
    }
}
