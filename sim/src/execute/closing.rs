//! How fingers close on whatever is between them: all at once, until each is held.
//!
//! Fingers with one motor each go on until their force limits hold them (or they can go no further). Fingers with
//! several motors would curl into themselves that way; in a hand that has such fingers each goes to the commanded
//! squeeze, where its servos press like springs, and on in the same direction, all joints in proportion, until one
//! of its motors is held.

use graspd_hands::{CoordinateKind, Hand};

use crate::world::{Command, HandId, Touched, World};

/// By this time fingers have reached their commanded squeeze, or are held, seconds.
const REACHED_S: f64 = 0.8;
/// Interval of the commands that take the fingers to contact, seconds.
const MEET_COMMAND_S: f64 = 0.02;
/// Time between looks at which fingers touch, seconds.
const LOOK_S: f64 = 0.02;

/// A finger that is not held goes on in steps of this share of its squeeze ...
const STEP: f64 = 0.1;
/// ... for at most this many squeezes.
const FARTHEST: f64 = 12.0;
/// A motor is held by its force limit when it gives this share of it.
const HELD: f64 = 0.95;
/// Squeeze of an actuator that was given none, radians or metres as a share of its range.
const LEAST: f64 = 0.02;

/// One actuator that closes.
#[derive(Debug, Clone)]
struct Closer {
    /// Index among the actuators.
    actuator: usize,
    /// The links that it moves.
    links: Vec<usize>,
    /// Fingers that it moves, by their pads.
    fingers: Vec<usize>,
    /// Farthest position in the direction of closing.
    limit: f64,
    /// What the command goes beyond contact, with its sign.
    squeeze: f64,
    /// True when the hand has fingers of several motors.
    shared: bool,
    /// How far it has gone beyond the commanded squeeze, in squeezes.
    beyond: f64,
}

/// How a hand closes: lists in the order of its actuators, radians or metres.
#[derive(Debug, Clone, PartialEq)]
pub struct CloseOrder {
    /// Where the fingers begin.
    pub from: Vec<f64>,
    /// Where contact is expected.
    pub contact: Vec<f64>,
    /// What to command then, beyond contact.
    pub squeezed: Vec<f64>,
    /// Where actuators that close go at most; empty: to the end of their range.
    pub farthest: Vec<f64>,
    /// Share of the actuators' effort.
    pub force: f64,
    /// Share of the actuators' speed after contact.
    pub speed: f64,
    /// Time from the beginning to contact, seconds.
    pub meet_s: f64,
    /// Longest time for closing after that, seconds.
    pub close_s: f64,
}

/// The closing of one hand: what its controller tells the motors from step to step.
///
/// First all fingers go to where contact is expected so that they arrive together: a finger that came first would push
/// the object before the others hold against it. Then they close until each is held or can go no further.
#[derive(Debug, Clone)]
pub struct Closing {
    order: CloseOrder,
    closers: Vec<Closer>,
    /// Where the fingers meet.
    meeting: Vec<f64>,
    targets: Vec<f64>,
    full: Vec<f64>,
    /// Steps done.
    step: usize,
    /// True when the motors know the targets.
    told: bool,
}

impl Closing {
    /// A closing that has not begun; `None` when the hand is not in the world.
    pub fn new(world: &World, id: HandId, order: CloseOrder) -> Option<Self> {
        let hand = world.hand(id)?;
        let (closers, targets) = closers(hand, &order);
        let full = world.full_efforts(id)?;
        let ways = order.from.iter().zip(&order.contact).zip(&targets);
        // A finger that is beyond contact already waits there: opened again, it might let go.
        let meeting = ways
            .map(
                |((&from, &contact), to)| {
                    if (from - contact) * (to - contact) > 0.0 { from } else { contact }
                },
            )
            .collect();
        Some(Self { order, closers, meeting, targets, full, step: 0, told: false })
    }

    /// Tells the motors what to do in the next step of the world; true when there is nothing more to do. Call it
    /// before every step.
    pub fn before_step(&mut self, world: &mut World, id: HandId) -> bool {
        let dt_s = world.settings().dt_s;
        let steps = |time_s: f64| (time_s.clamp(0.0, 60.0) / dt_s).round() as usize;
        let meet = steps(self.order.meet_s);
        let step = self.step;
        self.step += 1;
        if step < meet {
            let every = steps(MEET_COMMAND_S).max(1);
            if step.is_multiple_of(every) {
                let share = (step + every).min(meet) as f64 / meet as f64;
                let between = |(from, meeting): (&f64, &f64)| from + share * (meeting - from);
                let actuators = self.order.from.iter().zip(&self.meeting).map(between).collect();
                world.command(id, Command::Close { actuators, force: self.order.force, speed: 1.0 });
            }
            return false;
        }
        let closing = step - meet;
        if let Some(last) = closing.checked_sub(1)
            && last.is_multiple_of(steps(LOOK_S).max(1))
        {
            let Some(settled) = world.hand_settled(id) else { return true };
            if settled || last >= steps(REACHED_S) {
                let goes_on = self.look(world, id);
                if settled && !goes_on {
                    return true;
                }
            }
        }
        if closing >= steps(self.order.close_s) {
            return true;
        }
        if !self.told {
            let (force, speed) = (self.order.force, self.order.speed);
            world.command(id, Command::Close { actuators: self.targets.clone(), force, speed });
            self.told = true;
        }
        false
    }

    /// Where the actuators go, in the order of the hand's actuators: what the motors are told from contact on.
    pub fn targets(&self) -> &[f64] {
        &self.targets
    }

    /// Looks at which fingers touch, and how hard; true when some go on.
    fn look(&mut self, world: &World, id: HandId) -> bool {
        let Some(state) = world.hand_state(id) else { return false };
        let contacts = world.hand_contacts(id);
        let objects = contacts.iter().filter(|c| matches!(c.touched, Touched::Object(_)));
        let touching: Vec<usize> = objects.map(|c| c.link).collect();
        let allowed = self.full.iter().map(|full| (self.order.force * full).max(1e-9));
        let loads: Vec<f64> = state.efforts.iter().zip(allowed).map(|(e, allowed)| e / allowed).collect();
        let changed = self.go_on(&touching, &loads);
        self.told &= !changed;
        changed
    }

    /// Lets fingers of several motors go on: those that have met nothing until they do, those that touch until one
    /// of their motors is held by its force limit. `touching` are the links that touch an object, `loads` the
    /// efforts of the actuators as shares of what they were allowed. `true` when a target has changed.
    fn go_on(&mut self, touching: &[usize], loads: &[f64]) -> bool {
        let full = |c: &&Closer| {
            let touches = c.links.iter().any(|l| touching.contains(l));
            touches && loads.get(c.actuator).is_some_and(|&load| load >= HELD)
        };
        let held: Vec<usize> = self.closers.iter().filter(full).flat_map(|c| c.fingers.clone()).collect();
        let mut changed = false;
        for closer in self.closers.iter_mut().filter(|c| c.shared && c.beyond < FARTHEST) {
            if closer.fingers.iter().any(|f| held.contains(f)) {
                continue;
            }
            closer.beyond += STEP;
            let next = self.targets[closer.actuator] + STEP * closer.squeeze;
            let next = if closer.squeeze > 0.0 { next.min(closer.limit) } else { next.max(closer.limit) };
            changed |= next != self.targets[closer.actuator];
            self.targets[closer.actuator] = next;
        }
        changed
    }
}

/// The actuators that close, and where all go.
fn closers(hand: &Hand, order: &CloseOrder) -> (Vec<Closer>, Vec<f64>) {
    let actuators: Vec<usize> = (0..hand.actuation.coordinates.len())
        .filter(|&i| hand.actuation.coordinates[i].kind == CoordinateKind::Actuator)
        .collect();
    let mut targets: Vec<f64> = actuators
        .iter()
        .enumerate()
        .map(|(a, &i)| order.squeezed.get(a).copied().unwrap_or(hand.actuation.coordinates[i].closed))
        .collect();
    let mut closers = Vec::new();
    for (a, &i) in actuators.iter().enumerate() {
        let c = &hand.actuation.coordinates[i];
        if c.closed == c.open {
            continue;
        }
        let sign = (c.closed - c.open).signum();
        let contact = order.contact.get(a).copied().unwrap_or(targets[a]);
        let asked = (targets[a] - contact) * sign;
        let squeeze = sign * if asked > 0.0 { asked } else { LEAST * (c.upper - c.lower) };
        let links = moved(hand, i);
        let mut fingers: Vec<usize> =
            hand.pads.iter().filter(|p| links.contains(&p.link)).map(|p| p.finger).collect();
        fingers.sort_unstable();
        fingers.dedup();
        let end = if sign > 0.0 { c.upper } else { c.lower };
        let limit = order.farthest.get(a).map_or(end, |f| f.clamp(c.lower, c.upper));
        closers.push(Closer { actuator: a, links, fingers, limit, squeeze, shared: false, beyond: 0.0 });
    }
    let several = (0..closers.len())
        .any(|a| (0..a).any(|b| closers[b].fingers.iter().any(|f| closers[a].fingers.contains(f))));
    if several {
        // One hand, one way: a thumb that pressed with all its force at once would push the object away from
        // where fingers that press like springs expect it.
        closers.iter_mut().for_each(|c| c.shared = true);
    }
    for closer in closers.iter().filter(|c| !c.shared) {
        targets[closer.actuator] = closer.limit;
    }
    (closers, targets)
}

/// The links that a coordinate moves.
fn moved(hand: &Hand, coordinate: usize) -> Vec<usize> {
    let tree = &hand.tree;
    let depends = |j: usize| hand.actuation.rows[j].terms.iter().any(|&(i, _)| i == coordinate);
    let carried = |body: usize| {
        (0..tree.bodies.len()).any(|b| tree.bodies[b].joint.is_some_and(depends) && tree.carries(b, body))
    };
    (0..tree.links.len()).filter(|&l| carried(tree.links[l].body)).collect()
}
