//! Frames on their way from a camera's own thread to callers who wait for the next one.
//!
//! Only the newest frame is kept: a slow caller never holds up a camera, nor makes it pile up frames.

use std::sync::Mutex;
use std::sync::PoisonError;
use std::time::{Duration, Instant};

use tokio::sync::watch;

use crate::{DepthFrame, DeviceError};

/// Names of the one operation that a feed serves.
const CAPTURE: &str = "capture";

/// What came, and what did not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FeedCounts {
    /// Frames that the camera handed over.
    pub arrived: u64,
    /// Exposures that the device counted and nobody received.
    pub lost: u64,
    /// Times that the camera was lost.
    pub failures: u64,
}

/// The newest frame, and when it was exposed.
#[derive(Debug, Clone)]
struct Newest {
    frame: DepthFrame,
    exposed: Instant,
    /// How many had arrived with it.
    number: u64,
}

#[derive(Debug, Default)]
struct Board {
    newest: Option<Newest>,
    failure: Option<DeviceError>,
    counts: FeedCounts,
}

/// Where a camera's thread puts frames and callers wait for them.
#[derive(Debug)]
pub struct Feed {
    device: String,
    board: watch::Sender<Board>,
    last_sequence: Mutex<Option<u64>>,
}

impl Feed {
    /// Of a camera of this name.
    pub fn new(device: impl Into<String>) -> Self {
        Self {
            device: device.into(),
            board: watch::Sender::new(Board::default()),
            last_sequence: Mutex::new(None),
        }
    }

    /// A frame came that was exposed then. A gap in [`DepthFrame::sequence`] counts as lost exposures; the frame's `age` is
    /// set when it is handed over. Never waits.
    pub fn publish(&self, frame: DepthFrame, exposed: Instant) {
        let before = {
            let mut last = self.last_sequence.lock().unwrap_or_else(PoisonError::into_inner);
            last.replace(frame.sequence)
        };
        let lost = before.map_or(0, |before| frame.sequence.saturating_sub(before).saturating_sub(1));
        self.board.send_modify(|board| {
            board.counts.arrived += 1;
            board.counts.lost += lost;
            board.newest = Some(Newest { frame, exposed, number: board.counts.arrived });
        });
    }

    /// The camera was lost, or could not be reached again: all who wait now are told so. The next gap in the sequence does
    /// not count as lost exposures.
    pub fn fail(&self, error: DeviceError) {
        *self.last_sequence.lock().unwrap_or_else(PoisonError::into_inner) = None;
        self.board.send_modify(|board| {
            board.counts.failures += 1;
            board.failure = Some(error);
        });
    }

    /// [`Self::fail`] with [`DeviceError::Disconnected`].
    pub fn fail_because(&self, detail: &str) {
        self.fail(DeviceError::Disconnected { device: self.device.clone(), detail: detail.to_owned() });
    }

    /// What came so far.
    pub fn counts(&self) -> FeedCounts {
        self.board.borrow().counts
    }

    /// The next frame exposed after the call, no older than `max_age` when it is handed over. `wake` is called once,
    /// after the wait has begun: a failure that it causes is not missed. Dropping the future loses nothing.
    ///
    /// # Errors
    /// [`DeviceError::Timeout`] when none comes in time, [`DeviceError::Stale`] when only older ones come, the camera's
    /// own error when it is lost meanwhile.
    pub async fn next(
        &self,
        max_age: Duration,
        timeout: Duration,
        wake: impl FnOnce(),
    ) -> Result<DepthFrame, DeviceError> {
        let called = Instant::now();
        let mut board = self.board.subscribe();
        let FeedCounts { arrived, failures, .. } = board.borrow().counts;
        wake();
        let mut too_old: Option<Duration> = None;
        let wait = async {
            loop {
                {
                    let now = board.borrow_and_update();
                    if let Some(newest) = now.newest.as_ref().filter(|n| n.number > arrived) {
                        let age = newest.exposed.elapsed();
                        if newest.exposed >= called && age <= max_age {
                            return Ok(DepthFrame { age, ..newest.frame.clone() });
                        }
                        if age > max_age {
                            too_old = Some(too_old.map_or(age, |other| other.min(age)));
                        }
                    }
                    if now.counts.failures > failures
                        && let Some(error) = &now.failure
                    {
                        return Err(error.clone());
                    }
                }
                if board.changed().await.is_err() {
                    let detail = "its thread has ended".to_owned();
                    return Err(DeviceError::Disconnected { device: self.device.clone(), detail });
                }
            }
        };
        match tokio::time::timeout(timeout, wait).await {
            Ok(answer) => answer,
            Err(_) => Err(match too_old {
                Some(age) => DeviceError::Stale { device: self.device.clone(), age, limit: max_age },
                None => {
                    DeviceError::Timeout { device: self.device.clone(), operation: CAPTURE, after: timeout }
                }
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::Lens;

    fn frame(sequence: u64) -> DepthFrame {
        let lens = Lens { fx_px: 1.0, fy_px: 1.0, cx_px: 0.0, cy_px: 0.0, distortion: [0.0; 8] };
        DepthFrame {
            width: 1,
            height: 1,
            depth_m: vec![1.0].into(),
            lens,
            world_from_camera: None,
            sequence,
            stamp: Duration::ZERO,
            age: Duration::ZERO,
        }
    }

    const LONG: Duration = Duration::from_secs(5);
    const SHORT: Duration = Duration::from_millis(30);

    #[tokio::test]
    async fn only_a_frame_exposed_after_the_call_is_handed_over() {
        let feed = Arc::new(Feed::new("camera"));
        feed.publish(frame(1), Instant::now());
        let other = feed.clone();
        let later = tokio::spawn(async move {
            tokio::time::sleep(SHORT).await;
            // Exposed before the call, arrived after it.
            other.publish(frame(2), Instant::now() - Duration::from_secs(1));
            other.publish(frame(3), Instant::now());
        });
        let got = feed.next(LONG, LONG, || {}).await.unwrap();
        assert_eq!(got.sequence, 3);
        later.await.unwrap();
    }

    #[tokio::test]
    async fn late_frames_are_stale_and_no_frames_are_a_timeout() {
        let feed = Feed::new("camera");
        let silent = feed.next(LONG, SHORT, || {}).await.unwrap_err();
        assert!(matches!(silent, DeviceError::Timeout { operation: CAPTURE, .. }), "{silent}");
        let old = || feed.publish(frame(1), Instant::now() - Duration::from_secs(2));
        let stale = feed.next(Duration::from_secs(1), SHORT, old).await.unwrap_err();
        assert!(matches!(stale, DeviceError::Stale { age, .. } if age >= Duration::from_secs(2)), "{stale}");
    }

    #[tokio::test]
    async fn a_failure_after_the_call_ends_it_and_one_before_it_does_not() {
        let feed = Feed::new("camera");
        let lost = || DeviceError::Disconnected { device: "camera".into(), detail: "unplugged".into() };
        feed.fail(lost());
        let silent = feed.next(LONG, SHORT, || {}).await.unwrap_err();
        assert!(matches!(silent, DeviceError::Timeout { .. }), "{silent}");
        assert_eq!(feed.next(LONG, LONG, || feed.fail(lost())).await.unwrap_err(), lost());
        let got = feed.next(LONG, LONG, || feed.publish(frame(9), Instant::now())).await.unwrap();
        assert_eq!(got.sequence, 9);
    }

    #[test]
    fn gaps_count_as_lost_but_not_across_a_failure() {
        let feed = Feed::new("camera");
        for sequence in [4, 5, 8] {
            feed.publish(frame(sequence), Instant::now());
        }
        feed.fail(DeviceError::Disconnected { device: "camera".into(), detail: String::new() });
        feed.publish(frame(100), Instant::now());
        assert_eq!(feed.counts(), FeedCounts { arrived: 4, lost: 2, failures: 1 });
    }
}
