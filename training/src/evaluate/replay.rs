//! Failed trials, kept so that anyone can look at them: the world's file, the grasp, and what was thought of
//! it.

use std::sync::Arc;

use graspd_hands::Hand;
use graspd_planner::estimator::ContactEstimator;
use graspd_planner::options::{PlanOptions, Scheme, VolumeKind};
use graspd_sim::execute::{ExecuteSettings, GraspCommand, Moment};
use graspd_sim::scene;
use graspd_sim::world::World;
use serde::{Deserialize, Serialize};

use super::EvaluationError;
use super::attempt::{Attempt, Class, Conditions, Figures, command};
use super::station::Station;

/// The layout of the file; raised with every change that old files do not survive.
const VERSION: u32 = 2;
/// Most candidates of a search; `graspd eval clear` allows 4096, and four times as many after plans in vain.
const MOST_CANDIDATES: usize = 16_384;
/// Most iterations of a search.
const MOST_ITERATIONS: usize = 10_000;
/// Farthest from the world's origin that a hand may be sent along an axis, metres.
const FARTHEST_M: f64 = 10.0;

/// One failed attempt: all it takes to execute it again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FailedTrial {
    /// Layout of the file.
    pub version: u32,
    /// The attempt.
    pub attempt: Attempt,
    /// Revision of the hand's files.
    pub hand_revision: String,
    /// The grasp that was executed; none where none was found.
    pub command: Option<GraspCommand>,
    /// How it was executed.
    pub execute: ExecuteSettings,
    /// Candidates of the search.
    pub batch: usize,
    /// Iterations, and how many of them with penetration.
    pub scheme: [usize; 2],
    /// True where the volume stored occupancy.
    pub occupancy: bool,
    /// Seed of the depth camera's noise.
    pub noise_seed: u64,
    /// Seed of the search.
    pub plan_seed: u64,
    /// The world before the attempt, as the scene's own file.
    pub scene: serde_json::Value,
}

impl FailedTrial {
    #[expect(clippy::too_many_arguments, reason = "it gathers what one attempt consists of")]
    pub(crate) fn new(
        attempt: &Attempt,
        hand: &Hand,
        scene_json: &str,
        command: Option<GraspCommand>,
        execute: &ExecuteSettings,
        search: &PlanOptions,
        volume: VolumeKind,
        [noise_seed, plan_seed]: [u64; 2],
    ) -> Result<Self, EvaluationError> {
        Ok(Self {
            version: VERSION,
            attempt: attempt.clone(),
            hand_revision: hand.revision.clone(),
            command,
            execute: execute.clone(),
            batch: search.batch,
            scheme: [search.scheme.iterations, search.scheme.with_penetration],
            occupancy: volume == VolumeKind::Occupancy,
            noise_seed,
            plan_seed,
            scene: serde_json::from_str(scene_json)?,
        })
    }

    /// A name for its file, for example `leap_clutter_run3_attempt2_lost_lifting`.
    pub fn name(&self) -> String {
        let a = &self.attempt;
        let class = format!("{:?}", a.class);
        // LostLifting becomes lost_lifting.
        let mut snake = String::new();
        for c in class.chars() {
            if c.is_uppercase() && !snake.is_empty() {
                snake.push('_');
            }
            snake.extend(c.to_lowercase());
        }
        let setup = a.setup.title().to_lowercase();
        format!("{}_{setup}_run{}_attempt{}_{snake}", a.hand, a.run, a.number)
    }

    /// A trial from its file.
    ///
    /// # Errors
    /// [`EvaluationError`] for a file that is none, or of another layout, and for numbers out of bounds.
    pub fn from_json(text: &str) -> Result<Self, EvaluationError> {
        /// What every layout begins with.
        #[derive(Deserialize)]
        struct Head {
            version: u32,
        }
        let found = serde_json::from_str::<Head>(text)?.version;
        if found != VERSION {
            return Err(setting("version", found, VERSION));
        }
        let trial: Self = serde_json::from_str(text)?;
        trial.check()?;
        Ok(trial)
    }

    /// `Ok` when the numbers of the search and of the grasp are within bounds; the scene checks its own.
    fn check(&self) -> Result<(), EvaluationError> {
        if !(1..=MOST_CANDIDATES).contains(&self.batch) {
            return Err(setting("batch", self.batch, format!("1 to {MOST_CANDIDATES}")));
        }
        let [iterations, with_penetration] = self.scheme;
        if !(1..=MOST_ITERATIONS).contains(&iterations) || with_penetration > iterations {
            let expected = format!("1 to {MOST_ITERATIONS} iterations, and no more of them with penetration");
            return Err(setting("scheme", format!("{:?}", self.scheme), expected));
        }
        let e = &self.execute;
        for (field, value, low, high) in [
            ("execute.grip_force", e.grip_force, 0.0, 1.0),
            ("execute.approach_m_s", e.approach_m_s, 1e-3, 5.0),
            ("execute.lift_m", e.lift_m, 0.0, 2.0),
            ("execute.lift_m_s", e.lift_m_s, 1e-3, 5.0),
            ("execute.hold_s", e.hold_s, 0.0, 60.0),
            ("execute.shake_m", e.shake_m, 0.0, 0.5),
            ("execute.shake_hz", e.shake_hz, 0.1, 20.0),
            ("execute.shake_cycles", e.shake_cycles, 0.0, 100.0),
            ("execute.stop_force_n", e.stop_force_n, 0.0, 1e6),
            ("execute.push_m", e.push_m, 0.0, 10.0),
            ("execute.meet_s", e.meet_s, 0.0, 60.0),
            ("execute.close_s", e.close_s, 0.0, 60.0),
        ] {
            within(field, value, low, high)?;
        }
        let Some(command) = &self.command else { return Ok(()) };
        for (field, pose) in [
            ("command.world_from_pregrasp", &command.world_from_pregrasp),
            ("command.world_from_hand", &command.world_from_hand),
        ] {
            for &value in &pose.translation.vector {
                within(field, value, -FARTHEST_M, FARTHEST_M)?;
            }
            // The length of its quaternion.
            within(field, pose.rotation.coords.norm(), 0.999, 1.001)?;
        }
        let postures = [&command.open, &command.contact, &command.squeezed];
        postures.into_iter().flatten().try_for_each(|&value| within("command", value, -100.0, 100.0))
    }

    /// Its file.
    ///
    /// # Errors
    /// [`EvaluationError::Trial`] for numbers that JSON has no words for.
    pub fn to_json(&self) -> Result<String, EvaluationError> {
        Ok(serde_json::to_string(self)?)
    }

    /// The world before the attempt.
    ///
    /// # Errors
    /// [`EvaluationError::World`] for a scene that cannot be read.
    pub fn world(&self) -> Result<World, EvaluationError> {
        Ok(scene::from_json(&self.scene.to_string())?)
    }

    /// How its search was asked.
    fn search(&self) -> PlanOptions {
        let [iterations, with_penetration] = self.scheme;
        PlanOptions {
            batch: self.batch,
            scheme: Scheme { iterations, with_penetration },
            ..PlanOptions::default()
        }
    }

    fn volume(&self) -> VolumeKind {
        if self.occupancy { VolumeKind::Occupancy } else { VolumeKind::Tsdf }
    }
}

fn setting(field: &'static str, found: impl ToString, expected: impl ToString) -> EvaluationError {
    EvaluationError::Setting { field, found: found.to_string(), expected: expected.to_string() }
}

fn within(field: &'static str, value: f64, low: f64, high: f64) -> Result<(), EvaluationError> {
    if (low..=high).contains(&value) {
        Ok(())
    } else {
        Err(setting(field, value, format!("{low} to {high}")))
    }
}

/// What came of executing again.
#[derive(Debug, Clone, PartialEq)]
pub struct Replay {
    /// What became of it now.
    pub class: Class,
    /// True when it is what it was then.
    pub same: bool,
    /// What the planner thinks; without a new plan, what it thought then.
    pub figures: Figures,
    /// The grasp.
    pub command: Option<GraspCommand>,
}

/// Executes the grasp of a failed trial again; `watch` sees the moments that are worth a picture.
/// A trial in which no grasp was found has nothing to execute and stays what it was.
///
/// # Errors
/// [`EvaluationError`] for a world that cannot be read.
pub fn replay(
    trial: &FailedTrial,
    hand: &Arc<Hand>,
    estimator: &dyn ContactEstimator,
    watch: &mut dyn FnMut(Moment, &World),
) -> Result<Replay, EvaluationError> {
    under(trial, hand, estimator, |conditions| {
        again(trial, conditions, trial.command.clone(), trial.attempt.figures.clone(), watch)
    })
}

/// Looks at the world of a failed trial again, with the same noise, plans as the planner plans today, and
/// executes.
///
/// # Errors
/// [`EvaluationError`] for a world that cannot be read.
pub fn plan_again(
    trial: &FailedTrial,
    hand: &Arc<Hand>,
    estimator: &dyn ContactEstimator,
    watch: &mut dyn FnMut(Moment, &World),
) -> Result<Replay, EvaluationError> {
    under(trial, hand, estimator, |conditions| {
        let (plan, _) = conditions.plan(&trial.world()?, trial.noise_seed, trial.plan_seed)?;
        again(trial, conditions, plan.grasps.first().map(command), Figures::of(&plan, hand), watch)
    })
}

/// Does something under the conditions of a trial.
fn under<T>(
    trial: &FailedTrial,
    hand: &Arc<Hand>,
    estimator: &dyn ContactEstimator,
    what: impl FnOnce(&Conditions<'_>) -> Result<T, EvaluationError>,
) -> Result<T, EvaluationError> {
    let station = Station::tray();
    what(&Conditions {
        station: &station,
        hand,
        estimator,
        scene: &station.scene_options(trial.volume()),
        search: &trial.search(),
        execute: &trial.execute,
    })
}

fn again(
    trial: &FailedTrial,
    conditions: &Conditions<'_>,
    command: Option<GraspCommand>,
    figures: Figures,
    watch: &mut dyn FnMut(Moment, &World),
) -> Result<Replay, EvaluationError> {
    let mut world = trial.world()?;
    let class = match &command {
        Some(command) => Class::of(&conditions.execute(&mut world, command, watch)),
        None => {
            watch(Moment::Before, &world);
            Class::NoGrasp
        }
    };
    Ok(Replay { class, same: class == trial.attempt.class, figures, command })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A trial on an empty table, whose file is short.
    fn text() -> String {
        let command = GraspCommand {
            world_from_pregrasp: nalgebra::Isometry3::translation(0.0, 0.0, 0.3),
            world_from_hand: nalgebra::Isometry3::translation(0.0, 0.0, 0.2),
            open: vec![0.5],
            contact: vec![0.25],
            squeezed: vec![0.125],
        };
        let attempt = Attempt {
            hand: "panda".into(),
            setup: super::super::clear::Setup::Single,
            run: 0,
            number: 1,
            class: Class::UnstableContact,
            other_held: false,
            meant: None,
            held: Vec::new(),
            objects: 0,
            slip_m: 0.0,
            figures: Figures::default(),
        };
        let hand = graspd_hands::library::hand("panda").unwrap();
        let scene = scene::to_json(&World::new(Station::tray().world));
        let (execute, search) = (ExecuteSettings::default(), PlanOptions::default());
        let seeds = [1, 2];
        FailedTrial::new(&attempt, hand, &scene, Some(command), &execute, &search, VolumeKind::Tsdf, seeds)
            .and_then(|trial| trial.to_json())
            .unwrap()
    }

    #[test]
    fn numbers_out_of_bounds_and_fields_that_are_missing_are_named() {
        let text = text();
        assert!(FailedTrial::from_json(&text).is_ok());
        for (from, to, expected) in [
            ("\"batch\":48", "\"batch\":1000000000000", "batch: found 1000000000000, expected 1 to 16384"),
            ("\"batch\":48", "\"batch\":0", "batch: found 0"),
            ("\"scheme\":[200,40]", "\"scheme\":[200,201]", "scheme: found [200, 201]"),
            ("\"scheme\":[200,40]", "\"scheme\":[99999999,0]", "scheme: found"),
            ("\"lift_m\":0.15", "\"lift_m\":1e300", "execute.lift_m: found"),
            ("\"hold_s\":0.5", "\"hold_s\":-1", "execute.hold_s: found -1, expected 0 to 60"),
            ("[0.0,0.0,0.3]", "[0.0,0.0,1e9]", "command.world_from_pregrasp: found 1000000000"),
            ("\"open\":[0.5]", "\"open\":[5e9]", "command: found 5000000000"),
            ("\"version\":2", "\"version\":1", "version: found 1, expected 2"),
        ] {
            assert!(text.contains(from), "{from} not in {text}");
            let error = FailedTrial::from_json(&text.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(error.starts_with(expected), "{to}: {error}");
        }
        // No setting is filled in for a file that does not have it.
        let error = FailedTrial::from_json(&text.replacen("\"meet_s\":0.5,", "", 1)).unwrap_err();
        let EvaluationError::Trial(error) = error else { panic!("{error:?}") };
        assert!(error.to_string().contains("meet_s"), "{error}");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]

        /// Numbers replaced by extreme ones: an error, or bounds that hold.
        #[test]
        fn no_number_makes_it_panic(
            at in any::<prop::sample::Index>(),
            number in prop::sample::select(vec!["0", "-1", "1e308", "1e-308", "18446744073709551615", "null", "[]"]),
        ) {
            let text = text();
            let is_number = |c: char| c.is_ascii_digit() || "+-.eE".contains(c);
            let pairs = text.char_indices().zip(text.chars().skip(1));
            let starts = pairs.filter(|&((_, before), c)| ",:[".contains(before) && (c.is_ascii_digit() || c == '-'));
            let starts: Vec<usize> = starts.map(|((i, _), _)| i + 1).collect();
            let start = starts[at.index(starts.len())];
            let end = start + text[start..].find(|c| !is_number(c)).unwrap();
            if let Ok(trial) = FailedTrial::from_json(&format!("{}{number}{}", &text[..start], &text[end..])) {
                prop_assert!((1..=MOST_CANDIDATES).contains(&trial.batch));
                // The scene has bounds of its own.
                if let Ok(mut world) = trial.world() {
                    world.step();
                }
            }
        }
    }
}
