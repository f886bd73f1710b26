//! From the chosen grasp to the hand among the objects.

use graspd_adapters_core::Reached;

use super::calls::{Pace, Problem, Who};
use super::{Next, Run};
use crate::plan::PlannedGrasp;
use crate::pose::raised_to;
use crate::steps::{Step, Trouble};

impl Run<'_> {
    /// The grasp that is tried; there is one in every step that asks.
    pub(super) fn chosen(&self) -> Result<&PlannedGrasp, Problem> {
        let chosen = self.attempt.grasp().map(|(_, grasp)| grasp);
        chosen.ok_or_else(|| Problem::broken(Who::Planner, "no grasp is chosen"))
    }

    pub(super) async fn open(&mut self) -> Result<Next, Problem> {
        let (names, open) = self.open_posture();
        self.grip(&names, &open).await?;
        Ok(Next::Go(Step::Pregrasp))
    }

    /// Up, across above everything, and down to the pre-grasp.
    pub(super) async fn pregrasp(&mut self) -> Result<Next, Problem> {
        let pregrasp = self.chosen()?.world_from_pregrasp.isometry();
        let above = raised_to(&pregrasp, &self.facts.tool_point, self.places.travel_m);
        self.raise_empty(Pace::Travel).await?;
        self.move_to(&above, Pace::Travel).await?;
        self.move_linear(&pregrasp, Pace::Approach).await?;
        Ok(Next::Go(Step::Approach))
    }

    /// Straight to the grasp, or as far as nothing resists: the fingers close there, and what they hold decides. From here on it is a grasp trial.
    pub(super) async fn approach(&mut self) -> Result<Next, Problem> {
        let grasp = self.chosen()?.world_from_hand.isometry();
        self.attempt.trial = true;
        self.attempt.inside = true;
        let moved = self.move_until_contact(&grasp).await;
        if let Err(problem) = &moved
            && problem.trouble == Trouble::OutOfReach
        {
            // Refused before anything moved.
            self.attempt.trial = false;
            self.attempt.inside = false;
        }
        self.attempt.met = moved? == Reached::Contact;
        self.idle_attempts = 0;
        Ok(Next::Go(Step::Close))
    }
}
