//! What arms tell, and what becomes of it: leases, losses, returns.

use std::time::Duration;

use tokio::time::Instant;

use super::Lead;
use super::parts::SortError;
use crate::outcome::{End, Holding, Outcome};
use crate::run::seconds;
use crate::sort::table::{Doing, SortEvent};
use crate::sort::worker::{Notice, Order};

/// How often the loop looks up from waiting.
const TICK: Duration = Duration::from_millis(200);

impl Lead<'_> {
    /// Tries arms again that were lost long enough ago.
    pub(super) fn wake_lost(&mut self) {
        let wait = seconds(self.config.sort.come_back_s);
        for i in 0..self.arms.len() {
            let due = self.arms[i].lost_at.is_some_and(|at| at.elapsed() >= wait);
            if due && matches!(self.arms[i].doing, Doing::Lost { .. }) {
                self.arms[i].lost_at = None;
                self.arms[i].doing = Doing::Homing;
                self.arms[i].is_over_tray = true;
                self.order(i, Order::ComeBack);
            }
        }
    }

    /// Waits for the next word of an arm, not for ever.
    pub(super) async fn hear(&mut self) -> Result<(), SortError> {
        let tick = tokio::time::sleep(TICK);
        tokio::select! {
            biased;
            Some((arm, notice)) = self.notices.recv() => {
                self.on(arm, notice);
                // What else has been said by now.
                while let Ok((arm, notice)) = self.notices.try_recv() {
                    self.on(arm, notice);
                }
            }
            Some(ended) = self.workers.join_next() => match ended {
                Ok((arm, Err(source))) => {
                    return Err(SortError::Arm { arm: self.names[arm].clone(), source });
                }
                Ok((arm, Ok(()))) => self.out(arm, "its task has ended".to_owned()),
                Err(panicked) => tracing::error!(%panicked, "an arm's task has failed"),
            },
            () = tick => {}
        }
        for arm in self.space.expire(Instant::now()) {
            self.trouble(Some(arm), "no sign of life while it holds space: its space stays closed");
        }
        Ok(())
    }

    pub(super) fn on(&mut self, arm: usize, notice: Notice) {
        self.count_time();
        self.space.renew(arm, Instant::now());
        match notice {
            Notice::Step(step) => {
                if let Doing::Picking { step: now, .. } = &mut self.arms[arm].doing {
                    *now = step;
                }
            }
            Notice::Lifted => {
                // The rest of its way is part of what it holds: nobody can be there.
                if let Some(tail) = self.arms[arm].tail.take()
                    && self.space.reserve(arm, tail, Instant::now()).is_ok()
                {
                    self.changed = true;
                }
                // What lay against it is as it will stay.
                self.is_stale = true;
                let taken = self.arms[arm].taking.take();
                self.arms[arm].carries_m = taken.map_or(0.0, |t| t.width_m.hypot(t.length_m) / 2.0);
            }
            Notice::Left => {
                self.space.release(arm);
                self.leaves_tray(arm);
                self.changed = true;
            }
            Notice::Trouble(text) => self.trouble(Some(arm), &text),
            Notice::Picked { outcome, trials, successes } => {
                self.picked(arm, &outcome);
                (self.arms[arm].trials, self.arms[arm].delivered) = (trials, successes);
                self.arms[arm].doing = Doing::Homing;
            }
            Notice::Home => {
                self.space.release(arm);
                if self.arms[arm].is_over_tray {
                    self.leaves_tray(arm);
                }
                let state = &mut self.arms[arm];
                if state.tries > 0 {
                    state.came_back += 1;
                    state.tries = 0;
                    // What it could not do, it or another can: but where things lie now, only a look tells.
                    self.look = None;
                }
                self.arms[arm].doing = Doing::Idle { why: String::new() };
                self.changed = true;
            }
            Notice::Lost { end, holding } => self.lost(arm, &end, holding),
            Notice::Ended(report) => self.arms[arm].report = Some(*report),
        }
    }

    /// It is not between camera and tray any more, and nothing there is its own.
    fn leaves_tray(&mut self, arm: usize) {
        let state = &mut self.arms[arm];
        (state.is_over_tray, state.carries_m, state.taking) = (false, 0.0, None);
        self.is_stale = true;
    }

    pub(super) fn picked(&mut self, arm: usize, outcome: &Outcome) {
        match outcome {
            Outcome::Success => {
                self.failures = 0;
                self.failed.iter_mut().for_each(Vec::clear);
            }
            Outcome::Failed { .. } => {
                self.failures += 1;
                let target = self.arms[arm].target.take();
                self.failed[arm].extend(target);
            }
            Outcome::NotExecuted { .. } | Outcome::Unknown { .. } => {}
        }
        if let Outcome::Failed { why, .. } | Outcome::NotExecuted { why } = outcome {
            self.trouble(Some(arm), why);
        }
    }

    /// An arm does not do what it is asked: what it was to take goes back to the others with the next look; its space
    /// stays closed.
    pub(super) fn lost(&mut self, arm: usize, end: &End, holding: Holding) {
        self.space.doubt(arm);
        // It is not waited for: a look shows the tray around it.
        self.leaves_tray(arm);
        let held = if holding == Holding::Nothing { "" } else { " (with something in its hand, perhaps)" };
        let why = format!("{end}{held}");
        self.trouble(Some(arm), &why);
        let state = &mut self.arms[arm];
        state.lost += u32::from(state.tries == 0);
        state.tries += 1;
        let lasting = matches!(end, End::Failures { .. } | End::NoGrasp { .. } | End::Asked);
        if lasting || state.tries > self.config.recovery.tries {
            self.out(arm, why);
            return;
        }
        state.lost_at = Some(Instant::now());
        state.doing = Doing::Lost { why };
    }

    pub(super) fn out(&mut self, arm: usize, why: String) {
        self.space.doubt(arm);
        self.arms[arm].lost_at = None;
        self.arms[arm].doing = Doing::Out { why };
    }

    pub(super) fn trouble(&mut self, arm: Option<usize>, text: &str) {
        let name = arm.map(|i| self.names[i].clone());
        tracing::info!(arm = name.as_deref().unwrap_or("cell"), text, "trouble");
        self.observer.on(&SortEvent::Trouble { arm: name.as_deref(), text });
    }
}
