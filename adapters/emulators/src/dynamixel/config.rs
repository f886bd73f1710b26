//! What is on a bus.

use std::path::PathBuf;
use std::time::Duration;

use graspd_adapters_dynamixel::table::{XC330_M288, XL330_M288};

/// A motor on a bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MotorConfig {
    /// Address.
    pub id: u8,
    /// Model number: it sets initial values.
    pub model: u16,
}

/// A bus.
#[derive(Debug, Clone, PartialEq)]
pub struct BusConfig {
    /// Motors.
    pub motors: Vec<MotorConfig>,
    /// Baud rate that is simulated: ten bits a byte. The line itself is as fast as the machine.
    pub baud: u32,
    /// What the adapter between host and bus adds to each exchange (a USB converter's latency timer).
    pub latency: Duration,
    /// False for firmware that does not know fast sync read.
    pub fast_sync_read: bool,
    /// How long a motor is away when it reboots.
    pub reboot: Duration,
    /// Value of the return delay register at power-up, 2 microseconds each.
    pub return_delay: u8,
    /// Where clients find the line; left out: a path of its own.
    pub path: Option<PathBuf>,
}

impl BusConfig {
    /// Sixteen motors, addresses 0 to 15, as in a LEAP Hand; `full` for the one with XC330 motors, else XL330.
    pub fn leap(full: bool) -> Self {
        let model = if full { XC330_M288 } else { XL330_M288 };
        Self {
            motors: (0..16).map(|id| MotorConfig { id, model }).collect(),
            baud: 4_000_000,
            latency: Duration::ZERO,
            fast_sync_read: true,
            reboot: Duration::from_millis(200),
            return_delay: 250,
            path: None,
        }
    }
}
