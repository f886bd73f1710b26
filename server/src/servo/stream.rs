//! One servo stream: frames come in at their pace, answers go out at the reader's, the planning pool works in between.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use graspd_hands::Hand;
use graspd_live::Layer;
use graspd_planner::budget::Stop;
use graspd_planner::servo::{Answer, Counters, Refused, Servo, ServoFrame, State};
use graspd_proto::v1;
use graspd_proto::v1::servo_grasp_request::Message;
use tokio::sync::mpsc;
use tonic::{Status, Streaming};

use super::newest::{End, Newest};
use crate::caller::Caller;
use crate::convert::{EncodedServoFrame, ServoWords, servo_answer};
use crate::deadline::{CallBudget, CallClock};
use crate::engine::Engine;
use crate::error::{FieldError, ServiceError};
use crate::live::followed;
use crate::metrics::{Metrics, PlanOutcome};
use crate::pool::{Estimate, Flow, Order, PoolError, Priority};
use crate::status;

/// A frame that has waited so long for a slot says nothing about where things are now.
const STALE: Duration = Duration::from_secs(2);

/// How many streams there may be, and are.
#[derive(Debug)]
pub(crate) struct Streams {
    most: usize,
    open: AtomicUsize,
}

impl Streams {
    pub(crate) fn new(most: usize) -> Arc<Self> {
        Arc::new(Self { most, open: AtomicUsize::new(0) })
    }

    /// Room for one more.
    pub(crate) fn enter(self: &Arc<Self>, metrics: &Arc<Metrics>) -> Result<Room, ServiceError> {
        let enter = |open: usize| (open < self.most).then_some(open + 1);
        match self.open.fetch_update(Ordering::AcqRel, Ordering::Acquire, enter) {
            Ok(_) => {
                metrics.servo_stream(true);
                Ok(Room { streams: Arc::clone(self), metrics: Arc::clone(metrics) })
            }
            Err(_) => Err(ServiceError::Quota {
                what: "servo streams at the same time, of all callers",
                limit: self.most as u64,
            }),
        }
    }
}

/// A stream's place among the others; given back when it is dropped.
#[derive(Debug)]
pub(crate) struct Room {
    streams: Arc<Streams>,
    metrics: Arc<Metrics>,
}

impl Drop for Room {
    fn drop(&mut self) {
        self.streams.open.fetch_sub(1, Ordering::AcqRel);
        self.metrics.servo_stream(false);
    }
}

/// A frame that waits.
#[derive(Debug)]
struct Arrived {
    frame: EncodedServoFrame,
    at: Instant,
}

/// What a job gives back.
struct Done {
    answer: Result<Answer, Refused>,
    counters: Counters,
}

type Answers = mpsc::Sender<Result<v1::ServoGraspResponse, Status>>;

/// A stream whose configuration is known.
pub(crate) struct ServoStream {
    pub(crate) engine: Arc<Engine>,
    pub(crate) clock: CallClock,
    pub(crate) caller: Flow,
    pub(crate) hand: Arc<Hand>,
    pub(crate) servo: Servo,
    pub(crate) budget: CallBudget,
    /// Longest time without a frame, or without a reader.
    pub(crate) idle: Duration,
    pub(crate) room: Room,
}

/// What the stream itself has counted and learned.
#[derive(Debug, Default)]
struct Tally {
    unreadable: u64,
    shed: u64,
    /// Why the last refused frame was.
    refused: String,
    /// What the metrics know of: the servo's counters, frames replaced.
    told: (Counters, u64),
    /// How long a frame takes, a moving mean.
    frame_time: Duration,
}

impl ServoStream {
    /// Until the robot has said all, something fails, or nobody listens any more.
    pub(crate) async fn run(self, messages: Streaming<v1::ServoGraspRequest>, sender: Answers) {
        let _cancel = self.budget.cancel_on_drop();
        let newest: Arc<Newest<Arrived, Status>> = Arc::new(Newest::new());
        let refused: Arc<Mutex<(u64, String)>> = Arc::default();
        let joints = self.hand.tree.joints.len();
        let reading = read(messages, Arc::clone(&newest), Arc::clone(&refused), (joints, self.idle));
        let due = self.clock.answer_deadline();
        let clock = self.clock;
        let expired = async move {
            match due {
                Some(deadline) => tokio::time::sleep_until(deadline.into()).await,
                None => std::future::pending().await,
            }
        };
        let gone = sender.clone();
        let last_word = sender.clone();
        let mut working = Box::pin(self.work(&newest, &refused, sender));
        tokio::pin!(reading);
        let mut is_reading = true;
        let end = tokio::select! {
            biased;
            () = gone.closed() => return,
            () = expired => Err(ServiceError::Deadline { elapsed: clock.elapsed(), stage: "of the servo stream" }.into()),
            end = async {
                loop {
                    tokio::select! {
                        end = &mut working => return end,
                        () = &mut reading, if is_reading => is_reading = false,
                    }
                }
            } => end,
        };
        // It may hold the place in which the last word goes.
        drop(working);
        if let Err(error) = end {
            // A reader that does not read does not get to know either.
            last_word.try_send(Err(error)).ok();
        }
    }

    /// One frame after the other, each the newest of its moment.
    async fn work(
        self,
        newest: &Newest<Arrived, Status>,
        refused: &Mutex<(u64, String)>,
        sender: Answers,
    ) -> Result<(), Status> {
        let Self { engine, clock, caller, hand, servo, budget, idle, room: _room } = self;
        let servo = Arc::new(Mutex::new(servo));
        let mut tally = Tally::default();
        let mut has_grasp = false;
        loop {
            // No work for an answer that nobody would read: the frame that is the newest then is worked on.
            let permit = tokio::time::timeout(idle, sender.reserve());
            let permit = match permit.await {
                Ok(Ok(permit)) => permit,
                Ok(Err(_)) => return Ok(()),
                Err(_) => {
                    return Err(ServiceError::Idle { what: "nobody read an answer", limit: idle }.into());
                }
            };
            let arrived = match newest.take().await {
                Ok(arrived) => arrived,
                Err(End::Finished) => return Ok(()),
                Err(End::Failed(error)) => return Err(error),
            };
            if budget.is_cancelled() {
                return Err(ServiceError::Draining.into());
            }
            let order = Order {
                // The first plan is a search like any other; from then on a motion is under way.
                priority: if has_grasp { Priority::Servo } else { Priority::High },
                caller,
                hand: Caller::number(&hand.id),
                estimate: Estimate { least: Duration::ZERO, expected: tally.frame_time },
            };
            let Arrived { frame, at } = arrived;
            let (capture_time, sequence) = (frame.frame.capture_time, frame.sequence);
            let names = (frame.frame.world_frame_id.clone(), frame.frame.camera_frame_id.clone());
            let seen = engine.live.as_ref().map(|_| frame.frame.clone());
            let captured = frame.captured().unwrap_or_else(|| at.saturating_duration_since(clock.arrived));
            let job_servo = Arc::clone(&servo);
            let job_budget = budget.clone();
            let frame_budget = budget.within(Some(at.saturating_duration_since(budget.start()) + STALE));
            let began = Instant::now();
            let ticket = engine.pool.submit(&frame_budget, &order, None, move |turn| {
                let decoded = frame.frame.decode();
                let mut servo = job_servo.lock().unwrap_or_else(PoisonError::into_inner);
                let answer = decoded.map(|(depth, _)| {
                    let next = ServoFrame { sequence, captured, frame: depth, hand: frame.hand };
                    servo.step(next, &job_budget)
                });
                (answer.map(|answer| Done { answer, counters: servo.counters() }), turn.queued)
            });
            let done = match ticket {
                Ok(ticket) => engine.finish(&frame_budget, ticket).await,
                Err(error) => Err(error),
            };
            let (done, queued) = match done {
                Ok(done) => done,
                Err(
                    PoolError::Full { .. }
                    | PoolError::CannotFinish { .. }
                    | PoolError::Shed { .. }
                    | PoolError::Expired,
                ) => {
                    tally.shed += 1;
                    tally.refused = format!("frame {sequence}: the server had no room for it");
                    engine.metrics.servo_frames("shed", 1);
                    continue;
                }
                Err(error) => return Err(ServiceError::of_pool(&error, || clock.elapsed()).into()),
            };
            engine.metrics.queued(order.priority, queued);
            let Done { answer, counters } = match done {
                Ok(done) => done,
                Err(fault) => {
                    tally.unreadable += 1;
                    tally.refused = format!("frame {sequence}: {fault}");
                    engine.metrics.servo_frames("invalid", 1);
                    continue;
                }
            };
            tally.tell(&engine.metrics, &counters, newest.replaced());
            let answer = match answer {
                Ok(answer) => answer,
                Err(Refused::Stopped(Stop::Deadline)) => {
                    return Err(ServiceError::Deadline {
                        elapsed: clock.elapsed(),
                        stage: "while a frame was worked on",
                    }
                    .into());
                }
                Err(Refused::Stopped(Stop::Cancelled)) => return Err(ServiceError::Draining.into()),
                Err(refused) => {
                    tally.refused = refused.to_string();
                    continue;
                }
            };
            if !has_grasp {
                let found = answer.grasp.is_some();
                let outcome = if found { PlanOutcome::Grasps } else { PlanOutcome::NoGrasp };
                engine.metrics.plan(&hand.id, outcome);
                has_grasp = found;
            } else {
                tally.frame_time = (tally.frame_time * 7 + began.elapsed().saturating_sub(queued)) / 8;
            }
            engine.metrics.stages(&answer.stages);
            let (unread, why) = refused.lock().unwrap_or_else(PoisonError::into_inner).clone();
            if !why.is_empty() {
                tally.refused = why;
                refused.lock().unwrap_or_else(PoisonError::into_inner).1.clear();
            }
            let age = at.elapsed();
            engine.metrics.servo_answered(age);
            let words = ServoWords {
                hand: &hand,
                world: names.0.as_deref().unwrap_or("world"),
                camera: &names.1,
                capture_time,
                age,
                superseded: newest.replaced(),
                unreadable: tally.unreadable + unread,
                shed: tally.shed,
                refused: std::mem::take(&mut tally.refused),
                calibration: engine.calibration.as_deref(),
            };
            tracing::trace!(sequence, state = ?answer.state, tracking = answer.state == State::Tracking, "servo");
            let answer = servo_answer(&answer, words);
            if let (Some(live), Some(seen)) = (&engine.live, seen) {
                live.show(Layer::Servo, followed(seen, answer.clone(), &hand));
            }
            permit.send(Ok(answer));
        }
    }
}

impl Tally {
    /// Tells the metrics what is new in the counters.
    fn tell(&mut self, metrics: &Metrics, now: &Counters, replaced: u64) {
        let (before, superseded) = self.told;
        let outcomes = [
            ("answered", now.answered, before.answered),
            ("late", now.late, before.late),
            ("repeated", now.repeated, before.repeated),
            ("wild", now.wild, before.wild),
            ("invalid", now.invalid, before.invalid),
            ("superseded", replaced, superseded),
        ];
        for (outcome, now, before) in outcomes {
            metrics.servo_frames(outcome, now.saturating_sub(before));
        }
        self.told = (*now, replaced);
    }
}

/// Takes frames in as they come, the newest in the place of the one that waits.
async fn read(
    mut messages: Streaming<v1::ServoGraspRequest>,
    newest: Arc<Newest<Arrived, Status>>,
    refused: Arc<Mutex<(u64, String)>>,
    (joints, idle): (usize, Duration),
) {
    loop {
        let message = match tokio::time::timeout(idle, messages.message()).await {
            Err(_) => {
                let error = ServiceError::Idle { what: "no frame came", limit: idle };
                return newest.end(End::Failed(error.into()));
            }
            // Too large, too slow, or nobody there any more.
            Ok(Err(status)) => {
                let ours = status::from_transport(&status).map(Status::from);
                return newest.end(End::Failed(ours.unwrap_or(status)));
            }
            Ok(Ok(None)) => return newest.end(End::Finished),
            Ok(Ok(Some(message))) => message.message,
        };
        let wire = match message {
            Some(Message::Frame(frame)) => frame,
            Some(Message::Config(_)) => {
                let error =
                    FieldError::value("config", "a second configuration", "one, in the first message");
                return newest.end(End::Failed(ServiceError::from(error).into()));
            }
            None => {
                let error = FieldError::missing("message", "a frame");
                return newest.end(End::Failed(ServiceError::from(error).into()));
            }
        };
        let (sequence, at) = (wire.sequence, Instant::now());
        match EncodedServoFrame::parse(wire).and_then(|frame| frame.of_hand(joints)) {
            Ok(frame) => newest.put(Arrived { frame, at }),
            Err(fault) => {
                let mut refused = refused.lock().unwrap_or_else(PoisonError::into_inner);
                refused.0 += 1;
                refused.1 = format!("frame {sequence}: {fault}");
            }
        }
    }
}
