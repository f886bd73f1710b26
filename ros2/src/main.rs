//! The program `graspd-ros2`: settings, logs, and the bridge until it is told to end.

use std::io::IsTerminal as _;
use std::process::ExitCode;

use clap::Parser as _;
use graspd_ros2::bridge::Bridge;
use graspd_ros2::link::Link;
use graspd_ros2::node::RosNode;
use graspd_ros2::settings::{LogFormat, Options, Parts};
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::mpsc;
use tracing_subscriber::EnvFilter;

/// Messages that wait for the bridge; images among them are the largest.
const WAITING: usize = 16;

fn main() -> ExitCode {
    let options = Options::parse();
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info"));
    let lines = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        // Its own complaints go through a macro that panics when standard error is closed.
        .log_internal_errors(false);
    match options.log_format {
        LogFormat::Text => lines.init(),
        LogFormat::Json => lines.json().flatten_event(true).with_span_list(false).init(),
    }
    check_distribution();
    match run(options) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            use std::io::Write as _;
            // Standard error may be closed.
            writeln!(std::io::stderr(), "error: {error:#}").ok();
            ExitCode::FAILURE
        }
    }
}

/// Says so where the environment's distribution is not one that this build is for.
fn check_distribution() {
    let Ok(distribution) = std::env::var("ROS_DISTRO") else { return };
    let (built_for_old, is_old) = (cfg!(not(feature = "iron")), distribution == "humble");
    if built_for_old != is_old {
        let built_for = if built_for_old { "humble" } else { "iron and later" };
        tracing::warn!(distribution, built_for, "another build is needed for this distribution");
    }
}

fn run(options: Options) -> anyhow::Result<()> {
    let parts = options.parts(|name| std::env::var(name).ok())?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    runtime.block_on(serve(parts))
}

async fn serve(parts: Parts) -> anyhow::Result<()> {
    let Parts { client, bridge: config, node: node_config } = parts;
    let mut terminated = signal(SignalKind::terminate())?;
    let stop = async move {
        tokio::select! {
            _ = tokio::signal::ctrl_c() => {}
            _ = terminated.recv() => {}
        }
        tracing::info!("ending");
    };
    let (link, keeper) = Link::new(client, config.hands.first().map_or("", String::as_str));
    let node = RosNode::new(&node_config)?;
    tracing::info!(
        node = config.node,
        domain = node_config.domain_id,
        image = node_config.image,
        camera_info = node_config.info,
        server = config.server,
        hands = config.hands.join(","),
        "takes goals"
    );
    let keeper = tokio::spawn(keeper);
    let (to_bridge, from_node) = mpsc::channel(WAITING);
    let (to_node, from_bridge) = mpsc::unbounded_channel();
    let bridge = tokio::spawn(Bridge::new(config, link, to_node).run(from_node, stop));
    // Ends when the bridge has ended and said its last words.
    node.run(to_bridge, from_bridge).await;
    keeper.abort();
    bridge.await?;
    Ok(())
}
