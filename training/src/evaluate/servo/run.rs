//! Trays cleared with the servo, and what is written down of every attempt.

use std::sync::Arc;

use graspd_hands::Hand;
use graspd_planner::estimator::ContactEstimator;
use graspd_planner::options::{PlanOptions, VolumeKind};
use graspd_planner::servo::{Mode, Servo, ServoOptions};
use graspd_sim::camera::look_at;
use graspd_sim::clutter::settle;
use graspd_sim::execute::execute;
use graspd_sim::world::{World, WorldSettings};
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use super::approach::{Approach, Arrived, Way};
use super::paired::Pair;
use super::palm::PalmCamera;
use super::settings::{Group, ServoSettings};
use crate::evaluate::contents::{Contents, SETTLE_S, put_back};
use crate::evaluate::seeds::derive;
use crate::evaluate::workers::in_turn;
use crate::evaluate::{Class, EvaluationError, Station, command};

/// Where the palm camera first looks from, world frame, metres.
const EYE: [f64; 3] = [0.0, -0.06, 0.46];
/// More attempts than so many times the objects of a tray are never made.
const MOST_ATTEMPTS: usize = 4;

/// One attempt, written down.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ServoAttempt {
    /// What became of it; `no_grasp` where nothing was gripped for.
    pub class: Class,
    /// Without a grip: why.
    pub nothing: Option<String>,
    /// Objects that were held.
    pub held: usize,
    /// Objects in the tray before it.
    pub objects: usize,
    /// The approach.
    pub way: Way,
    /// Every grasp that was announced as another one: frame, reason, score, stand-off.
    #[serde(default)]
    pub replans: Vec<String>,
}

/// One tray, cleared or given up.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ServoTray {
    /// Id of the hand.
    pub hand: String,
    /// The objects.
    pub group: Group,
    /// Which run, from 0.
    pub run: usize,
    /// True for the dynamic mode.
    pub is_dynamic: bool,
    /// Objects in the beginning.
    pub objects: usize,
    /// Objects that were lifted and dropped in the container.
    pub cleared: usize,
    /// Every attempt, in order.
    pub attempts: Vec<ServoAttempt>,
}

/// How a tray's attempts ended, counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ServoEnd {
    /// Attempts in which the hand gripped.
    pub trials: usize,
    /// Successful ones.
    pub successes: usize,
    /// Objects that were held in these.
    pub grasped: usize,
    /// Objects, and those that were cleared.
    pub objects: usize,
    /// See `objects`.
    pub cleared: usize,
}

/// Who wants to know while it runs; called from several threads.
pub trait ServoObserver: Sync {
    /// An attempt has ended.
    fn attempt(&self, attempt: &ServoAttempt);
    /// A tray has ended.
    fn tray(&self, tray: &ServoTray);
    /// A pair of attempts has ended.
    fn pair(&self, pair: &Pair);
}

impl ServoTray {
    /// Its attempts, counted.
    pub fn end(&self) -> ServoEnd {
        let of = |keep: &dyn Fn(&&ServoAttempt) -> bool| self.attempts.iter().filter(keep).count();
        ServoEnd {
            trials: of(&|a| a.class != Class::NoGrasp),
            successes: of(&|a| a.class == Class::Success),
            grasped: self.attempts.iter().map(|a| a.held).sum(),
            objects: self.objects,
            cleared: self.cleared,
        }
    }
}

/// Clears every tray with every hand in every mode, but for those that are `done` already. The trays are in the order of
/// groups, runs, hands and modes, and do not depend on the number of workers.
///
/// # Errors
/// [`EvaluationError`] for settings of no use, and for what the world refuses.
pub fn clear_with_servo(
    settings: &ServoSettings,
    estimator: &Arc<dyn ContactEstimator>,
    observer: &dyn ServoObserver,
    done: &[ServoTray],
) -> Result<Vec<ServoTray>, EvaluationError> {
    settings.validate()?;
    let mut jobs = Vec::new();
    for run in 0..settings.runs {
        for &group in &settings.groups {
            for hand in &settings.hands {
                jobs.extend(settings.modes.iter().map(|&mode| (group, run, hand, mode)));
            }
        }
    }
    in_turn(jobs.len(), settings.workers, |index| {
        let (group, run, hand, mode) = jobs[index];
        let is_this = |t: &&ServoTray| {
            (t.group, t.run, t.is_dynamic) == (group, run, mode == Mode::Dynamic) && t.hand == hand.id
        };
        if let Some(tray) = done.iter().find(is_this) {
            return Ok(tray.clone());
        }
        let tray = clear_tray(settings, estimator, group, run, hand, mode, observer)?;
        observer.tray(&tray);
        Ok(tray)
    })
}

/// The seed of one tray.
pub(super) fn run_seed(settings: &ServoSettings, group: Group, run: usize) -> u64 {
    derive(settings.seed, &[group as u64, run as u64])
}

/// A tray with its objects at rest.
pub(super) struct Poured {
    pub(super) station: Station,
    pub(super) world: World,
    pub(super) objects: usize,
    pub(super) contents: Contents,
}

impl Poured {
    pub(super) fn new(
        settings: &ServoSettings,
        group: Group,
        run_seed: u64,
    ) -> Result<Self, EvaluationError> {
        let objects = match settings.nudge {
            Some(nudge) => group.draw_some(nudge.objects, derive(run_seed, &[0])),
            None => group.draw(derive(run_seed, &[0])),
        };
        let station = Station {
            world: WorldSettings { tray: Some(settings.tray), ..WorldSettings::default() },
            sensor: settings.sensor.clone(),
            ..Station::tray()
        };
        let world = station.poured(&objects, derive(run_seed, &[1]))?;
        Ok(Self { station, world, objects: objects.len(), contents: Contents::new(&objects) })
    }
}

/// One tray. Objects, how they lie, and the noise of the first frame are the same for every hand and mode.
fn clear_tray(
    settings: &ServoSettings,
    estimator: &Arc<dyn ContactEstimator>,
    group: Group,
    run: usize,
    hand: &Arc<Hand>,
    mode: Mode,
    observer: &dyn ServoObserver,
) -> Result<ServoTray, EvaluationError> {
    let run_seed = run_seed(settings, group, run);
    let Poured { station, mut world, objects, mut contents } = Poured::new(settings, group, run_seed)?;
    let mut tray = ServoTray {
        hand: hand.id.clone(),
        group,
        run,
        is_dynamic: mode == Mode::Dynamic,
        objects,
        cleared: 0,
        attempts: Vec::new(),
    };
    let mut in_vain = 0;
    while !contents.present.is_empty()
        && in_vain < settings.give_up
        && tray.attempts.len() < MOST_ATTEMPTS * objects
    {
        let number = tray.attempts.len() as u64;
        put_back(&mut world, &station, derive(run_seed, &[2, number]));
        let seed = derive(run_seed, &[3, number]);
        let attempt = attempt(settings, &station, estimator, hand, mode, seed, &mut world, &mut contents)?;
        in_vain = if attempt.class == Class::NoGrasp { in_vain + 1 } else { 0 };
        observer.attempt(&attempt);
        tray.attempts.push(attempt);
        settle(&mut world, SETTLE_S);
    }
    tray.cleared = contents.items.iter().filter(|i| i.cleared).count();
    Ok(tray)
}

/// Looks, comes nearer, grips, lifts, and takes out of the tray what is held.
#[allow(clippy::too_many_arguments)] // the parts of one attempt
pub(super) fn attempt(
    settings: &ServoSettings,
    station: &Station,
    estimator: &Arc<dyn ContactEstimator>,
    hand: &Arc<Hand>,
    mode: Mode,
    seed: u64,
    world: &mut World,
    contents: &mut Contents,
) -> Result<ServoAttempt, EvaluationError> {
    let mut camera = PalmCamera::new(hand, settings.sensor.clone());
    let world_from_camera = look_at(&Point3::from(EYE), &Point3::new(0.0, 0.0, 0.02), &Vector3::y());
    let world_from_hand = world_from_camera * camera.hand_from_camera.inverse();
    let options = options(settings, station, mode, seed, &camera);
    let mut servo = Servo::new(Arc::clone(hand), options, Arc::clone(estimator)).map_err(|e| {
        EvaluationError::Setting { field: e.field, found: e.found, expected: e.expected.into() }
    })?;
    let objects = contents.present.len();
    let id = world.add_hand(Arc::clone(hand), &world_from_hand, &[]);
    let approach = Approach {
        world,
        hand: id,
        camera: &mut camera,
        servo: &mut servo,
        frames_per_s: settings.frames_per_s,
        nudge: settings.nudge,
        seed,
    };
    let (arrived, way, replans) = approach.run();
    let grasp = match arrived {
        Arrived::Go(grasp) => grasp,
        Arrived::Nothing(why) => {
            world.remove_hand(id);
            return Ok(ServoAttempt {
                class: Class::NoGrasp,
                nothing: Some(why.to_owned()),
                held: 0,
                objects,
                way,
                replans,
            });
        }
    };
    let mut command = command(&grasp);
    // The hand stands at its stand-off already: from here straight in.
    if let Some(state) = world.hand_state(id) {
        command.world_from_pregrasp = state.world_from_hand;
    }
    let ids = world.ids();
    let trial = execute(world, id, &command, &settings.execute, &mut |_, _| {});
    world.remove_hand(id);
    let place = |id| ids.iter().position(|&i| i == id);
    let mut gone: Vec<usize> = trial.held.iter().filter_map(|&id| place(id)).collect();
    let held = gone.len();
    for &at in &gone {
        contents.items[contents.present[at]].cleared = true;
    }
    let class = Class::of(&trial);
    if class != Class::Success
        && let Some(at) = trial.meant.and_then(place)
    {
        let failures = &mut contents.failures[contents.present[at]];
        *failures += 1;
        if *failures >= settings.give_up && !gone.contains(&at) {
            gone.push(at);
        }
    }
    gone.sort_unstable();
    for &at in gone.iter().rev() {
        contents.take(world, at);
    }
    Ok(ServoAttempt { class, nothing: None, held, objects, way, replans })
}

/// The servo's options for one attempt.
fn options(
    settings: &ServoSettings,
    station: &Station,
    mode: Mode,
    seed: u64,
    camera: &PalmCamera,
) -> ServoOptions {
    let base = match mode {
        Mode::Dynamic => settings.servo.clone(),
        Mode::Static => {
            let scheme = ServoOptions::of_first_frame().plan.scheme;
            let plan = PlanOptions { scheme, ..settings.servo.plan.clone() };
            ServoOptions { plan, ..settings.servo.clone() }
        }
    };
    ServoOptions {
        mode,
        scene: station.scene_options(VolumeKind::Tsdf),
        plan: PlanOptions { keep_out: station.keep_out(), seed: derive(seed, &[9]), ..base.plan },
        hand_from_camera: Some(camera.hand_from_camera),
        ..base
    }
}
