//! The dynamic grasp servo (Supplementary Note 7, Task 2): a first look from afar, and the hand follows the grasp that every
//! further frame of the camera in its palm refines, until it may go straight in.

use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use graspd_adapters_core::Limits;
use graspd_adapters_core::follow::{Lead, lead};
use nalgebra::Isometry3;
use tokio::time::Instant;

use super::calls::{Pace, Problem, Who, answered, seconds};
use super::look::looking;
use super::palm::{Palm, PalmFrame};
use super::{Next, Run};
use crate::config::ServoConfig;
use crate::outcome::Outcome;
use crate::plan::{
    Answer, EmptyReason, GraspServo, NoGrasp, PlannerError, ServoAnswer, ServoFrame, ServoQuestion,
    ServoState,
};
use crate::record::ServoRecord;
use crate::steps::{Step, Trouble};

/// How often whoever leads gives a sign of life while no answer comes.
const BEAT: Duration = Duration::from_millis(50);
/// Fingers whose open posture has changed by less than this are left alone, radians or metres.
const SAME_POSTURE: f64 = 1e-3;

/// A grasp that is carried on, and what was sent of it.
#[derive(Debug)]
pub(super) struct Servoing {
    stream: Box<dyn GraspServo>,
    sent: u64,
    /// Joints of the hand as it was told to open last.
    joints: Vec<f64>,
}

impl Servoing {
    async fn send(&mut self, palm: &PalmFrame) -> Result<(), Problem> {
        self.sent += 1;
        let frame = ServoFrame {
            sequence: self.sent,
            captured: palm.captured,
            frame: &palm.frame,
            world_from_hand: &palm.world_from_hand,
            joints: &self.joints,
        };
        Ok(self.stream.send(frame).await?)
    }
}

/// A frame that is being taken.
type Looking = Pin<Box<dyn Future<Output = Result<PalmFrame, Problem>> + Send>>;

impl Run<'_> {
    /// Where the hand is when the camera in its palm takes its first look.
    pub(super) fn first_look(&self, servo: &ServoConfig) -> Isometry3<f64> {
        looking(&servo.eye_m, &servo.looks_at_m) * servo.hand_from_camera().inverse()
    }

    fn palm(&self, servo: &ServoConfig) -> Palm {
        Palm::new(&self.cell.camera, &self.cell.arm, servo.hand_from_camera(), self.config)
    }

    /// A frame of the camera in the palm, which must be a new one.
    pub(super) async fn palm_frame(&mut self, servo: &ServoConfig) -> Result<PalmFrame, Problem> {
        let palm = self.palm(servo).look().await?;
        if self.last_exposure == Some(palm.exposure) {
            let text = format!("the exposure {} again, expected a new one", palm.exposure);
            return Err(Problem { who: Who::Camera, trouble: Trouble::NoAnswer, text });
        }
        self.last_exposure = Some(palm.exposure);
        Ok(palm)
    }

    async fn begin_servo(&mut self, servo: &ServoConfig) -> Result<Servoing, Problem> {
        let question = match &self.attempt.question {
            Some(question) => question.clone(),
            None => self.question().as_recorded().map_err(|e| Problem::broken(Who::Planner, e))?,
        };
        self.attempt.question = Some(question.clone());
        let limit = seconds(self.config.timeouts.plan_s);
        let asked = ServoQuestion { question, servo: servo.clone() };
        let stream = answered(limit, self.cell.planner.servo(&asked, limit)).await?;
        Ok(Servoing { stream, sent: 0, joints: Vec::new() })
    }

    /// The first plan: what the servo says of the first look.
    pub(super) async fn servo_plan(&mut self, servo: &ServoConfig) -> Result<Next, Problem> {
        self.servoing = None;
        let mut servoing = self.begin_servo(servo).await?;
        let Some(palm) = &self.attempt.palm else {
            return Err(Problem::broken(Who::Camera, "no frame to plan from"));
        };
        servoing.send(palm).await?;
        let limit = seconds(self.config.timeouts.plan_s);
        let answer = answered(limit, servoing.stream.next()).await?;
        servoing.joints.clone_from(&answer.open_joints);
        let no_grasp = answer
            .grasp
            .is_none()
            .then(|| NoGrasp { reason: EmptyReason::named(&answer.reason), nearest_fix: String::new() });
        let hand_revision = self.facts.revision.clone();
        let plan_s = answer.age.as_secs_f64();
        let whole = Answer {
            grasps: answer.grasp.into_iter().collect(),
            no_grasp: no_grasp.clone(),
            rejected: std::collections::BTreeMap::new(),
            plan_s,
            hand_revision,
            estimator: self.config.planner.estimator.clone(),
        };
        let out_of_reach = self.out_of_reach(&whole);
        self.attempt.take(whole, out_of_reach, &[]);
        let Some(why) = no_grasp else {
            self.empty_frames = 0;
            self.some_in_reach()?;
            self.servoing = Some(servoing);
            return Ok(Next::Go(Step::Open));
        };
        if why.reason.is_empty_tray() {
            self.empty_frames += 1;
            return Ok(Next::Finished(Outcome::NotExecuted { why: why.reason.name().to_owned() }));
        }
        self.empty_frames = 0;
        Err(Problem { who: Who::Planner, trouble: Trouble::NoGrasp, text: answer.reason })
    }

    /// Follows the grasp until the hand may go straight in. Tried again after the stream has broken, it goes back to where
    /// the approach begins, and plans from there.
    pub(super) async fn follow(&mut self) -> Result<Next, Problem> {
        let Some(servo) = self.config.servo.clone() else { return Ok(Next::Go(Step::Approach)) };
        self.attempt.inside = true;
        let mut servoing = match self.servoing.take() {
            Some(servoing) => servoing,
            None => {
                let back = self.chosen()?.world_from_pregrasp.isometry();
                self.move_linear(&back, Pace::Approach).await?;
                self.begin_servo(&servo).await?
            }
        };
        let limits =
            Limits { speed_m_s: servo.speed_m_s, acceleration_m_s2: self.config.arm.acceleration_m_s2 };
        let limit = seconds(self.config.timeouts.move_s);
        let arm = Arc::clone(&self.cell.arm);
        let name = arm.info().name;
        let (lead, goals) = lead();
        // The arm hears of silence before a stream is broken: whoever leads gives signs of life until then.
        let mut following = arm.follow(goals, limits, seconds(servo.silence_s), limit);
        let led = async {
            let led = self.lead(&servo, &mut servoing, &lead).await;
            // From here on nobody leads: the arm stops and stands.
            drop(lead);
            led
        };
        let led = tokio::select! {
            biased;
            ended = &mut following => Err(match ended {
                Ok(()) => Problem::broken(Who::Arm, format!("{name}: it follows no more, expected it to until it is told")),
                Err(error) => Problem::of(Who::Arm, &error),
            }),
            led = led => {
                let stood = self.within(Who::Arm, &name, "follow", limit, following).await;
                led.and(stood)
            }
        };
        if let Err(problem) = led {
            // What the planner has lost is begun anew; a camera or an arm that recovers goes on with what there is.
            if problem.who != Who::Planner {
                self.servoing = Some(servoing);
            }
            return Err(problem);
        }
        self.reopen().await?;
        Ok(Next::Go(Step::Approach))
    }

    /// Looks, asks and leads the arm, until the hand may go straight in.
    async fn lead(
        &mut self,
        servo: &ServoConfig,
        servoing: &mut Servoing,
        lead: &Lead,
    ) -> Result<(), Problem> {
        let (silence, patience) = (seconds(servo.silence_s), seconds(servo.answer_s));
        let mut goal = self.flange().await?;
        let began = (servoing.sent, Instant::now());
        let mut approach = Approach { first: None, lost: 0, sent: servoing.sent, answered: servoing.sent };
        let mut looking: Option<Looking> = None;
        let mut heard = Instant::now();
        loop {
            lead.to(&goal);
            // The arm hears of it before the camera looks again.
            tokio::task::yield_now().await;
            if looking.is_none() && approach.under_way() < u64::from(servo.frames_under_way) {
                looking = Some(Box::pin(self.palm(servo).look()));
            }
            tokio::select! {
                biased;
                answer = servoing.stream.next(), if approach.under_way() > 0 => {
                    let answer = answer?;
                    heard = Instant::now();
                    approach.answered = answer.sequence.max(approach.answered);
                    self.note_answer(&answer, began);
                    servoing.joints.clone_from(&answer.open_joints);
                    if answer.state == ServoState::Lost {
                        approach.lost += 1;
                        if approach.lost >= servo.lost_answers {
                            return Err(lost(format!("nothing to follow in {} answers: {}", approach.lost, answer.reason)));
                        }
                        continue;
                    }
                    approach.lost = 0;
                    if let Some(grasp) = answer.grasp {
                        self.attempt.refine(grasp);
                    }
                    if let Some(standoff) = answer.world_from_standoff {
                        goal = standoff.isometry();
                    }
                    if answer.go {
                        return Ok(());
                    }
                }
                seen = look(&mut looking) => {
                    looking = None;
                    let palm = seen?;
                    if self.last_exposure == Some(palm.exposure) {
                        continue;
                    }
                    self.last_exposure = Some(palm.exposure);
                    approach.in_time(palm.captured, servo.longest_s)?;
                    servoing.send(&palm).await?;
                    approach.sent = servoing.sent;
                }
                () = tokio::time::sleep(BEAT) => {
                    if approach.under_way() == 0 {
                        // It is the camera that is waited for, within its own time.
                        heard = Instant::now();
                    } else if heard.elapsed() > patience {
                        let text = format!("no answer within {patience:?}");
                        return Err(PlannerError::Failed(text).into());
                    } else if heard.elapsed() > silence {
                        goal = self.flange().await?;
                    }
                }
            }
        }
    }

    fn note_answer(&mut self, answer: &ServoAnswer, (frames, began): (u64, Instant)) {
        let record = self.attempt.servo.get_or_insert_with(ServoRecord::default);
        record.answers += 1;
        record.frames = record.frames.max(answer.sequence.saturating_sub(frames));
        record.tracking += u64::from(answer.state == ServoState::Tracking);
        record.replanned = answer.replanned;
        record.unanswered = answer.unanswered;
        record.took_s = began.elapsed().as_secs_f64();
        record.standoff_m = answer.standoff_m;
        record.last.clone_from(&answer.reason);
        if let (Some(before), Some(now)) = (self.attempt.first_grasp(), &answer.grasp) {
            let apart = now.world_from_hand.isometry().translation.vector
                - before.world_from_hand.isometry().translation.vector;
            if let Some(record) = &mut self.attempt.servo {
                record.drift_m = apart.norm();
            }
        }
    }

    /// Opens the fingers as the refined grasp asks, where that is another posture than the first one's.
    async fn reopen(&mut self) -> Result<(), Problem> {
        let (names, open) = self.open_posture();
        let told = self.attempt.opened.as_ref();
        let same = told.is_some_and(|told| told.iter().zip(&open).all(|(a, b)| (a - b).abs() < SAME_POSTURE));
        if same {
            return Ok(());
        }
        self.attempt.opened = Some(open.clone());
        self.grip_against(&names, &open).await.map(drop)
    }

    /// Straight back along the approach to where it began.
    pub(super) async fn back_off(&mut self) -> Result<(), Problem> {
        self.servoing = None;
        if !self.attempt.inside {
            return Ok(());
        }
        let back = self.chosen()?.world_from_pregrasp.isometry();
        match self.move_linear(&back, Pace::Approach).await {
            // Upwards is what is left.
            Err(problem) if problem.trouble == Trouble::OutOfReach => {}
            done => done?,
        }
        self.attempt.inside = false;
        Ok(())
    }
}

/// How an approach goes on.
struct Approach {
    /// When its first frame was exposed, on the camera's clock, or on ours where it has none.
    first: Option<(Option<Duration>, Instant)>,
    /// Answers in a row without anything to follow.
    lost: u32,
    /// Numbers of the last frame and of the last answer.
    sent: u64,
    answered: u64,
}

impl Approach {
    fn under_way(&self) -> u64 {
        self.sent.saturating_sub(self.answered)
    }

    /// Trouble when it has taken too long.
    fn in_time(&mut self, captured: Option<Duration>, longest_s: f64) -> Result<(), Problem> {
        let (first, began) = *self.first.get_or_insert((captured, Instant::now()));
        let passed = match (first, captured) {
            (Some(first), Some(now)) => now.saturating_sub(first),
            _ => began.elapsed(),
        };
        if passed.as_secs_f64() <= longest_s {
            return Ok(());
        }
        Err(lost(format!("not near enough to grasp after {longest_s} s")))
    }
}

fn lost(text: String) -> Problem {
    Problem { who: Who::Planner, trouble: Trouble::TargetLost, text }
}

/// Ready when a frame that is being taken has come.
async fn look(looking: &mut Option<Looking>) -> Result<PalmFrame, Problem> {
    match looking {
        Some(looking) => looking.await,
        None => std::future::pending().await,
    }
}
