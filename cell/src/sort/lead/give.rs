//! Grasps to arms: the assignment of what waits to those that are free, and their way.

use graspd_assign::{Arm as Side, Assignment, Problem, Reason, Settings, assign};
use tokio::time::Instant;

use super::Lead;
use crate::run::{Chosen, seconds};
use crate::sort::offer::{Look, Offer, bin_of};
use crate::sort::record::{DecisionRecord, Given};
use crate::sort::table::{Doing, SortEvent};
use crate::sort::worker::Order;
use crate::steps::Step;

/// What is left of the score of a grasp that another arm can take as well, for an arm for which something waits that nobody
/// else can take: it would be the last to be ready.
const LEFT_TO_OTHERS: f64 = 0.6;

impl Lead<'_> {
    /// Gives grasps to the arms that are free.
    pub(super) fn give(&mut self) {
        let Some(look) = self.look.take() else { return };
        let _still = self.cell.clock.still();
        let free: Vec<usize> = self.idle().collect();
        let began = std::time::Instant::now();
        let (found, sides) = self.assignment(&look, &free);
        self.assign_s.push(began.elapsed().as_secs_f64());
        self.assignments += 1;
        let time_s = self.cell.clock.now_s() - self.began_s;
        let (mut records, mut picks) = (Vec::new(), Vec::new());
        for ((&arm, decision), side) in free.iter().zip(&found.decisions).zip(&sides) {
            let mut given = None;
            if let (Some(chosen), Some(offer)) = (&decision.chosen, &look.offers[arm]) {
                let offered = &offer.grasps[side[chosen.grasp]];
                let object = &look.objects[offered.object];
                let rule = object.rule.map(|i| self.config.rules[i].name.clone()).unwrap_or_default();
                let f = chosen.factors;
                given = Some(Given {
                    object: offered.object,
                    width_m: object.seen.width_m,
                    rule,
                    bin: offered.bin.clone(),
                    rank: offered.rank,
                    value: chosen.value,
                    factors: [f.score, f.size, f.reach],
                });
                picks.push((arm, side[chosen.grasp]));
            }
            let reason = decision.reason.to_string();
            self.arms[arm].blocked = is_blocked(&decision.reason);
            if given.is_none() {
                self.arms[arm].doing = Doing::Idle { why: reason.clone() };
            }
            records.push(DecisionRecord {
                time_s,
                look: look.number,
                arm: self.names[arm].clone(),
                given,
                reason,
            });
        }
        self.look = Some(look);
        for (arm, at) in picks {
            self.dispatch(arm, at);
        }
        if records.iter().any(|r| r.given.is_some()) || !self.is_working() {
            self.observer.on(&SortEvent::Decided(&records));
            let kept = self.recorder.as_mut().map_or(Ok(()), |r| r.decided(&records));
            self.note(kept);
        }
        self.show();
    }

    /// The assignment of what waits to the arms that are free; for each arm the places of its grasps in its offer.
    pub(super) fn assignment(&self, look: &Look, free: &[usize]) -> (Assignment, Vec<Vec<usize>>) {
        let mut sides = Vec::with_capacity(free.len());
        let arms: Vec<Side> = free
            .iter()
            .map(|&arm| {
                let waiting = |offer: &Offer| {
                    let all = offer.grasps.iter().enumerate();
                    all.filter(|(_, g)| look.objects[g.object].waits).map(|(i, _)| i).collect::<Vec<_>>()
                };
                let of = look.offers[arm].as_ref();
                let places = of.map(waiting).unwrap_or_default();
                let needed = self.is_needed(look, arm);
                let grasp = |o: &Offer, i: usize| {
                    let mut grasp = o.grasps[i].grasp.clone();
                    if needed && !self.is_only_taker(look, arm, o.grasps[i].object) {
                        grasp.score *= LEFT_TO_OTHERS;
                    }
                    grasp
                };
                let grasps = of.map(|o| places.iter().map(|&i| grasp(o, i)).collect());
                sides.push(places);
                let [min, max] = self.config.arms[arm].opening_m;
                Side {
                    opening_m: Some((min, max)),
                    ..Side::new(&self.names[arm], grasps.unwrap_or_default())
                }
            })
            .collect();
        let occupied = self.space.occupied(&self.names, free);
        let settings = Settings { clearance_m: self.config.sort.clearance_m, ..Settings::default() };
        let (began, limit) = (std::time::Instant::now(), seconds(self.config.sort.assign_s));
        let problem = Problem { arms: &arms, occupied: &occupied, taken: &[] };
        (assign(&problem, &settings, &mut || began.elapsed() > limit), sides)
    }

    /// True for an arm for which something waits that nobody else can take.
    fn is_needed(&self, look: &Look, arm: usize) -> bool {
        let offer = look.offers[arm].as_ref();
        let of = |o: &Offer| {
            o.grasps.iter().any(|g| {
                g.grasp.barred.is_none()
                    && look.objects[g.object].waits
                    && self.is_only_taker(look, arm, g.object)
            })
        };
        offer.is_some_and(of)
    }

    /// True where rules and sizes leave an object to this arm alone, of those that are of use.
    fn is_only_taker(&self, look: &Look, arm: usize, object: usize) -> bool {
        let others = (0..self.arms.len()).filter(|&other| other != arm);
        let object = &look.objects[object];
        let takes = |other: usize| {
            let is_out = matches!(self.arms[other].doing, Doing::Out { .. });
            let fits = object.seen.width_m < self.config.arms[other].opening_m[1];
            !is_out && fits && bin_of(self.config, other, object).is_ok()
        };
        !others.into_iter().any(takes)
    }

    /// Reserves the space of a grasp and sends the arm.
    pub(super) fn dispatch(&mut self, arm: usize, at: usize) {
        let Some(look) = &mut self.look else { return };
        let Some(offer) = look.offers[arm].as_ref() else { return };
        let offered = &offer.grasps[at];
        // The assignment keeps corridors apart; the space has the last word.
        if let Err(refused) = self.space.reserve(arm, offered.corridor.clone(), Instant::now()) {
            let why = format!("{} is in the way", self.names[refused.holder]);
            self.arms[arm].blocked = true;
            self.arms[arm].doing = Doing::Idle { why };
            return;
        }
        let chosen = Chosen {
            frame: look.frame.clone(),
            question: offer.question.clone(),
            answer: offer.answer.clone(),
            out_of_reach: offer.out_of_reach.clone(),
            rank: offered.rank,
            drop: offered.drop,
        };
        let (object, bin) = (offered.object, offered.bin.clone());
        let pose = offered.grasp.world_from_hand;
        let tail = offered.tail.clone();
        // It and what lies against it: what is there after the pick only a look tells.
        let disturbed = self.config.sort.disturbed_m;
        let taken = look.objects[object].seen.clone();
        look.objects[object].waits = false;
        for other in &mut look.objects {
            other.waits &= other.seen.gap(&taken) > disturbed;
        }
        let others = self.arms.iter().filter(|a| matches!(a.doing, Doing::Picking { .. })).count();
        self.together += u32::from(others > 0);
        self.idle_looks = 0;
        self.arms[arm].target = Some(pose);
        self.arms[arm].tail = Some(tail);
        self.arms[arm].taking = Some(taken);
        self.arms[arm].is_over_tray = true;
        self.arms[arm].doing = Doing::Picking { object, bin, step: Step::Open };
        self.order(arm, Order::Pick(Box::new(chosen)));
    }
}

/// True for an arm that others keep from what it could take.
fn is_blocked(reason: &Reason) -> bool {
    match reason {
        Reason::NoneFeasible { counts, .. } => counts.contains_key("occupied"),
        Reason::LeftOut { same_object, .. } => !same_object,
        Reason::Best | Reason::BestTogether { .. } | Reason::NoGrasps => false,
    }
}
