//! The way between a caller and a mock device: latency, refused connections, no answer.

use std::time::Duration;

use graspd_adapters_core::DeviceError;

use crate::fault_handle::FaultHandle;
use crate::shared::{SharedWorld, ended};

/// Seconds that a refused call takes.
const REFUSAL_S: f64 = 0.1;

/// A device's name, world and faults.
#[derive(Debug)]
pub(crate) struct Link {
    pub(crate) device: String,
    pub(crate) shared: SharedWorld,
    pub(crate) faults: FaultHandle,
}

/// One call: what is asked, and until when it may take.
#[derive(Debug, Clone)]
pub(crate) struct Call {
    pub(crate) device: String,
    pub(crate) operation: &'static str,
    pub(crate) timeout: Duration,
    pub(crate) until_s: f64,
}

impl Call {
    pub(crate) fn timed_out(&self) -> DeviceError {
        DeviceError::Timeout { device: self.device.clone(), operation: self.operation, after: self.timeout }
    }
}

impl Link {
    /// A call that begins now.
    pub(crate) fn call(&self, operation: &'static str, timeout: Duration) -> Call {
        let until_s = self.shared.deadline_s(timeout);
        Call { device: self.device.clone(), operation, timeout, until_s }
    }

    /// Goes to the device; `latency` where it is the link's and not the device's own.
    ///
    /// # Errors
    /// `Disconnected` when the connection is refused, `Timeout` when the device does not answer.
    pub(crate) async fn reach(&self, call: &Call, latency: bool) -> Result<(), DeviceError> {
        let now_s = self.shared.time_s();
        if self.faults.refuses() {
            self.sleep_until((now_s + REFUSAL_S).min(call.until_s)).await?;
            return Err(DeviceError::Disconnected {
                device: self.device.clone(),
                detail: "connection refused".into(),
            });
        }
        if self.faults.is_silent() {
            self.sleep_until(call.until_s).await?;
            return Err(call.timed_out());
        }
        let arrives_s = now_s + if latency { self.faults.call_latency_s() } else { 0.0 };
        if arrives_s > call.until_s {
            self.sleep_until(call.until_s).await?;
            return Err(call.timed_out());
        }
        self.sleep_until(arrives_s).await
    }

    /// Brings an answer back, unless it is lost on its way.
    ///
    /// # Errors
    /// The answer's own; `Timeout` when the device has fallen silent meanwhile.
    pub(crate) async fn back<R>(
        &self,
        call: &Call,
        answer: Result<R, DeviceError>,
    ) -> Result<R, DeviceError> {
        if self.faults.loses_answers() {
            self.sleep_until(call.until_s).await?;
            return Err(call.timed_out());
        }
        answer
    }

    pub(crate) fn ended(&self) -> DeviceError {
        ended(&self.device)
    }

    async fn sleep_until(&self, until_s: f64) -> Result<(), DeviceError> {
        self.shared.wait_until(until_s).await.map_err(|_| self.ended())
    }
}
