//! Recordings as a source of frames, on a thread of their own.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use graspd_adapters_core::feed::Feed;
use graspd_adapters_core::{DepthFrame, DeviceError, Lens};

use crate::camera::Command;
use crate::frames::{Counter, frame};
use crate::recording::{Recording, RecordingError};
use crate::settings::Pace;

/// A recording that is played.
pub(crate) struct Playback {
    device: String,
    recording: Recording,
    lens: Lens,
    pace: Pace,
    repeat: bool,
    counter: Counter,
    /// Device time that earlier rounds took: stamps go on rising.
    rounds: Duration,
    last: Option<Duration>,
    frames_in_round: u64,
    /// Read, and not handed over.
    kept: Option<DepthFrame>,
    /// Why nothing more comes.
    over: Option<DeviceError>,
}

impl Playback {
    pub(crate) fn new(
        device: String,
        recording: Recording,
        pace: Pace,
        repeat: bool,
    ) -> Result<Self, RecordingError> {
        let lens = recording.lens().to_frame()?;
        let counter = Counter::new(recording.period());
        Ok(Self {
            device,
            recording,
            lens,
            pace,
            repeat,
            counter,
            rounds: Duration::ZERO,
            last: None,
            frames_in_round: 0,
            kept: None,
            over: None,
        })
    }

    /// Plays until nobody wants frames any more.
    pub(crate) fn run(mut self, commands: &Receiver<Command>, feed: &Arc<Feed>) {
        match self.pace {
            Pace::AsAsked => self.serve(commands),
            Pace::RealTime => self.stream(commands, feed),
        }
    }

    fn serve(&mut self, commands: &Receiver<Command>) {
        while let Ok(command) = commands.recv() {
            match command {
                Command::Quit => return,
                Command::Wake => {}
                Command::Stop(done) => {
                    let _unheard = done.send(());
                }
                // Who gave up already takes no frame away.
                Command::Next(reply) if reply.is_closed() => {}
                Command::Next(reply) => {
                    let answer = self.next();
                    if let Err(Ok(frame)) = reply.send(answer) {
                        self.kept = Some(frame);
                    }
                }
            }
        }
    }

    fn stream(&mut self, commands: &Receiver<Command>, feed: &Arc<Feed>) {
        let mut begun: Option<(Instant, Duration)> = None;
        loop {
            let Some((zero, first)) = begun else {
                // Nothing is played before somebody looks.
                match commands.recv() {
                    Ok(Command::Wake) => match self.peek() {
                        Ok(stamp) => begun = Some((Instant::now(), stamp)),
                        Err(error) => feed.fail(error),
                    },
                    Ok(Command::Stop(done)) => {
                        let _unheard = done.send(());
                    }
                    Ok(Command::Next(_)) => {}
                    Ok(Command::Quit) | Err(_) => return,
                }
                continue;
            };
            let stamp = match self.peek() {
                Ok(stamp) => stamp,
                Err(error) => {
                    feed.fail(error);
                    begun = None;
                    continue;
                }
            };
            let due = zero + stamp.saturating_sub(first);
            match commands.recv_timeout(due.saturating_duration_since(Instant::now())) {
                Err(RecvTimeoutError::Timeout) => {
                    if let Some(frame) = self.kept.take() {
                        feed.publish(frame, due);
                    }
                }
                Ok(Command::Stop(done)) => {
                    begun = None;
                    let _unheard = done.send(());
                }
                Ok(Command::Wake | Command::Next(_)) => {}
                Ok(Command::Quit) | Err(RecvTimeoutError::Disconnected) => return,
            }
        }
    }

    /// Reads the next frame ahead; its stamp.
    fn peek(&mut self) -> Result<Duration, DeviceError> {
        let frame = self.next()?;
        let stamp = frame.stamp;
        self.kept = Some(frame);
        Ok(stamp)
    }

    fn next(&mut self) -> Result<DepthFrame, DeviceError> {
        if let Some(frame) = self.kept.take() {
            return Ok(frame);
        }
        if let Some(over) = &self.over {
            return Err(over.clone());
        }
        let answer = self.read();
        if let Err(error) = &answer {
            self.over = Some(error.clone());
        }
        answer
    }

    fn read(&mut self) -> Result<DepthFrame, DeviceError> {
        loop {
            let image = self.recording.next_depth().map_err(|error| {
                let detail = format!("the recording is broken: {error}");
                DeviceError::Protocol { device: self.device.clone(), detail }
            })?;
            if let Some(image) = image {
                self.frames_in_round += 1;
                let stamp = image.stamp.saturating_add(self.rounds);
                self.last = Some(stamp);
                let sequence = self.counter.count(stamp);
                let size = self.recording.mode().size();
                return Ok(frame(size, &image.values, self.lens, sequence, stamp));
            }
            if self.frames_in_round == 0 {
                return Err(self.ended("the recording has no depth frame"));
            }
            if !self.repeat {
                let frames = self.frames_in_round;
                let detail =
                    format!("the recording has ended after {frames} frames (`repeat = true` plays on)");
                return Err(self.ended(&detail));
            }
            self.begin_again();
        }
    }

    /// Stamps of the next round begin one period after the last.
    fn begin_again(&mut self) {
        self.recording.rewind();
        self.frames_in_round = 0;
        if let (Some(last), Ok(Some(first))) = (self.last, self.recording.next_depth()) {
            self.rounds = (last + self.recording.period()).saturating_sub(first.stamp);
        }
        self.recording.rewind();
    }

    fn ended(&self, detail: &str) -> DeviceError {
        DeviceError::Disconnected { device: self.device.clone(), detail: detail.to_owned() }
    }
}
