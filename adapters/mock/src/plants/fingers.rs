//! The fingers of a hand of the world as motors of an emulated device: targets, speeds and forces in, positions, speeds
//! and loads out.

use graspd_adapters_core::check::SettingsError;
use graspd_hands::{Coordinate, CoordinateKind};
use graspd_sim::world::{Command, HandId, World};

use super::{FarEnd, Line, require_hand, require_speed};
use crate::shared::SharedWorld;
use crate::stage::Process;

/// An actuator stands when, for a while, it has not gone farther than this share of its range.
const STILL_SHARE: f64 = 1e-3;
/// What a motor is led to is never farther ahead of where it is than this share of its range: let go, it does not snap.
const AHEAD_SHARE: f64 = 0.3;
/// Speeds are smoothed over this time, seconds.
const SPEED_S: f64 = 0.02;

/// What the motors are told; lists in the order of the hand's actuators.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Told {
    /// Where to go, radians or metres; `None`: stay, and go on pressing.
    pub(super) targets: Vec<Option<f64>>,
    /// How fast, per second.
    pub(super) speeds: Vec<f64>,
    /// Share of its full effort that each may use.
    pub(super) forces: Vec<f64>,
}

/// What was measured of one motor.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Seen {
    pub(super) position: f64,
    pub(super) velocity: f64,
    /// Share of its full effort, in its own direction.
    pub(super) load: f64,
    /// How long it has stood since it was last told something new, seconds.
    pub(super) still_s: f64,
}

#[derive(Debug)]
struct Said {
    told: Option<Told>,
    /// Counts what was told, and up to where the world has taken it.
    count: u64,
    taken: u64,
    seen: Vec<Seen>,
}

/// The near end: what a device holds.
#[derive(Debug)]
pub(super) struct Fingers {
    line: Line<Said>,
    /// The hand's actuators.
    pub(super) actuators: Vec<Coordinate>,
}

impl Fingers {
    /// For a hand of the world, whose fingers nobody else may move.
    pub(super) async fn new(shared: &SharedWorld, hand: HandId) -> Result<Self, SettingsError> {
        require_speed(shared)?;
        let begun = shared.on_stage(move |stage| {
            let coordinates = stage.world.hand(hand)?.actuation.coordinates.clone();
            let actuators: Vec<Coordinate> =
                coordinates.into_iter().filter(|c| c.kind == CoordinateKind::Actuator).collect();
            let positions = stage.world.hand_state(hand)?.actuators;
            let seen = positions.iter().map(|p| Seen { position: *p, ..Seen::default() }).collect();
            let line = Line::new(Said { told: None, count: 0, taken: 0, seen });
            let full = stage.world.full_efforts(hand)?;
            stage.start(Lead {
                line: line.far_end(),
                hand,
                full,
                actuators: actuators.clone(),
                references: positions.clone(),
                anchors: positions.iter().map(|p| (*p, stage.world.time_s())).collect(),
                before: positions,
                commanded: None,
            });
            Some(Self { line, actuators })
        });
        require_hand(begun.await.ok().flatten())
    }

    /// Tells the motors; the same again is nothing new.
    pub(super) fn tell(&self, told: Told) {
        let mut line = self.line.lock();
        if line.told.as_ref() != Some(&told) {
            line.told = Some(told);
            line.count += 1;
        }
    }

    /// Lets the motors stay where they are and press on as they do.
    pub(super) fn hold(&self) {
        let told = self.line.lock().told.clone();
        if let Some(told) = told {
            self.tell(Told { targets: vec![None; told.targets.len()], ..told });
        }
    }

    /// What was measured last, and whether it is about what was told last.
    pub(super) fn seen(&self) -> (Vec<Seen>, bool) {
        let line = self.line.lock();
        (line.seen.clone(), line.taken == line.count)
    }
}

/// Leads the motors after each step of the world; ends with the device.
struct Lead {
    line: FarEnd<Said>,
    hand: HandId,
    full: Vec<f64>,
    actuators: Vec<Coordinate>,
    references: Vec<f64>,
    /// Where each actuator was when it last moved, and when that was.
    anchors: Vec<(f64, f64)>,
    before: Vec<f64>,
    commanded: Option<(Vec<f64>, Vec<f64>)>,
}

impl Process for Lead {
    fn after_step(&mut self, world: &mut World) -> bool {
        let Some(line) = self.line.line() else { return true };
        let Some(state) = world.hand_state(self.hand) else { return true };
        let (dt, now_s) = (world.settings().dt_s, world.time_s());
        let mut line = line.lock();
        if line.taken != line.count {
            line.taken = line.count;
            self.anchors = state.actuators.iter().map(|p| (*p, now_s)).collect();
        }
        let blend = (dt / SPEED_S).min(1.0);
        for (i, seen) in line.seen.iter_mut().enumerate() {
            let (position, c) = (state.actuators[i], &self.actuators[i]);
            let speed = (position - self.before[i]) / dt;
            seen.position = position;
            seen.velocity += (speed - seen.velocity) * blend;
            let upwards = if c.closed < c.open { -1.0 } else { 1.0 };
            seen.load = upwards * state.efforts[i] / self.full[i].max(1e-9);
            let (anchor, since_s) = &mut self.anchors[i];
            if (position - *anchor).abs() > STILL_SHARE * (c.upper - c.lower) {
                (*anchor, *since_s) = (position, now_s);
            }
            seen.still_s = now_s - *since_s;
        }
        self.before.clone_from(&state.actuators);
        let Some(told) = &line.told else { return false };
        for (i, c) in self.actuators.iter().enumerate() {
            let Some(target) = told.targets[i] else { continue };
            let (most, ahead) = (told.speeds[i] * dt, AHEAD_SHARE * (c.upper - c.lower));
            let way = (target.clamp(c.lower, c.upper) - self.references[i]).clamp(-most, most);
            self.references[i] =
                (self.references[i] + way).clamp(state.actuators[i] - ahead, state.actuators[i] + ahead);
        }
        let command = (self.references.clone(), told.forces.clone());
        drop(line);
        if self.commanded.as_ref() != Some(&command) {
            let actuators = command.0.clone();
            let close = Command::Close { actuators, force: 1.0, speed: 1.0 };
            if !(world.share_forces(self.hand, &command.1) && world.command(self.hand, close)) {
                return true;
            }
            self.commanded = Some(command);
        }
        false
    }
}
