//! Both modes from the same places: one attempt of each in the same tray, with the same first frame, again and again.
//!
//! Trays that are cleared by one mode alone part after the first attempt, so that their rates differ by what lay where.
//! Here every attempt of one mode has a partner, and what came out differently is counted (McNemar's test).

use std::sync::Arc;

use graspd_hands::Hand;
use graspd_planner::estimator::ContactEstimator;
use graspd_planner::servo::Mode;
use graspd_sim::clutter::settle;
use graspd_sim::scene;
use graspd_sim::world::World;
use serde::{Deserialize, Serialize};

use super::run::{Poured, ServoAttempt, ServoObserver, attempt, run_seed};
use super::settings::{Group, ServoSettings};
use crate::evaluate::contents::{Contents, SETTLE_S, put_back};
use crate::evaluate::seeds::derive;
use crate::evaluate::statistics::mcnemar;
use crate::evaluate::table::Table;
use crate::evaluate::workers::in_turn;
use crate::evaluate::{Class, EvaluationError};

/// One attempt of each mode in the same tray.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pair {
    /// Id of the hand.
    pub hand: String,
    /// The objects.
    pub group: Group,
    /// Which run, from 0.
    pub run: usize,
    /// Which attempt in this tray, from 0.
    pub number: usize,
    /// The static mode's.
    pub fixed: ServoAttempt,
    /// The dynamic mode's.
    pub dynamic: ServoAttempt,
}

impl Pair {
    /// Whether each succeeded, static first. An attempt without a grip has not.
    pub fn successes(&self) -> [bool; 2] {
        [&self.fixed, &self.dynamic].map(|a| a.class == Class::Success)
    }
}

/// Makes `attempts` pairs in every tray. After each the tray goes on as one of the two modes has left it, by turns; where
/// that took nothing out, the object that lies highest is taken. The pairs are in the order of groups, runs and hands.
///
/// # Errors
/// [`EvaluationError`] for settings of no use, and for what the world refuses.
pub fn pairs_with_servo(
    settings: &ServoSettings,
    attempts: usize,
    estimator: &Arc<dyn ContactEstimator>,
    observer: &dyn ServoObserver,
) -> Result<Vec<Pair>, EvaluationError> {
    settings.validate()?;
    let mut jobs = Vec::new();
    for run in 0..settings.runs {
        for &group in &settings.groups {
            jobs.extend(settings.hands.iter().map(|hand| (group, run, hand)));
        }
    }
    let done = in_turn(jobs.len(), settings.workers, |index| {
        let (group, run, hand) = jobs[index];
        tray(settings, attempts, estimator, group, run, hand, observer)
    })?;
    Ok(done.into_iter().flatten().collect())
}

fn tray(
    settings: &ServoSettings,
    attempts: usize,
    estimator: &Arc<dyn ContactEstimator>,
    group: Group,
    run: usize,
    hand: &Arc<Hand>,
    observer: &dyn ServoObserver,
) -> Result<Vec<Pair>, EvaluationError> {
    let run_seed = run_seed(settings, group, run);
    let Poured { station, mut world, mut contents, .. } = Poured::new(settings, group, run_seed)?;
    let mut pairs = Vec::new();
    for number in 0..attempts {
        put_back(&mut world, &station, derive(run_seed, &[2, number as u64]));
        let before = scene::to_json(&world);
        let seed = derive(run_seed, &[3, number as u64]);
        let one = |mode: Mode| -> Result<(ServoAttempt, World, Contents), EvaluationError> {
            let (mut world, mut contents) = (scene::from_json(&before)?, contents.clone());
            settle(&mut world, SETTLE_S);
            let made = attempt(settings, &station, estimator, hand, mode, seed, &mut world, &mut contents)?;
            observer.attempt(&made);
            settle(&mut world, SETTLE_S);
            Ok((made, world, contents))
        };
        let (fixed, dynamic) = (one(Mode::Static)?, one(Mode::Dynamic)?);
        let left = contents.present.len();
        let pair = Pair { hand: hand.id.clone(), group, run, number, fixed: fixed.0, dynamic: dynamic.0 };
        observer.pair(&pair);
        pairs.push(pair);
        (world, contents) = if number % 2 == 0 { (fixed.1, fixed.2) } else { (dynamic.1, dynamic.2) };
        if contents.present.len() == left {
            let height = |id| world.pose(id).map_or(0.0, |pose| pose.translation.z);
            let highest =
                world.ids().into_iter().enumerate().max_by(|a, b| height(a.1).total_cmp(&height(b.1)));
            if let Some((at, _)) = highest {
                contents.take(&mut world, at);
                settle(&mut world, SETTLE_S);
            }
        }
        if contents.present.is_empty() {
            break;
        }
    }
    Ok(pairs)
}

/// What came out, by hand and for all.
pub(super) fn table(pairs: &[Pair]) -> Table {
    let mut hands: Vec<&str> = Vec::new();
    for pair in pairs {
        if !hands.contains(&pair.hand.as_str()) {
            hands.push(&pair.hand);
        }
    }
    let mut table = Table::new([
        "pairs of attempts in the same tray",
        "pairs",
        "static",
        "dynamic",
        "both",
        "only static",
        "only dynamic",
        "neither",
        "p (McNemar)",
    ]);
    let all = (hands.len() > 1).then_some(None);
    for hand in hands.into_iter().map(Some).chain(all) {
        let of = pairs.iter().filter(|p| hand.is_none_or(|h| h == p.hand)).map(Pair::successes);
        let of: Vec<[bool; 2]> = of.collect();
        let count = |wanted: [bool; 2]| of.iter().filter(|s| **s == wanted).count();
        let (both, neither) = (count([true, true]), count([false, false]));
        let (fixed, dynamic) = (count([true, false]), count([false, true]));
        let rate = |n: usize| format!("{:.1}%", 100.0 * n as f64 / of.len().max(1) as f64);
        table.row([
            hand.unwrap_or("all").to_owned(),
            of.len().to_string(),
            rate(both + fixed),
            rate(both + dynamic),
            both.to_string(),
            fixed.to_string(),
            dynamic.to_string(),
            neither.to_string(),
            format!("{:.3}", mcnemar(fixed, dynamic)),
        ]);
    }
    table
}
