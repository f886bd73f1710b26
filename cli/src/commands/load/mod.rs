//! `graspd load`: how much a server can take, and what it does when that is exceeded.

mod arrivals;
mod call;
mod find;
mod mix;
mod report;
mod servo;

use std::io::Write as _;
use std::net::ToSocketAddrs as _;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context as _, bail, ensure};
use clap::{Args, ValueEnum};
use graspd_client::{Client, ClientConfig, RetryPolicy};

use self::arrivals::Arrivals;
use self::call::{Caller, Outcome};
use self::find::Objective;
use self::mix::Mix;
use self::report::Report;
use crate::commands::args::parse_scheme;
use crate::remote;

/// Calls a server at a given rate, with a given number of callers, or faster and faster, and reports latencies,
/// codes and goodput. In open loop (--rate) calls are due at times fixed beforehand and latency counts from
/// there: a server that stalls does not slow down the measurement.
#[derive(Debug, Clone, Args)]
pub(crate) struct LoadArgs {
    /// Server to call
    #[arg(long, default_value = "http://127.0.0.1:50051", env = "GRASPD_SERVER", value_name = "URL")]
    server: String,
    /// I may load this server although it is not on this machine
    #[arg(long)]
    i_own_this_target: bool,
    /// Calls a second (open loop)
    #[arg(long, value_name = "RATE", conflicts_with_all = ["concurrency", "find_max"])]
    rate: Option<f64>,
    /// With --rate: begin with this rate and grow evenly
    #[arg(long, value_name = "RATE", requires = "rate")]
    ramp_from: Option<f64>,
    /// Spacing of calls in open loop
    #[arg(long, value_enum, default_value_t = Spacing::Poisson)]
    arrivals: Spacing,
    /// Callers that call again as soon as they have an answer (closed loop)
    #[arg(long, value_name = "CALLERS", conflicts_with = "find_max", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    concurrency: Option<u32>,
    /// Find the highest rate that keeps this objective, for example p99=250ms; 99 of 100 calls must succeed
    #[arg(long, value_name = "OBJECTIVE")]
    find_max: Option<Objective>,
    /// Seconds of measurement (of each try, with --find-max)
    #[arg(long, default_value_t = 10.0, value_name = "SECONDS")]
    duration: f64,
    /// Seconds of load before the measurement
    #[arg(long, default_value_t = 1.0, value_name = "SECONDS")]
    warmup: f64,
    /// Deadline of each call, milliseconds
    #[arg(long, default_value_t = 1000, value_name = "MS", value_parser = clap::value_parser!(u64).range(1..=600_000))]
    deadline_ms: u64,
    /// Hands, with weights: robotiq-2f85=3,leap
    #[arg(long, default_value = "robotiq-2f85", value_name = "MIX")]
    hands: Mix,
    /// Priorities, with weights: low, normal, high, servo
    #[arg(long, default_value = "normal", value_name = "MIX")]
    priorities: Mix,
    /// Sizes of frames, with weights: 640x480=3,320x240
    #[arg(long, default_value = "640x480", value_name = "MIX")]
    sizes: Mix,
    /// Share of calls that are dropped before their answer, 0 to 1
    #[arg(long, default_value_t = 0.0, value_name = "SHARE")]
    drop: f64,
    /// Share of calls that stream (StreamGrasps), 0 to 1
    #[arg(long, default_value_t = 0.0, value_name = "SHARE")]
    stream: f64,
    /// Every call sends the same frame, so that the server can share its scene
    #[arg(long)]
    same_frame: bool,
    /// Frames come from the calls of this recording, in place of the bundled scene (a file, or its folder)
    #[arg(long, value_name = "FILE|DIR", conflicts_with = "sizes")]
    recording: Option<PathBuf>,
    /// Servo streams beside the calls, or alone, each of a mocked camera
    #[arg(long, default_value_t = 0, value_name = "STREAMS", value_parser = clap::value_parser!(u32).range(0..=1000))]
    servo: u32,
    /// Frames a second of each servo stream
    #[arg(long, default_value_t = 10.0, value_name = "RATE")]
    servo_rate: f64,
    /// Iterations, and how many of the last ones avoid penetration; the server's choice if left out
    #[arg(long, value_name = "ALL,LAST", value_parser = parse_scheme)]
    scheme: Option<graspd_planner::options::Scheme>,
    /// Candidates of each search
    #[arg(long, default_value_t = 48, value_parser = clap::value_parser!(u32).range(1..=4096))]
    batch: u32,
    /// Take no answer that is less than the whole search
    #[arg(long)]
    require_complete: bool,
    /// Connections that calls are spread over
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    connections: u32,
    /// Same seed, same due times and same mix
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// How due times are spaced.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Spacing {
    /// Evenly.
    Constant,
    /// At random, as calls of many that do not know of each other.
    Poisson,
}

/// Runs the load.
///
/// # Errors
/// For flags out of range, a target that is not on this machine, and a server that does not answer.
pub(crate) fn run(args: &LoadArgs) -> anyhow::Result<()> {
    args.check()?;
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    let report = runtime.block_on(args.measure())?;
    let mut out = std::io::stdout().lock();
    if args.json {
        writeln!(out, "{:#}", report.to_json())?;
    } else {
        write!(out, "{}", report.to_text())?;
    }
    Ok(())
}

impl LoadArgs {
    fn check(&self) -> anyhow::Result<()> {
        for (flag, value) in [("--drop", self.drop), ("--stream", self.stream)] {
            ensure!((0.0..=1.0).contains(&value), "{flag}: found {value}, expected 0 to 1");
        }
        for (flag, value, least) in [("--duration", self.duration, 0.1), ("--warmup", self.warmup, 0.0)] {
            ensure!(
                (least..=86_400.0).contains(&value),
                "{flag}: found {value}, expected {least} to 86400 seconds"
            );
        }
        for (flag, rate) in [("--rate", self.rate), ("--ramp-from", self.ramp_from)] {
            let Some(rate) = rate else { continue };
            ensure!(
                rate > 0.0 && rate <= 100_000.0,
                "{flag}: found {rate}, expected more than 0, at most 100000 calls a second"
            );
        }
        ensure!(
            self.servo_rate > 0.0 && self.servo_rate <= 1000.0,
            "--servo-rate: found {}, expected more than 0, at most 1000 frames a second",
            self.servo_rate
        );
        ensure!(
            self.rate.is_some() || self.concurrency.is_some() || self.find_max.is_some() || self.servo > 0,
            "expected one of --rate, --concurrency and --find-max, or --servo"
        );
        if !self.i_own_this_target {
            refuse_others(&self.server)?;
        }
        Ok(())
    }

    async fn measure(&self) -> anyhow::Result<Report> {
        let caller = Arc::new(self.caller().await?);
        let calls = self.measure_calls(&caller);
        if self.servo == 0 {
            return calls.await;
        }
        let (stop, stopped) = tokio::sync::watch::channel(false);
        let streams = caller.servo_until(self, stopped)?;
        let calls = async {
            let report = calls.await;
            stop.send(true).ok();
            report
        };
        let (report, streams) = tokio::join!(calls, streams);
        let mut report = report?;
        report.servo(&streams?)?;
        Ok(report)
    }

    async fn measure_calls(&self, caller: &Arc<Caller>) -> anyhow::Result<Report> {
        match (self.rate, self.concurrency, self.find_max) {
            (Some(rate), _, _) => self.open_loop(caller, self.ramp_from.unwrap_or(rate), rate).await,
            (None, Some(callers), _) => self.closed_loop(caller, callers).await,
            (None, None, Some(objective)) => {
                find::find_max(objective, async |rate| self.open_loop(caller, rate, rate).await).await
            }
            // Streams alone.
            (None, None, None) => {
                tokio::time::sleep(Duration::from_secs_f64(self.warmup + self.duration)).await;
                Report::new(self, 0.0)
            }
        }
    }

    async fn caller(&self) -> anyhow::Result<Caller> {
        let mut clients = Vec::new();
        for _ in 0..self.connections {
            let config = ClientConfig {
                call_timeout: Duration::from_millis(self.deadline_ms),
                ..remote::config(self.server.clone())?
            };
            // A server that is starting is waited for; calls are never repeated.
            clients.push(Client::connect(config).await?.with_retry(RetryPolicy::NONE));
        }
        Caller::new(clients, self)
    }

    /// Sends every call when it is due, whatever became of those before.
    async fn open_loop(&self, caller: &Arc<Caller>, from: f64, to: f64) -> anyhow::Result<Report> {
        let whole = Duration::from_secs_f64(self.warmup + self.duration);
        let arrivals = Arrivals { from, to, over: whole, spacing: self.arrivals, seed: self.seed };
        let begin = tokio::time::Instant::now() + Duration::from_millis(20);
        let mut calls = tokio::task::JoinSet::new();
        for (number, due) in arrivals.due_times().enumerate() {
            tokio::time::sleep_until(begin + due).await;
            let caller = Arc::clone(caller);
            let due_at = begin + due;
            calls.spawn(async move { (due, caller.call(number as u64, due_at).await) });
        }
        let mut report = Report::new(self, to)?;
        while let Some(ended) = calls.join_next().await {
            let (due, outcome) = ended.context("a call's task was lost")?;
            if due.as_secs_f64() >= self.warmup {
                report.count(&outcome);
            }
        }
        Ok(report)
    }

    /// So many callers, each with one call at a time.
    async fn closed_loop(&self, caller: &Arc<Caller>, callers: u32) -> anyhow::Result<Report> {
        let begin = tokio::time::Instant::now();
        let warm = begin + Duration::from_secs_f64(self.warmup);
        let end = warm + Duration::from_secs_f64(self.duration);
        let mut tasks = tokio::task::JoinSet::new();
        for first in 0..u64::from(callers) {
            let caller = Arc::clone(caller);
            tasks.spawn(async move {
                let mut outcomes: Vec<Outcome> = Vec::new();
                let mut number = first;
                loop {
                    let now = tokio::time::Instant::now();
                    if now >= end {
                        return outcomes;
                    }
                    let outcome = caller.call(number, now).await;
                    number += u64::from(callers);
                    let ended = tokio::time::Instant::now();
                    // What ends after the end belongs to nobody: the rate would be too high.
                    if ended >= warm && ended < end {
                        outcomes.push(outcome);
                    }
                }
            });
        }
        let mut report = Report::new(self, 0.0)?;
        while let Some(Ok(outcomes)) = tasks.join_next().await {
            outcomes.iter().for_each(|outcome| report.count(outcome));
        }
        Ok(report)
    }
}

/// Load is an attack on whoever did not ask for it.
fn refuse_others(url: &str) -> anyhow::Result<()> {
    let rest = url.split_once("://").map_or(url, |(_, rest)| rest);
    let authority = rest.split('/').next().unwrap_or(rest);
    let with_port = if authority.rsplit(']').next().is_some_and(|end| end.contains(':')) {
        authority.to_owned()
    } else {
        format!("{authority}:80")
    };
    let addresses: Vec<_> = with_port
        .to_socket_addrs()
        .with_context(|| {
            format!("--server: found {url:?}, expected an address such as http://127.0.0.1:50051")
        })?
        .collect();
    if let Some(other) = addresses.iter().find(|a| !a.ip().is_loopback()) {
        bail!(
            "--server: {url} is {}, which is not this machine; load on a server that is not yours is an attack. \
             If it is yours, say so with --i-own-this-target",
            other.ip()
        );
    }
    Ok(())
}

#[cfg(test)]
mod tests;
