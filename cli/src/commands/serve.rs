//! `graspd serve`: the gRPC service.

mod file;

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::Context as _;
use clap::Args;
use graspd_server::calibration::Calibration;
use graspd_server::{Example, LiveConfig, Page, RecordConfig, Server, ServerConfig, shutdown_signal};

use crate::demo_scene;
use crate::estimators::EstimatorArgs;

/// Serves grasps over gRPC until SIGINT or SIGTERM, then finishes what is running.
#[derive(Debug, Clone, Args)]
pub(crate) struct ServeArgs {
    /// Settings as TOML; see docs/operations.md. Flags come before it
    #[arg(long, env = "GRASPD_CONFIG", value_name = "TOML")]
    config: Option<PathBuf>,
    /// Address to listen on; port 0 takes a free one [default: 127.0.0.1:50051]
    #[arg(long, env = "GRASPD_LISTEN", value_name = "ADDRESS:PORT")]
    listen: Option<SocketAddr>,
    /// Allow an address that other machines can reach, without encryption
    #[arg(long, env = "GRASPD_INSECURE_LISTEN")]
    insecure_listen: bool,
    /// Address of /metrics, /livez and /readyz
    #[arg(long, env = "GRASPD_METRICS_LISTEN", value_name = "ADDRESS:PORT")]
    metrics_listen: Option<SocketAddr>,
    /// Show the page for browsers; without the flag it is shown at loopback addresses alone
    #[arg(long, env = "GRASPD_PAGE", conflicts_with = "no_page")]
    page: bool,
    /// Show no page, and speak gRPC alone
    #[arg(long, env = "GRASPD_NO_PAGE")]
    no_page: bool,
    /// Largest message that is taken, MiB [default: 16]
    #[arg(long, env = "GRASPD_MAX_MESSAGE_MIB", value_parser = clap::value_parser!(u32).range(1..=1024))]
    max_message_mib: Option<u32>,
    /// Threads that work on one request; all cores if left out
    #[arg(long, env = "GRASPD_THREADS", value_parser = clap::value_parser!(u32).range(1..=1024))]
    threads: Option<u32>,
    /// Requests that are planned at the same time
    #[arg(long, env = "GRASPD_SLOTS", value_parser = clap::value_parser!(u32).range(1..=1024))]
    slots: Option<u32>,
    /// Further requests that are planned at the same time, for servo calls alone
    #[arg(long, env = "GRASPD_SERVO_SLOTS", value_parser = clap::value_parser!(u32).range(0..=1024))]
    servo_slots: Option<u32>,
    /// Requests that may wait; more are refused at once
    #[arg(long, env = "GRASPD_QUEUE", value_parser = clap::value_parser!(u32).range(0..=100_000))]
    queue: Option<u32>,
    /// How much nicer planning threads are than the rest, so that refusals and cancellations need not wait for them [default: 5]
    #[arg(long, env = "GRASPD_NICE", value_parser = clap::value_parser!(u8).range(0..=19))]
    nice: Option<u8>,
    /// For comparison: plan in the order of arrival, and refuse nothing but by a full queue
    #[arg(long)]
    plain_fifo: bool,
    /// Folder of hands to offer besides the library, one folder for each hand
    #[arg(long, env = "GRASPD_HANDS_DIR", value_name = "DIR")]
    hands_dir: Option<PathBuf>,
    #[command(flatten)]
    estimator: EstimatorArgs,
    /// Folder to record calls and outcomes in, for viewers and graspd replay
    #[arg(long, env = "GRASPD_RECORD", value_name = "DIR")]
    record: Option<PathBuf>,
    /// Share of calls that are recorded without asking for it, 0 to 1 [default: 1]
    #[arg(long, env = "GRASPD_RECORD_SHARE", value_name = "SHARE", value_parser = super::args::parse_share)]
    record_share: Option<f64>,
    /// Disk space of the recording, for example 500MB or 2GiB; the oldest files go first [default: 2GiB]
    #[arg(long, env = "GRASPD_RECORD_BUDGET", value_name = "SIZE", value_parser = parse_size)]
    record_budget: Option<u64>,
    /// Address of the live view for Foxglove and its like: loopback alone, for example 127.0.0.1:8765
    #[arg(long, env = "GRASPD_LIVE", value_name = "ADDRESS:PORT")]
    live: Option<SocketAddr>,
    /// Origin of a viewer's page elsewhere that may look too, for example `https://app.foxglove.dev`
    #[arg(long, env = "GRASPD_LIVE_ORIGIN", value_name = "ORIGIN", value_delimiter = ',')]
    live_origin: Vec<String>,
    /// Calibration of the score for this site, as graspd recalibrate writes it
    #[arg(long, env = "GRASPD_CALIBRATION", value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// OpenTelemetry collector that gets traces (OTLP over gRPC), for example http://127.0.0.1:4317
    #[arg(long, env = "GRASPD_OTLP", value_name = "URL")]
    otlp: Option<String>,
    /// Seconds that running requests may take to finish at the end [default: 10]
    #[arg(long, env = "GRASPD_DRAIN_SECONDS", value_name = "SECONDS")]
    drain_seconds: Option<f64>,
    #[cfg(feature = "nats")]
    #[command(flatten)]
    engine: super::engine::EngineArgs,
}

impl ServeArgs {
    /// The file's settings, and over them those of flags and environment.
    pub(crate) fn config(&self) -> anyhow::Result<ServerConfig> {
        let (mut config, page) = match &self.config {
            None => (ServerConfig::default(), None),
            Some(path) => {
                let text = std::fs::read_to_string(path)
                    .with_context(|| format!("--config: {} cannot be read", path.display()))?;
                file::parse(&text).with_context(|| path.display().to_string())?
            }
        };
        let pool = &mut config.pool;
        let set = |slot: &mut usize, value: Option<u32>| {
            if let Some(value) = value {
                *slot = value as usize;
            }
        };
        set(&mut pool.threads, self.threads);
        set(&mut pool.slots, self.slots);
        set(&mut pool.queue, self.queue);
        set(&mut pool.servo_slots, self.servo_slots);
        pool.nice = self.nice.unwrap_or(pool.nice);
        pool.plain_fifo |= self.plain_fifo;
        if let Some(seconds) = self.drain_seconds {
            config.drain_grace = Duration::try_from_secs_f64(seconds).map_err(|_| {
                anyhow::anyhow!("--drain-seconds: found {seconds}, expected a number of seconds, 0 or more")
            })?;
        }
        if let Some(mib) = self.max_message_mib {
            config.max_message_bytes = mib as usize * 1024 * 1024;
        }
        config.listen = self.listen.unwrap_or(config.listen);
        config.insecure_listen |= self.insecure_listen;
        let page = if self.page || self.no_page { Some(self.page) } else { page };
        let has_page = page.unwrap_or_else(|| config.listen.ip().is_loopback());
        config.page = has_page.then_some(PAGE);
        config.metrics_listen = self.metrics_listen.or(config.metrics_listen);
        config.hands_dir = self.hands_dir.clone().or(config.hands_dir);
        config.estimators = self.estimator.all()?;
        config.otlp = self.otlp.clone().or(config.otlp);
        if let Some(listen) = self.live {
            let live = config.live.get_or_insert_with(|| LiveConfig::at(listen));
            live.listen = listen;
        }
        match &mut config.live {
            Some(live) => live.origins.extend(self.live_origin.iter().cloned()),
            None => anyhow::ensure!(
                self.live_origin.is_empty(),
                "--live-origin: expected --live ADDRESS:PORT with it"
            ),
        }
        if let Some(path) = &self.calibration {
            config.calibration = Some(calibration(path).context("--calibration")?);
        }
        if let Some(folder) = &self.record {
            let record = config.record.get_or_insert_with(|| record_in(PathBuf::new()));
            record.folder.clone_from(folder);
        }
        match &mut config.record {
            Some(record) => {
                record.share = self.record_share.unwrap_or(record.share);
                record.budget_bytes = self.record_budget.unwrap_or(record.budget_bytes);
            }
            None => anyhow::ensure!(
                self.record_share.is_none() && self.record_budget.is_none(),
                "--record-share, --record-budget: expected --record DIR with them"
            ),
        }
        Ok(config)
    }
}

/// The page, with the frame that comes with graspd.
const PAGE: Page =
    Page { example: Some(Example::from_static(demo_scene::DEPTH_PNG, demo_scene::FRAME_JSON)) };

/// A recording with the defaults.
fn record_in(folder: PathBuf) -> RecordConfig {
    RecordConfig { folder, share: 1.0, budget_bytes: 2 << 30 }
}

/// The calibration in a file.
pub(super) fn calibration(path: &std::path::Path) -> anyhow::Result<Calibration> {
    let text = std::fs::read_to_string(path).with_context(|| format!("{} cannot be read", path.display()))?;
    Calibration::parse(&text).with_context(|| path.display().to_string())
}

/// A number of bytes with a unit, for example `500MB` or `2GiB`.
fn parse_size(text: &str) -> Result<u64, String> {
    let expected = || format!("found {text:?}, expected a size such as 500MB or 2GiB");
    let digits = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    let unit: u64 = match unit.trim() {
        "" | "B" => 1,
        "kB" | "KB" => 1000,
        "KiB" => 1 << 10,
        "MB" => 1_000_000,
        "MiB" => 1 << 20,
        "GB" => 1_000_000_000,
        "GiB" => 1 << 30,
        "TB" => 1_000_000_000_000,
        "TiB" => 1 << 40,
        _ => return Err(expected()),
    };
    let bytes = number.parse::<f64>().map_err(|_| expected())? * unit as f64;
    // Less than a petabyte, so that the number is exact.
    if bytes < 1e15 { Ok(bytes as u64) } else { Err(expected()) }
}

/// Runs the service.
///
/// # Errors
/// If the address cannot be had, or the folder of hands cannot be read.
pub(crate) fn run(args: &ServeArgs) -> anyhow::Result<()> {
    let config = args.config()?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    runtime.block_on(async {
        #[cfg(feature = "nats")]
        let (config, hands) = on_workers(&args.engine, config).await?;
        let server = Server::bind(config).await?;
        #[cfg(feature = "nats")]
        if let Some(hands) = hands {
            hands.follow(server.hands()).await.map_err(|e| anyhow::anyhow!("hands: {e}"))?;
        }
        let ended = async {
            if let Err(error) = shutdown_signal().await {
                tracing::error!(%error, "cannot listen for signals; ending");
            }
        };
        Ok(server.serve_until(ended).await?)
    })
}

/// The settings with the engine of a broker, where one is named, and its hands.
#[cfg(feature = "nats")]
async fn on_workers(
    args: &super::engine::EngineArgs,
    mut config: ServerConfig,
) -> anyhow::Result<(ServerConfig, Option<std::sync::Arc<graspd_engine_nats::NatsHands>>)> {
    let Some(broker) = args.connect(graspd_engine_nats::Node::Front).await? else {
        return Ok((config, None));
    };
    anyhow::ensure!(
        config.calibration.is_none(),
        "--calibration: found one with --engine, expected none; scores are calibrated by the workers, give it to them"
    );
    let engine = graspd_engine_nats::NatsEngine::start(&broker).await;
    config.engine = Some(engine.map_err(|e| anyhow::anyhow!("the broker: {e}"))?);
    let hands = graspd_engine_nats::NatsHands::new(&broker);
    config.hand_store = Some(std::sync::Arc::clone(&hands) as _);
    Ok((config, Some(hands)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Only {
        #[command(flatten)]
        serve: ServeArgs,
    }

    #[test]
    fn a_recording_has_a_folder_a_share_and_a_size() {
        let parse =
            |flags: &str| Only::parse_from(["serve"].into_iter().chain(flags.split(' '))).serve.config();
        let record =
            parse("--record /tmp/r --record-share 0.1 --record-budget 1.5GiB").unwrap().record.unwrap();
        let folder = PathBuf::from("/tmp/r");
        assert_eq!(record, RecordConfig { folder, share: 0.1, budget_bytes: 3 << 29 });
        assert!(parse("--queue 4").unwrap().record.is_none());
        assert!(parse("--record-share 0.5").unwrap_err().to_string().contains("expected --record DIR"));
        assert_eq!(
            (parse_size("500MB"), parse_size("16 KiB"), parse_size("7")),
            (Ok(500_000_000), Ok(16384), Ok(7))
        );
        for wrong in ["", "MB", "1.2.3MB", "2 parsec", "-1", "1e9", "9999999TB"] {
            assert!(parse_size(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_live_view_has_an_address_and_origins() {
        let parse = |flags: &str| {
            Only::parse_from(["serve"].into_iter().chain(flags.split_whitespace())).serve.config()
        };
        assert_eq!(parse("").unwrap().live, None);
        let live = parse("--live 127.0.0.1:8765 --live-origin https://a.example,https://b.example").unwrap();
        let live = live.live.unwrap();
        assert_eq!((live.listen.port(), live.origins.len()), (8765, 2));
        let missing = parse("--live-origin https://a.example").unwrap_err();
        assert!(missing.to_string().contains("expected --live ADDRESS:PORT"));
    }

    #[test]
    fn the_page_is_shown_on_loopback_or_where_it_is_asked_for() {
        let shown = |flags: &str| {
            let all = ["serve"].into_iter().chain(flags.split_whitespace());
            Only::try_parse_from(all).unwrap().serve.config().unwrap().page.is_some()
        };
        assert!(shown("") && shown("--listen [::1]:0") && !shown("--no-page"));
        assert!(!shown("--listen 0.0.0.0:0") && shown("--listen 0.0.0.0:0 --page"));
        assert!(Only::try_parse_from(["serve", "--page", "--no-page"]).is_err());
    }

    #[test]
    fn flags_reach_the_configuration() {
        let flags = "--listen 127.0.0.1:0 --threads 3 --slots 2 --queue 7 --nice 2 --max-message-mib 4 --drain-seconds 0.5";
        let only = Only::parse_from(std::iter::once("serve").chain(flags.split(' ')));
        let config = only.serve.config().unwrap();
        let pool = config.pool;
        assert_eq!((pool.threads, pool.slots, pool.queue, pool.nice), (3, 2, 7, 2));
        assert_eq!(config.max_message_bytes, 4 << 20);
        assert_eq!(config.drain_grace, Duration::from_millis(500));
        let negative = Only::parse_from(["serve", "--drain-seconds=-1"]).serve.config().unwrap_err();
        assert!(negative.to_string().starts_with("--drain-seconds: found -1"));
        let missing = Only::parse_from(["serve", "--config", "/nowhere.toml"]).serve.config().unwrap_err();
        assert!(missing.to_string().starts_with("--config: /nowhere.toml cannot be read"));
    }
}
