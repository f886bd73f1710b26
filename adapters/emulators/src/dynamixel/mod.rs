//! A Dynamixel bus: motors of the X330 series at the end of a serial line, protocol 2.0.
//!
//! The time that bytes take on the wire, and each motor's return delay, are simulated. Motors obey their registers as
//! the real ones do: locked registers while torque is on, limits, shutdown on hardware errors until a reboot, the bus
//! watchdog.

mod bus;
mod config;
mod motor;
mod plant;
mod registers;
#[cfg(test)]
mod tests;

use std::io;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use bus::Bus;
pub use config::{BusConfig, MotorConfig};
pub use plant::{KinematicPlant, MotorCommand, MotorState, Obstacles, Plant};

use crate::faults::LinkFaults;
use crate::line::{LineDevice, Reply, SerialLine};

/// A bus of motors that clients open by its path.
#[derive(Debug)]
pub struct BusEmulator {
    line: SerialLine,
    bus: Shared,
}

impl BusEmulator {
    /// Starts a bus whose motors move a plant.
    ///
    /// # Errors
    /// The serial line cannot be made.
    pub fn start(config: BusConfig, plant: impl Plant) -> io::Result<Self> {
        let path = config.path.clone();
        let bus = Shared(Arc::new(Mutex::new(Bus::new(config, Box::new(plant), Instant::now()))));
        let line = SerialLine::start(bus.clone(), path)?;
        Ok(Self { line, bus })
    }

    /// What clients open.
    pub fn path(&self) -> &Path {
        self.line.path()
    }

    /// Faults of the line.
    pub fn faults(&self) -> &LinkFaults {
        self.line.faults()
    }

    /// Gives a motor hardware errors, bits as in register 70; it shuts down as its register 63 says.
    pub fn raise(&self, id: u8, errors: u8) {
        self.bus.lock().raise(id, errors);
    }

    /// Takes a motor off the bus, or puts it back.
    pub fn unplug(&self, id: u8, unplugged: bool) {
        self.bus.lock().unplug(id, unplugged);
    }

    /// Takes a motor's power away for a moment: it is back at once, without torque.
    pub fn power_cycle(&self, id: u8) {
        let mut bus = self.bus.lock();
        bus.unplug(id, true);
        bus.unplug(id, false);
    }

    /// Bytes of a motor's control table, now; `None` for what is not there.
    pub fn register(&self, id: u8, addr: u16, len: u16) -> Option<Vec<u8>> {
        self.bus.lock().peek(id, addr, len, Instant::now())
    }

    /// Packets that were understood so far.
    pub fn packets(&self) -> u64 {
        self.bus.lock().packets()
    }
}

/// The bus as its serial line and its owner share it.
#[derive(Clone)]
struct Shared(Arc<Mutex<Bus>>);

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Bus> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl std::fmt::Debug for Shared {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("bus")
    }
}

impl LineDevice for Shared {
    fn receive(&mut self, bytes: &[u8], now: Instant) -> Vec<Reply> {
        self.lock().receive(bytes, now)
    }
}
