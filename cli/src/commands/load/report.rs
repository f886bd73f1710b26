//! What a run of load found: counts, latencies, goodput; for people and for programs.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::time::Duration;

use base64::Engine as _;
use hdrhistogram::Histogram;
use hdrhistogram::serialization::{Serializer as _, V2Serializer};
use serde_json::{Value, json};

use super::LoadArgs;
use super::call::{End, Outcome};
use super::servo::Frames;
use crate::output::table::Table;

/// Quantiles that are told.
const QUANTILES: [(&str, f64); 5] =
    [("p50", 0.5), ("p90", 0.9), ("p95", 0.95), ("p99", 0.99), ("p999", 0.999)];

/// Latencies in microseconds to three digits; longer ones than an hour count as an hour.
#[derive(Debug)]
struct Latencies(Histogram<u64>);

impl Latencies {
    fn new() -> anyhow::Result<Self> {
        Ok(Self(Histogram::new(3)?))
    }

    fn record(&mut self, latency: Duration) {
        let us = u64::try_from(latency.as_micros()).unwrap_or(u64::MAX).clamp(1, 3_600_000_000);
        self.0.record(us).ok();
    }

    fn at(&self, quantile: f64) -> Duration {
        Duration::from_micros(if self.0.is_empty() { 0 } else { self.0.value_at_quantile(quantile) })
    }

    fn to_json(&self) -> Value {
        let mut bytes = Vec::new();
        V2Serializer::new().serialize(&self.0, &mut bytes).ok();
        let ms = |d: Duration| d.as_secs_f64() * 1e3;
        let mut figures: serde_json::Map<String, Value> =
            QUANTILES.iter().map(|(name, q)| (format!("{name}_ms"), json!(ms(self.at(*q))))).collect();
        figures.insert("max_ms".to_owned(), json!(self.0.max() as f64 / 1e3));
        figures.insert("mean_ms".to_owned(), json!(self.0.mean() / 1e3));
        figures.insert("count".to_owned(), json!(self.0.len()));
        let encoded = base64::engine::general_purpose::STANDARD.encode(bytes);
        figures.insert("hdr_v2_base64_us".to_owned(), json!(encoded));
        Value::Object(figures)
    }
}

/// What was found.
#[derive(Debug)]
pub(super) struct Report {
    target: String,
    offered: f64,
    seconds: f64,
    deadline_ms: u64,
    priorities: Vec<String>,
    calls: u64,
    in_time: u64,
    dropped: u64,
    codes: BTreeMap<String, u64>,
    /// What the first call of each code was told.
    messages: BTreeMap<String, String>,
    iterations: BTreeMap<i32, u64>,
    /// Answered calls, from when they were due.
    answered: Latencies,
    by_priority: Vec<Latencies>,
    /// Refused calls, from when they were sent.
    refused: Latencies,
    /// Servo streams beside them.
    servo: Vec<Servo>,
}

/// What one servo stream found.
#[derive(Debug)]
struct Servo {
    sent: u64,
    /// Answers a second.
    rate: f64,
    /// From when frames were due.
    answered: Latencies,
    /// From one answer to the next.
    gaps: Latencies,
    broken: BTreeMap<String, u64>,
}

impl Servo {
    fn new(frames: &Frames) -> anyhow::Result<Self> {
        let (mut answered, mut gaps) = (Latencies::new()?, Latencies::new()?);
        frames.ages.iter().for_each(|age| answered.record(*age));
        frames.gaps.iter().for_each(|gap| gaps.record(*gap));
        let mut broken = BTreeMap::new();
        for reason in &frames.broken {
            *broken.entry(reason.clone()).or_default() += 1;
        }
        Ok(Self { sent: frames.sent, rate: frames.rate(), answered, gaps, broken })
    }

    fn to_json(&self) -> Value {
        json!({
            "frames": self.sent,
            "answers_per_s": self.rate,
            "answered": self.answered.to_json(),
            "gaps": self.gaps.to_json(),
            "broken": self.broken,
        })
    }
}

impl Report {
    /// An empty one for a run at that rate; 0 in closed loop.
    pub(super) fn new(args: &LoadArgs, offered: f64) -> anyhow::Result<Self> {
        let priorities: Vec<String> = args.priorities.names().map(str::to_owned).collect();
        Ok(Self {
            target: args.server.clone(),
            offered,
            seconds: args.duration,
            deadline_ms: args.deadline_ms,
            by_priority: priorities.iter().map(|_| Latencies::new()).collect::<anyhow::Result<_>>()?,
            priorities,
            calls: 0,
            in_time: 0,
            dropped: 0,
            codes: BTreeMap::new(),
            messages: BTreeMap::new(),
            iterations: BTreeMap::new(),
            answered: Latencies::new()?,
            refused: Latencies::new()?,
            servo: Vec::new(),
        })
    }

    /// Takes in what became of servo streams beside the calls.
    pub(super) fn servo(&mut self, streams: &[Frames]) -> anyhow::Result<()> {
        self.servo = streams.iter().map(Servo::new).collect::<anyhow::Result<_>>()?;
        Ok(())
    }

    /// Counts a call.
    pub(super) fn count(&mut self, outcome: &Outcome) {
        self.calls += 1;
        self.in_time += u64::from(outcome.in_time);
        match &outcome.end {
            End::Answered { iterations } => {
                *self.codes.entry("OK".to_owned()).or_default() += 1;
                *self.iterations.entry(*iterations).or_default() += 1;
                self.answered.record(outcome.latency);
                if let Some(own) = self.by_priority.get_mut(outcome.priority) {
                    own.record(outcome.latency);
                }
            }
            End::Dropped => self.dropped += 1,
            End::Failed { code, reason, message } => {
                let key = if reason.is_empty() { format!("{code:?}") } else { format!("{code:?}/{reason}") };
                self.messages.entry(key.clone()).or_insert_with(|| message.clone());
                *self.codes.entry(key).or_default() += 1;
                if *code == graspd_client::Code::ResourceExhausted {
                    self.refused.record(outcome.service);
                }
            }
        }
    }

    /// Share of calls that were answered; those dropped on purpose do not count.
    pub(super) fn answered_share(&self) -> f64 {
        self.answered.0.len() as f64 / (self.calls - self.dropped).max(1) as f64
    }

    /// A quantile of the latency of answered calls.
    pub(super) fn latency(&self, quantile: f64) -> Duration {
        self.answered.at(quantile)
    }

    /// Answers in time, a second.
    pub(super) fn goodput(&self) -> f64 {
        self.in_time as f64 / self.seconds
    }

    /// Calls that were counted.
    #[cfg(test)]
    pub(super) fn calls(&self) -> u64 {
        self.calls
    }

    /// For programs.
    pub(super) fn to_json(&self) -> Value {
        let by_priority: serde_json::Map<String, Value> =
            self.priorities.iter().cloned().zip(self.by_priority.iter().map(Latencies::to_json)).collect();
        json!({
            "target": self.target,
            "offered_per_s": self.offered,
            "duration_s": self.seconds,
            "deadline_ms": self.deadline_ms,
            "calls": self.calls,
            "dropped": self.dropped,
            "goodput_per_s": self.goodput(),
            "answered_share": self.answered_share(),
            "codes": self.codes,
            "messages": self.messages,
            "iterations": self.iterations.iter().map(|(k, n)| (k.to_string(), *n)).collect::<BTreeMap<_, _>>(),
            "answered": self.answered.to_json(),
            "answered_by_priority": by_priority,
            "refused": self.refused.to_json(),
            "servo": self.servo.iter().map(Servo::to_json).collect::<Vec<_>>(),
        })
    }

    /// For people.
    pub(super) fn to_text(&self) -> String {
        let mut text = String::new();
        let offered = if self.offered > 0.0 {
            format!("offered {:.1}/s", self.offered)
        } else if self.calls == 0 && !self.servo.is_empty() {
            "servo streams alone".to_owned()
        } else {
            "closed loop".to_owned()
        };
        // Writing to a string cannot fail.
        writeln!(
            text,
            "{offered} for {:.1} s: {} calls, goodput {:.2}/s within {} ms, {} dropped on purpose",
            self.seconds,
            self.calls,
            self.goodput(),
            self.deadline_ms,
            self.dropped
        )
        .ok();
        for (code, count) in &self.codes {
            writeln!(text, "  {code:<40} {count:>8}").ok();
            if let Some(message) = self.messages.get(code) {
                writeln!(text, "    {message}").ok();
            }
        }
        for (iterations, count) in &self.iterations {
            writeln!(text, "  answers after {iterations:>5} iterations {count:>17}").ok();
        }
        let mut table = Table::new(&["latency, ms", "n", "p50", "p90", "p95", "p99", "p999", "max"], 1);
        let mut row = |name: &str, latencies: &Latencies| {
            let mut cells = vec![name.to_owned(), latencies.0.len().to_string()];
            let ms = |d: Duration| format!("{:.1}", d.as_secs_f64() * 1e3);
            cells.extend(QUANTILES.iter().map(|(_, q)| ms(latencies.at(*q))));
            cells.push(format!("{:.1}", latencies.0.max() as f64 / 1e3));
            table.row(cells);
        };
        row("answered, from due", &self.answered);
        if self.priorities.len() > 1 {
            for (name, latencies) in self.priorities.iter().zip(&self.by_priority) {
                row(&format!("  {name}"), latencies);
            }
        }
        row("refused, from sent", &self.refused);
        for (number, servo) in self.servo.iter().enumerate() {
            row(&format!("servo {number}, from due"), &servo.answered);
            row(&format!("servo {number}, answer to answer"), &servo.gaps);
        }
        write!(text, "{table}").ok();
        for (number, servo) in self.servo.iter().enumerate() {
            // Newer frames take the place of older ones: not every frame has an answer.
            writeln!(
                text,
                "servo {number}: {} frames, {} answers, {:.1} answers/s",
                servo.sent,
                servo.answered.0.len(),
                servo.rate
            )
            .ok();
            for (reason, count) in &servo.broken {
                writeln!(text, "  {count} streams ended: {reason}").ok();
            }
        }
        text
    }
}
