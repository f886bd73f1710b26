//! Modbus RTU frames: address, request, check.

use std::time::{Duration, Instant};

use super::device::Gripper;
use super::modbus;
use super::tcp::Talker;
use crate::line::{LineDevice, Reply};

/// Time of a byte at 115200 baud, ten bits each.
const BYTE: Duration = Duration::from_nanos(86_806);
/// Longest frame.
const MOST: usize = 256;

/// The check of Modbus RTU: polynomial 0x8005 reflected, start 0xFFFF; the low byte goes first.
pub(super) fn check(bytes: &[u8]) -> [u8; 2] {
    let mut crc = 0xFFFF_u16;
    for byte in bytes {
        crc ^= u16::from(*byte);
        for _ in 0..8 {
            crc = if crc & 1 == 0 { crc >> 1 } else { crc >> 1 ^ 0xA001 };
        }
    }
    crc.to_le_bytes()
}

/// A gripper at the end of a line of RTU frames.
pub(super) struct RtuSlave {
    gripper: Gripper,
    bytes: Vec<u8>,
}

impl RtuSlave {
    pub(super) fn new(gripper: Gripper) -> Self {
        Self { gripper, bytes: Vec::new() }
    }

    /// Length of the frame that begins here; `None`: not enough of it is there to know.
    fn frame(&self) -> Option<usize> {
        let counted = |at: usize| self.bytes.get(at).map(|n| at + 1 + usize::from(*n) + 2);
        match self.bytes.get(1)? {
            3 | 4 | 6 => Some(8),
            16 => counted(6),
            23 => counted(10),
            // Nobody knows how long it is: what came is it.
            _ => Some(self.bytes.len().max(4)),
        }
    }

    fn answers(&mut self, bytes: &[u8], now: Instant) -> Vec<Vec<u8>> {
        self.bytes.extend_from_slice(bytes);
        let mut answers = Vec::new();
        while let Some(length) = self.frame() {
            if length > MOST || self.bytes.len() > MOST {
                // Nothing that fits begins here: as after a garbled frame, only silence helps.
                self.bytes.clear();
                break;
            }
            if self.bytes.len() < length {
                break;
            }
            let frame: Vec<u8> = self.bytes.drain(..length).collect();
            let Some((body, found)) = frame.split_last_chunk::<2>() else { break };
            if check(body) != *found {
                // A slave that cannot trust a frame is silent, and waits for silence.
                tracing::debug!("a frame with a wrong check");
                self.bytes.clear();
                break;
            }
            let slave = self.gripper.lock().config.slave;
            if body[0] != slave {
                continue;
            }
            let mut answer = vec![slave];
            answer.extend(modbus::answer(&self.gripper, &body[1..], false, now));
            answer.extend(check(&answer));
            answers.push(answer);
        }
        answers
    }
}

impl LineDevice for RtuSlave {
    fn receive(&mut self, bytes: &[u8], now: Instant) -> Vec<Reply> {
        let heard = BYTE * u32::try_from(bytes.len()).unwrap_or(u32::MAX);
        let reply = |bytes: Vec<u8>| {
            let after = heard + BYTE * u32::try_from(bytes.len()).unwrap_or(u32::MAX);
            Reply { bytes, after }
        };
        self.answers(bytes, now).into_iter().map(reply).collect()
    }

    fn silence(&mut self) {
        self.bytes.clear();
    }
}

/// Behind a tool port there is the same slow line.
impl Talker for RtuSlave {
    fn receive(&mut self, bytes: &[u8], now: Instant) -> Vec<Reply> {
        LineDevice::receive(self, bytes, now)
    }
}
