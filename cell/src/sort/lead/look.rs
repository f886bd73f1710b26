//! A look into the tray: a frame, its objects, and grasps of every hand that is or comes home.

use graspd_assign::Capsule;
use nalgebra::{Isometry3, Point3};
use tokio::time::Instant;

use super::Lead;
use crate::frame::Frame;
use crate::outcome::End;
use crate::plan::PlannerError;
use crate::run::{Asked, answered, looking, seconds};
use crate::sort::objects::{Seen, see};
use crate::sort::offer::{Look, Offer, PoolObject, offer};
use crate::sort::shadow::hide;
use crate::sort::way::{sweep_with_tail, through};

/// Pixels so far beside an arm's bodies are not believed either: edges are noisy, and arms are not exactly where they say,
/// metres.
const SEEN_BESIDE_M: f64 = 0.015;

impl Lead<'_> {
    /// Looks into the tray and plans for every hand that is there.
    pub(super) async fn look_again(&mut self) -> Result<(), End> {
        self.look = None;
        self.is_stale = false;
        let (mut frame, bodies) = self.capture().await?;
        let _still = self.cell.clock.still();
        let is_whole = bodies.is_empty();
        let shadow = hide(&mut frame, &bodies, &self.config.tray);
        self.looks += 1;
        self.looks_past_arms += u32::from(!is_whole);
        let mut objects: Vec<PoolObject> =
            see(&frame, &shadow, &self.config.tray, self.config.sort.object_height_m)
                .into_iter()
                .map(|seen| PoolObject {
                    waits: !seen.is_cut && !self.is_being_taken(&seen),
                    seen,
                    rule: None,
                })
                .collect();
        let classes = match &self.cell.recognizer {
            Some(recognizer) => recognizer.classes().await,
            None => Vec::new(),
        };
        for object in &mut objects {
            let near = |(point, _): &&(Point3<f64>, String)| object.seen.distance(point) < 0.02;
            let class = classes.iter().find(near).map(|(_, class)| class.as_str());
            object.rule = self.config.rules.iter().position(|r| r.fits(object.seen.width_m, class));
        }
        let asked = |arm: usize| {
            let number = u64::from(self.looks - 1) * self.arms.len() as u64 + arm as u64;
            let asked = Asked {
                number,
                idle: self.idle_looks,
                failures: self.failures,
                seemed_empty: self.empty_looks > 0,
            };
            asked.question(&self.config.cell(&self.config.arms[arm])).as_recorded()
        };
        // Those that deliver are home soon.
        let arms: Vec<usize> = (0..self.arms.len()).filter(|&arm| self.arms[arm].is_coming()).collect();
        let questions: Result<Vec<_>, _> = arms.iter().map(|&arm| asked(arm)).collect();
        let questions = questions.map_err(|e| End::PlannerRefused { why: e.to_string() })?;
        let began = Instant::now();
        let answers = self.plan(&frame, &questions).await?;
        self.plan_s.push(began.elapsed().as_secs_f64());
        let empty = |a: &crate::plan::Answer| a.no_grasp.as_ref().is_some_and(|n| n.reason.is_empty_tray());
        if !answers.is_empty() && answers.iter().all(empty) {
            // What arms hide may be all that there is.
            self.empty_looks += u32::from(is_whole);
            return Ok(());
        }
        self.empty_looks = 0;
        let mut offers: Vec<Option<Offer>> = (0..self.arms.len()).map(|_| None).collect();
        for ((&arm, question), answer) in arms.iter().zip(questions).zip(answers) {
            let parts = (&self.cell.arms[arm], &self.stations[arm]);
            let around = (&self.space, &self.failed[arm][..]);
            offers[arm] = Some(offer(self.config, arm, parts, (question, answer), &objects, around));
        }
        self.changed = true;
        self.look = Some(Look { number: self.looks, frame, objects, offers });
        Ok(())
    }

    /// True for what an arm is about to lift, and for what lies against it.
    fn is_being_taken(&self, seen: &Seen) -> bool {
        let taking = self.arms.iter().filter_map(|a| a.taking.as_ref());
        taking.into_iter().any(|taken| seen.gap(taken) <= self.config.sort.disturbed_m)
    }

    /// A new frame, and the space in which arms may have been between camera and tray when it was exposed; tried again with a
    /// growing wait.
    async fn capture(&mut self) -> Result<(Frame, Vec<Capsule>), End> {
        let (rules, camera) = (&self.config.recovery, &self.config.camera);
        let (limit, max_age) = (seconds(self.config.timeouts.capture_s), seconds(camera.max_age_s));
        let over: Vec<usize> = (0..self.arms.len()).filter(|&arm| self.arms[arm].is_over_tray).collect();
        let asked_s = self.cell.clock.now_s();
        let before = self.poses(&over).await;
        let mut tries = 0;
        loop {
            let patience = limit.mul_f64(self.config.timeouts.patience);
            let why = match tokio::time::timeout(patience, self.cell.camera.capture(max_age, limit)).await {
                Err(_) => format!("the camera has not answered for {patience:?}"),
                Ok(Err(error)) => error.to_string(),
                Ok(Ok(frame)) if frame.age > max_age => format!("a frame {:?} old", frame.age),
                Ok(Ok(frame)) if self.last_exposure == Some(frame.sequence) => {
                    "the same exposure again".into()
                }
                Ok(Ok(frame))
                    if !over.is_empty() && frame.age.as_secs_f64() > self.cell.clock.now_s() - asked_s =>
                {
                    "exposed before the arms over the tray were asked where they are".into()
                }
                Ok(Ok(frame)) => {
                    self.last_exposure = Some(frame.sequence);
                    let pose = looking(&camera.position_m, &camera.looks_at_m);
                    let frame =
                        Frame::of(&frame, &pose).map_err(|e| End::CameraLost { why: e.to_string() })?;
                    let after = self.poses(&over).await;
                    let arms = over.iter().zip(before.iter().zip(after));
                    let bodies = arms.flat_map(|(&arm, (before, after))| self.bodies(arm, before.zip(after)));
                    return Ok((frame, bodies.collect()));
                }
            };
            self.trouble(None, &why);
            if tries >= rules.tries {
                return Err(End::CameraLost { why });
            }
            tokio::time::sleep(rules.backoff(tries)).await;
            tries += 1;
        }
    }

    /// Where the hands of these arms are; `None` for one that does not say.
    async fn poses(&self, arms: &[usize]) -> Vec<Option<Isometry3<f64>>> {
        let limit = seconds(self.config.timeouts.state_s);
        let mut poses = Vec::with_capacity(arms.len());
        for &arm in arms {
            let state = tokio::time::timeout(limit, self.cell.arms[arm].arm.state(limit)).await;
            poses.push(state.ok().and_then(Result::ok).map(|state| state.world_from_flange));
        }
        poses
    }

    /// The space in which an arm, its hand and what it carries may be between two poses of the hand; all that it holds where
    /// those are not known.
    fn bodies(&self, arm: usize, poses: Option<(Isometry3<f64>, Isometry3<f64>)>) -> Vec<Capsule> {
        let station = &self.stations[arm];
        let swept = poses.and_then(|(before, after)| {
            let way = through(&[station.home, before, after]);
            let tail = through(&[before, after]).len();
            let found = sweep_with_tail(&*self.cell.arms[arm].shape, &station.hand, &way, tail);
            let (mut swept, begin, _) = found.ok()?;
            let mut bodies = swept.split_off(begin);
            if self.arms[arm].carries_m > 0.0 {
                let tool = |pose: &Isometry3<f64>| pose * station.hand.tool_point;
                let radius_m = self.arms[arm].carries_m;
                bodies.push(Capsule { a: tool(&before), b: tool(&after), radius_m });
            }
            Some(bodies)
        });
        let mut bodies = swept.unwrap_or_else(|| self.space.held(arm));
        for body in &mut bodies {
            body.radius_m += SEEN_BESIDE_M;
        }
        bodies
    }

    /// Answers of all hands. A planner that is away is waited for until the time limit.
    pub(super) async fn plan(
        &mut self,
        frame: &Frame,
        questions: &[crate::plan::Question],
    ) -> Result<Vec<crate::plan::Answer>, End> {
        let limit = seconds(self.config.timeouts.plan_s);
        let (mut before, mut failed) = (0, 0);
        loop {
            let asked = answered(limit, self.cell.planner.plan_together(frame, questions, limit)).await;
            let error = match asked {
                Ok(answers) if answers.len() == questions.len() => return Ok(answers),
                Ok(_) => PlannerError::Failed("not every hand was answered".to_owned()),
                Err(error) => error,
            };
            let why = error.to_string();
            self.trouble(None, &why);
            match error {
                PlannerError::Refused(_) => return Err(End::PlannerRefused { why }),
                PlannerError::Failed(_) if failed >= self.config.recovery.tries => {
                    return Err(End::PlannerLost { why });
                }
                PlannerError::Failed(_) => failed += 1,
                PlannerError::Away(_) => {}
            }
            match self.must_end() {
                Some(End::TimeLimit) => return Err(End::PlannerLost { why }),
                Some(end) => return Err(end),
                None => tokio::time::sleep(self.config.recovery.backoff(before)).await,
            }
            before += 1;
        }
    }
}
