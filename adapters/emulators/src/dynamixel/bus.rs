//! The bus: instructions to motors, answers and the time that they take on the wire.

use std::time::{Duration, Instant};

use graspd_adapters_dynamixel::table;
use graspd_adapters_dynamixel::{
    BROADCAST, Decoder, Event, FastBlock, Instruction, Packet, PacketError, Refusal, Status, encode_fast_sync,
};

use super::config::BusConfig;
use super::motor::Motor;
use super::plant::{MotorCommand, MotorState, Plant};
use crate::line::Reply;

pub(super) struct Bus {
    config: BusConfig,
    motors: Vec<Motor>,
    plant: Box<dyn Plant>,
    decoder: Decoder,
    advanced: Instant,
    heard: Instant,
    packets: u64,
}

impl Bus {
    pub(super) fn new(config: BusConfig, plant: Box<dyn Plant>, now: Instant) -> Self {
        let motors = config.motors.iter().map(|m| Motor::new(m.id, m.model, config.return_delay)).collect();
        Self { config, motors, plant, decoder: Decoder::new(), advanced: now, heard: now, packets: 0 }
    }

    pub(super) fn raise(&mut self, id: u8, errors: u8) {
        self.motors.iter_mut().filter(|m| m.id == id).for_each(|m| m.raise(errors));
    }

    pub(super) fn unplug(&mut self, id: u8, unplugged: bool) {
        for motor in self.motors.iter_mut().filter(|m| m.id == id) {
            if motor.unplugged && !unplugged {
                // It comes back powered up anew.
                motor.reboot(self.advanced, Duration::ZERO);
            }
            motor.unplugged = unplugged;
        }
    }

    pub(super) fn peek(&mut self, id: u8, addr: u16, len: u16, now: Instant) -> Option<Vec<u8>> {
        self.advance(now);
        self.motors.iter().find(|m| m.id == id)?.read(addr, len).ok()
    }

    pub(super) fn packets(&self) -> u64 {
        self.packets
    }

    /// Lets the plant catch up with the time; watchdogs fire when they fire, not when somebody looks.
    fn advance(&mut self, now: Instant) {
        while let Some(fires) = self.motors.iter().filter_map(Motor::watchdog).min().map(|s| self.heard + s)
            && fires < now
        {
            self.pass(fires);
            let heard = self.heard;
            for motor in &mut self.motors {
                if motor.watchdog().is_some_and(|silence| heard + silence <= fires) {
                    motor.stop_alone();
                }
            }
        }
        self.pass(now);
    }

    fn pass(&mut self, now: Instant) {
        let commands: Vec<MotorCommand> = self.motors.iter().map(Motor::command).collect();
        let mut states: Vec<MotorState> = self.motors.iter().map(|m| m.state).collect();
        self.plant.advance(now.saturating_duration_since(self.advanced), &commands, &mut states);
        for (motor, state) in self.motors.iter_mut().zip(states) {
            motor.state = state;
            motor.measure();
        }
        self.advanced = self.advanced.max(now);
    }

    pub(super) fn receive(&mut self, bytes: &[u8], now: Instant) -> Vec<Reply> {
        self.decoder.push(bytes);
        let mut replies = Vec::new();
        let mut after = self.config.latency;
        while let Some(event) = self.decoder.next_event() {
            match event {
                Event::Packet(packet) => {
                    self.advance(now);
                    self.heard = now;
                    self.packets += 1;
                    after += self.on_wire(packet.params.len() + 10);
                    self.obey(&packet, now, &mut after, &mut replies);
                }
                // Devices whose address came through would say so; which one that was is not sure.
                Event::Broken(error) => tracing::debug!(%error, "a packet that nobody understands"),
                Event::Skipped(bytes) => tracing::debug!(bytes, "bytes between packets"),
            }
        }
        replies
    }

    /// Time of so many bytes.
    fn on_wire(&self, bytes: usize) -> Duration {
        Duration::from_secs_f64(bytes as f64 * 10.0 / f64::from(self.config.baud.max(1)))
    }

    fn obey(&mut self, packet: &Packet, now: Instant, after: &mut Duration, replies: &mut Vec<Reply>) {
        let instruction = match Instruction::from_packet(packet) {
            Ok(instruction) => instruction,
            Err(error) => {
                let refusal = match error {
                    PacketError::Instruction { .. } => Refusal::Instruction,
                    _ => Refusal::DataLength,
                };
                let answers = self.each(packet.id, now, |_| Err(refusal));
                return self.send(packet.id, answers, 2, after, replies);
            }
        };
        let to = packet.id;
        match instruction {
            Instruction::Ping => {
                let answers = self.each(to, now, |m| {
                    let model = m.read(table::MODEL_NUMBER.addr, 2)?;
                    Ok([model, m.read(table::FIRMWARE.addr, 1)?].concat())
                });
                self.answer(answers, after, replies);
            }
            Instruction::Read { addr, len } => {
                let answers = self.each(to, now, |m| m.read(addr, len));
                self.send(to, answers, 1, after, replies);
            }
            Instruction::Write { addr, data } => {
                let answers = self.each(to, now, |m| m.write(addr, &data).map(|()| Vec::new()));
                self.send(to, answers, 2, after, replies);
            }
            Instruction::RegWrite { addr, data } => {
                let answers = self.each(to, now, |m| m.stage(addr, data.clone()).map(|()| Vec::new()));
                self.send(to, answers, 2, after, replies);
            }
            Instruction::Action => {
                let answers = self.each(to, now, |m| m.act().map(|()| Vec::new()));
                self.send(to, answers, 2, after, replies);
            }
            Instruction::FactoryReset { what } => {
                let answers = self.each(to, now, |m| {
                    // Losing its address would take a motor off this bus.
                    if !matches!(what, 1 | 2) {
                        return Err(Refusal::DataRange);
                    }
                    m.reset();
                    Ok(Vec::new())
                });
                self.send(to, answers, 2, after, replies);
            }
            Instruction::Reboot => {
                let answers = self.each(to, now, |_| Ok(Vec::new()));
                self.send(to, answers, 2, after, replies);
                let away = self.config.reboot;
                self.each(to, now, |m| {
                    m.reboot(now, away);
                    Ok(Vec::new())
                });
            }
            Instruction::Clear { what } => {
                let known = what.starts_with(&[0x01, 0x44, 0x58, 0x4C, 0x22]);
                let done = if known { Ok(Vec::new()) } else { Err(Refusal::DataRange) };
                let answers = self.each(to, now, |_| done.clone());
                self.send(to, answers, 2, after, replies);
            }
            Instruction::SyncRead { addr, len, ids } => {
                let answers = self.each_of(ids.iter().map(|id| (*id, addr, len)), now);
                self.answer(answers, after, replies);
            }
            Instruction::BulkRead { blocks } => {
                let answers = self.each_of(blocks.into_iter(), now);
                self.answer(answers, after, replies);
            }
            Instruction::FastSyncRead { addr, len, ids } => {
                if self.config.fast_sync_read {
                    self.fast(addr, len, &ids, now, after, replies);
                }
            }
            Instruction::SyncWrite { addr, blocks, .. } => {
                for (id, data) in blocks {
                    // Nobody answers a sync write, whatever becomes of it.
                    self.each(id, now, |m| m.write(addr, &data).map(|()| Vec::new()));
                }
            }
            Instruction::BulkWrite { blocks } => {
                for (id, addr, data) in blocks {
                    self.each(id, now, |m| m.write(addr, &data).map(|()| Vec::new()));
                }
            }
        }
    }

    /// What each motor that is meant does; those that do not hear are left out.
    fn each(
        &mut self,
        to: u8,
        now: Instant,
        mut act: impl FnMut(&mut Motor) -> Result<Vec<u8>, Refusal>,
    ) -> Vec<(Status, Duration)> {
        let mut answers = Vec::new();
        for motor in self.motors.iter_mut().filter(|m| to == BROADCAST || m.id == to) {
            if !motor.hears(now) {
                continue;
            }
            let (data, refusal) = match act(motor) {
                Ok(data) => (data, None),
                Err(refusal) => (Vec::new(), Some(refusal)),
            };
            answers.push((Status { id: motor.id, error: motor.error(refusal), data }, motor.delay()));
        }
        answers
    }

    /// Reads of several motors, in the order that was asked. A motor waits for the one before it: what follows one that
    /// is silent does not come.
    fn each_of(
        &mut self,
        asked: impl Iterator<Item = (u8, u16, u16)>,
        now: Instant,
    ) -> Vec<(Status, Duration)> {
        let mut answers = Vec::new();
        for (id, addr, len) in asked {
            let answer = self.each(id, now, |m| m.read(addr, len));
            if answer.is_empty() {
                break;
            }
            answers.extend(answer);
        }
        answers
    }

    fn fast(
        &mut self,
        addr: u16,
        len: u16,
        ids: &[u8],
        now: Instant,
        after: &mut Duration,
        replies: &mut Vec<Reply>,
    ) {
        let answers = self.each_of(ids.iter().map(|id| (*id, addr, len)), now);
        let Some((_, delay)) = answers.first() else { return };
        let delay = *delay;
        let block = |s: &Status| {
            let mut data = s.data.clone();
            data.resize(usize::from(len), 0);
            FastBlock { id: s.id, error: s.error, data }
        };
        let blocks: Vec<FastBlock> = answers.iter().map(|(s, _)| block(s)).collect();
        match encode_fast_sync(&blocks, ids.len()) {
            Ok(bytes) => {
                *after += delay + self.on_wire(bytes.len());
                replies.push(Reply { bytes, after: *after });
            }
            Err(error) => tracing::debug!(%error, "a fast sync read that nobody can answer"),
        }
    }

    /// Answers to an instruction that is not answered when all are meant, nor below a status return level.
    fn send(
        &mut self,
        to: u8,
        answers: Vec<(Status, Duration)>,
        level: i64,
        after: &mut Duration,
        replies: &mut Vec<Reply>,
    ) {
        if to == BROADCAST {
            return;
        }
        let talks = |id: u8| {
            let motor = self.motors.iter().find(|m| m.id == id);
            motor.is_some_and(|m| m.get(table::STATUS_RETURN_LEVEL) >= level)
        };
        let answers = answers.into_iter().filter(|(s, _)| talks(s.id)).collect();
        self.answer(answers, after, replies);
    }

    fn answer(&self, answers: Vec<(Status, Duration)>, after: &mut Duration, replies: &mut Vec<Reply>) {
        for (status, delay) in answers {
            match status.to_packet().encode() {
                Ok(bytes) => {
                    *after += delay + self.on_wire(bytes.len());
                    replies.push(Reply { bytes, after: *after });
                }
                Err(error) => tracing::debug!(%error, "an answer that no packet carries"),
            }
        }
    }
}
