//! One call: what is sent, when it is dropped, what became of it.

use std::path::Path;
use std::sync::Mutex;
use std::sync::PoisonError;
use std::time::Duration;

use anyhow::{Context as _, ensure};
use graspd_client::{
    Client, ClientError, Code, DepthFrame, GraspEvent, PlanGraspsRequest, PlanGraspsResponse, PlanOptions,
    wire,
};
use tokio::sync::watch;
use tokio::time::Instant;

use super::LoadArgs;
use super::mix::{Draw, Mix};
use super::servo::{self, Cameras, Frames};
use crate::commands::plan::FrameFiles;
use crate::commands::replay;
use crate::demo_scene;
use crate::input::depth::DepthValues;
use crate::remote::to_wire;

/// What became of a call.
#[derive(Debug, Clone)]
pub(super) struct Outcome {
    /// From when it was due.
    pub(super) latency: Duration,
    /// From when it was sent.
    pub(super) service: Duration,
    /// How it ended.
    pub(super) end: End,
    /// Its priority.
    pub(super) priority: usize,
    /// Its answer came within its deadline, counted from when it was due.
    pub(super) in_time: bool,
}

/// How a call ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum End {
    /// With an answer, after so many iterations.
    Answered { iterations: i32 },
    /// Dropped on purpose.
    Dropped,
    /// With an error.
    Failed { code: Code, reason: String, message: String },
}

/// Sends calls.
pub(super) struct Caller {
    clients: Vec<Client>,
    hands: Mix,
    priorities: Mix,
    kinds: Vec<wire::Priority>,
    sizes: Mix,
    frames: Vec<(DepthFrame, Vec<u8>)>,
    /// Frames of recorded calls, in place of those.
    recorded: Vec<(Vec<DepthFrame>, Option<wire::SceneOptions>)>,
    options: PlanOptions,
    deadline: Duration,
    drop: f64,
    stream: f64,
    same_frame: bool,
    seed: u64,
    /// Which client is next; calls in flight on one connection do not disturb those on others.
    next: Mutex<usize>,
}

impl Caller {
    pub(super) fn new(clients: Vec<Client>, args: &LoadArgs) -> anyhow::Result<Self> {
        let kinds = args.priorities.names().map(priority).collect::<anyhow::Result<_>>()?;
        let frames = args.sizes.names().map(frame).collect::<anyhow::Result<_>>()?;
        let recorded = args.recording.as_deref().map(recorded).transpose()?.unwrap_or_default();
        let count = |n: usize| i32::try_from(n).unwrap_or(i32::MAX);
        let options = PlanOptions {
            batch_size: count(args.batch as usize),
            scheme: args.scheme.map(|s| wire::Scheme {
                iteration_count: count(s.iterations),
                penetration_iteration_count: count(s.with_penetration),
            }),
            require_complete: args.require_complete,
            ..PlanOptions::default()
        };
        Ok(Self {
            clients,
            hands: args.hands.clone(),
            priorities: args.priorities.clone(),
            kinds,
            sizes: args.sizes.clone(),
            frames,
            recorded,
            options,
            deadline: Duration::from_millis(args.deadline_ms),
            drop: args.drop,
            stream: args.stream,
            same_frame: args.same_frame,
            seed: args.seed,
            next: Mutex::new(0),
        })
    }

    /// Makes call `number`, which is due at `due`.
    pub(super) async fn call(&self, number: u64, due: Instant) -> Outcome {
        let draw = |which| Draw::of(self.seed, number, which);
        let priority = self.priorities.pick(draw(1));
        let request = self.request(number, priority);
        let client = {
            let mut next = self.next.lock().unwrap_or_else(PoisonError::into_inner);
            *next = (*next + 1) % self.clients.len().max(1);
            self.clients.get(*next).cloned()
        };
        let sent = Instant::now();
        let streams = draw(2).share() < self.stream;
        let call = async {
            let Some(client) = client else { return Err(ClientError::Protocol("no connection")) };
            if streams { stream(&client, &request).await } else { client.plan_grasps(&request).await }
        };
        let end = if draw(3).share() < self.drop {
            // At a time when it may be waiting, at work, or done.
            let patience = self.deadline.mul_f64(0.3 * draw(4).share());
            match tokio::time::timeout(patience, call).await {
                Ok(answer) => end(answer),
                Err(_) => End::Dropped,
            }
        } else {
            end(call.await)
        };
        let latency = due.elapsed();
        let in_time = latency <= self.deadline && matches!(end, End::Answered { .. });
        Outcome { latency, service: sent.elapsed(), end, priority, in_time }
    }

    /// Servo streams beside the calls, until told to stop; with the first picture and the first hand.
    pub(super) fn servo_until(
        &self,
        args: &LoadArgs,
        stopped: watch::Receiver<bool>,
    ) -> anyhow::Result<impl Future<Output = anyhow::Result<Vec<Frames>>> + use<>> {
        let hand = self.hands.names().next().unwrap_or_default().to_owned();
        let own =
            self.recorded.iter().flat_map(|(frames, _)| frames).find(|frame| frame.camera_pose.is_some());
        let bundled = || self.frames.first().map(|(frame, pixels)| self.own_frame(0, frame, pixels.clone()));
        let frame = own.cloned().or_else(bundled).context("--servo: found no frame to send")?;
        let cameras = Cameras { streams: args.servo, rate: args.servo_rate, hand, frame };
        let warm = Instant::now() + Duration::from_secs_f64(args.warmup);
        Ok(servo::stream_until(self.clients.clone(), cameras, warm, stopped))
    }

    /// A frame that no other call brings: one millimetre in one pixel makes it another one for whoever compares, and the
    /// same scene for whoever plans. Compressed ones are what they are.
    fn own_frame(&self, number: u64, frame: &DepthFrame, mut pixels: Vec<u8>) -> DepthFrame {
        let is_raw = frame.encoding() == wire::DepthEncoding::RawU16;
        let at = (number as usize * 2) % pixels.len().max(1);
        if let (true, Some(byte)) = (is_raw && !self.same_frame, pixels.get_mut(at & !1)) {
            *byte ^= 1;
        }
        DepthFrame { data: pixels.into(), ..frame.clone() }
    }

    fn request(&self, number: u64, priority: usize) -> PlanGraspsRequest {
        let draw = |which| Draw::of(self.seed, number, which);
        let hand = self.hands.names().nth(self.hands.pick(draw(5))).unwrap_or_default();
        let mut frames = Vec::new();
        let mut scene_options = None;
        let share = draw(6).share() * self.recorded.len() as f64;
        if let Some((recorded, options)) = self.recorded.get(share as usize) {
            frames.extend(recorded.iter().map(|frame| self.own_frame(number, frame, frame.data.to_vec())));
            scene_options.clone_from(options);
        } else if let Some((frame, pixels)) = self.frames.get(self.sizes.pick(draw(6))) {
            frames.push(self.own_frame(number, frame, pixels.clone()));
        }
        let kind = self.kinds.get(priority).copied().unwrap_or(wire::Priority::Normal);
        PlanGraspsRequest {
            hand: format!("hands/{hand}"),
            frames,
            scene_options,
            options: Some(PlanOptions { priority: kind.into(), seed: number, ..self.options.clone() }),
            ..PlanGraspsRequest::default()
        }
    }
}

/// Frames and scene options of the calls of a recording.
fn recorded(path: &Path) -> anyhow::Result<Vec<(Vec<DepthFrame>, Option<wire::SceneOptions>)>> {
    use wire::plan_record::Request;
    let recording = replay::read(path)?;
    let asked = recording.plans.into_iter().filter_map(|plan| match plan.request? {
        Request::PlanGrasps(plan) => Some((plan.frames, plan.scene_options)),
        Request::PlanMultiHand(plan) => Some((plan.frames, plan.scene_options)),
    });
    let asked: Vec<_> = asked.collect();
    ensure!(!asked.is_empty(), "--recording: {}: no calls are recorded there", path.display());
    Ok(asked)
}

async fn stream(client: &Client, request: &PlanGraspsRequest) -> Result<PlanGraspsResponse, ClientError> {
    let mut events = client.stream_grasps(request).await?;
    while let Some(event) = events.next().await? {
        if let GraspEvent::Finished(answer) = event {
            return Ok(answer);
        }
    }
    Err(ClientError::Protocol("a stream without an end"))
}

fn end(answer: Result<PlanGraspsResponse, ClientError>) -> End {
    match answer {
        Ok(answer) => End::Answered { iterations: answer.stats.map_or(0, |s| s.iteration_count) },
        Err(ClientError::Call(error)) => {
            End::Failed { code: error.code, reason: error.reason, message: error.message }
        }
        Err(other) => End::Failed { code: Code::Unknown, reason: String::new(), message: other.to_string() },
    }
}

fn priority(name: &str) -> anyhow::Result<wire::Priority> {
    Ok(match name {
        "low" => wire::Priority::Low,
        "normal" => wire::Priority::Normal,
        "high" => wire::Priority::High,
        "servo" => wire::Priority::Servo,
        _ => anyhow::bail!("--priorities: found {name:?}, expected low, normal, high or servo"),
    })
}

/// The bundled frame in another size: every so many pixels of it, or each several times.
fn frame(size: &str) -> anyhow::Result<(DepthFrame, Vec<u8>)> {
    let sides = size.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    let sides = sides.filter(|(w, h)| (16..=3840usize).contains(w) && (16..=2160usize).contains(h));
    ensure!(
        sides.is_some(),
        "--sizes: found {size:?}, expected for example 640x480, from 16x16 to 3840x2160"
    );
    let (width, height) = sides.unwrap_or((640, 480));
    let (depth, file) = demo_scene::bundled()?;
    let values = match &depth.values {
        DepthValues::U16(values) => values.clone(),
        DepthValues::Metres(_) => anyhow::bail!("the bundled frame is not in millimetres"),
    };
    let (own_width, own_height) = (depth.width, depth.height);
    let files = FrameFiles::new(depth, file, None)?;
    let mut frame = to_wire::frame(&files);
    let (sx, sy) = (width as f64 / own_width as f64, height as f64 / own_height as f64);
    if let Some(lens) = frame.intrinsics.as_mut() {
        (lens.fx_px, lens.fy_px) = (lens.fx_px * sx, lens.fy_px * sy);
        (lens.cx_px, lens.cy_px) = ((lens.cx_px + 0.5) * sx - 0.5, (lens.cy_px + 0.5) * sy - 0.5);
    }
    let pixel = |row: usize, column: usize| {
        let from = |i: usize, scale: f64, most: usize| (((i as f64 + 0.5) / scale) as usize).min(most - 1);
        let at = from(row, sy, own_height) * own_width + from(column, sx, own_width);
        values.get(at).copied().unwrap_or(0)
    };
    let pixels = (0..height).flat_map(|row| (0..width).map(move |column| (row, column)));
    let bytes = pixels.flat_map(|(row, column)| pixel(row, column).to_le_bytes()).collect();
    (frame.width_px, frame.height_px) = (width as i32, height as i32);
    Ok((frame, bytes))
}
