//! The bridge between messages and the planner: frames and goals come in, answers go out. It knows no middleware and no topic.

mod admission;
mod interface;

use std::collections::BTreeMap;
use std::future::Future;
use std::sync::Arc;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tokio::sync::{mpsc, oneshot};
use tokio::task::AbortHandle;

use crate::answer;
use crate::call::{self, Failure, Models, Planned, Progress};
use crate::goal::{Goal, GoalError};
use crate::link::Link;
use crate::markers::markers;
use crate::messages::{Header, Stamp, TriggerResponse};
use crate::pairing::Pairing;
use crate::status::{FrameState, GoalState, Snapshot};

pub use interface::{BridgeConfig, Incoming, Outgoing, TopicNames};

/// How often the bridge says how it is.
const STATUS_PERIOD: Duration = Duration::from_secs(1);
/// States in which goals end.
const ENDS: [&str; 5] = ["succeeded", "no_grasp", "refused", "canceled", "aborted"];

/// A goal under way.
#[derive(Debug)]
struct Running {
    /// Which of the goals of this name it is.
    number: u64,
    hand: String,
    header: Header,
    began: Instant,
    phase: &'static str,
    call: AbortHandle,
    reply: Option<oneshot::Sender<TriggerResponse>>,
}

/// How a goal ended.
#[derive(Debug)]
struct End {
    state: &'static str,
    reason: String,
    message: String,
}

impl End {
    fn new(state: &'static str, reason: impl Into<String>, message: impl Into<String>) -> Self {
        Self { state, reason: reason.into(), message: message.into() }
    }
}

impl From<GoalError> for End {
    fn from(error: GoalError) -> Self {
        Self::new("refused", "INVALID_GOAL", error.to_string())
    }
}

#[derive(Debug)]
enum Event {
    Progress(Progress),
    Ended(Box<Result<Planned, Failure>>),
}

/// A goal's id and number, and what its call tells.
type Told = (String, u64, Event);

/// The bridge.
#[derive(Debug)]
pub struct Bridge {
    config: BridgeConfig,
    link: Link,
    frames: Pairing,
    running: BTreeMap<String, Running>,
    models: Arc<Models>,
    out: mpsc::UnboundedSender<Outgoing>,
    events: (mpsc::UnboundedSender<Told>, mpsc::UnboundedReceiver<Told>),
    /// Goals that were given a name here.
    named: u64,
    /// Goals that were begun.
    begun: u64,
    ended: BTreeMap<&'static str, u64>,
}

impl Bridge {
    /// A bridge to a server; what it has to say goes to `out`.
    pub fn new(config: BridgeConfig, link: Link, out: mpsc::UnboundedSender<Outgoing>) -> Self {
        let frames = Pairing::new(config.pairing);
        let ended = ENDS.iter().map(|state| (*state, 0)).collect();
        let (running, models, events) = (BTreeMap::new(), Arc::default(), mpsc::unbounded_channel());
        Self { config, link, frames, running, models, out, events, named: 0, begun: 0, ended }
    }

    /// Works until nothing can come in any more or `stop` is over; goals under way are cancelled then.
    pub async fn run(mut self, mut incoming: mpsc::Receiver<Incoming>, stop: impl Future<Output = ()>) {
        let mut tick = tokio::time::interval(STATUS_PERIOD);
        tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        tokio::pin!(stop);
        loop {
            tokio::select! {
                message = incoming.recv() => match message {
                    Some(message) => self.take(message),
                    None => break,
                },
                event = self.events.1.recv() => if let Some((id, number, event)) = event { self.event(&id, number, event) },
                () = self.link.changed() => self.tell_status(false),
                _ = tick.tick() => {
                    self.tell_status(false);
                    let diagnostics = self.snapshot(false).diagnostics(Stamp::now());
                    self.send(Outgoing::Diagnostics(diagnostics));
                }
                () = &mut stop => break,
            }
        }
        self.cancel("", "STOPPING", "the bridge is ending");
        self.tell_status(true);
    }

    fn take(&mut self, message: Incoming) {
        let now = Instant::now();
        match message {
            Incoming::Image(image) => self.frames.image(image, now),
            Incoming::Info(info) => self.frames.info(*info, now),
            Incoming::Labels(labels) => self.frames.labels(labels, now),
            Incoming::Goal(text) => match Goal::parse(&text) {
                Ok(goal) => self.begin(goal, "goal", None),
                Err(error) => {
                    let id = self.name(&error.id, "goal");
                    self.refuse(&id, "", error.into(), None);
                }
            },
            Incoming::Point(point) => self.begin(Goal::near(&point), "point", None),
            Incoming::Cancel(id) => self.cancel(&id, "CANCELED", "cancelled by its caller"),
            Incoming::Service { hand, reply } => {
                let goal = Goal { hand: hand.unwrap_or_default(), ..Goal::default() };
                self.begin(goal, "service", Some(reply));
            }
        }
    }

    /// The caller's name for a goal, or one of ours.
    fn name(&mut self, id: &str, kind: &str) -> String {
        if !id.is_empty() {
            return id.to_owned();
        }
        self.named += 1;
        format!("{kind}-{}", self.named)
    }

    fn begin(&mut self, goal: Goal, kind: &str, reply: Option<oneshot::Sender<TriggerResponse>>) {
        let id = self.name(&goal.id, kind);
        let hand =
            if goal.hand.is_empty() { self.config.hands.first().cloned() } else { Some(goal.hand.clone()) };
        let hand = hand.unwrap_or_default();
        match self.prepare(&id, &goal, &hand) {
            Err(end) => self.refuse(&id, &hand, end, reply),
            Ok((client, exposure, request)) => {
                let header = exposure.image.header.clone();
                tracing::info!(goal = id, hand, stamp = %header.stamp, "a goal begins");
                self.begun += 1;
                let (name, number, events) = (id.clone(), self.begun, self.events.0.clone());
                let (lens, models) = (self.config.lens, Arc::clone(&self.models));
                let call = tokio::spawn(async move {
                    let (told, mut progress) = mpsc::unbounded_channel();
                    let planning = call::plan(client, exposure, lens, request, models, told);
                    tokio::pin!(planning);
                    // The bridge outlives its calls.
                    let tell = |event| drop(events.send((name.clone(), number, event)));
                    let ended = loop {
                        tokio::select! {
                            biased;
                            Some(step) = progress.recv() => tell(Event::Progress(step)),
                            ended = &mut planning => break ended,
                        }
                    };
                    while let Ok(step) = progress.try_recv() {
                        tell(Event::Progress(step));
                    }
                    tell(Event::Ended(Box::new(ended)));
                });
                let call = call.abort_handle();
                let running =
                    Running { number, hand, header, began: Instant::now(), phase: "waiting", call, reply };
                self.running.insert(id, running);
                self.tell_status(false);
            }
        }
    }

    fn event(&mut self, id: &str, number: u64, event: Event) {
        // A goal that was cancelled has ended, and its name may be another one's by now.
        let Some(running) = self.running.get_mut(id).filter(|r| r.number == number) else { return };
        let elapsed_s = running.began.elapsed().as_secs_f64();
        match event {
            Event::Progress(progress) => {
                let (phase, mut feedback) = match progress {
                    Progress::Accepted(position) => ("accepted", json!({ "queue_position": position })),
                    Progress::Improved { grasps, best_score } => {
                        ("improving", json!({ "grasps": grasps, "best_score": best_score }))
                    }
                };
                let changed = std::mem::replace(&mut running.phase, phase) != phase;
                feedback["goal_id"] = json!(id);
                feedback["hand"] = json!(running.hand);
                feedback["phase"] = json!(phase);
                feedback["elapsed_s"] = json!(elapsed_s);
                self.send(Outgoing::Feedback(feedback.to_string()));
                if changed {
                    self.tell_status(false);
                }
            }
            Event::Ended(ended) => {
                let Some(running) = self.running.remove(id) else { return };
                match *ended {
                    Ok(planned) => self.planned(id, running, &planned),
                    Err(failure) => {
                        if failure.away {
                            self.link.doubt();
                        }
                        let state = if failure.refused { "refused" } else { "aborted" };
                        let end = End::new(state, failure.reason, failure.message);
                        let began = Some(running.began);
                        self.ended(id, &running.hand, end, began, Value::Null, running.reply);
                    }
                }
            }
        }
    }

    /// Publishes a plan, then its result.
    fn planned(&mut self, id: &str, running: Running, planned: &Planned) {
        let (response, header) = (&planned.response, &running.header);
        let model = planned.model.as_deref();
        let answer = answer::answer(header, response, self.config.step);
        let markers = markers(header, &response.grasps, model, self.config.drawn_grasps);
        self.send(Outgoing::Plan(Box::new((answer, markers))));
        let end = if response.grasps.is_empty() {
            let reason = response.no_grasp.as_ref().map(|no| no.reason().as_str_name()).unwrap_or_default();
            let reason = reason.strip_prefix("NO_GRASP_REASON_").unwrap_or(reason);
            End::new("no_grasp", reason, answer::no_grasp(response))
        } else {
            End::new("succeeded", "", "")
        };
        let report = answer::report(header, response, model);
        self.ended(id, &running.hand, end, Some(running.began), report, running.reply);
    }

    fn refuse(&mut self, id: &str, hand: &str, end: End, reply: Option<oneshot::Sender<TriggerResponse>>) {
        self.ended(id, hand, end, None, Value::Null, reply);
    }

    /// The last word on a goal.
    fn ended(
        &mut self,
        id: &str,
        hand: &str,
        end: End,
        began: Option<Instant>,
        report: Value,
        reply: Option<oneshot::Sender<TriggerResponse>>,
    ) {
        let elapsed_s = began.map_or(0.0, |began| began.elapsed().as_secs_f64());
        tracing::info!(
            goal = id,
            hand,
            state = end.state,
            reason = end.reason,
            detail = end.message,
            elapsed_s,
            "a goal ended"
        );
        let mut result = json!({
            "goal_id": id,
            "hand": hand,
            "state": end.state,
            "reason": end.reason,
            "message": end.message,
            "elapsed_s": elapsed_s,
        });
        if let (Value::Object(result), Value::Object(report)) = (&mut result, report) {
            result.extend(report);
        }
        let text = result.to_string();
        if let Some(reply) = reply {
            // A caller that has gone does not need its answer.
            drop(reply.send(TriggerResponse { success: end.state == "succeeded", message: text.clone() }));
        }
        self.send(Outgoing::Result(text));
        *self.ended.entry(end.state).or_default() += 1;
        self.tell_status(false);
    }

    /// Ends one goal, or all where no id is given. The server's work ends with the call.
    fn cancel(&mut self, id: &str, reason: &str, message: &str) {
        let ids: Vec<String> = match id {
            "" => self.running.keys().cloned().collect(),
            id => vec![id.to_owned()],
        };
        for id in ids {
            match self.running.remove(&id) {
                Some(running) => {
                    running.call.abort();
                    let end = End::new("canceled", reason, message);
                    self.ended(&id, &running.hand, end, Some(running.began), Value::Null, running.reply);
                }
                None => tracing::info!(goal = id, "no such goal to cancel"),
            }
        }
    }

    fn snapshot(&self, stopping: bool) -> Snapshot {
        let frame = match self.frame() {
            Ok(exposure) => FrameState::Ready {
                frame_id: exposure.image.header.frame_id.clone(),
                stamp: exposure.image.header.stamp,
                age: exposure.complete.elapsed(),
            },
            Err((reason, message)) => FrameState::Unusable { reason, message },
        };
        let goals = self.running.iter().map(|(id, running)| GoalState {
            id: id.clone(),
            hand: running.hand.clone(),
            phase: running.phase,
            elapsed: running.began.elapsed(),
        });
        Snapshot {
            node: self.config.node.clone(),
            server: self.config.server.clone(),
            link: self.link.state(),
            frame,
            images: self.frames.image_count(),
            goals: goals.collect(),
            ended: self.ended.iter().map(|(state, count)| (*state, *count)).collect(),
            stopping,
        }
    }

    fn tell_status(&self, stopping: bool) {
        self.send(Outgoing::Status(self.snapshot(stopping).json().to_string()));
    }

    fn send(&self, message: Outgoing) {
        // Whoever publishes ends after the bridge; if not, there is nobody to tell.
        drop(self.out.send(message));
    }
}
