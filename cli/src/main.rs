//! The `graspd` command: each subcommand a thin call into a crate.

mod clock;
mod commands;
mod demo_scene;
#[cfg(feature = "devices")]
mod devices;
#[cfg(test)]
mod documents;
mod estimators;
mod hand_source;
mod input;
mod local;
mod memory;
mod outcome;
mod output;
mod remote;
mod view;

use std::io::IsTerminal as _;
use std::process::ExitCode;

use clap::{CommandFactory as _, Parser, Subcommand};
use tracing_subscriber::EnvFilter;

use commands::{bench, demo, doctor, hands, load, plan, recalibrate, replay, serve, shell};
#[cfg(feature = "sim")]
use commands::{cell, dataset, eval};
#[cfg(feature = "devices")]
use commands::{device, emulate};
#[cfg(feature = "nats")]
use commands::{lease, worker};

/// Ranked grasps for any robotic hand from one depth frame, over gRPC.
#[derive(Debug, Parser)]
#[command(name = "graspd", version, propagate_version = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Lines of the log, on standard error
    #[arg(long, global = true, value_enum, default_value_t = LogFormat::Text, env = "GRASPD_LOG_FORMAT")]
    log_format: LogFormat,
}

/// How a line of the log looks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum LogFormat {
    /// For people.
    Text,
    /// One JSON object a line.
    Json,
}

#[derive(Debug, Subcommand)]
enum Command {
    Serve(Box<serve::ServeArgs>),
    #[cfg(feature = "nats")]
    Worker(Box<worker::WorkerArgs>),
    #[cfg(feature = "nats")]
    Lease(Box<lease::LeaseArgs>),
    Plan(Box<plan::PlanArgs>),
    Hands(hands::HandsArgs),
    Demo(demo::DemoArgs),
    Bench(bench::BenchArgs),
    Load(Box<load::LoadArgs>),
    Doctor(Box<doctor::DoctorArgs>),
    Replay(Box<replay::ReplayArgs>),
    Recalibrate(recalibrate::RecalibrateArgs),
    Completions(shell::CompletionsArgs),
    Man(shell::ManArgs),
    #[cfg(feature = "sim")]
    Cell(cell::CellArgs),
    #[cfg(feature = "sim")]
    Dataset(Box<dataset::DatasetArgs>),
    #[cfg(feature = "sim")]
    Eval(Box<eval::EvalArgs>),
    #[cfg(feature = "devices")]
    Device(device::DeviceArgs),
    #[cfg(feature = "devices")]
    Emulate(emulate::EmulateArgs),
}

fn main() -> ExitCode {
    memory::keep();
    #[cfg(all(feature = "devices", target_feature = "crt-static"))]
    graspd_adapters_core::library::program_is_static();
    let cli = Cli::parse();
    // Logs go to stderr: stdout belongs to tables and JSON.
    let quiet = match cli.command {
        Command::Serve(_) => "info,async_nats=warn",
        #[cfg(feature = "nats")]
        Command::Worker(_) => "info,async_nats=warn",
        _ => "warn",
    };
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(quiet));
    let ansi = std::io::stderr().is_terminal();
    let lines = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(ansi)
        // Its own complaints go through a macro that panics when standard error is closed.
        .log_internal_errors(false);
    match cli.log_format {
        LogFormat::Text => lines.init(),
        LogFormat::Json => lines.json().flatten_event(true).with_span_list(false).init(),
    }
    memory::give_back_now_and_then();
    let result = match &cli.command {
        Command::Serve(args) => serve::run(args),
        #[cfg(feature = "nats")]
        Command::Worker(args) => worker::run(args),
        #[cfg(feature = "nats")]
        Command::Lease(args) => lease::run(args),
        Command::Plan(args) => plan::run(args),
        Command::Hands(args) => hands::run(args),
        Command::Demo(args) => demo::run(args),
        Command::Bench(args) => bench::run(args),
        Command::Load(args) => load::run(args),
        Command::Doctor(args) => doctor::run(args),
        Command::Replay(args) => replay::run(args),
        Command::Recalibrate(args) => recalibrate::run(args),
        Command::Completions(args) => shell::completions(args, Cli::command()),
        Command::Man(args) => shell::man(args, Cli::command()),
        #[cfg(feature = "sim")]
        Command::Cell(args) => cell::run(args),
        #[cfg(feature = "sim")]
        Command::Dataset(args) => dataset::run(args),
        #[cfg(feature = "sim")]
        Command::Eval(args) => eval::run(args),
        #[cfg(feature = "devices")]
        Command::Device(args) => device::run(args),
        #[cfg(feature = "devices")]
        Command::Emulate(args) => emulate::run(args),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        // Whoever read our output has seen enough: that is no fault of ours (`graspd hands list | head -1`).
        Err(error) if is_closed_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            // Standard error may be closed too.
            use std::io::Write as _;
            writeln!(std::io::stderr(), "error: {error:#}").ok();
            ExitCode::FAILURE
        }
    }
}

fn is_closed_pipe(error: &anyhow::Error) -> bool {
    error
        .chain()
        .filter_map(|cause| cause.downcast_ref::<std::io::Error>())
        .any(|e| e.kind() == std::io::ErrorKind::BrokenPipe)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn a_closed_pipe_is_recognized_under_context() {
        let closed = std::io::Error::from(std::io::ErrorKind::BrokenPipe);
        assert!(is_closed_pipe(&anyhow::Error::from(closed).context("writing the table")));
        assert!(!is_closed_pipe(&anyhow::anyhow!("other")));
    }
}
