//! From closing the fingers to opening them over the dropping place, and the way out after a failure.

use super::calls::{Pace, Problem, Who};
use super::{Next, Run};
use crate::outcome::{Holding, Outcome};
use crate::steps::{Step, Trouble};

impl Run<'_> {
    /// All fingers together to where contact is expected, and on until they are held (Supplementary Note 7). Where each
    /// has one motor they close as far as they go with their limited force. Fingers of several motors go to the planned
    /// squeeze, and on from there, all joints in proportion, while too little holds them.
    pub(super) async fn close(&mut self) -> Result<Next, Problem> {
        self.holding = Holding::Unknown;
        let grasp = self.chosen()?.clone();
        let ends: Vec<Option<f64>> = grasp.actuators.iter().map(|name| self.facts.farthest(name)).collect();
        let or_end = |(&squeezed, end): (&f64, &Option<f64>)| end.unwrap_or(squeezed);
        let farthest: Vec<f64> = grasp.squeezed.iter().zip(&ends).map(or_end).collect();
        let squeezed =
            if self.facts.one_motor_a_finger() { farthest.clone() } else { grasp.squeezed.clone() };
        self.attempt.told = Some(squeezed.clone());
        self.close_hand(&grasp, &squeezed, &farthest).await?;
        Ok(Next::Go(Step::CheckContact))
    }

    pub(super) async fn check_contact(&mut self) -> Result<Next, Problem> {
        self.must_feel("the fingers closed on nothing").await?;
        Ok(Next::Go(Step::Lift))
    }

    /// Straight up from where the hand has closed, which is short of the grasp where something was in its way.
    pub(super) async fn lift(&mut self) -> Result<Next, Problem> {
        let target = if self.attempt.lift_short {
            self.chosen()?.world_from_pregrasp.isometry()
        } else if let Some(up) = self.attempt.lift_to {
            up
        } else {
            let mut up = self.flange().await?;
            up.translation.vector.z += self.config.motion.lift_m;
            // Tried again, it goes on to the same height.
            *self.attempt.lift_to.insert(up)
        };
        self.move_linear(&target, Pace::Lift).await?;
        self.attempt.inside = false;
        Ok(Next::Go(Step::CheckHeld))
    }

    pub(super) async fn check_held(&mut self) -> Result<Next, Problem> {
        self.must_feel("the object left the hand while it was lifted").await?;
        Ok(Next::Go(Step::Carry))
    }

    pub(super) async fn carry(&mut self) -> Result<Next, Problem> {
        // Not sideways with an object from lower than that: there are other objects and the tray's walls.
        self.raise(Pace::Carry).await?;
        self.through_air(&self.places.drop, Pace::Carry).await?;
        // One that is known to be lost needs no question.
        Ok(Next::Go(if self.attempt.failed.is_some() { Step::Release } else { Step::CheckDelivered }))
    }

    pub(super) async fn check_delivered(&mut self) -> Result<Next, Problem> {
        self.must_feel("the object left the hand on the way to the drop pose").await?;
        self.attempt.felt = true;
        Ok(Next::Go(Step::Release))
    }

    pub(super) async fn release(&mut self) -> Result<Next, Problem> {
        self.open_wide().await?;
        self.holding = Holding::Nothing;
        let outcome = match self.attempt.failed.take() {
            Some((class, why)) => Outcome::Failed { class, why },
            None => Outcome::Success,
        };
        Ok(Next::Finished(outcome))
    }

    /// The way out of a failed attempt. Safe to be done again from any point of it.
    ///
    /// Fingers that open between objects and walls may press so hard on them that the arm stops itself whenever it is
    /// released. They were smaller before, and were there: closed again as they had been, they press on nothing, and go out
    /// like that. That comes before the arm is released.
    pub(super) async fn retreat(&mut self) -> Result<Next, Problem> {
        self.stop_arm().await?;
        if let Some(positions) = self.attempt.wedged.then(|| self.attempt.before_opening.clone()).flatten() {
            let names = self.cell.hand.info().actuators;
            self.grip_against(&names, &positions).await?;
            self.clear_arm().await?;
        } else {
            self.clear_arm().await?;
            if self.attempt.before_opening.is_none() {
                // A hand that cannot say where its fingers are opens all the same.
                self.attempt.before_opening = self.hand_state().await.ok().map(|state| state.actuators);
            }
            self.open_among().await?;
        }
        self.holding = Holding::Nothing;
        if self.attempt.inside {
            let back = self.chosen()?.world_from_pregrasp.isometry();
            let moved = match self.move_linear(&back, Pace::Approach).await {
                // No straight line leads out, as next to a singularity: the joints' own way is better than a person's.
                Err(problem) if problem.trouble == Trouble::OutOfReach => {
                    self.move_to(&back, Pace::Approach).await
                }
                moved => moved,
            };
            self.notice_wedge(moved)?;
            self.attempt.inside = false;
        }
        if self.attempt.wedged {
            // What went out between the fingers falls back into the tray.
            self.open_among().await?;
            self.attempt.wedged = false;
        }
        self.raise_empty(Pace::Travel).await?;
        let outcome = match self.attempt.failed.take() {
            Some((class, why)) if self.attempt.trial => Outcome::Failed { class, why },
            Some((_, why)) => Outcome::NotExecuted { why },
            None => Outcome::NotExecuted { why: "given up".to_owned() },
        };
        Ok(Next::Finished(outcome))
    }

    async fn clear_arm(&mut self) -> Result<(), Problem> {
        let cleared = self.clear_fault(Who::Arm).await;
        self.notice_wedge(cleared)
    }

    async fn open_among(&self) -> Result<(), Problem> {
        let (names, open) = self.open_posture();
        self.grip_against(&names, &open).await.map(drop)
    }

    /// An arm that stops itself, or refuses to move, on the way out: the next try is with the fingers the other way.
    fn notice_wedge(&mut self, done: Result<(), Problem>) -> Result<(), Problem> {
        if let Err(problem) = &done
            && matches!(problem.trouble, Trouble::Stop | Trouble::OutOfReach)
        {
            self.attempt.wedged = !self.attempt.wedged && self.attempt.before_opening.is_some();
        }
        done
    }

    async fn must_feel(&mut self, otherwise: &str) -> Result<(), Problem> {
        if self.feels().await? {
            self.holding = Holding::Object;
            return Ok(());
        }
        Err(Problem { who: Who::Hand, trouble: Trouble::NothingHeld, text: otherwise.to_owned() })
    }
}
