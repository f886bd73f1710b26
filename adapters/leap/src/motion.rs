//! Where the fingers are told to go from moment to moment. No I/O, no clock: the time is handed in.
//!
//! A way is gone by all joints together, each at the same share of it at any moment, as a cubic in time: speed and
//! acceleration of every joint stay below their bounds.

use std::collections::VecDeque;
use std::time::Duration;

/// A joint at rest moves less than this, radians ...
const REST_RAD: f64 = 0.01;
/// ... for this long.
const REST: Duration = Duration::from_millis(200);
/// A joint that uses this share of its current and lacks at least [`REST_RAD`] of its goal is held, too.
const HELD_LOAD: f64 = 0.8;

/// A motor that gives this share of its current gives what it may.
const FULL_LOAD: f64 = 0.9;
/// Fingers press on at this share of their speed: the one that pressed first would push the object away from the others.
const PRESSING: f64 = 0.4;

/// No more squeezes a second than this, and no more in all: a finger that has met nothing by then will not.
const SQUEEZES_S: f64 = 5.0;
const MOST_SQUEEZES: f64 = 12.0;
/// Squeeze of a joint that was given none, radians.
const LEAST_SQUEEZE_RAD: f64 = 0.03;

/// Bounds of a motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Bounds {
    /// Radians per second.
    pub(crate) speed_rad_s: f64,
    /// Radians per second squared.
    pub(crate) acceleration_rad_s2: f64,
    /// Milliamperes.
    pub(crate) current_ma: f64,
    /// What a joint at rest lacks of its goal when something holds it, radians.
    pub(crate) held_rad: f64,
}

/// What a joint measured.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Reading {
    pub(crate) position_rad: f64,
    pub(crate) velocity_rad_s: f64,
    pub(crate) current_ma: f64,
}

/// A part of a motion.
#[derive(Debug, Clone, PartialEq)]
enum Stage {
    /// All joints to here, together, in no less than this time, no faster than this.
    Travel { to: Vec<f64>, least: Duration, speed_rad_s: f64 },
    /// Fingers go on by their squeeze, again and again, up to here, each until it is held.
    Press { squeeze: Vec<f64>, to: Vec<f64> },
    /// Wait until all joints are at rest.
    Rest,
}

/// Fingers on their way.
#[derive(Debug)]
pub(crate) struct Motion {
    bounds: Bounds,
    /// Which finger each joint belongs to.
    fingers: Vec<u8>,
    stages: VecDeque<Stage>,
    goals: Vec<f64>,
    /// Where the stage began, and when.
    from: Vec<f64>,
    began: Duration,
    /// While pressing: how many squeezes each joint has gone.
    gone: Vec<f64>,
    rest: RestWatch,
}

impl Motion {
    /// All joints to `to`.
    pub(crate) fn grip(
        fingers: Vec<u8>,
        from: Vec<f64>,
        to: Vec<f64>,
        bounds: Bounds,
        now: Duration,
    ) -> Self {
        let least = Duration::ZERO;
        let stages = [Stage::Travel { to, least, speed_rad_s: bounds.speed_rad_s }, Stage::Rest];
        Self::new(fingers, from, stages.into(), bounds, now)
    }

    /// All joints to `contact` in `meet`, no faster than `fastest_rad_s`; on to `squeezed`, and fingers that do not press
    /// with what they may on to `farthest`, within `bounds`.
    pub(crate) fn close(
        fingers: Vec<u8>,
        from: Vec<f64>,
        way: [&[f64]; 3],
        (meet, fastest_rad_s): (Duration, f64),
        bounds: Bounds,
        now: Duration,
    ) -> Self {
        let [contact, squeezed, farthest] = way;
        // A joint that is beyond contact already stays: opened again it might let go.
        let meeting = from
            .iter()
            .zip(contact.iter().zip(squeezed))
            .map(
                |(from, (contact, squeezed))| {
                    if (from - contact) * (squeezed - contact) > 0.0 { *from } else { *contact }
                },
            )
            .collect();
        let stages = [
            Stage::Travel { to: meeting, least: meet, speed_rad_s: fastest_rad_s },
            Stage::Travel { to: squeezed.to_vec(), least: Duration::ZERO, speed_rad_s: bounds.speed_rad_s },
            Stage::Press { squeeze: squeezes(contact, squeezed, farthest), to: farthest.to_vec() },
            Stage::Rest,
        ];
        Self::new(fingers, from, stages.into(), bounds, now)
    }

    fn new(fingers: Vec<u8>, from: Vec<f64>, stages: VecDeque<Stage>, bounds: Bounds, now: Duration) -> Self {
        let gone = vec![0.0; from.len()];
        Self { bounds, fingers, stages, goals: from.clone(), from, began: now, gone, rest: RestWatch::new() }
    }

    /// Where joints are told to go now.
    pub(crate) fn goals(&self) -> &[f64] {
        &self.goals
    }

    /// Goes on after a reading; true when the motion is at its end.
    pub(crate) fn step(&mut self, readings: &[Reading], now: Duration) -> bool {
        let resting = self.rest.look(readings, now);
        loop {
            let Some(stage) = self.stages.front() else { return true };
            let done = match stage {
                Stage::Travel { to, least, speed_rad_s } => {
                    let (to, least) = (to.clone(), *least);
                    let bounds = Bounds { speed_rad_s: *speed_rad_s, ..self.bounds };
                    self.travel(&to, least, &bounds, now)
                }
                Stage::Press { squeeze, to } => {
                    let (squeeze, to) = (squeeze.clone(), to.clone());
                    self.press(&squeeze, &to, readings, now)
                }
                Stage::Rest => resting && now.saturating_sub(self.began) >= REST,
            };
            if !done {
                return false;
            }
            self.stages.pop_front();
            self.from.clone_from(&self.goals);
            self.began = now;
            self.gone.fill(0.0);
        }
    }

    fn travel(&mut self, to: &[f64], least: Duration, bounds: &Bounds, now: Duration) -> bool {
        let way = self.from.iter().zip(to).map(|(a, b)| (b - a).abs()).fold(0.0, f64::max);
        let takes = travel_s(way, bounds).max(least.as_secs_f64());
        let t = now.saturating_sub(self.began).as_secs_f64();
        let share = if takes > 0.0 { (t / takes).min(1.0) } else { 1.0 };
        let eased = share * share * (3.0 - 2.0 * share);
        for ((goal, from), to) in self.goals.iter_mut().zip(&self.from).zip(to) {
            *goal = from + eased * (to - from);
        }
        share >= 1.0
    }

    fn press(&mut self, squeeze: &[f64], to: &[f64], readings: &[Reading], now: Duration) -> bool {
        // A finger that merely met something goes on until one of its motors gives what it may: fingers of several motors
        // hold by what they press with, and lag a little behind their goals in any case.
        let held = pressed(&self.goals, readings, &self.bounds);
        let dt = now.saturating_sub(self.began).as_secs_f64();
        let longest = squeeze.iter().map(|s| s.abs()).fold(0.0, f64::max);
        // A ramp up to the speed keeps to the acceleration; where a finger stops, an object stops it.
        let speed = (PRESSING * self.bounds.speed_rad_s).min(self.bounds.acceleration_rad_s2 * dt);
        let step = self.dt(now) * (speed / longest.max(1e-9)).min(SQUEEZES_S);
        let mut done = true;
        for joint in 0..self.goals.len() {
            let finger = self.fingers[joint];
            // Joints that do not close, such as those that spread fingers, do not say that their finger holds something.
            if (0..held.len()).any(|j| self.fingers[j] == finger && held[j] && squeeze[j] != 0.0) {
                continue;
            }
            self.gone[joint] = (self.gone[joint] + step).min(MOST_SQUEEZES);
            let next = self.from[joint] + self.gone[joint] * squeeze[joint];
            let (least, most) = (self.from[joint].min(to[joint]), self.from[joint].max(to[joint]));
            self.goals[joint] = next.clamp(least, most);
            done &= self.gone[joint] >= MOST_SQUEEZES || self.goals[joint] == to[joint];
        }
        done
    }

    /// Time since the last reading, seconds; a pause does not become a leap.
    fn dt(&self, now: Duration) -> f64 {
        self.rest.since_last(now).as_secs_f64().min(0.05)
    }
}

/// Time of a way, seconds: the cubic's largest speed is 1.5 times its mean, its largest acceleration 6 times way over
/// time squared.
fn travel_s(way: f64, bounds: &Bounds) -> f64 {
    (1.5 * way / bounds.speed_rad_s).max((6.0 * way / bounds.acceleration_rad_s2).sqrt())
}

/// How far each joint goes on at a time: as from contact to the squeeze, in the direction of closing. One that was given no
/// squeeze goes on a little, too; one that is at its end does not.
fn squeezes(contact: &[f64], squeezed: &[f64], farthest: &[f64]) -> Vec<f64> {
    let joint = |((contact, squeezed), farthest): ((&f64, &f64), &f64)| {
        let (asked, left) = (squeezed - contact, farthest - squeezed);
        if asked * left > 0.0 {
            asked
        } else if left == 0.0 {
            0.0
        } else {
            LEAST_SQUEEZE_RAD.copysign(left)
        }
    };
    contact.iter().zip(squeezed).zip(farthest).map(joint).collect()
}

/// Joints that give most of the current that they may without getting to their goal.
fn pressed(goals: &[f64], readings: &[Reading], bounds: &Bounds) -> Vec<bool> {
    let joint = |(goal, r): (&f64, &Reading)| {
        let lacks = (goal - r.position_rad).abs();
        let still = r.velocity_rad_s.abs() < 0.1;
        still && r.current_ma.abs() >= FULL_LOAD * bounds.current_ma && lacks > REST_RAD
    };
    goals.iter().zip(readings).map(joint).collect()
}

/// Joints that something holds before their goal.
pub(crate) fn held(goals: &[f64], readings: &[Reading], bounds: &Bounds) -> Vec<bool> {
    goals
        .iter()
        .zip(readings)
        .map(|(goal, r)| {
            let lacks = (goal - r.position_rad).abs();
            let still = r.velocity_rad_s.abs() < 0.1;
            let presses = r.current_ma.abs() >= HELD_LOAD * bounds.current_ma && lacks > REST_RAD;
            still && (lacks > bounds.held_rad || presses)
        })
        .collect()
}

/// Knows how long all joints have been at rest.
#[derive(Debug, Default)]
pub(crate) struct RestWatch {
    there: Vec<f64>,
    since: Duration,
    last: Duration,
    before: Duration,
}

impl RestWatch {
    pub(crate) fn new() -> Self {
        Self::default()
    }

    /// Looks at a reading; true when no joint has moved for a while.
    pub(crate) fn look(&mut self, readings: &[Reading], now: Duration) -> bool {
        (self.before, self.last) = (self.last, now);
        let moved = self.there.len() != readings.len()
            || self.there.iter().zip(readings).any(|(was, is)| (was - is.position_rad).abs() > REST_RAD);
        if moved {
            self.there = readings.iter().map(|r| r.position_rad).collect();
            self.since = now;
        }
        !moved && now.saturating_sub(self.since) >= REST
    }

    fn since_last(&self, now: Duration) -> Duration {
        now.saturating_sub(self.before)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const TICK: Duration = Duration::from_millis(10);

    fn bounds() -> Bounds {
        Bounds { speed_rad_s: 2.0, acceleration_rad_s2: 20.0, current_ma: 300.0, held_rad: 0.08 }
    }

    /// Joints that follow at once up to walls; goals of every tick.
    fn run(motion: &mut Motion, walls: &[f64], most: u32) -> (Vec<Vec<f64>>, Vec<Reading>, bool) {
        let mut readings: Vec<Reading> =
            motion.goals().iter().map(|g| Reading { position_rad: *g, ..Reading::default() }).collect();
        let mut goals = Vec::new();
        for tick in 1..=most {
            let done = motion.step(&readings, TICK * tick);
            goals.push(motion.goals().to_vec());
            for ((reading, goal), wall) in readings.iter_mut().zip(motion.goals()).zip(walls) {
                let to = goal.min(*wall);
                reading.velocity_rad_s = (to - reading.position_rad) / TICK.as_secs_f64();
                reading.position_rad = to;
                reading.current_ma = if to < *goal { 300.0 } else { 0.0 };
            }
            if done {
                return (goals, readings, true);
            }
        }
        (goals, readings, false)
    }

    #[test]
    fn all_joints_arrive_together() {
        let mut motion = Motion::grip(vec![0, 1], vec![0.0, 0.0], vec![1.0, -0.5], bounds(), Duration::ZERO);
        let (goals, readings, done) = run(&mut motion, &[9.0, 9.0], 300);
        assert!(done);
        for goal in &goals {
            assert!((goal[0] + 2.0 * goal[1]).abs() < 1e-12, "{goal:?}");
        }
        assert!((readings[0].position_rad - 1.0).abs() < 1e-12);
        // 1.5 rad at 2 rad/s: the way takes 0.75 s, then the joints rest.
        assert!((goals.len() as f64 * 0.01 - 0.97).abs() < 0.05, "{}", goals.len());
    }

    #[test]
    fn a_finger_stops_where_it_is_held_and_the_other_goes_on() {
        let far = [1.5, 1.5, 1.5];
        let way: [&[f64]; 3] = [&[0.5, 0.5, 0.5], &[0.7, 0.7, 0.7], &far];
        let fingers = vec![0, 0, 1];
        let mut motion = Motion::close(
            fingers,
            vec![0.0; 3],
            way,
            (Duration::from_millis(400), 2.0),
            bounds(),
            Duration::ZERO,
        );
        let (_, readings, done) = run(&mut motion, &[0.6, 9.0, 1.2], 600);
        assert!(done);
        let goals = motion.goals();
        // Joint 1 is not held itself: its finger is.
        assert!((goals[0] - 0.7).abs() < 0.05 && (goals[1] - 0.7).abs() < 0.05, "{goals:?}");
        assert!(goals[2] > 1.2 && goals[2] < 1.35, "{goals:?}");
        assert_eq!(held(goals, &readings, &bounds()), [true, false, true]);
    }

    #[test]
    fn fingers_come_to_contact_as_fast_as_they_may_and_press_on_slowly() {
        let way: [&[f64]; 3] = [&[1.0], &[1.1], &[2.0]];
        let slow = Bounds { speed_rad_s: 0.5, ..bounds() };
        let mut motion = Motion::close(vec![0], vec![0.0], way, (Duration::ZERO, 2.0), slow, Duration::ZERO);
        let (goals, ..) = run(&mut motion, &[9.0], 900);
        let fastest = |from: f64, to: f64| {
            let steps = goals.windows(2).filter(|w| w[0][0] >= from && w[1][0] <= to);
            steps.map(|w| (w[1][0] - w[0][0]) / TICK.as_secs_f64()).fold(0.0, f64::max)
        };
        assert!(fastest(0.0, 1.0) > 1.8, "{}", fastest(0.0, 1.0));
        assert!(fastest(1.0, 1.1) <= 0.5 + 1e-9 && fastest(1.1, 2.0) <= 0.2 + 1e-9, "{}", fastest(1.1, 2.0));
    }

    #[test]
    fn a_finger_that_met_something_presses_with_what_it_may() {
        // A joint that gives 100 mA for each tenth of a radian that it lacks: it lacks 0.08 long before its 300 mA.
        let way: [&[f64]; 3] = [&[0.5], &[0.55], &[2.0]];
        let mut motion = Motion::close(
            vec![0],
            vec![0.0],
            way,
            (Duration::from_millis(300), 2.0),
            bounds(),
            Duration::ZERO,
        );
        let mut reading = Reading::default();
        for tick in 1..900 {
            if motion.step(&[reading], TICK * tick) {
                break;
            }
            let goal = motion.goals()[0];
            let at = goal.min(0.5);
            reading = Reading {
                position_rad: at,
                velocity_rad_s: 0.0,
                current_ma: (1000.0 * (goal - at)).min(300.0),
            };
        }
        assert!(reading.current_ma >= 0.8 * 300.0, "{reading:?}");
        assert!(motion.goals()[0] < 0.8, "it presses no farther than it must: {:?}", motion.goals());
    }

    #[test]
    fn fingers_that_meet_nothing_end_at_their_farthest_position() {
        let way: [&[f64]; 3] = [&[0.5, 0.2], &[0.7, 0.3], &[1.5, 0.4]];
        let mut motion =
            Motion::close(vec![0, 0], vec![0.0, 0.25], way, (Duration::ZERO, 2.0), bounds(), Duration::ZERO);
        let (goals, readings, done) = run(&mut motion, &[9.0, 9.0], 600);
        assert!(done);
        assert!(
            (readings[0].position_rad - 1.5).abs() < 1e-9 && (readings[1].position_rad - 0.4).abs() < 1e-9
        );
        // What was beyond contact did not open.
        assert!(goals.iter().all(|g| g[1] >= 0.25 - 1e-12));
    }

    proptest! {
        #[test]
        fn no_motion_exceeds_its_bounds(from in -1.0..1.0f64, to in -1.0..2.0f64, squeezed in 0.0..2.0f64, farthest in 0.0..2.0f64, wall in -1.0..2.0f64) {
            let way: [&[f64]; 3] = [&[to], &[squeezed], &[farthest]];
            let mut motion = Motion::close(vec![0], vec![from], way, (Duration::from_millis(100), 2.0), bounds(), Duration::ZERO);
            let (goals, _, done) = run(&mut motion, &[wall], 3000);
            prop_assert!(done);
            let mut last = from;
            for goal in goals {
                let speed = (goal[0] - last).abs() / TICK.as_secs_f64();
                prop_assert!(speed <= bounds().speed_rad_s * 1.02, "{speed}");
                last = goal[0];
            }
        }
    }
}
