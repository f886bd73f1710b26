//! What is measured: hands, groups of objects, runs, and how the objects are disturbed.

use std::sync::Arc;

use graspd_hands::Hand;
use graspd_planner::servo::{Mode, ServoOptions};
use graspd_sim::clutter::{Sizes, assortment_of};
use graspd_sim::execute::ExecuteSettings;
use graspd_sim::object::{Kind, Object};
use graspd_sim::sensor::Sensor;
use graspd_sim::world::Tray;
use serde::{Deserialize, Serialize};

use crate::evaluate::EvaluationError;
use crate::evaluate::seeds::derive;

/// Objects of this size are drawn: what both hands of the supplement open for, metres.
const OPENING_M: f64 = 0.09;
/// Objects in a tray of dense clutter (Supplementary Note 7).
const DENSE: (u64, u64) = (12, 16);
/// Draws before giving up.
const MOST_DRAWS: u64 = 200;

/// A group of object families, after the four of Supplementary Fig. 7 (fabric toys, artificial vegetables, adversarial
/// units, household items), as far as procedural families can stand for them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Group {
    /// Balls, superquadrics, building blocks.
    Toys,
    /// Capsules, frusta, cylinders.
    Vegetables,
    /// Angles, tees, hammers, nuts, pegs.
    Adversarial,
    /// Boxes, bottles, cans, cups.
    Household,
}

impl Group {
    /// All, in the supplement's order.
    pub const ALL: [Self; 4] = [Self::Toys, Self::Vegetables, Self::Adversarial, Self::Household];

    /// As files and the command line name it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Toys => "toys",
            Self::Vegetables => "vegetables",
            Self::Adversarial => "adversarial",
            Self::Household => "household",
        }
    }

    /// Its families.
    pub fn kinds(self) -> &'static [Kind] {
        match self {
            Self::Toys => &[Kind::Sphere, Kind::Superquadric, Kind::Block],
            Self::Vegetables => &[Kind::Capsule, Kind::Frustum, Kind::Cylinder],
            Self::Adversarial => &[Kind::Ell, Kind::Tee, Kind::Hammer, Kind::Nut, Kind::Peg],
            Self::Household => &[Kind::Box, Kind::Bottle, Kind::Can, Kind::Cup],
        }
    }

    /// 12 to 16 objects of the group, by seed.
    pub fn draw(self, seed: u64) -> Vec<Arc<Object>> {
        let count = DENSE.0 + derive(seed, &[0]) % (DENSE.1 - DENSE.0 + 1);
        self.draw_some(count as usize, seed)
    }

    /// So many objects of the group, by seed; fewer where nearly nothing fits.
    pub fn draw_some(self, count: usize, seed: u64) -> Vec<Arc<Object>> {
        let sizes = Sizes::up_to(OPENING_M);
        let drawn = (0..MOST_DRAWS).flat_map(|r| assortment_of(self.kinds(), 16, derive(seed, &[1, r])));
        drawn.filter(|o| sizes.allow(o)).take(count).collect()
    }
}

/// What disturbs objects.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Nudge {
    /// How far the object nearest to the grasp is shoved sideways, metres.
    pub distance_m: f64,
    /// At the first stand-off not above this, metres.
    pub at_standoff_m: f64,
    /// Objects in the tray: in dense clutter nothing can be shoved without its neighbours.
    pub objects: usize,
}

impl Default for Nudge {
    fn default() -> Self {
        Self { distance_m: 0.025, at_standoff_m: 0.12, objects: 5 }
    }
}

/// What is measured, and how.
#[derive(Debug, Clone)]
pub struct ServoSettings {
    /// The hands.
    pub hands: Vec<Arc<Hand>>,
    /// The groups of objects.
    pub groups: Vec<Group>,
    /// Trays of each group (the supplement: 5).
    pub runs: usize,
    /// Dynamic, static, or both.
    pub modes: Vec<Mode>,
    /// Objects are shoved during the approach.
    pub nudge: Option<Nudge>,
    /// The tray.
    pub tray: Tray,
    /// The camera in the palm.
    pub sensor: Sensor,
    /// Frames per second of the camera.
    pub frames_per_s: f64,
    /// How the grasp is carried on; mode, workspace, region and keep-out boxes in it are set by the evaluation.
    pub servo: ServoOptions,
    /// How grasps are executed.
    pub execute: ExecuteSettings,
    /// Failed attempts at one object, or attempts without a grasp in a row, after which it, or the tray, is given up.
    pub give_up: usize,
    /// Same seed, same settings: same attempts.
    pub seed: u64,
    /// Trays at the same time, each on one thread.
    pub workers: usize,
}

impl ServoSettings {
    /// The supplement's setting for these hands.
    pub fn new(hands: Vec<Arc<Hand>>) -> Self {
        Self {
            hands,
            groups: Group::ALL.to_vec(),
            runs: 5,
            modes: vec![Mode::Static, Mode::Dynamic],
            nudge: None,
            tray: Tray { width_m: 0.32, length_m: 0.28, ..Tray::default() },
            sensor: Sensor::pico_flexx(),
            frames_per_s: 15.0,
            servo: ServoOptions::default(),
            execute: ExecuteSettings::default(),
            give_up: 3,
            seed: 1,
            workers: 1,
        }
    }

    pub(super) fn validate(&self) -> Result<(), EvaluationError> {
        let counts = [
            ("hands", self.hands.len()),
            ("groups", self.groups.len()),
            ("runs", self.runs),
            ("modes", self.modes.len()),
            ("give_up", self.give_up),
            ("workers", self.workers),
        ];
        if let Some((field, _)) = counts.into_iter().find(|&(_, n)| n == 0) {
            return Err(EvaluationError::Setting { field, found: "0".into(), expected: "at least 1".into() });
        }
        if !(1.0..=200.0).contains(&self.frames_per_s) {
            return Err(EvaluationError::Setting {
                field: "frames_per_s",
                found: self.frames_per_s.to_string(),
                expected: "1 to 200".into(),
            });
        }
        self.servo.validate().map_err(|e| EvaluationError::Setting {
            field: e.field,
            found: e.found,
            expected: e.expected.into(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_group_gives_dense_clutter() {
        for group in Group::ALL {
            for seed in 0..4 {
                let objects = group.draw(seed);
                assert!((12..=16).contains(&objects.len()), "{}: {}", group.name(), objects.len());
                assert_eq!(objects, group.draw(seed));
            }
        }
    }
}
