//! `graspd replay`: plans what was recorded again and shows what is different; lists what became of grasps.

mod again;
mod compare;
pub(crate) mod outcomes;

use std::io::Write as _;
use std::net::SocketAddr;
use std::path::PathBuf;

use anyhow::{Context as _, ensure};
use clap::Args;
use graspd_recording::Recording;
use graspd_server::{Server, ServerConfig};

use crate::estimators::EstimatorArgs;
use crate::remote;
use compare::{Report, Task};

/// Largest message of the server that replays: recordings may come from one that takes more than the default.
const MESSAGE_BYTES: usize = 1 << 30;

/// Plans every call of a recording again, here or by a server, and shows what is different. The same program gives the
/// same grasps bit for bit, unless a deadline had ended the search.
#[derive(Debug, Clone, Args)]
pub(crate) struct ReplayArgs {
    /// A file of a recording, or its folder
    #[arg(value_name = "FILE|DIR")]
    path: PathBuf,
    /// Ask this server instead of planning here
    #[arg(long, value_name = "URL")]
    server: Option<String>,
    /// Folder of hands besides the library, where planning is here
    #[arg(long, value_name = "DIR", conflicts_with = "server")]
    hands_dir: Option<PathBuf>,
    #[command(flatten)]
    estimator: EstimatorArgs,
    /// List what became of grasps instead of planning
    #[arg(long, conflicts_with_all = ["server", "expect_equal"])]
    outcomes: bool,
    /// At most this many calls, the latest
    #[arg(long, value_name = "N")]
    last: Option<usize>,
    /// End with 1 if anything is different that should not be
    #[arg(long)]
    expect_equal: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// For files that are no recording, a server that does not answer, and differences where none are expected.
pub(crate) fn run(args: &ReplayArgs) -> anyhow::Result<()> {
    let mut recording = read(&args.path)?;
    let mut out = std::io::stdout().lock();
    if args.outcomes {
        let listed = outcomes::listed(&recording);
        match args.json {
            true => writeln!(out, "{}", serde_json::to_string_pretty(&listed)?)?,
            false => write!(out, "{}", outcomes::Text(&listed))?,
        }
        return Ok(());
    }
    if let Some(last) = args.last {
        recording.plans.drain(..recording.plans.len().saturating_sub(last));
    }
    ensure!(!recording.plans.is_empty(), "{}: no calls are recorded there", args.path.display());
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let tasks = runtime.block_on(async {
        match &args.server {
            Some(url) => plan_all(url, &recording).await,
            None => {
                let server = Server::bind(ServerConfig {
                    listen: SocketAddr::from(([127, 0, 0, 1], 0)),
                    hands_dir: args.hands_dir.clone(),
                    estimators: args.estimator.all()?,
                    max_message_bytes: MESSAGE_BYTES,
                    ..ServerConfig::default()
                })
                .await?;
                let url = format!("http://{}", server.local_addr());
                let serving = tokio::spawn(server.serve_until(std::future::pending()));
                let tasks = plan_all(&url, &recording).await;
                serving.abort();
                tasks
            }
        }
    })?;
    let report = Report::new(tasks, recording.ended);
    match args.json {
        true => writeln!(out, "{}", serde_json::to_string_pretty(&report)?)?,
        false => write!(out, "{report}")?,
    }
    let wrong = report.summary.different + report.summary.failed;
    ensure!(!args.expect_equal || wrong == 0, "{wrong} plans are different or failed, expected none");
    Ok(())
}

/// Everything in a file, or in all files of a folder.
///
/// # Errors
/// For a path that cannot be read, and files that are no recordings.
pub(crate) fn read(path: &std::path::Path) -> anyhow::Result<Recording> {
    let files = graspd_recording::files(path).with_context(|| path.display().to_string())?;
    ensure!(!files.is_empty(), "{}: no recording there (files graspd-*.mcap)", path.display());
    let mut all = Recording { ended: true, ..Recording::default() };
    for file in files {
        let read = graspd_recording::read_file(&file);
        let Recording { plans, outcomes, ended } = read.with_context(|| file.display().to_string())?;
        all.plans.extend(plans);
        all.outcomes.extend(outcomes);
        all.ended &= ended;
    }
    Ok(all)
}

async fn plan_all(url: &str, recording: &Recording) -> anyhow::Result<Vec<Task>> {
    let client = remote::connect(url).await?;
    let mut tasks = Vec::new();
    for (i, record) in recording.plans.iter().enumerate() {
        tasks.extend(again::plan(&client, i, record).await?);
    }
    Ok(tasks)
}
