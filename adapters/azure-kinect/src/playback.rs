//! Recordings as a source of frames, on a thread of their own.

use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use graspd_adapters_core::feed::Feed;
use graspd_adapters_core::stamps::ExposureCounter;
use graspd_adapters_core::streaming::{Order, Orders};
use graspd_adapters_core::{DepthFrame, DeviceError, Lens};
use tokio::sync::oneshot;

use crate::frames::frame;
use crate::recording::{Recording, RecordingError};

/// Where the frame goes that somebody asked for.
pub(crate) type Asked = oneshot::Sender<Result<DepthFrame, DeviceError>>;

/// A recording that is played.
pub(crate) struct Playback {
    device: String,
    recording: Recording,
    lens: Lens,
    repeat: bool,
    counter: ExposureCounter,
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
    pub(crate) fn new(device: String, recording: Recording, repeat: bool) -> Result<Self, RecordingError> {
        let lens = recording.lens().to_frame()?;
        let counter = ExposureCounter::new(recording.period());
        Ok(Self {
            device,
            recording,
            lens,
            repeat,
            counter,
            rounds: Duration::ZERO,
            last: None,
            frames_in_round: 0,
            kept: None,
            over: None,
        })
    }

    /// Each who asks gets the next frame, until nobody can ask any more.
    pub(crate) fn serve(mut self, asked: &Receiver<Asked>) {
        while let Ok(reply) = asked.recv() {
            // Who gave up already takes no frame away.
            if reply.is_closed() {
                continue;
            }
            let answer = self.next();
            if let Err(Ok(frame)) = reply.send(answer) {
                self.kept = Some(frame);
            }
        }
    }

    /// Plays in real time while somebody looks, until nobody can order anything any more.
    pub(crate) fn stream(mut self, orders: &Orders, feed: &Arc<Feed>) {
        let mut begun: Option<(Instant, Duration)> = None;
        loop {
            let Some((zero, first)) = begun else {
                // Nothing is played before somebody looks.
                match orders.wait(None) {
                    Some(Order::Wake) => match self.peek() {
                        Ok(stamp) => begun = Some((Instant::now(), stamp)),
                        Err(error) => feed.fail(error),
                    },
                    Some(Order::Stop(done)) => done.tell(),
                    Some(Order::Quit) => return,
                    None => {}
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
            match orders.wait(Some(due.saturating_duration_since(Instant::now()))) {
                None => {
                    if let Some(frame) = self.kept.take() {
                        feed.publish(frame, due);
                    }
                }
                Some(Order::Stop(done)) => {
                    begun = None;
                    done.tell();
                }
                Some(Order::Wake) => {}
                Some(Order::Quit) => return,
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
