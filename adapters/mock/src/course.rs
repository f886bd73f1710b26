//! One motion of a mock arm: what was ordered, how far it has come, whether something blocks it.

use graspd_adapters_core::Reached;
use nalgebra::{Isometry3, Vector3};

use crate::link::Call;
use crate::shared::Reply;

/// A motion that makes less than [`PROGRESS`] of its speed for this long is blocked, seconds.
const BLOCKED_S: f64 = 0.5;
/// Share of its speed that a motion must make.
const PROGRESS: f64 = 0.1;
/// Turning counts as the way of a point this far from the flange, metres.
const TURNING_M: f64 = 0.1;

/// A motion to begin.
pub(crate) struct Order {
    pub(crate) call: Call,
    pub(crate) reply: Reply<Reached>,
    pub(crate) world_from_hand: Isometry3<f64>,
    pub(crate) speed_m_s: f64,
    /// Force at which it ends as it should; none: it goes on.
    pub(crate) contact_n: Option<f64>,
    /// One of many that somebody leads along.
    pub(crate) led: bool,
}

/// A motion that runs.
pub(crate) struct Motion {
    pub(crate) call: Call,
    pub(crate) reply: Reply<Reached>,
    pub(crate) began_s: f64,
    last: Vector3<f64>,
    pub(crate) path_m: f64,
    goal: Isometry3<f64>,
    speed_m_s: f64,
    pub(crate) contact_n: Option<f64>,
    pub(crate) led: bool,
    /// The least way that was left, and when it was reached.
    left_m: f64,
    left_at_s: f64,
}

impl Motion {
    /// The motion that is ordered, of an arm whose flange is at `at` (world frame) and turns at `turn_rad_s`.
    pub(crate) fn new(order: Order, at: Vector3<f64>, now_s: f64, turn_rad_s: f64) -> Self {
        Self {
            call: order.call,
            reply: order.reply,
            began_s: now_s,
            last: at,
            path_m: 0.0,
            goal: order.world_from_hand,
            speed_m_s: order.speed_m_s.min(TURNING_M * turn_rad_s),
            contact_n: order.contact_n,
            led: order.led,
            left_m: f64::INFINITY,
            left_at_s: now_s,
        }
    }

    /// Takes the place of another that was led along: what was counted counts on.
    pub(crate) fn go_on_from(&mut self, before: &Self) {
        (self.began_s, self.path_m) = (before.began_s, before.path_m);
    }

    /// Counts the way since it was looked at last.
    pub(crate) fn go_on(&mut self, at: &Isometry3<f64>) {
        self.path_m += (at.translation.vector - self.last).norm();
        self.last = at.translation.vector;
    }

    /// Way and angle left.
    pub(crate) fn left(&self, at: &Isometry3<f64>) -> (f64, f64) {
        let way = (self.goal.translation.vector - at.translation.vector).norm();
        (way, self.goal.rotation.angle_to(&at.rotation))
    }

    /// True when something blocks it: it has stopped following its path.
    pub(crate) fn blocked(&mut self, at: &Isometry3<f64>, now_s: f64) -> bool {
        let (way, angle) = self.left(at);
        let left_m = way + TURNING_M * angle;
        if left_m < self.left_m - PROGRESS * self.speed_m_s * BLOCKED_S {
            (self.left_m, self.left_at_s) = (left_m, now_s);
        }
        now_s - self.left_at_s > BLOCKED_S
    }
}
