//! What is emulated, and where it listens.

use std::net::{IpAddr, Ipv4Addr};

use serde::{Deserialize, Serialize};

use super::geometry::{Six, UrModel};

/// Ports of the controller; 0 takes a free one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct UrPorts {
    /// Dashboard.
    pub dashboard: u16,
    /// Primary interface: state, messages, scripts.
    pub primary: u16,
    /// Secondary interface: state, scripts.
    pub secondary: u16,
    /// Real-time interface: a fixed block of state, scripts.
    pub realtime: u16,
    /// RTDE.
    pub rtde: u16,
}

impl Default for UrPorts {
    /// Those of a controller.
    fn default() -> Self {
        Self { dashboard: 29999, primary: 30001, secondary: 30002, realtime: 30003, rtde: 30004 }
    }
}

impl UrPorts {
    /// Free ones.
    pub const FREE: Self = Self { dashboard: 0, primary: 0, secondary: 0, realtime: 0, rtde: 0 };
}

/// Settings of an emulated arm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct UrSettings {
    /// Which arm.
    pub model: UrModel,
    /// Address to listen on.
    pub address: IpAddr,
    /// Ports to listen on.
    pub ports: UrPorts,
    /// Version of the controller's software: major, minor, bugfix, build.
    pub version: [u32; 4],
    /// True when it may be controlled over the network.
    pub remote_control: bool,
    /// True when powered and brakes released from the start.
    pub powered: bool,
    /// Time that a change of power or brakes takes, seconds.
    pub mode_change_s: f64,
    /// Time before a protective stop can be unlocked, seconds; 5 on a real one.
    pub unlock_wait_s: f64,
    /// Force at the tool that makes it stop itself, newtons.
    pub stop_force_n: f64,
    /// Where the joints stand at first; left out: folded in front of the base, tool down.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub joints: Option<Six>,
}

impl Default for UrSettings {
    fn default() -> Self {
        Self {
            model: UrModel::Ur5e,
            address: IpAddr::V4(Ipv4Addr::LOCALHOST),
            ports: UrPorts::default(),
            version: [5, 17, 3, 123_456],
            remote_control: true,
            powered: true,
            mode_change_s: 0.3,
            unlock_wait_s: 5.0,
            stop_force_n: 150.0,
            joints: None,
        }
    }
}

impl UrSettings {
    /// Those of a model, with software of its series.
    pub fn of(model: UrModel) -> Self {
        let version = if model.is_cb3() { [3, 15, 8, 106_339] } else { Self::default().version };
        Self { model, version, ..Self::default() }
    }
}
