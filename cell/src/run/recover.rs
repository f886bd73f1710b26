//! Doing what the table of recoveries says.

use super::calls::{Problem, Who};
use super::{Next, Run};
use crate::outcome::{End, FailureClass, Outcome};
use crate::recovery::Recovery;
use crate::steps::{Step, Trouble};

impl Run<'_> {
    pub(super) async fn recover(&mut self, recovery: Recovery, problem: Problem) -> Next {
        // `tries` counts this trouble already.
        let wait = self.config.recovery.backoff(self.tries.saturating_sub(1));
        match recovery {
            Recovery::Retry => {
                self.pause(wait).await;
                Next::Again
            }
            Recovery::ClearAndRetry => {
                self.pause(wait).await;
                // Whether it is released shows with the next try; only a person's business ends the run here.
                match self.clear_fault(problem.who).await {
                    Err(p) if matches!(p.trouble, Trouble::Emergency | Trouble::Broken) => Next::End(p.end()),
                    _ => Next::Again,
                }
            }
            Recovery::ClearAndFeel => self.clear_and_feel(problem).await,
            Recovery::Wait => {
                if self.observer.wants_end() {
                    return Next::End(End::Asked);
                }
                if self.out_of_time() {
                    return Next::End(problem.end());
                }
                self.pause(wait).await;
                Next::Again
            }
            Recovery::NextGrasp => {
                if self.attempt.next_grasp() {
                    return Next::Go(Step::Open);
                }
                let why = format!("no ranked grasp is in reach; the last: {}", problem.text);
                Next::Finished(Outcome::NotExecuted { why })
            }
            Recovery::LiftToPregrasp if !self.attempt.lift_short => {
                self.attempt.lift_short = true;
                Next::Again
            }
            Recovery::Retreat => {
                let class = self.failure_class(problem.trouble);
                self.attempt.fail(class, &problem.text);
                Next::Go(Step::Retreat)
            }
            Recovery::BackOff => match self.back_off().await {
                Ok(()) => Next::Finished(Outcome::NotExecuted { why: problem.text }),
                Err(_) => {
                    self.attempt.fail(self.failure_class(problem.trouble), &problem.text);
                    Next::Go(Step::Retreat)
                }
            },
            Recovery::PlanAgain => Next::Finished(Outcome::NotExecuted { why: problem.text }),
            Recovery::LiftToPregrasp | Recovery::End => Next::End(problem.end()),
        }
    }

    /// After a stop with something in the hand.
    async fn clear_and_feel(&mut self, problem: Problem) -> Next {
        if let Err(p) = self.clear_fault(Who::Arm).await
            && matches!(p.trouble, Trouble::Emergency | Trouble::Broken)
        {
            return Next::End(p.end());
        }
        let mut before = 0;
        let feels = loop {
            match self.feels().await {
                Ok(feels) => break feels,
                Err(p) if matches!(p.trouble, Trouble::Emergency | Trouble::Broken) => {
                    return Next::End(p.end());
                }
                Err(p) if before >= self.config.recovery.tries => return Next::End(p.end()),
                Err(_) => {
                    self.pause(self.config.recovery.backoff(before)).await;
                    before += 1;
                }
            }
        };
        if feels {
            return Next::Again;
        }
        self.attempt.fail(self.failure_class(Trouble::NothingHeld), &problem.text);
        // Over the tray the hand opens at once. On the way it opens at the drop pose: what it may hold after all, it
        // must not let go of anywhere else.
        if self.step == Step::Carry { Next::Again } else { Next::Go(Step::Retreat) }
    }

    /// What trouble in this step makes of the trial.
    fn failure_class(&self, trouble: Trouble) -> FailureClass {
        match (self.step, trouble) {
            (Step::Approach | Step::Lift, Trouble::Stop) => FailureClass::Collision,
            // Whatever was lost later: a hand that does not get where it should has collided (Fig. 8b, c).
            (_, Trouble::NothingHeld) if self.attempt.met => FailureClass::Collision,
            (Step::CheckContact, Trouble::NothingHeld) => FailureClass::UnstableContact,
            (Step::Lift | Step::CheckHeld, Trouble::NothingHeld) => FailureClass::LostLifting,
            (Step::Carry | Step::CheckDelivered, Trouble::NothingHeld) => FailureClass::LostCarrying,
            _ => FailureClass::Device,
        }
    }
}
