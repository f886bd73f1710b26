//! Which grasps the arm can go to; from the chosen one to the hand among the objects.

use graspd_adapters_core::{Leg, Reach, Reached};

use super::calls::{Pace, Problem, Who};
use super::{Next, Run};
use crate::plan::{Answer, PlannedGrasp};
use crate::pose::raised_to;
use crate::record::OutOfReach;
use crate::steps::{Step, Trouble};

/// Names of the motions to a grasp, in order.
const TO: [&str; 3] = ["above", "pregrasp", "grasp"];

impl Run<'_> {
    /// The way to a grasp, as [`Run::pregrasp`] and [`Run::approach`] go it. How far the hand is lifted is not part of it:
    /// where the full lift is out of reach, it is lifted to the pre-grasp.
    fn way_to(&self, grasp: &PlannedGrasp) -> [Leg; 3] {
        let pregrasp = grasp.world_from_pregrasp.isometry();
        let above = raised_to(&pregrasp, &self.facts.tool_point, self.places.travel_m);
        let leg = |world_from_flange, straight, pace| {
            let limits = self.limits(pace);
            Leg { world_from_flange, straight, limits }
        };
        [
            leg(above, false, Pace::Travel),
            leg(pregrasp, true, Pace::Approach),
            leg(grasp.world_from_hand.isometry(), true, Pace::Approach),
        ]
    }

    /// The grasps of an answer that the arm says it cannot go to. An arm that cannot tell drops none: it refuses on the
    /// way.
    pub(super) fn out_of_reach(&self, answer: &Answer) -> Vec<OutOfReach> {
        let asked = |(rank, grasp)| match self.cell.arm.reaches(&self.way_to(grasp)) {
            Reach::Beyond { leg, why } => {
                let to = TO.get(leg).copied().unwrap_or("grasp").to_owned();
                Some(OutOfReach { rank, to, why })
            }
            Reach::Reaches | Reach::Unknown => None,
        };
        answer.grasps.iter().enumerate().filter_map(asked).collect()
    }

    /// Trouble when an answer has grasps, and the arm reaches none of them.
    pub(super) fn some_in_reach(&self) -> Result<(), Problem> {
        match &self.attempt.out_of_reach[..] {
            [best, ..] if self.attempt.grasp().is_none() => {
                let count = self.attempt.out_of_reach.len();
                let text =
                    format!("none of {count} grasps is in reach; the best, to its {}: {}", best.to, best.why);
                Err(Problem { who: Who::Planner, trouble: Trouble::NoGrasp, text })
            }
            _ => Ok(()),
        }
    }

    /// The grasp that is tried; there is one in every step that asks.
    pub(super) fn chosen(&self) -> Result<&PlannedGrasp, Problem> {
        let chosen = self.attempt.grasp().map(|(_, grasp)| grasp);
        chosen.ok_or_else(|| Problem::broken(Who::Planner, "no grasp is chosen"))
    }

    pub(super) async fn open(&mut self) -> Result<Next, Problem> {
        let (names, open) = self.open_posture();
        self.grip(&names, &open).await?;
        self.attempt.opened = Some(open);
        // A servo leads the hand there.
        Ok(Next::Go(if self.servoing.is_some() { Step::Follow } else { Step::Pregrasp }))
    }

    /// Up, across above everything, and down to the pre-grasp.
    pub(super) async fn pregrasp(&mut self) -> Result<Next, Problem> {
        let pregrasp = self.chosen()?.world_from_pregrasp.isometry();
        let above = raised_to(&pregrasp, &self.facts.tool_point, self.places.travel_m);
        self.raise_empty(Pace::Travel).await?;
        self.through_air(&above, Pace::Travel).await?;
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
