//! Closing fingers on an object, for hands whose controllers only go to positions.

use std::time::{Duration, Instant};

use crate::hand::{CloseCommand, GripCommand, Hand, HandState};
use crate::{DeviceError, HandInfo};

/// The way to where contact is expected is gone in so many parts, all actuators together.
const PARTS: u32 = 5;
/// A finger that is not held goes on by its squeeze, at most so often.
const MORE_SQUEEZES: u32 = 8;
/// Motors that must be held before a hand of several closing motors stops closing.
const HELD_MOTORS: usize = 2;

impl CloseCommand {
    /// Refuses what no hand can do, before anything moves.
    ///
    /// # Errors
    /// [`DeviceError::OutOfRange`] for lists that are not those of the hand's actuators, numbers that are not finite
    /// and shares beyond 0 to 1. Limits of the actuators are the hand's business.
    pub fn check(&self, info: &HandInfo) -> Result<(), DeviceError> {
        let refuse = |field: &str, found: String, expected: String| {
            let (device, field) = (info.name.clone(), field.to_owned());
            Err(DeviceError::OutOfRange { device, field, found, expected })
        };
        let expected = info.actuators.len();
        for (field, list) in
            [("contact", &self.contact), ("squeezed", &self.squeezed), ("farthest", &self.farthest)]
        {
            if list.len() != expected {
                return refuse(field, format!("{} values", list.len()), expected.to_string());
            }
            if let Some(value) = list.iter().find(|v| !v.is_finite()) {
                return refuse(field, value.to_string(), "finite values".into());
            }
        }
        for (field, share) in [("speed", self.speed), ("force", self.force)] {
            if !(0.0..=1.0).contains(&share) {
                return refuse(field, share.to_string(), "a share from 0 to 1".into());
            }
        }
        Ok(())
    }

    /// Where actuators that are at `from` meet the object: one that is beyond contact already stays, since opened again
    /// it might let go.
    fn meeting(&self, from: &[f64]) -> Vec<f64> {
        let ways = from.iter().zip(&self.contact).zip(&self.squeezed);
        ways.map(
            |((&from, &contact), squeezed)| {
                if (from - contact) * (squeezed - contact) > 0.0 { from } else { contact }
            },
        )
        .collect()
    }

    /// Where actuators are told to go after `told`, one squeeze farther; none beyond its farthest position.
    fn farther(&self, told: &[f64]) -> Vec<f64> {
        let ways = self.contact.iter().zip(&self.squeezed).zip(&self.farthest);
        told.iter()
            .zip(ways)
            .map(|(&told, ((contact, squeezed), farthest))| {
                let squeeze = squeezed - contact;
                let next = told + squeeze;
                if squeeze > 0.0 { next.min(farthest.max(told)) } else { next.max(farthest.min(told)) }
            })
            .collect()
    }
}

/// What [`Hand::close`] does for a hand that has no better way: [`Hand::grip`] after grip. The way to where contact is
/// expected is gone in a few parts, so that no finger gets far ahead of the others; then all are told the squeeze, and
/// on from there while fewer than two motors are held.
pub(crate) async fn close_in_grips<H: Hand + ?Sized>(
    hand: &H,
    command: &CloseCommand,
    timeout: Duration,
) -> Result<HandState, DeviceError> {
    let info = hand.info();
    command.check(&info)?;
    let until = Instant::now() + timeout;
    let left = || {
        let left = until.saturating_duration_since(Instant::now());
        let late = DeviceError::Timeout { device: info.name.clone(), operation: "close", after: timeout };
        if left.is_zero() { Err(late) } else { Ok(left) }
    };
    let (speed, force) = (command.speed, command.force);
    let from = hand.state(left()?).await?.actuators;
    if from.len() != command.contact.len() {
        let detail = format!("{} actuators reported, expected {}", from.len(), command.contact.len());
        return Err(DeviceError::Protocol { device: info.name, detail });
    }
    let meeting = command.meeting(&from);
    for part in 1..=PARTS {
        let share = f64::from(part) / f64::from(PARTS);
        let between = |(from, meeting): (&f64, &f64)| from + share * (meeting - from);
        let actuators = from.iter().zip(&meeting).map(between).collect();
        hand.grip(&GripCommand { actuators, speed, force }, left()?).await?;
    }
    let mut told = command.squeezed.clone();
    let mut state = hand.grip(&GripCommand { actuators: told.clone(), speed, force }, left()?).await?;
    for _ in 0..MORE_SQUEEZES {
        let held = state.held.iter().filter(|h| **h).count();
        let next = command.farther(&told);
        if held >= HELD_MOTORS.min(state.held.len()) || next == told {
            break;
        }
        told = next;
        state = hand.grip(&GripCommand { actuators: told.clone(), speed, force }, left()?).await?;
    }
    Ok(state)
}

#[cfg(test)]
mod tests {
    use std::future::Future;
    use std::pin::pin;
    use std::sync::{Mutex, PoisonError};
    use std::task::{Context, Poll, Waker};

    use super::*;
    use crate::async_trait;

    /// Fingers that stop where something is.
    #[derive(Debug)]
    struct Stepper {
        at: Mutex<Vec<f64>>,
        walls: Vec<f64>,
        grips: Mutex<Vec<Vec<f64>>>,
    }

    impl Stepper {
        fn new(walls: &[f64]) -> Self {
            Self { at: Mutex::new(vec![0.0; 2]), walls: walls.to_vec(), grips: Mutex::default() }
        }
    }

    #[async_trait]
    impl Hand for Stepper {
        fn info(&self) -> HandInfo {
            HandInfo {
                name: "stepper".into(),
                hand_id: "stepper".into(),
                actuators: vec!["a".into(), "b".into()],
                feels_contact: true,
            }
        }

        async fn state(&self, _: Duration) -> Result<HandState, DeviceError> {
            let actuators = self.at.lock().unwrap_or_else(PoisonError::into_inner).clone();
            let held = actuators.iter().zip(&self.walls).map(|(at, wall)| at >= wall).collect();
            Ok(HandState { actuators, held, settled: true })
        }

        async fn grip(&self, command: &GripCommand, timeout: Duration) -> Result<HandState, DeviceError> {
            self.grips.lock().unwrap().push(command.actuators.clone());
            let reached = command.actuators.iter().zip(&self.walls).map(|(to, wall)| to.min(*wall)).collect();
            *self.at.lock().unwrap() = reached;
            self.state(timeout).await
        }

        async fn clear_fault(&self, _: Duration) -> Result<(), DeviceError> {
            Ok(())
        }
    }

    /// Nothing here waits for anything.
    fn done<T>(future: impl Future<Output = T>) -> T {
        match pin!(future).poll(&mut Context::from_waker(Waker::noop())) {
            Poll::Ready(value) => value,
            Poll::Pending => panic!("a step waits"),
        }
    }

    fn command() -> CloseCommand {
        CloseCommand {
            contact: vec![0.5, 1.0],
            squeezed: vec![0.6, 1.1],
            farthest: vec![0.75, 2.0],
            meet: Duration::from_millis(500),
            speed: 1.0,
            force: 0.5,
        }
    }

    #[test]
    fn fingers_go_to_contact_together_and_on_until_two_are_held() {
        let hand = Stepper::new(&[0.7, 1.25]);
        let state = done(hand.close(&command(), Duration::from_secs(9))).unwrap();
        assert_eq!((state.actuators, state.held), (vec![0.7, 1.25], vec![true, true]));
        let grips = hand.grips.lock().unwrap();
        for (part, grip) in grips[..5].iter().enumerate() {
            let share = (part + 1) as f64 / 5.0;
            assert!((grip[0] - 0.5 * share).abs() < 1e-12 && (grip[1] - share).abs() < 1e-12, "{grips:?}");
        }
        assert_eq!(grips[5], [0.6, 1.1]);
        // No actuator is told to go beyond its farthest position.
        assert!(grips.len() == 8 && (grips[7][0] - 0.75).abs() < 1e-12, "{grips:?}");
    }

    #[test]
    fn fingers_that_meet_nothing_end_at_their_farthest_position() {
        let hand = Stepper::new(&[9.0, 9.0]);
        let state = done(hand.close(&command(), Duration::from_secs(9))).unwrap();
        assert!((state.actuators[0] - 0.75).abs() < 1e-12 && !state.feels_object());
        assert!(state.actuators[1] <= 2.0);
    }

    #[test]
    fn what_cannot_be_is_refused_before_anything_moves() {
        for (command, expected) in [
            (CloseCommand { contact: vec![0.5], ..command() }, "contact"),
            (CloseCommand { squeezed: vec![0.5, f64::NAN], ..command() }, "squeezed"),
            (CloseCommand { farthest: Vec::new(), ..command() }, "farthest"),
            (CloseCommand { force: 1.5, ..command() }, "force"),
        ] {
            let hand = Stepper::new(&[9.0, 9.0]);
            let error = done(hand.close(&command, Duration::from_secs(9))).unwrap_err();
            assert!(matches!(&error, DeviceError::OutOfRange { field, .. } if field == expected), "{error}");
            assert!(hand.grips.lock().unwrap().is_empty());
        }
        let hand = Stepper::new(&[9.0, 9.0]);
        let late = done(hand.close(&command(), Duration::ZERO)).unwrap_err();
        assert!(matches!(late, DeviceError::Timeout { operation: "close", .. }), "{late}");
    }
}
