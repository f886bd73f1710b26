//! Sections of the devices and of the planner.

use serde::{Deserialize, Serialize};

use crate::plan::ReachingChoice;

/// `[planner]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PlannerConfig {
    /// Where the server is, for example `http://127.0.0.1:50051`. Unused when `embedded`.
    pub endpoint: String,
    /// Start a server in this process, on a free port, and use that: one command clears a tray.
    pub embedded: bool,
    /// Contact estimator by name; empty: the server's default.
    pub estimator: String,
    /// Candidates that are optimized together (Supplementary Note 7: 48).
    pub batch: u32,
    /// Iterations, of which the last so many also avoid penetration (Supplementary Note 7: 200, 40).
    pub scheme: [u32; 2],
    /// At most so many ranked grasps in an answer.
    pub max_grasps: u32,
    /// Grasps that score less are left out, 0 to 1.
    pub min_score: f64,
    /// Coulomb friction between pads and objects.
    pub friction: f64,
    /// Distance of the pre-grasp from the grasp along the approach, metres.
    pub pregrasp_offset_m: f64,
    /// Reaching direction of the first question for a scene: `top_down`, `camera_ray` or `free`.
    pub reaching: ReachingChoice,
    /// Largest angle between approach and reaching direction, radians; left out: the planner's default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_tilt_rad: Option<f64>,
}

impl Default for PlannerConfig {
    fn default() -> Self {
        Self {
            endpoint: "http://127.0.0.1:50051".to_owned(),
            embedded: true,
            estimator: String::new(),
            batch: 48,
            scheme: [200, 40],
            max_grasps: 10,
            min_score: 0.0,
            friction: 0.5,
            pregrasp_offset_m: 0.10,
            reaching: ReachingChoice::TopDown,
            max_tilt_rad: None,
        }
    }
}

/// `[camera]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CameraConfig {
    /// Which kind of camera, for example `mock`.
    #[serde(alias = "adapter")]
    pub kind: String,
    /// Where it is: what its kind understands, `emulator` for one that is emulated in this process. Mock cameras have none.
    pub address: String,
    /// Oldest frame that is planned from, seconds.
    pub max_age_s: f64,
    /// Where the camera is, for one that does not know: position of the optical frame, metres, world.
    pub position_m: [f64; 3],
    /// Where it looks: a point on its optical axis, metres, world.
    pub looks_at_m: [f64; 3],
    /// Settings of the device, a table for each kind, for example `[camera.settings.mock]`. Only that of `kind` is read.
    pub settings: toml::Table,
}

impl Default for CameraConfig {
    /// Above the tray, a little to the side, so that sides of objects are seen too.
    fn default() -> Self {
        Self {
            kind: "mock".to_owned(),
            address: String::new(),
            max_age_s: 0.5,
            position_m: [0.0, -0.25, 0.75],
            looks_at_m: [0.0, 0.0, 0.02],
            settings: toml::Table::new(),
        }
    }
}

/// `[arm]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ArmConfig {
    /// Which kind of arm, for example `mock` or `ur`.
    #[serde(alias = "adapter")]
    pub kind: String,
    /// Where it is: address or name of its controller, `emulator` for one that is emulated in this process. Mock arms have
    /// none.
    pub address: String,
    /// Motion is allowed. Without it, nothing but a mock arm moves.
    pub armed: bool,
    /// Speed through the air, metres per second.
    pub speed_m_s: f64,
    /// Acceleration, metres per second squared. The mock arm always accelerates with 2 and refuses less.
    pub acceleration_m_s2: f64,
    /// Speed of the straight approach, and of the way back, metres per second.
    pub approach_speed_m_s: f64,
    /// Speed of the lift, metres per second.
    pub lift_speed_m_s: f64,
    /// Speed with an object in the hand, metres per second.
    pub carry_speed_m_s: f64,
    /// Settings of the device, a table for each kind, for example `[arm.settings.ur]`. Only that of `kind` is read.
    pub settings: toml::Table,
}

impl Default for ArmConfig {
    fn default() -> Self {
        Self {
            kind: "mock".to_owned(),
            address: String::new(),
            armed: false,
            speed_m_s: 0.5,
            acceleration_m_s2: 2.0,
            approach_speed_m_s: 0.1,
            lift_speed_m_s: 0.15,
            carry_speed_m_s: 0.25,
            settings: toml::Table::new(),
        }
    }
}

/// `[hand]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HandConfig {
    /// Id of the hand in the planner (`graspd hands list`), for example `leap`.
    pub id: String,
    /// Which kind of hand, for example `mock`, `robotiq-2f`, `robotiq-3f` or `leap`.
    #[serde(alias = "adapter")]
    pub kind: String,
    /// Where it is: a serial port, or `socket://`, `modbus://` or `rtu://` with host and port; `emulator` for one that is
    /// emulated in this process. Mock hands have none.
    pub address: String,
    /// Motion is allowed. Without it, nothing but a mock hand moves.
    pub armed: bool,
    /// Time in which all fingers go from open to where contact is expected, to arrive there together, seconds.
    pub meet_s: f64,
    /// Share of the speed when opening, and when closing from contact on, more than 0, at most 1.
    pub speed: f64,
    /// Share of the force when closing, more than 0, at most 1.
    pub force: f64,
    /// Settings of the device, a table for each kind, for example `[hand.settings.leap]`. Only that of `kind` is read.
    pub settings: toml::Table,
}

impl Default for HandConfig {
    fn default() -> Self {
        Self {
            id: "robotiq-2f85".to_owned(),
            kind: "mock".to_owned(),
            address: String::new(),
            armed: false,
            meet_s: 0.5,
            speed: 0.5,
            force: 0.7,
            settings: toml::Table::new(),
        }
    }
}
