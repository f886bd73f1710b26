//! A gripper that servers share.

use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::gripper::Machine;
use super::plant::Plant;
use super::rtu::RtuSlave;
use super::socket;
use super::tcp::{self, Server};
use crate::line::{LineDevice, SerialLine};

/// Which gripper.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Model {
    /// 2F-85 or 2F-140: one motor.
    TwoFinger,
    /// 3-Finger: fingers A, B, C and scissor.
    ThreeFinger,
}

/// How a gripper is set.
#[derive(Debug, Clone, PartialEq)]
pub struct GripperConfig {
    /// Which gripper.
    pub model: Model,
    /// Modbus address.
    pub slave: u8,
    /// Time from a write until the gripper has taken it: until then it echoes and reports what was before.
    pub takes: Duration,
    /// Time of a change of mode of a 3-Finger.
    pub mode_change: Duration,
}

impl GripperConfig {
    /// A gripper as it is delivered.
    pub fn new(model: Model) -> Self {
        Self { model, slave: 9, takes: Duration::from_millis(2), mode_change: Duration::from_millis(800) }
    }
}

/// A gripper; clones are handles to the same one.
#[derive(Debug, Clone)]
pub struct Gripper(Arc<Mutex<Machine>>);

impl Gripper {
    /// A gripper that has power and is not activated.
    pub fn new(config: GripperConfig, plant: impl Plant) -> Self {
        Self(Arc::new(Mutex::new(Machine::new(config, Box::new(plant), Instant::now()))))
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, Machine> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The gripper as what is at the end of a serial line of Modbus RTU, for lines that somebody else serves.
    pub fn rtu_device(&self) -> impl LineDevice {
        super::rtu::RtuSlave::new(self.clone())
    }

    /// Gives the gripper a fault by its code; 0 takes it away. Codes from 0x0A on (0x0D for a 3-Finger) stop it until it is
    /// activated again.
    pub fn fault(&self, code: u8) {
        self.lock().set_fault(code);
    }

    /// Lets the wrist socket say `?`, as during an emergency stop of the arm, or when the gripper has no power.
    pub fn out_of_reach(&self, away: bool) {
        self.lock().away = away;
    }

    /// Takes its power away and gives it back: it is not activated any more.
    pub fn power_cycle(&self) {
        self.lock().power_cycle();
    }

    /// Its sixteen status bytes, now.
    pub fn status(&self) -> [u8; 16] {
        self.lock().inputs(Instant::now())
    }

    /// Writes all request bytes, as another master on the line would.
    pub fn overwrite(&self, request: [u8; 16]) {
        self.lock().write(0, &request, Instant::now());
    }

    /// Its sixteen request bytes, as written last.
    pub fn request(&self) -> [u8; 16] {
        self.lock().outputs()
    }

    /// Serves Modbus RTU on a new serial line; without a path, at one of its own.
    ///
    /// # Errors
    /// The serial line cannot be made.
    pub fn serve_rtu(&self, path: Option<PathBuf>) -> io::Result<SerialLine> {
        SerialLine::start(RtuSlave::new(self.clone()), path)
    }

    /// Serves Modbus TCP. Within a tokio runtime.
    ///
    /// # Errors
    /// The address cannot be listened on.
    pub async fn serve_modbus_tcp(&self, address: SocketAddr) -> io::Result<Server> {
        let gripper = self.clone();
        tcp::serve(address, move || tcp::ModbusTcp::new(gripper.clone())).await
    }

    /// Serves Modbus RTU frames over TCP, as the tool port of a robot arm does. Within a tokio runtime.
    ///
    /// # Errors
    /// The address cannot be listened on.
    pub async fn serve_rtu_over_tcp(&self, address: SocketAddr) -> io::Result<Server> {
        let gripper = self.clone();
        tcp::serve(address, move || RtuSlave::new(gripper.clone())).await
    }

    /// Serves the text protocol of the wrist socket. Within a tokio runtime.
    ///
    /// # Errors
    /// The address cannot be listened on.
    pub async fn serve_socket(&self, address: SocketAddr) -> io::Result<Server> {
        let gripper = self.clone();
        tcp::serve(address, move || socket::Talk::new(gripper.clone())).await
    }
}
