//! Which goals are taken: what a goal needs, and why it cannot be.

use graspd_client::{Client, PlanGraspsRequest};

use super::{Bridge, End};
use crate::depth;
use crate::goal::Goal;
use crate::pairing::{Exposure, Missing};

impl Bridge {
    /// What a goal needs, or why it cannot be.
    pub(super) fn prepare(
        &self,
        id: &str,
        goal: &Goal,
        hand: &str,
    ) -> Result<(Client, Exposure, PlanGraspsRequest), End> {
        let refused = |reason: &str, message: String| End::new("refused", reason, message);
        let request = goal.request(hand, self.config.max_grasps)?;
        if self.running.contains_key(id) {
            return Err(refused("GOAL_ID_IN_USE", format!("a goal {id:?} is under way")));
        }
        if self.running.len() >= self.config.max_goals {
            let message = format!("{} goals are under way, no more at a time", self.running.len());
            return Err(refused("BUSY", message));
        }
        let exposure = self.frame().map_err(|(reason, message)| refused(reason, message))?;
        let frame_id = &exposure.image.header.frame_id;
        if let Some(asked) = goal.frame_id.as_ref().filter(|asked| *asked != frame_id) {
            let message = format!(
                "goal.frame_id: found {asked:?}, expected the image's, {frame_id:?}: points are not transformed"
            );
            return Err(refused("FRAME_MISMATCH", message));
        }
        if goal.target_label.is_some() && exposure.labels.is_none() {
            let message = "goal.target_label: found a label, expected none without a topic of label images";
            return Err(refused("NO_LABELS", message.to_owned()));
        }
        let away = |problem| End::new("aborted", "SERVER_AWAY", problem);
        Ok((self.link.client().map_err(away)?, exposure.clone(), request))
    }

    /// The newest frame, or why there is none to plan on.
    pub(super) fn frame(&self) -> Result<&Exposure, (&'static str, String)> {
        let topics = &self.config.topics;
        let exposure = self.frames.newest().map_err(|missing| {
            let message = match missing {
                Missing::Image => format!("no depth image has come on {}", topics.image),
                Missing::Info => format!("no camera info has come on {}", topics.info),
                Missing::Labels => {
                    format!("no label image has come on {}", topics.labels.as_deref().unwrap_or_default())
                }
                Missing::Match { partner, nearest } => format!(
                    "no {partner} of the depth image's stamp has come; the nearest differs by {:.3} s",
                    nearest.as_secs_f64()
                ),
            };
            ("NO_FRAME", message)
        })?;
        let age = exposure.complete.elapsed();
        if let Some(limit) = self.config.max_age.filter(|limit| age > *limit) {
            let message = format!(
                "the newest frame came {:.1} s ago, expected at most {:.1} s",
                age.as_secs_f64(),
                limit.as_secs_f64()
            );
            return Err(("FRAME_TOO_OLD", message));
        }
        depth::check(&exposure.image, &exposure.info, self.config.lens)
            .map_err(|error| ("INVALID_FRAME", error.to_string()))?;
        Ok(exposure)
    }
}
