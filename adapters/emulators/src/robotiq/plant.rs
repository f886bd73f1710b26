//! What a gripper's motors move. Positions are in the gripper's counts: 0 open to 255 closed.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// What a motor is told at a moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisCommand {
    /// Where to go, counts; `None`: it stays.
    pub target: Option<f64>,
    /// Share of the speed between the slowest and the fastest, 0 to 1.
    pub speed: f64,
    /// Share of the force between the weakest and the strongest, 0 to 1.
    pub force: f64,
}

/// What stopped a motor before its target.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Contact {
    /// Something inside it, while it opened.
    Opening,
    /// Something between the fingers, while it closed.
    Closing,
}

/// How a motor is.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AxisState {
    /// Where it is, counts.
    pub position: f64,
    /// It is on its way.
    pub moving: bool,
    /// What stopped it.
    pub contact: Option<Contact>,
    /// Its current, 10 mA each.
    pub current: f64,
}

/// What the motors of a gripper move: one of a 2F; fingers A, B, C and scissor of a 3-Finger. A simulated world
/// implements this to stand behind the gripper; it must not keep its caller waiting, who answers on the line.
pub trait Plant: Send + 'static {
    /// Lets `elapsed` pass under these commands; `states[i]` belongs to `commands[i]`. Called whenever the gripper is
    /// asked something.
    fn advance(&mut self, elapsed: Duration, commands: &[AxisCommand], states: &mut [AxisState]);
}

impl<P: Plant + ?Sized> Plant for Box<P> {
    fn advance(&mut self, elapsed: Duration, commands: &[AxisCommand], states: &mut [AxisState]) {
        (**self).advance(elapsed, commands, states);
    }
}

/// Motors that go to their targets at their speed, and stop at objects.
#[derive(Debug)]
pub struct KinematicPlant {
    objects: Objects,
    /// Mechanical end positions, counts.
    ends: (f64, f64),
    /// Slowest and fastest, counts per second.
    speeds: (f64, f64),
}

/// Where objects are, for each motor; clones are handles to the same.
#[derive(Debug, Clone, Default)]
pub struct Objects(Arc<Mutex<Met>>);

#[derive(Debug, Default)]
struct Met {
    closing: BTreeMap<usize, f64>,
    opening: BTreeMap<usize, f64>,
}

impl Objects {
    fn lock(&self) -> MutexGuard<'_, Met> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Motor `axis` meets something at a position when it closes; `None`: nothing.
    pub fn between(&self, axis: usize, count: Option<f64>) {
        set(&mut self.lock().closing, axis, count);
    }

    /// Motor `axis` meets something at a position when it opens; `None`: nothing.
    pub fn around(&self, axis: usize, count: Option<f64>) {
        set(&mut self.lock().opening, axis, count);
    }
}

fn set(map: &mut BTreeMap<usize, f64>, axis: usize, count: Option<f64>) {
    match count {
        Some(count) => map.insert(axis, count),
        None => map.remove(&axis),
    };
}

impl KinematicPlant {
    /// A 2F-85: 20 to 150 mm/s over 85 mm, mechanically between counts 3 and 230.
    pub fn two_finger() -> Self {
        let counts_per_mm = 227.0 / 85.0;
        Self {
            objects: Objects::default(),
            ends: (3.0, 230.0),
            speeds: (20.0 * counts_per_mm, 150.0 * counts_per_mm),
        }
    }

    /// A 3-Finger: 22 to 110 mm/s at the fingertips over some 155 mm.
    pub fn three_finger() -> Self {
        let counts_per_mm = 255.0 / 155.0;
        Self {
            objects: Objects::default(),
            ends: (6.0, 241.0),
            speeds: (22.0 * counts_per_mm, 110.0 * counts_per_mm),
        }
    }

    /// The same, so many times as fast: for tests that do not want to wait.
    pub fn times_as_fast(mut self, factor: f64) -> Self {
        self.speeds = (self.speeds.0 * factor, self.speeds.1 * factor);
        self
    }

    /// Where objects are.
    pub fn objects(&self) -> Objects {
        self.objects.clone()
    }
}

impl Plant for KinematicPlant {
    fn advance(&mut self, elapsed: Duration, commands: &[AxisCommand], states: &mut [AxisState]) {
        let dt = elapsed.as_secs_f64();
        let met = self.objects.lock();
        for (axis, (command, state)) in commands.iter().zip(states).enumerate() {
            let from = state.position.clamp(self.ends.0, self.ends.1);
            state.position = from;
            let Some(target) = command.target else {
                (state.moving, state.current) = (false, 0.0);
                continue;
            };
            let target = target.clamp(self.ends.0, self.ends.1);
            let most = dt * (self.speeds.0 + command.speed * (self.speeds.1 - self.speeds.0));
            let mut to = from + (target - from).clamp(-most, most);
            let mut contact = None;
            if let Some(object) = met.closing.get(&axis).filter(|o| to > **o && target > **o) {
                (to, contact) = (object.max(from), Some(Contact::Closing));
            }
            if let Some(object) = met.opening.get(&axis).filter(|o| to < **o && target < **o) {
                (to, contact) = (object.min(from), Some(Contact::Opening));
            }
            let there = (target - to).abs() < 0.5;
            state.position = to;
            state.contact = if there { None } else { contact };
            state.moving = !there && contact.is_none();
            state.current = match (state.moving, state.contact) {
                (true, _) => 10.0,
                (false, Some(_)) => 5.0 + 60.0 * command.force,
                (false, None) => 0.0,
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn command(target: f64) -> AxisCommand {
        AxisCommand { target: Some(target), speed: 1.0, force: 1.0 }
    }

    #[test]
    fn a_motor_stops_at_its_target_at_its_ends_and_at_objects() {
        let mut plant = KinematicPlant::two_finger();
        let objects = plant.objects();
        let mut states = [AxisState::default()];
        let second = Duration::from_secs(1);
        plant.advance(Duration::from_millis(100), &[command(255.0)], &mut states);
        assert!(states[0].moving && (states[0].position - 43.06).abs() < 0.01, "{states:?}");
        plant.advance(second, &[command(255.0)], &mut states);
        assert_eq!((states[0].position, states[0].moving, states[0].contact), (230.0, false, None));
        plant.advance(second, &[command(0.0)], &mut states);
        assert!((states[0].position - 3.0).abs() < 1e-9);
        objects.between(0, Some(100.0));
        plant.advance(second, &[command(255.0)], &mut states);
        assert_eq!((states[0].position, states[0].contact), (100.0, Some(Contact::Closing)));
        // An object that is gone: the motor goes on.
        objects.between(0, None);
        plant.advance(second, &[command(255.0)], &mut states);
        assert_eq!((states[0].position, states[0].contact), (230.0, None));
        objects.around(0, Some(50.0));
        plant.advance(second, &[command(0.0)], &mut states);
        assert_eq!((states[0].position, states[0].contact), (50.0, Some(Contact::Opening)));
    }
}
