//! `graspd eval`: how good grasps are, measured in simulation.

mod clear;
mod look;
mod objects;

use std::sync::Arc;

use clap::{Args, Subcommand};
use graspd_hands::Hand;

use crate::hand_source;

/// Measures grasp quality in a simulated world.
#[derive(Debug, Clone, Args)]
pub(crate) struct EvalArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Clone, Subcommand)]
enum What {
    Clear(clear::ClearArgs),
    Look(look::LookArgs),
}

/// Runs the command.
///
/// # Errors
/// For unknown hands, files that cannot be read or written, and settings of no use.
pub(crate) fn run(args: &EvalArgs) -> anyhow::Result<()> {
    match &args.what {
        What::Clear(args) => clear::run(args),
        What::Look(args) => look::run(args),
    }
}

/// Hands by id or folder.
fn hands(names: &[String]) -> anyhow::Result<Vec<Arc<Hand>>> {
    names.iter().map(|name| Ok(Arc::new(hand_source::resolve(name)?))).collect()
}
