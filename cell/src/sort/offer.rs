//! The grasps of one look: each with its object, the object's size and rule, the arm's reach, and the space that it takes.

use std::sync::Arc;

use graspd_adapters_core::{Leg, Limits, Reach};
use graspd_assign::{Grasp, ObjectKey, Reach as Comfort, Swept};
use nalgebra::{Isometry3, Point3, Vector3};

use super::config::{ArmStation, SortConfig};
use super::lead::ArmCell;
use super::objects::Seen;
use super::space::Space;
use super::way::{HandShape, Heights, comfort, from_lifted_on, sweep, sweep_with_tail, through, way_of};
use crate::frame::Frame;
use crate::plan::{Answer, HandFacts, PlannedGrasp, Question};
use crate::pose::{pointing_down, raised_to};
use crate::record::OutOfReach;

/// A grasp whose centroid is farther than this from all that was seen belongs to nothing, metres.
const FAR_FROM_ALL_M: f64 = 0.03;
/// A grasp this near to one that failed: metres, radians.
const SAME_GRASP: (f64, f64) = (0.02, 0.4);
/// What is left of its score.
const FAILED_BEFORE: f64 = 0.3;

/// An object of a look.
#[derive(Debug, Clone)]
pub(super) struct PoolObject {
    pub(super) seen: Seen,
    /// Index of its rule; `None`: none fits.
    pub(super) rule: Option<usize>,
    /// It may be given.
    pub(super) waits: bool,
}

/// A grasp of a look.
#[derive(Debug, Clone)]
pub(super) struct Offered {
    pub(super) rank: usize,
    pub(super) object: usize,
    pub(super) bin: String,
    pub(super) drop: Isometry3<f64>,
    /// The space of the whole way, and of the way with the lifted object.
    pub(super) corridor: Arc<Swept>,
    pub(super) tail: Arc<Swept>,
    pub(super) grasp: Grasp,
}

/// What an arm could do after a look.
#[derive(Debug, Clone)]
pub(super) struct Offer {
    pub(super) question: Question,
    pub(super) answer: Answer,
    pub(super) out_of_reach: Vec<OutOfReach>,
    pub(super) grasps: Vec<Offered>,
}

/// A look.
#[derive(Debug, Clone)]
pub(super) struct Look {
    pub(super) number: u32,
    pub(super) frame: Frame,
    pub(super) objects: Vec<PoolObject>,
    /// One for each arm that was asked for.
    pub(super) offers: Vec<Option<Offer>>,
}

/// What is known of an arm for all looks.
#[derive(Debug, Clone)]
pub(super) struct Station {
    pub(super) facts: HandFacts,
    pub(super) hand: HandShape,
    pub(super) home: Isometry3<f64>,
    pub(super) heights: Heights,
}

impl Station {
    pub(super) fn new(config: &SortConfig, arm: &ArmStation, cell: &ArmCell, facts: HandFacts) -> Self {
        let tool_point = Point3::from(facts.tool_point);
        let hand = match arm.hand_radius_m {
            Some(radius_m) => HandShape::thick_line(tool_point, radius_m),
            None => HandShape { tool_point, bodies: cell.hand_bodies.clone() },
        };
        let home = place(&facts, &arm.home_m, arm.yaw_rad);
        let travel_m = config.tray.floor_m() + config.motion.travel_height_m;
        Self { facts, hand, home, heights: Heights { travel_m, lift_m: config.motion.lift_m } }
    }

    /// Where the hand lets go over a bin.
    pub(super) fn drop(&self, position_m: &[f64; 3], yaw_rad: f64) -> Isometry3<f64> {
        place(&self.facts, position_m, yaw_rad)
    }

    /// Where the arm stands at home, over its bins, and between.
    pub(super) fn ground(
        &self,
        cell: &ArmCell,
        config: &SortConfig,
        arm: &ArmStation,
    ) -> Result<Arc<Swept>, String> {
        let tool = self.hand.tool_point.coords;
        let high = |pose: &Isometry3<f64>| raised_to(pose, &tool, self.heights.travel_m);
        let mut out = Vec::new();
        for bin in arm.bins.iter().filter_map(|name| config.bin(name)) {
            let drop = self.drop(&bin.position_m, arm.yaw_rad);
            let way = through(&[self.home, high(&self.home), high(&drop), drop]);
            let at = |why| format!("from home to bin {}: {why}", bin.name);
            out.extend(sweep(&*cell.shape, &self.hand, &way).map_err(at)?.0);
        }
        Ok(Arc::new(Swept::new(out)))
    }
}

fn place(facts: &HandFacts, position_m: &[f64; 3], yaw_rad: f64) -> Isometry3<f64> {
    pointing_down(&facts.approach, &facts.lateral, &facts.tool_point, &Vector3::from(*position_m), yaw_rad)
}

/// What an arm could do: every grasp of an answer that belongs to an object, with what forbids it.
pub(super) fn offer(
    config: &SortConfig,
    arm: usize,
    (cell, station): (&ArmCell, &Station),
    (question, answer): (Question, Answer),
    objects: &[PoolObject],
    (space, failed): (&Space, &[Isometry3<f64>]),
) -> Offer {
    let mut offer = Offer { question, answer, out_of_reach: Vec::new(), grasps: Vec::new() };
    for (rank, planned) in offer.answer.grasps.iter().enumerate() {
        let centroid = Point3::from(planned.centroid_m);
        let near = objects.iter().enumerate().map(|(i, o)| (i, o.seen.distance(&centroid)));
        let nearest = near.min_by(|a, b| a.1.total_cmp(&b.1)).filter(|(_, far)| *far <= FAR_FROM_ALL_M);
        let Some((object, _)) = nearest else { continue };
        let mut grasp = Grasp {
            world_from_pregrasp: planned.world_from_pregrasp.isometry(),
            world_from_hand: planned.world_from_hand.isometry(),
            score: planned.score * again(planned, failed),
            object: ObjectKey::Id(i64::try_from(object).unwrap_or(i64::MAX)),
            width_m: Some(objects[object].seen.width_m),
            reach: Comfort::Unknown,
            barred: None,
            corridor: None,
        };
        let (mut bin, mut drop) = (String::new(), station.home);
        let (mut corridor, mut tail) = (Arc::default(), Arc::default());
        match bin_of(config, arm, &objects[object]) {
            Err(why) => grasp.barred = Some(why),
            Ok(found) => {
                bin.clone_from(&found.name);
                drop = station.drop(&found.position_m, config.arms[arm].yaw_rad);
                let way = way_of(planned, &station.hand, &station.home, &drop, &station.heights);
                let lifted = from_lifted_on(planned, &station.hand, &drop, &station.heights);
                match sweep_with_tail(&*cell.shape, &station.hand, &way, lifted) {
                    Err(why) => grasp.reach = Comfort::Beyond(why),
                    Ok((swept, begin, stretch)) => {
                        tail = Arc::new(Swept::new(swept[begin..].to_vec()));
                        corridor = Arc::new(Swept::new(swept));
                        grasp.reach = reach(config, arm, cell, station, (planned, &drop), stretch);
                        if let Some(other) = space.ground_in_way(arm, &corridor) {
                            grasp.barred = Some(format!("{} stands in the way", config.arms[other].name));
                        }
                    }
                }
            }
        }
        if let Comfort::Beyond(why) = &grasp.reach {
            offer.out_of_reach.push(OutOfReach { rank, to: "grasp".to_owned(), why: why.clone() });
        }
        grasp.corridor = Some(corridor.clone());
        offer.grasps.push(Offered { rank, object, bin, drop, corridor, tail, grasp });
    }
    offer
}

/// The arm's own word on the way to a grasp, and from there to the bin, stands above what its kinematics here say.
fn reach(
    config: &SortConfig,
    arm: usize,
    cell: &ArmCell,
    station: &Station,
    (planned, drop): (&PlannedGrasp, &Isometry3<f64>),
    stretch: f64,
) -> Comfort {
    let pregrasp = planned.world_from_pregrasp.isometry();
    let high = |pose: &Isometry3<f64>| raised_to(pose, &station.facts.tool_point, station.heights.travel_m);
    let settings = &config.arms[arm].arm;
    let leg = |world_from_flange, straight, speed_m_s| Leg {
        world_from_flange,
        straight,
        limits: Limits { speed_m_s, acceleration_m_s2: settings.acceleration_m_s2 },
    };
    let way = [
        // Where it is now is no part of the way.
        leg(high(&station.home), false, settings.speed_m_s),
        leg(high(&pregrasp), true, settings.speed_m_s),
        leg(pregrasp, true, settings.approach_speed_m_s),
        leg(planned.world_from_hand.isometry(), true, settings.approach_speed_m_s),
        leg(station.heights.lifted(planned, &station.facts.tool_point), true, settings.lift_speed_m_s),
        leg(high(drop), true, settings.carry_speed_m_s),
    ];
    match cell.arm.reaches(&way) {
        Reach::Beyond { why, .. } => Comfort::Beyond(why),
        Reach::Reaches | Reach::Unknown => Comfort::Within(comfort(stretch)),
    }
}

/// The bin into which this arm puts an object, or why it must not take it.
pub(super) fn bin_of<'c>(
    config: &'c SortConfig,
    arm: usize,
    object: &PoolObject,
) -> Result<&'c super::config::BinConfig, String> {
    let Some(rule) = object.rule.and_then(|i| config.rules.get(i)) else {
        return Err(format!("no rule fits an object {:.0} mm wide", 1e3 * object.seen.width_m));
    };
    let own = &config.arms[arm].bins;
    let bin = rule.bins.iter().find(|bin| own.contains(bin)).and_then(|name| config.bin(name));
    bin.ok_or_else(|| {
        format!("rule {} sends it to {}, where this arm does not go", rule.name, rule.bins.join(" or "))
    })
}

/// Grasps like those that failed are left for when nothing else is there.
fn again(planned: &PlannedGrasp, failed: &[Isometry3<f64>]) -> f64 {
    let pose = planned.world_from_hand.isometry();
    let near = failed.iter().any(|f| {
        let between = f.inverse() * pose;
        between.translation.vector.norm() < SAME_GRASP.0 && between.rotation.angle() < SAME_GRASP.1
    });
    if near { FAILED_BEFORE } else { 1.0 }
}
