//! `graspd doctor`: whether this installation would serve, and what is wrong where it would not.

use std::fmt;
use std::io::Write as _;
use std::net::TcpListener;
use std::time::{Duration, Instant};

use anyhow::ensure;
use clap::Args;
use graspd_planner::options::{PlanOptions, SceneOptions};
use graspd_server::{Server, ServerConfig};

use super::plan::FrameFiles;
use super::serve::ServeArgs;
use crate::estimators::EstimatorArgs;
use crate::local::{self, Observed, Settings};
use crate::{demo_scene, hand_source, remote};

/// Slower than this for the bundled frame is worth a word.
const SLOW: Duration = Duration::from_secs(1);

/// Checks an installation: settings, certificates, hands, address, planning itself, and a server that runs. Takes the
/// flags of `graspd serve`. Ends with 1 if the server would not start or plan.
#[derive(Debug, Clone, Args)]
pub(crate) struct DoctorArgs {
    /// Also ask this running server
    #[arg(long, value_name = "URL")]
    server: Option<String>,
    #[command(flatten)]
    serve: ServeArgs,
}

/// How a check ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Verdict {
    Good,
    Doubtful,
    Bad,
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Good => "ok  ",
            Self::Doubtful => "warn",
            Self::Bad => "FAIL",
        })
    }
}

type Finding = (Verdict, &'static str, String);

/// Runs the checks.
///
/// # Errors
/// If any of them failed.
pub(crate) fn run(args: &DoctorArgs) -> anyhow::Result<()> {
    let findings = examine(args)?;
    let mut out = std::io::stdout().lock();
    for (verdict, what, found) in &findings {
        writeln!(out, "{verdict}  {what:<12} {found}")?;
    }
    let bad = findings.iter().filter(|(verdict, ..)| *verdict == Verdict::Bad).count();
    ensure!(bad == 0, "{bad} of {} checks failed", findings.len());
    Ok(())
}

fn examine(args: &DoctorArgs) -> anyhow::Result<Vec<Finding>> {
    let mut findings = Vec::new();
    match args.serve.config() {
        Err(error) => findings.push((Verdict::Bad, "settings", format!("{error:#}"))),
        Ok(config) => {
            findings.push((Verdict::Good, "settings", said(&config)));
            findings.push(start(&config)?);
            findings.push(address(&config));
            findings.extend(key(&config));
            findings.extend(files(&config));
        }
    }
    findings.push(planning());
    if let Some(url) = &args.server {
        findings.push(running(url)?);
    }
    Ok(findings)
}

fn said(config: &ServerConfig) -> String {
    let p = &config.pool;
    let (slots, servo, threads, queue) = (p.slots, p.servo_slots, p.threads, p.queue);
    format!(
        "{slots} slots and {servo} for servo, {threads} threads each, {queue} may wait; {}, {} tokens",
        if config.tls.is_some() { "TLS" } else { "no TLS" },
        config.access.tokens.len()
    )
}

/// Starts everything but the accepting of calls, on a free port.
fn start(config: &ServerConfig) -> anyhow::Result<Finding> {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build()?;
    let mut config = config.clone();
    config.listen.set_port(0);
    config.metrics_listen = None;
    if let Some(live) = &mut config.live {
        live.listen.set_port(0);
    }
    // A server that runs keeps its folder to itself.
    config.record = None;
    Ok(match runtime.block_on(Server::bind(config)) {
        Ok(_) => (Verdict::Good, "start", "certificates, hands and threads are in order".to_owned()),
        Err(error) => (Verdict::Bad, "start", format!("{:#}", anyhow::Error::from(error))),
    })
}

fn address(config: &ServerConfig) -> Finding {
    match TcpListener::bind(config.listen) {
        Ok(_) => (Verdict::Good, "address", format!("{} is free", config.listen)),
        Err(error) => {
            (Verdict::Doubtful, "address", format!("{}: {error}; does a server run there?", config.listen))
        }
    }
}

/// A private key is nobody else's business.
fn key(config: &ServerConfig) -> Option<Finding> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;

        let path = &config.tls.as_ref()?.key;
        let mode = std::fs::metadata(path).ok()?.permissions().mode() & 0o777;
        let verdict = if mode & 0o077 == 0 { Verdict::Good } else { Verdict::Doubtful };
        Some((
            verdict,
            "key",
            format!("{} has mode {mode:03o}; 600 lets only its owner read it", path.display()),
        ))
    }
    #[cfg(not(unix))]
    {
        let _ = config;
        None
    }
}

/// Every connection is an open file. Where the system does not say how many there may be, nothing is said.
fn files(config: &ServerConfig) -> Option<Finding> {
    let limits = std::fs::read_to_string("/proc/self/limits").ok()?;
    let line = limits.lines().find_map(|line| line.strip_prefix("Max open files"))?;
    let may: usize = line.split_whitespace().next()?.parse().ok()?;
    let needs = config.limits.connections + 128;
    let verdict = if may >= needs { Verdict::Good } else { Verdict::Doubtful };
    Some((verdict, "open files", format!("{may} may be open, {needs} may be needed")))
}

/// Plans in the bundled frame.
fn planning() -> Finding {
    let plan = || -> anyhow::Result<(usize, Duration)> {
        let (depth, file) = demo_scene::bundled()?;
        let files = FrameFiles::new(depth, file, None)?;
        let hand = hand_source::resolve("robotiq-2f85")?;
        let (scene, search) = (SceneOptions::default(), PlanOptions::default());
        let estimator = EstimatorArgs::default();
        let settings = Settings { scene: &scene, search: &search, estimator: &estimator, budget: None };
        let began = Instant::now();
        let (_, outcomes) = local::plan(&Observed::Frame(Box::new(files.frame)), &[hand], &settings)?;
        Ok((outcomes.iter().map(|o| o.grasps.len()).sum(), began.elapsed()))
    };
    match plan() {
        Err(error) => (Verdict::Bad, "planning", format!("{error:#}")),
        Ok((0, _)) => (Verdict::Bad, "planning", "no grasp in the bundled frame".to_owned()),
        Ok((count, took)) => {
            let verdict = if took <= SLOW { Verdict::Good } else { Verdict::Doubtful };
            let ms = took.as_secs_f64() * 1e3;
            (verdict, "planning", format!("{count} grasps in the bundled frame after {ms:.0} ms"))
        }
    }
}

fn running(url: &str) -> anyhow::Result<Finding> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    Ok(runtime.block_on(async {
        let began = Instant::now();
        let answer = async { anyhow::Ok(remote::connect(url).await?.list_hands().await?.len()) };
        match answer.await {
            Ok(count) => {
                let ms = began.elapsed().as_secs_f64() * 1e3;
                (Verdict::Good, "server", format!("{url} has {count} hands and answered after {ms:.0} ms"))
            }
            Err(error) => (Verdict::Bad, "server", format!("{error:#}")),
        }
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Only {
        #[command(flatten)]
        doctor: DoctorArgs,
    }

    fn findings(flags: &str) -> Vec<Finding> {
        let only = Only::parse_from(std::iter::once("doctor").chain(flags.split_whitespace()));
        examine(&only.doctor).unwrap()
    }

    #[test]
    fn a_good_installation_is_good_and_a_bad_one_is_named() {
        let good = findings("--listen 127.0.0.1:0");
        assert!(good.iter().all(|(verdict, ..)| *verdict != Verdict::Bad), "{good:?}");
        assert!(good.iter().any(|(_, what, _)| *what == "planning"));
        let open = findings("--listen 0.0.0.0:0");
        assert!(open.iter().any(|(v, what, found)| {
            (*v, *what) == (Verdict::Bad, "start") && found.contains("refusing to listen")
        }));
        let missing = findings("--config /nowhere.toml");
        assert_eq!((missing[0].0, missing[0].1), (Verdict::Bad, "settings"));
        let nobody = findings("--listen 127.0.0.1:0 --hands-dir /nowhere");
        assert!(nobody.iter().any(|(v, what, _)| (*v, *what) == (Verdict::Bad, "start")), "{nobody:?}");
    }
}
