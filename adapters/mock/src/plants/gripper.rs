//! The fingers of a Robotiq hand of the world behind an emulated gripper.
//!
//! Counts are the gripper's own: a 2F counts 3 wide open to 230 closed; a 3-Finger's first joints go from 0 to 148,
//! beyond which only its other joints would move (they follow the object by themselves here), its scissor from 15 to 240.

use std::time::Duration;

use graspd_adapters_core::check::SettingsError;
use graspd_adapters_emulators::robotiq::{AxisCommand, AxisState, Contact, Plant};
use graspd_sim::world::HandId;

use super::fingers::{Fingers, Told};
use crate::shared::SharedWorld;

/// A motor that has stood for so long, seconds, has come to its end.
const STANDS_S: f64 = 0.12;
/// So near to its target it is there, counts.
const THERE: f64 = 2.0;
/// Current of a motor under full load, the gripper's counts.
const FULL_LOAD: f64 = 65.0;

/// One motor of the gripper.
#[derive(Debug, Clone, Copy)]
struct Axis {
    /// Index of the hand's actuator.
    actuator: usize,
    /// Counts at both ends, and the actuator's values there.
    counts: (f64, f64),
    values: (f64, f64),
    /// Slowest and fastest, counts per second.
    speeds: (f64, f64),
}

impl Axis {
    fn value(&self, count: f64) -> f64 {
        let (c, v) = (self.counts, self.values);
        v.0 + (count.clamp(c.0, c.1) - c.0) / (c.1 - c.0) * (v.1 - v.0)
    }

    fn count(&self, value: f64) -> f64 {
        let (c, v) = (self.counts, self.values);
        (c.0 + (value - v.0) / (v.1 - v.0) * (c.1 - c.0)).clamp(c.0.min(c.1), c.0.max(c.1))
    }
}

/// A body for an emulated gripper: the fingers of a hand of the world.
#[derive(Debug)]
pub struct GripperPlant {
    fingers: Fingers,
    axes: Vec<Axis>,
    /// Weakest force as a share of the strongest.
    weakest: f64,
    /// As told last, share of the full effort of each actuator: what stands presses on with it.
    forces: Vec<f64>,
}

impl GripperPlant {
    /// For a 2F: a hand with one actuator that slides its fingers together.
    ///
    /// # Errors
    /// [`SettingsError`] for a world that runs on demand, a hand that is not there or not such a hand.
    pub async fn two_finger(shared: &SharedWorld, hand: HandId) -> Result<Self, SettingsError> {
        let fingers = Fingers::new(shared, hand).await?;
        let [grip] = &fingers.actuators[..] else { return Err(other_hand(&fingers, "one actuator")) };
        let (counts, values) = ((3.0, 230.0), (grip.lower, grip.upper));
        // 20 to 150 mm/s over 85 mm.
        let speeds = (20.0 * 227.0 / 85.0, 150.0 * 227.0 / 85.0);
        let axes = vec![Axis { actuator: 0, counts, values, speeds }];
        let weakest = 20.0 / 235.0;
        Ok(Self { fingers, axes, weakest, forces: vec![weakest] })
    }

    /// For a 3-Finger: a hand whose actuators are `scissor`, `finger_1`, `finger_2` and `finger_middle`.
    ///
    /// # Errors
    /// As [`GripperPlant::two_finger`].
    pub async fn three_finger(shared: &SharedWorld, hand: HandId) -> Result<Self, SettingsError> {
        let fingers = Fingers::new(shared, hand).await?;
        // 22 to 110 mm/s at the fingertips over some 155 mm.
        let speeds = (22.0 * 255.0 / 155.0, 110.0 * 255.0 / 155.0);
        let mut axes = Vec::new();
        // Fingers A (the middle one), B, C and scissor.
        for name in ["finger_middle", "finger_1", "finger_2", "scissor"] {
            let found = fingers.actuators.iter().position(|c| c.name == name);
            let Some(actuator) = found else { return Err(other_hand(&fingers, name)) };
            let (counts, values) = if name == "scissor" {
                let end = 11_f64.to_radians();
                ((15.0, 240.0), (end, -end))
            } else {
                ((0.0, 148.0), (0.0, 1.2218))
            };
            axes.push(Axis { actuator, counts, values, speeds });
        }
        let weakest = 15.0 / 60.0;
        let forces = vec![weakest; fingers.actuators.len()];
        Ok(Self { fingers, axes, weakest, forces })
    }
}

fn other_hand(fingers: &Fingers, expected: &str) -> SettingsError {
    let found: Vec<&str> = fingers.actuators.iter().map(|c| c.name.as_str()).collect();
    SettingsError { field: "hand".into(), found: format!("actuators {found:?}"), expected: expected.into() }
}

impl Plant for GripperPlant {
    fn advance(&mut self, _: Duration, commands: &[AxisCommand], states: &mut [AxisState]) {
        let count = self.fingers.actuators.len();
        let (targets, speeds) = (vec![None; count], vec![0.0; count]);
        let mut told = Told { targets, speeds, forces: self.forces.clone() };
        let mut goes = false;
        for (axis, command) in self.axes.iter().zip(commands) {
            let (slowest, fastest) = axis.speeds;
            let counts_s = slowest + command.speed * (fastest - slowest);
            let (c, v) = (axis.counts, axis.values);
            told.speeds[axis.actuator] = counts_s * ((v.1 - v.0) / (c.1 - c.0)).abs();
            if let Some(target) = command.target {
                goes = true;
                told.targets[axis.actuator] = Some(axis.value(target));
                told.forces[axis.actuator] = self.weakest + command.force * (1.0 - self.weakest);
            }
        }
        if goes {
            self.forces.clone_from(&told.forces);
            self.fingers.tell(told);
        } else {
            self.fingers.hold();
        }
        let (seen, current) = self.fingers.seen();
        for ((axis, command), state) in self.axes.iter().zip(commands).zip(states) {
            let Some(seen) = seen.get(axis.actuator) else { continue };
            state.position = axis.count(seen.position);
            state.current = FULL_LOAD * seen.load.abs();
            let Some(target) = command.target else {
                (state.moving, state.current) = (false, 0.0);
                continue;
            };
            let (least, most) = (axis.counts.0.min(axis.counts.1), axis.counts.0.max(axis.counts.1));
            let way = target.clamp(least, most) - state.position;
            let stands = current && seen.still_s >= STANDS_S;
            state.moving = !stands;
            state.contact = match way {
                _ if !stands || way.abs() <= THERE => None,
                way if way > 0.0 => Some(Contact::Closing),
                _ => Some(Contact::Opening),
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_and_values_are_two_names_of_one_place() {
        let axis = Axis { actuator: 0, counts: (15.0, 240.0), values: (0.19, -0.19), speeds: (1.0, 2.0) };
        for count in [15.0, 100.0, 240.0] {
            assert!((axis.count(axis.value(count)) - count).abs() < 1e-9);
        }
        assert_eq!((axis.value(0.0), axis.value(255.0)), (0.19, -0.19));
        assert_eq!((axis.count(1.0), axis.count(-1.0)), (15.0, 240.0));
    }
}
