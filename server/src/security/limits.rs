//! How much there may be of everything, for all callers together and for each.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crate::error::ServiceError;

/// Limits of a server. Defaults are for a robot cell on one machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Connections at the same time. Default 1024.
    pub connections: usize,
    /// Connections at the same time from one address; loopback is not limited by this. Default 128.
    pub connections_per_address: usize,
    /// Time for the TLS handshake, and then for the first bytes of HTTP/2. Default 5 s.
    pub handshake: Duration,
    /// Time for a request to arrive whole, from its headers. Default 60 s.
    pub receive: Duration,
    /// Headers of a request, bytes. Default 16 KiB.
    pub header_bytes: u32,
    /// Calls of one caller at the same time. Default 256.
    pub calls_per_caller: usize,
    /// Bytes of requests of one caller that are held at the same time. Default 512 MiB.
    pub bytes_per_caller: u64,
    /// Hands that one caller may send in a minute. Default 60.
    pub uploads_per_minute: usize,
    /// Servo streams of all callers at the same time. Default 8.
    pub servo_streams: usize,
    /// A servo stream in which nothing arrives, or whose answers nobody reads, for so long is ended. Default 10 s.
    pub servo_idle: Duration,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            connections: 1024,
            connections_per_address: 128,
            handshake: Duration::from_secs(5),
            receive: Duration::from_secs(60),
            header_bytes: 16 << 10,
            calls_per_caller: 256,
            bytes_per_caller: 512 << 20,
            uploads_per_minute: 60,
            servo_streams: 8,
            servo_idle: Duration::from_secs(10),
        }
    }
}

#[derive(Debug, Default)]
struct Used {
    calls: usize,
    bytes: u64,
    /// When hands were sent in the last minute.
    uploads: Vec<Instant>,
}

/// What each caller uses now.
#[derive(Debug)]
pub(crate) struct Quotas {
    limits: Limits,
    used: Mutex<HashMap<Arc<str>, Used>>,
}

impl Quotas {
    pub(crate) fn new(limits: Limits) -> Self {
        Self { limits, used: Mutex::default() }
    }

    /// A call of a caller begins.
    pub(crate) fn call(self: &Arc<Self>, caller: &Arc<str>, is_upload: bool) -> Result<Use, ServiceError> {
        let mut all = self.lock();
        let used = all.entry(Arc::clone(caller)).or_default();
        let quota = |what, limit: u64| Err(ServiceError::Quota { what, limit });
        if used.calls >= self.limits.calls_per_caller {
            return quota("calls at the same time", self.limits.calls_per_caller as u64);
        }
        if is_upload {
            let now = Instant::now();
            used.uploads.retain(|at| now.saturating_duration_since(*at) < Duration::from_secs(60));
            if used.uploads.len() >= self.limits.uploads_per_minute {
                return quota("hands sent in a minute", self.limits.uploads_per_minute as u64);
            }
            used.uploads.push(now);
        }
        used.calls += 1;
        Ok(Use { quotas: Arc::clone(self), caller: Arc::clone(caller), bytes: Mutex::new(0) })
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<Arc<str>, Used>> {
        self.used.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A call's part of its caller's quotas; given back when it is dropped.
#[derive(Debug)]
pub(crate) struct Use {
    quotas: Arc<Quotas>,
    caller: Arc<str>,
    bytes: Mutex<u64>,
}

impl Use {
    /// So many more bytes of the request have arrived.
    pub(crate) fn receive(&self, bytes: usize) -> Result<(), ServiceError> {
        let bytes = bytes as u64;
        let mut all = self.quotas.lock();
        let used = all.entry(Arc::clone(&self.caller)).or_default();
        let limit = self.quotas.limits.bytes_per_caller;
        if used.bytes + bytes > limit {
            return Err(ServiceError::Quota { what: "bytes of requests at the same time", limit });
        }
        used.bytes += bytes;
        *self.bytes.lock().unwrap_or_else(PoisonError::into_inner) += bytes;
        Ok(())
    }
}

impl Drop for Use {
    fn drop(&mut self) {
        let bytes = *self.bytes.lock().unwrap_or_else(PoisonError::into_inner);
        let mut all = self.quotas.lock();
        if let Some(used) = all.get_mut(&self.caller) {
            used.calls -= 1;
            used.bytes -= bytes;
            // Somebody who sent a hand is remembered for a minute; the next call forgets.
            if used.calls == 0 && used.uploads.is_empty() {
                all.remove(&self.caller);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quotas() -> Arc<Quotas> {
        let limits =
            Limits { calls_per_caller: 2, bytes_per_caller: 100, uploads_per_minute: 3, ..Limits::default() };
        Arc::new(Quotas::new(limits))
    }

    #[test]
    fn a_callers_quota_is_its_own_and_comes_back() {
        let quotas = quotas();
        let (arm, desk): (Arc<str>, Arc<str>) = ("arm".into(), "desk".into());
        let first = quotas.call(&arm, false).unwrap();
        let second = quotas.call(&arm, false).unwrap();
        assert!(matches!(quotas.call(&arm, false), Err(ServiceError::Quota { limit: 2, .. })));
        let other = quotas.call(&desk, false).unwrap();
        first.receive(60).unwrap();
        second.receive(40).unwrap();
        assert!(matches!(second.receive(1), Err(ServiceError::Quota { limit: 100, .. })));
        other.receive(100).unwrap();
        drop(first);
        second.receive(60).unwrap();
        drop((second, other));
        assert!(quotas.lock().is_empty(), "nobody is remembered without a reason");
    }

    #[test]
    fn hands_are_counted_by_the_minute() {
        let quotas = quotas();
        let arm: Arc<str> = "arm".into();
        for _ in 0..3 {
            quotas.call(&arm, true).unwrap();
        }
        assert!(matches!(quotas.call(&arm, true), Err(ServiceError::Quota { limit: 3, .. })));
        quotas.call(&arm, false).unwrap();
    }
}
