//! The text protocol of the wrist socket: `GET POS`, `SET POS 100 GTO 1`, a line each.

use std::time::{Duration, Instant};

use super::device::Gripper;
use super::tcp::Talker;
use crate::line::Reply;

/// Longest line.
const MOST: usize = 512;

/// Bits or bytes of the request that a variable is: byte, shift, mask.
fn written(name: &str) -> Option<(usize, u8, u8)> {
    Some(match name {
        "ACT" => (0, 0, 1),
        "GTO" => (0, 3, 1),
        "ATR" => (0, 4, 1),
        "ARD" => (0, 5, 1),
        "POS" => (3, 0, 0xFF),
        "SPE" => (4, 0, 0xFF),
        "FOR" => (5, 0, 0xFF),
        _ => return None,
    })
}

/// Bits or bytes of the status that a variable is.
fn read(name: &str) -> Option<(usize, u8, u8)> {
    Some(match name {
        "ACT" => (0, 0, 1),
        "GTO" => (0, 3, 1),
        "STA" => (0, 4, 3),
        "OBJ" => (0, 6, 3),
        "FLT" => (2, 0, 0x0F),
        "PRE" => (3, 0, 0xFF),
        "POS" => (4, 0, 0xFF),
        _ => return None,
    })
}

/// One client.
pub(super) struct Talk {
    gripper: Gripper,
    line: Vec<u8>,
}

impl Talk {
    pub(super) fn new(gripper: Gripper) -> Self {
        Self { gripper, line: Vec::new() }
    }

    fn answer(&self, line: &str, now: Instant) -> Option<Vec<u8>> {
        let mut words = line.split_ascii_whitespace();
        match words.next()? {
            "GET" => Some(self.get(words.next()?, now)),
            "SET" => self.set(words, now).map(|()| b"ack".to_vec()),
            _ => None,
        }
    }

    fn get(&self, name: &str, now: Instant) -> Vec<u8> {
        let mut machine = self.gripper.lock();
        let value = if machine.away {
            None
        } else if name == "SID" {
            Some(machine.config.slave)
        } else if let Some((at, shift, mask)) = read(name) {
            Some(machine.inputs(now)[at] >> shift & mask)
        } else {
            // What is only written reads back as it was written.
            written(name).map(|(at, shift, mask)| machine.outputs()[at] >> shift & mask)
        };
        value.map_or_else(|| format!("{name} ?\n"), |value| format!("{name} {value}\n")).into_bytes()
    }

    fn set<'a>(&self, mut words: impl Iterator<Item = &'a str>, now: Instant) -> Option<()> {
        let mut machine = self.gripper.lock();
        let mut bytes = machine.outputs();
        while let Some(name) = words.next() {
            let value: u8 = words.next()?.parse().ok()?;
            if name == "SID" {
                continue;
            }
            let (at, shift, mask) = written(name)?;
            if value > mask {
                return None;
            }
            bytes[at] = bytes[at] & !(mask << shift) | value << shift;
        }
        machine.write(0, &bytes, now);
        Some(())
    }
}

impl Talker for Talk {
    fn receive(&mut self, bytes: &[u8], now: Instant) -> Vec<Reply> {
        let mut answers = Vec::new();
        for byte in bytes {
            match byte {
                b'\n' => {
                    let line = std::mem::take(&mut self.line);
                    if let Ok(line) = str::from_utf8(&line) {
                        let reply = |bytes| Reply { bytes, after: Duration::ZERO };
                        answers.extend(self.answer(line, now).map(reply));
                    }
                }
                byte if self.line.len() < MOST => self.line.push(*byte),
                // The rest of a line that is too long is not kept.
                _ => {}
            }
        }
        answers
    }
}
