//! What every port of the emulated controller has at hand.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::{mpsc, watch};

use super::robot::Robot;
use super::settings::UrSettings;
use crate::faults::LinkFaults;

/// Shared by the connections of one port.
#[derive(Clone)]
pub(crate) struct Port {
    pub(crate) robot: Arc<Mutex<Robot>>,
    pub(crate) settings: Arc<UrSettings>,
    pub(crate) faults: LinkFaults,
    /// Counts control steps.
    pub(crate) steps: watch::Receiver<u64>,
    pub(crate) scripts: mpsc::UnboundedSender<String>,
}

impl Port {
    pub(crate) fn robot(&self) -> MutexGuard<'_, Robot> {
        self.robot.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn upload(&self, program: String) {
        // The controller is gone: so is this connection, soon.
        let _gone = self.scripts.send(program);
    }
}
