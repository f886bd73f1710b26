//! A look into the tray: a frame, its objects, and grasps of every hand that is or comes home.

use nalgebra::Point3;
use tokio::time::Instant;

use super::Lead;
use crate::frame::Frame;
use crate::outcome::End;
use crate::plan::PlannerError;
use crate::run::{Asked, answered, looking, seconds};
use crate::sort::objects::see;
use crate::sort::offer::{Look, Offer, PoolObject, offer};

impl Lead<'_> {
    /// Looks into the tray and plans for every hand that is there.
    pub(super) async fn look_again(&mut self) -> Result<(), End> {
        self.look = None;
        let frame = self.capture().await?;
        self.looks += 1;
        let mut objects: Vec<PoolObject> = see(&frame, &self.config.tray, self.config.sort.object_height_m)
            .into_iter()
            .map(|seen| PoolObject { seen, rule: None, waits: true })
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
            self.empty_looks += 1;
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

    /// A new frame; tried again with a growing wait.
    pub(super) async fn capture(&mut self) -> Result<Frame, End> {
        let (rules, camera) = (&self.config.recovery, &self.config.camera);
        let (limit, max_age) = (seconds(self.config.timeouts.capture_s), seconds(camera.max_age_s));
        let mut before = 0;
        loop {
            let patience = limit.mul_f64(self.config.timeouts.patience);
            let why = match tokio::time::timeout(patience, self.cell.camera.capture(max_age, limit)).await {
                Err(_) => format!("the camera has not answered for {patience:?}"),
                Ok(Err(error)) => error.to_string(),
                Ok(Ok(frame)) if frame.age > max_age => format!("a frame {:?} old", frame.age),
                Ok(Ok(frame)) if self.last_exposure == Some(frame.sequence) => {
                    "the same exposure again".into()
                }
                Ok(Ok(frame)) => {
                    self.last_exposure = Some(frame.sequence);
                    let pose = looking(&camera.position_m, &camera.looks_at_m);
                    return Frame::of(&frame, &pose).map_err(|e| End::CameraLost { why: e.to_string() });
                }
            };
            self.trouble(None, &why);
            if before >= rules.tries {
                return Err(End::CameraLost { why });
            }
            tokio::time::sleep(rules.backoff(before)).await;
            before += 1;
        }
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
