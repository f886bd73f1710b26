//! A hand whose line is owned by one task: callers send it orders and wait for its answers.
//!
//! Nobody but the task reads or writes the line, so no exchange meets another. A caller that gives up drops the place
//! where its answer would go: that is how the task knows.

use std::time::Duration;

use tokio::sync::{mpsc, oneshot};
use tokio::time::{Instant, timeout_at};

use crate::check::Finding;
use crate::{CloseCommand, DeviceError, GripCommand, HandInfo, HandState};

/// Orders that wait for a task at most.
const ORDERS: usize = 32;
/// A planner's answer may lie on a limit, give or take a rounding.
const ROUNDING: f64 = 1e-6;
/// Longer than anybody waits: a caller's time is cut to it, so that no clock overflows.
const LONGEST: Duration = Duration::from_secs(24 * 3600);

/// Where an answer goes.
pub type Reply<T> = oneshot::Sender<Result<T, DeviceError>>;

/// Sends an answer; a caller that gave up is no error.
pub fn tell<T>(reply: oneshot::Sender<T>, answer: T) {
    let _unheard = reply.send(answer);
}

/// How long a caller waits.
#[derive(Debug, Clone, Copy)]
pub struct Patience {
    /// What it allowed.
    pub timeout: Duration,
    /// When a motion must have ended, so that its answer comes in time.
    pub until: Instant,
}

impl Patience {
    /// From now on; a motion ends `ahead` of the caller's time.
    pub fn new(timeout: Duration, ahead: Duration) -> Self {
        Self { timeout, until: Instant::now() + timeout.min(LONGEST).saturating_sub(ahead) }
    }

    /// What is left of it.
    pub fn left(&self) -> Duration {
        self.until.saturating_duration_since(Instant::now())
    }
}

/// What callers ask of any hand; `Own` is what only this kind of hand can do.
#[derive(Debug)]
pub enum HandOrder<Own> {
    /// As [`crate::Hand::state`].
    State(Reply<HandState>),
    /// As [`crate::Hand::grip`].
    Grip(GripCommand, Patience, Reply<HandState>),
    /// As [`crate::Hand::close`].
    Close(CloseCommand, Patience, Reply<HandState>),
    /// Stop where the fingers are.
    Stop(Reply<()>),
    /// As [`crate::Hand::clear_fault`].
    Clear(Patience, Reply<()>),
    /// Allow motion, or forbid it.
    Arm(bool, Reply<()>),
    /// What is wrong and what to do about it.
    Check(oneshot::Sender<Vec<Finding>>),
    /// What only this kind of hand can do.
    Own(Own),
}

/// The callers' side of such a hand: refuses what cannot be, sends the rest to the task.
#[derive(Debug)]
pub struct HandOrders<Own> {
    info: HandInfo,
    /// Least and largest value of each actuator.
    limits: Vec<(f64, f64)>,
    /// How much earlier than its caller's time a motion ends.
    ahead: Duration,
    orders: mpsc::Sender<HandOrder<Own>>,
}

impl<Own: Send> HandOrders<Own> {
    /// For a hand; the task obeys what it receives until nobody can give orders any more.
    pub fn new(
        info: HandInfo,
        limits: Vec<(f64, f64)>,
        ahead: Duration,
    ) -> (Self, mpsc::Receiver<HandOrder<Own>>) {
        let (orders, received) = mpsc::channel(ORDERS);
        (Self { info, limits, ahead, orders }, received)
    }

    /// What the hand is.
    pub fn info(&self) -> &HandInfo {
        &self.info
    }

    /// Time of a caller that begins to wait now.
    pub fn patience(&self, timeout: Duration) -> Patience {
        Patience::new(timeout, self.ahead)
    }

    /// As [`crate::Hand::state`].
    ///
    /// # Errors
    /// As [`crate::Hand::state`].
    pub async fn state(&self, timeout: Duration) -> Result<HandState, DeviceError> {
        self.ask("state", timeout, HandOrder::State).await
    }

    /// As [`crate::Hand::grip`].
    ///
    /// # Errors
    /// As [`crate::Hand::grip`].
    pub async fn grip(&self, command: &GripCommand, timeout: Duration) -> Result<HandState, DeviceError> {
        self.check_list("actuators", &command.actuators)?;
        self.check_share("speed", command.speed)?;
        self.check_share("force", command.force)?;
        let patience = self.patience(timeout);
        self.ask("grip", timeout, |reply| HandOrder::Grip(command.clone(), patience, reply)).await
    }

    /// As [`crate::Hand::close`].
    ///
    /// # Errors
    /// As [`crate::Hand::close`].
    pub async fn close(&self, command: &CloseCommand, timeout: Duration) -> Result<HandState, DeviceError> {
        command.check(&self.info)?;
        self.check_list("contact", &command.contact)?;
        self.check_list("squeezed", &command.squeezed)?;
        self.check_list("farthest", &command.farthest)?;
        let patience = self.patience(timeout);
        self.ask("close", timeout, |reply| HandOrder::Close(command.clone(), patience, reply)).await
    }

    /// As [`crate::Hand::clear_fault`].
    ///
    /// # Errors
    /// As [`crate::Hand::clear_fault`].
    pub async fn clear_fault(&self, timeout: Duration) -> Result<(), DeviceError> {
        let patience = self.patience(timeout);
        self.ask("clear_fault", timeout, |reply| HandOrder::Clear(patience, reply)).await
    }

    /// Allows motion, or forbids it.
    ///
    /// # Errors
    /// [`DeviceError::Disconnected`], [`DeviceError::Timeout`].
    pub async fn arm(&self, armed: bool, timeout: Duration) -> Result<(), DeviceError> {
        self.ask("arm", timeout, |reply| HandOrder::Arm(armed, reply)).await
    }

    /// Stops the fingers where they are.
    ///
    /// # Errors
    /// [`DeviceError::Disconnected`], [`DeviceError::Timeout`].
    pub async fn stop(&self, timeout: Duration) -> Result<(), DeviceError> {
        self.ask("stop", timeout, HandOrder::Stop).await
    }

    /// What is wrong with the hand and what to do about it.
    ///
    /// # Errors
    /// [`DeviceError::Timeout`]; what is found is no error.
    pub async fn check(&self, timeout: Duration) -> Result<Vec<Finding>, DeviceError> {
        let (reply, answer) = oneshot::channel();
        self.bounded("check", timeout, HandOrder::Check(reply), answer).await
    }

    /// What only this kind of hand can do.
    ///
    /// # Errors
    /// Those of the task; [`DeviceError::Timeout`]; [`DeviceError::Disconnected`] when the task has ended.
    pub async fn own<T>(
        &self,
        operation: &'static str,
        timeout: Duration,
        order: impl FnOnce(Reply<T>) -> Own,
    ) -> Result<T, DeviceError> {
        self.ask(operation, timeout, |reply| HandOrder::Own(order(reply))).await
    }

    async fn ask<T>(
        &self,
        operation: &'static str,
        timeout: Duration,
        order: impl FnOnce(Reply<T>) -> HandOrder<Own>,
    ) -> Result<T, DeviceError> {
        let (reply, answer) = oneshot::channel();
        self.bounded(operation, timeout, order(reply), answer).await?
    }

    /// Gives an order and waits for its answer, no longer than `timeout`.
    async fn bounded<T>(
        &self,
        operation: &'static str,
        timeout: Duration,
        order: HandOrder<Own>,
        answer: oneshot::Receiver<T>,
    ) -> Result<T, DeviceError> {
        let device = || self.info.name.clone();
        let ended = || DeviceError::Disconnected { device: device(), detail: "its task has ended".into() };
        let exchange = async {
            self.orders.send(order).await.map_err(|_| ended())?;
            answer.await.map_err(|_| ended())
        };
        match timeout_at(Instant::now() + timeout.min(LONGEST), exchange).await {
            Ok(answer) => answer,
            Err(_) => Err(DeviceError::Timeout { device: device(), operation, after: timeout }),
        }
    }

    fn check_list(&self, field: &str, values: &[f64]) -> Result<(), DeviceError> {
        if values.len() != self.limits.len() {
            let (found, expected) = (format!("{} values", values.len()), self.limits.len().to_string());
            return Err(self.out_of_range(field.to_owned(), found, expected));
        }
        for ((value, (least, most)), name) in values.iter().zip(&self.limits).zip(&self.info.actuators) {
            // Written so that NaN is refused.
            if !(*value >= least - ROUNDING && *value <= most + ROUNDING) {
                let expected = format!("{least} to {most}");
                return Err(self.out_of_range(format!("{field}.{name}"), value.to_string(), expected));
            }
        }
        Ok(())
    }

    /// Refuses what is no share.
    ///
    /// # Errors
    /// [`DeviceError::OutOfRange`].
    pub fn check_share(&self, field: &str, share: f64) -> Result<(), DeviceError> {
        if (0.0..=1.0).contains(&share) {
            return Ok(());
        }
        Err(self.out_of_range(field.to_owned(), share.to_string(), "a share from 0 to 1".to_owned()))
    }

    fn out_of_range(&self, field: String, found: String, expected: String) -> DeviceError {
        DeviceError::OutOfRange { device: self.info.name.clone(), field, found, expected }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hand() -> (HandOrders<()>, mpsc::Receiver<HandOrder<()>>) {
        let info = HandInfo {
            name: "hand".into(),
            hand_id: "hand".into(),
            actuators: vec!["a".into(), "b".into()],
            feels_contact: true,
        };
        HandOrders::new(info, vec![(0.0, 1.0), (-1.0, 1.0)], Duration::from_millis(25))
    }

    fn grip(actuators: &[f64], speed: f64, force: f64) -> GripCommand {
        GripCommand { actuators: actuators.to_vec(), speed, force }
    }

    #[tokio::test]
    async fn what_cannot_be_never_reaches_the_task() {
        let (hand, mut task) = hand();
        for (command, expected) in [
            (grip(&[0.5], 1.0, 1.0), "actuators"),
            (grip(&[0.5, f64::NAN], 1.0, 1.0), "actuators.b"),
            (grip(&[f64::INFINITY, 0.0], 1.0, 1.0), "actuators.a"),
            (grip(&[1.1, 0.0], 1.0, 1.0), "actuators.a"),
            (grip(&[0.5, 0.0], f64::NAN, 1.0), "speed"),
            (grip(&[0.5, 0.0], 1.0, 1.01), "force"),
        ] {
            let error = hand.grip(&command, Duration::from_secs(1)).await.unwrap_err();
            assert!(matches!(&error, DeviceError::OutOfRange { field, .. } if field == expected), "{error}");
        }
        let close = CloseCommand {
            contact: vec![0.5, 0.5],
            squeezed: vec![0.6, 0.6],
            farthest: vec![1.5, 1.0],
            meet: Duration::from_millis(100),
            speed: 1.0,
            force: 1.0,
        };
        let error = hand.close(&close, Duration::from_secs(1)).await.unwrap_err();
        assert!(matches!(&error, DeviceError::OutOfRange { field, .. } if field == "farthest.a"), "{error}");
        assert!(task.try_recv().is_err());
    }

    #[tokio::test(start_paused = true)]
    async fn nobody_waits_longer_than_allowed_and_the_task_learns_of_it() {
        let (hand, mut task) = hand();
        let error = hand.grip(&grip(&[0.5, 0.0], 1.0, 1.0), Duration::from_secs(2)).await.unwrap_err();
        assert!(matches!(error, DeviceError::Timeout { operation: "grip", .. }), "{error}");
        let HandOrder::Grip(_, patience, reply) = task.try_recv().unwrap() else { panic!("another order") };
        assert!(reply.is_closed() && patience.left().is_zero());
        // However long somebody would wait, no clock overflows.
        let waits = tokio::time::timeout(Duration::from_secs(3), hand.state(Duration::MAX));
        assert!(waits.await.is_err());
        assert!(Patience::new(Duration::MAX, Duration::ZERO).left() <= LONGEST);
    }

    #[tokio::test]
    async fn a_task_that_ended_is_a_hand_that_is_away() {
        let (hand, task) = hand();
        drop(task);
        for error in [
            hand.state(Duration::from_secs(1)).await.unwrap_err(),
            hand.own::<()>("own", Duration::from_secs(1), |_| ()).await.unwrap_err(),
        ] {
            assert!(matches!(error, DeviceError::Disconnected { .. }), "{error}");
        }
    }
}
