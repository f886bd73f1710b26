//! A camera's thread: it streams while somebody looks, and reaches a lost device again.
//!
//! Vendors' libraries block, so their calls live on a thread of their own. Callers only leave orders, which never waits.

use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TryRecvError, TrySendError, sync_channel};
use std::time::Duration;

use tokio::sync::oneshot;

use crate::DeviceError;
use crate::feed::Feed;

/// Orders that wait for the thread at most.
const MOST_ORDERS: usize = 32;
/// Tries to reach a device are at least so far apart, whoever asks.
const LEAST_PAUSE: Duration = Duration::from_millis(50);
/// The pause between tries grows up to so many times the first.
const MOST_PAUSES: u32 = 16;

/// Who waits for a thread to have stopped.
#[derive(Debug)]
pub struct Done(oneshot::Sender<()>);

impl Done {
    /// It has. Somebody who gave up waiting is no error.
    pub fn tell(self) {
        let _unheard = self.0.send(());
    }
}

/// What a camera's thread is told.
#[derive(Debug)]
pub enum Order {
    /// Somebody waits for a frame: stream, and try at once where the device was lost.
    Wake,
    /// Stop streaming until somebody waits again.
    Stop(Done),
    /// End.
    Quit,
}

/// The callers' end. The thread is told to end when this is dropped.
#[derive(Debug)]
pub struct Control(SyncSender<Order>);

/// The thread's end.
#[derive(Debug)]
pub struct Orders(Receiver<Order>);

/// Both ends.
pub fn channel() -> (Control, Orders) {
    let (sender, receiver) = sync_channel(MOST_ORDERS);
    (Control(sender), Orders(receiver))
}

impl Control {
    /// Somebody waits for a frame. Where the thread has ended, all who wait are told so.
    pub fn wake(&self, feed: &Feed) {
        // A full queue wakes the thread anyway.
        if let Err(TrySendError::Disconnected(_)) = self.0.try_send(Order::Wake) {
            feed.fail_because("its thread has ended");
        }
    }

    /// Stops streaming; ends when the thread says that it has.
    ///
    /// # Errors
    /// [`DeviceError::Timeout`], [`DeviceError::Disconnected`] where the thread has ended, [`DeviceError::Busy`] where
    /// too many orders wait for it.
    pub async fn stop(&self, device: &str, timeout: Duration) -> Result<(), DeviceError> {
        let device = || device.to_owned();
        let ended = || DeviceError::Disconnected { device: device(), detail: "its thread has ended".into() };
        let (done, answer) = oneshot::channel();
        self.0.try_send(Order::Stop(Done(done))).map_err(|error| match error {
            TrySendError::Full(_) => DeviceError::Busy { device: device(), with: "earlier calls".into() },
            TrySendError::Disconnected(_) => ended(),
        })?;
        match tokio::time::timeout(timeout, answer).await {
            Ok(answer) => answer.map_err(|_| ended()),
            Err(_) => Err(DeviceError::Timeout { device: device(), operation: "stop", after: timeout }),
        }
    }
}

impl Drop for Control {
    fn drop(&mut self) {
        // Where the queue is full, the thread ends when it finds its other end gone.
        let _full = self.0.try_send(Order::Quit);
    }
}

impl Orders {
    /// The next order, waiting no longer than this; `None` when none came.
    pub fn wait(&self, at_most: Option<Duration>) -> Option<Order> {
        match at_most {
            None => Some(self.0.recv().unwrap_or(Order::Quit)),
            Some(at_most) => match self.0.recv_timeout(at_most) {
                Ok(order) => Some(order),
                Err(RecvTimeoutError::Timeout) => None,
                Err(RecvTimeoutError::Disconnected) => Some(Order::Quit),
            },
        }
    }

    /// The next order that changes anything for a thread that streams already.
    pub fn look(&self) -> Option<Order> {
        loop {
            match self.0.try_recv() {
                Ok(Order::Wake) => {}
                Ok(order) => return Some(order),
                Err(TryRecvError::Empty) => return None,
                Err(TryRecvError::Disconnected) => return Some(Order::Quit),
            }
        }
    }
}

/// How a session with a device ended.
#[derive(Debug)]
pub enum Ended {
    /// It was told to end.
    Quit,
    /// It was told to stop, and the device has.
    Stopped(Done),
    /// The device was lost, or not reached.
    Lost(DeviceError),
}

/// The life of a camera's thread. `session` reaches the device and streams from it until an order or a failure ends that; it
/// is called again when somebody waits, at once, or else after a pause that begins with `retry` and doubles up to 16 times
/// that. Each failure is told to all who wait.
pub fn run(feed: &Feed, orders: &Orders, retry: Duration, mut session: impl FnMut(&Orders) -> Ended) {
    let mut pause = retry;
    let mut wanted = false;
    loop {
        if !wanted {
            match orders.wait(None) {
                Some(Order::Wake) => wanted = true,
                Some(Order::Stop(done)) => done.tell(),
                Some(Order::Quit) => return,
                None => {}
            }
            continue;
        }
        let before = feed.counts().arrived;
        match session(orders) {
            Ended::Quit => return,
            Ended::Stopped(done) => {
                (wanted, pause) = (false, retry);
                done.tell();
            }
            Ended::Lost(error) => {
                if feed.counts().arrived > before {
                    pause = retry;
                }
                feed.fail(error);
                std::thread::sleep(LEAST_PAUSE);
                match orders.wait(Some(pause)) {
                    Some(Order::Quit) => return,
                    Some(Order::Stop(done)) => {
                        wanted = false;
                        done.tell();
                    }
                    // Somebody waits: try at once.
                    Some(Order::Wake) => {}
                    None => pause = (pause * 2).min(retry * MOST_PAUSES),
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicU32, Ordering};
    use std::time::Instant;

    use super::*;

    const LONG: Duration = Duration::from_secs(10);

    fn lost() -> DeviceError {
        DeviceError::Disconnected { device: "camera".into(), detail: "unplugged".into() }
    }

    #[tokio::test]
    async fn nothing_streams_before_somebody_looks_and_everything_ends() {
        let (control, orders) = channel();
        let feed = Arc::new(Feed::new("camera"));
        let sessions = Arc::new(AtomicU32::new(0));
        let (inner, count) = (feed.clone(), sessions.clone());
        let thread = std::thread::spawn(move || {
            run(&inner, &orders, LONG, |orders| {
                count.fetch_add(1, Ordering::SeqCst);
                loop {
                    match orders.wait(None) {
                        Some(Order::Stop(done)) => return Ended::Stopped(done),
                        Some(Order::Quit) => return Ended::Quit,
                        _ => {}
                    }
                }
            });
        });
        control.stop("camera", LONG).await.unwrap();
        assert_eq!(sessions.load(Ordering::SeqCst), 0);
        control.wake(&feed);
        control.stop("camera", LONG).await.unwrap();
        assert_eq!(sessions.load(Ordering::SeqCst), 1);
        control.wake(&feed);
        drop(control);
        thread.join().unwrap();
    }

    #[tokio::test]
    async fn each_call_learns_of_a_try_that_was_made_for_it() {
        let (control, orders) = channel();
        let feed = Arc::new(Feed::new("camera"));
        let inner = feed.clone();
        let thread = std::thread::spawn(move || run(&inner, &orders, LONG, |_| Ended::Lost(lost())));
        for _ in 0..3 {
            let began = Instant::now();
            let error = feed.next(LONG, LONG, || control.wake(&feed)).await.unwrap_err();
            // Not after the pause, which is longer.
            assert!(error == lost() && began.elapsed() < LONG / 2);
        }
        control.stop("camera", LONG).await.unwrap();
        drop(control);
        thread.join().unwrap();
    }

    #[tokio::test]
    async fn a_thread_that_ended_is_said_so() {
        let (control, orders) = channel();
        drop(orders);
        let feed = Feed::new("camera");
        let error = feed.next(LONG, LONG, || control.wake(&feed)).await.unwrap_err();
        assert!(error.to_string().contains("thread has ended"), "{error}");
        let error = control.stop("camera", LONG).await.unwrap_err();
        assert!(matches!(error, DeviceError::Disconnected { .. }), "{error}");
    }
}
