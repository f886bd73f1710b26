//! Servo streams beside the calls: mock cameras that stand still, each with a grasp that follows it.
//!
//! Frames are sent when they are due, whatever became of those before; ages of answers count from then.

use std::time::Duration;

use anyhow::Context as _;
use graspd_client::{Client, DepthFrame, ServoConfig, ServoFrame};
use tokio::sync::watch;
use tokio::time::Instant;

/// A stream is begun anew after so many frames, as a robot begins another approach.
const APPROACH: u64 = 200;

/// What streams send.
#[derive(Debug, Clone)]
pub(super) struct Cameras {
    /// Streams at the same time.
    pub(super) streams: u32,
    /// Frames a second, of each.
    pub(super) rate: f64,
    /// The hand.
    pub(super) hand: String,
    /// The picture.
    pub(super) frame: DepthFrame,
}

/// What became of one camera's frames.
#[derive(Debug, Default)]
pub(super) struct Frames {
    /// That were sent.
    pub(super) sent: u64,
    /// Ages of the answered ones, from when they were due.
    pub(super) ages: Vec<Duration>,
    /// From one answer to the next, in approaches that had begun: the first plan is none.
    pub(super) gaps: Vec<Duration>,
    /// Streams that ended otherwise than on purpose, with what was said.
    pub(super) broken: Vec<String>,
}

impl Frames {
    /// Answers a second, while one followed the other.
    pub(super) fn rate(&self) -> f64 {
        let time: f64 = self.gaps.iter().map(Duration::as_secs_f64).sum();
        if time > 0.0 { self.gaps.len() as f64 / time } else { 0.0 }
    }
}

/// Streams until told to stop, each camera's frames apart; frames that are due before `warm` are not counted.
pub(super) async fn stream_until(
    clients: Vec<Client>,
    cameras: Cameras,
    warm: Instant,
    stopped: watch::Receiver<bool>,
) -> anyhow::Result<Vec<Frames>> {
    let mut tasks = tokio::task::JoinSet::new();
    for number in 0..cameras.streams {
        let client = clients.get(number as usize % clients.len().max(1)).cloned().context("no connection")?;
        let (cameras, stopped) = (cameras.clone(), stopped.clone());
        tasks.spawn(async move {
            let mut all = Frames::default();
            while !*stopped.borrow() {
                if let Err(error) = approach(&client, &cameras, warm, &stopped, &mut all).await {
                    all.broken.push(error.to_string());
                    // A server that has no place for it is not asked a thousand times a second.
                    tokio::time::sleep(Duration::from_millis(500)).await;
                }
            }
            (number, all)
        });
    }
    let mut all = Vec::new();
    while let Some(done) = tasks.join_next().await {
        all.push(done.context("a stream's task was lost")?);
    }
    all.sort_unstable_by_key(|(number, _)| *number);
    Ok(all.into_iter().map(|(_, frames)| frames).collect())
}

/// One stream, from its configuration to its last frame.
async fn approach(
    client: &Client,
    cameras: &Cameras,
    warm: Instant,
    stopped: &watch::Receiver<bool>,
    all: &mut Frames,
) -> anyhow::Result<()> {
    let config = ServoConfig { hand: format!("hands/{}", cameras.hand), ..ServoConfig::default() };
    let stream = client.servo_grasp(config).await?;
    let (frames, mut answers) = stream.split();
    let period = Duration::from_secs_f64(1.0 / cameras.rate);
    let began = Instant::now();
    let due = move |sequence: u64| began + period.mul_f64(sequence as f64);
    let picture = cameras.frame.clone();
    let sending = async move {
        let mut sent = 0;
        for sequence in 0..APPROACH {
            tokio::time::sleep_until(due(sequence)).await;
            if *stopped.borrow() {
                break;
            }
            let captured = began.elapsed();
            let seconds = i64::try_from(captured.as_secs()).unwrap_or(i64::MAX);
            let nanos = i32::try_from(captured.subsec_nanos()).unwrap_or(0);
            let capture_time = Some(prost_types::Timestamp { seconds, nanos });
            let frame = DepthFrame { capture_time, ..picture.clone() };
            if frames.send(ServoFrame { sequence, frame: Some(frame), hand: None }).await.is_err() {
                break;
            }
            sent += u64::from(due(sequence) >= warm);
        }
        sent
    };
    let listening = async {
        let (mut ages, mut gaps, mut before) = (Vec::new(), Vec::new(), None);
        while let Some(answer) = answers.next().await? {
            let now = Instant::now();
            if due(answer.sequence) >= warm {
                ages.push(now - due(answer.sequence));
                gaps.extend(before.map(|before| now - before));
                before = Some(now);
            }
        }
        Ok::<_, graspd_client::ClientError>((ages, gaps))
    };
    let (sent, heard) = tokio::join!(sending, listening);
    all.sent += sent;
    let (ages, gaps) = heard?;
    all.ages.extend(ages);
    all.gaps.extend(gaps);
    Ok(())
}
