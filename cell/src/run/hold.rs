//! From closing the fingers to opening them over the dropping place, and the way out after a failure.

use super::calls::{Pace, Problem, Who};
use super::{Next, Run};
use crate::outcome::{Holding, Outcome};
use crate::steps::{Step, Trouble};

/// Fingers that have met too little close by one more squeeze, so often.
const MORE_SQUEEZES: u32 = 8;
/// Motors that must be held before a hand of several closing motors stops closing.
const HELD_MOTORS: usize = 2;

impl Run<'_> {
    /// All fingers at once, until they are held (Supplementary Note 7). Where each has one motor they close as far as
    /// they go with their limited force. Fingers of several motors go to the planned squeeze, and on from there, all
    /// joints in proportion, while too little holds them.
    pub(super) async fn close(&mut self) -> Result<Next, Problem> {
        self.holding = Holding::Unknown;
        let grasp = self.chosen()?.clone();
        let closed = |name: &String| {
            let facts = self.facts.actuators.iter().find(|a| a.name == *name && a.open != a.closed);
            facts.map(|a| a.closed)
        };
        let limits: Vec<Option<f64>> = grasp.actuators.iter().map(closed).collect();
        let mut told = grasp.squeezed.clone();
        if self.facts.one_motor_a_finger() {
            for (to, limit) in told.iter_mut().zip(&limits) {
                *to = limit.unwrap_or(*to);
            }
        }
        self.attempt.told = Some(told.clone());
        let mut state = self.grip_against(&grasp.actuators, &told).await?;
        for _ in 0..MORE_SQUEEZES {
            let held = state.held.iter().filter(|h| **h).count();
            if held >= HELD_MOTORS.min(state.held.len()) {
                break;
            }
            let before = told.clone();
            for (i, to) in told.iter_mut().enumerate() {
                let (Some(contact), Some(squeezed)) = (grasp.contact.get(i), grasp.squeezed.get(i)) else {
                    continue;
                };
                if let Some(limit) = limits.get(i).copied().flatten() {
                    let next = *to + squeezed - contact;
                    *to =
                        if squeezed > contact { next.min(limit.max(*to)) } else { next.max(limit.min(*to)) };
                }
            }
            if told == before {
                break;
            }
            self.attempt.told = Some(told.clone());
            state = self.grip_against(&grasp.actuators, &told).await?;
        }
        Ok(Next::Go(Step::CheckContact))
    }

    pub(super) async fn check_contact(&mut self) -> Result<Next, Problem> {
        self.must_feel("the fingers closed on nothing").await?;
        Ok(Next::Go(Step::Lift))
    }

    /// Straight up.
    pub(super) async fn lift(&mut self) -> Result<Next, Problem> {
        let grasp = self.chosen()?;
        let target = if self.attempt.lift_short {
            grasp.world_from_pregrasp.isometry()
        } else {
            let mut up = grasp.world_from_hand.isometry();
            up.translation.vector.z += self.config.motion.lift_m;
            up
        };
        self.move_linear(&target, Pace::Carry).await?;
        self.attempt.inside = false;
        Ok(Next::Go(Step::CheckHeld))
    }

    pub(super) async fn check_held(&mut self) -> Result<Next, Problem> {
        self.must_feel("the object left the hand while it was lifted").await?;
        Ok(Next::Go(Step::Carry))
    }

    pub(super) async fn carry(&mut self) -> Result<Next, Problem> {
        self.raise(Pace::Carry).await?;
        self.move_to(&self.places.drop, Pace::Carry).await?;
        // One that is known to be lost needs no question.
        Ok(Next::Go(if self.attempt.failed.is_some() { Step::Release } else { Step::CheckDelivered }))
    }

    pub(super) async fn check_delivered(&mut self) -> Result<Next, Problem> {
        self.must_feel("the object left the hand on the way to the drop pose").await?;
        self.attempt.felt = true;
        Ok(Next::Go(Step::Release))
    }

    pub(super) async fn release(&mut self) -> Result<Next, Problem> {
        self.open_hand().await?;
        self.holding = Holding::Nothing;
        let outcome = match self.attempt.failed.take() {
            Some((class, why)) => Outcome::Failed { class, why },
            None => Outcome::Success,
        };
        Ok(Next::Finished(outcome))
    }

    /// The way out of a failed attempt. Safe to be done again from any point of it.
    pub(super) async fn retreat(&mut self) -> Result<Next, Problem> {
        self.stop_arm().await?;
        self.clear_fault(Who::Arm).await?;
        let (names, open) = self.open_posture();
        self.grip_against(&names, &open).await?;
        self.holding = Holding::Nothing;
        if self.attempt.inside {
            let back = self.chosen()?.world_from_pregrasp.isometry();
            self.move_linear(&back, Pace::Approach).await?;
            self.attempt.inside = false;
        }
        self.raise(Pace::Travel).await?;
        let outcome = match self.attempt.failed.take() {
            Some((class, why)) if self.attempt.trial => Outcome::Failed { class, why },
            Some((_, why)) => Outcome::NotExecuted { why },
            None => Outcome::NotExecuted { why: "given up".to_owned() },
        };
        Ok(Next::Finished(outcome))
    }

    async fn must_feel(&mut self, otherwise: &str) -> Result<(), Problem> {
        if self.feels().await? {
            self.holding = Holding::Object;
            return Ok(());
        }
        Err(Problem { who: Who::Hand, trouble: Trouble::NothingHeld, text: otherwise.to_owned() })
    }
}
