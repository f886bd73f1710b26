//! `graspd eval`: how good grasps are, measured in simulation.

mod ap;
mod calibration;
mod clear;
mod contacts;
mod diversity;
mod look;
mod objects;
mod precision;
mod servo;
mod thresholds;

use std::sync::Arc;

use clap::{Args, Subcommand};
use graspd_hands::Hand;

use crate::hand_source;

pub(crate) use look::png;
pub(crate) use objects::meshes;

/// Measures grasp quality in a simulated world.
#[derive(Debug, Clone, Args)]
pub(crate) struct EvalArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Clone, Subcommand)]
enum What {
    Clear(clear::ClearArgs),
    Ap(ap::ApArgs),
    Servo(servo::ServoArgs),
    Look(look::LookArgs),
    Contacts(contacts::ContactsArgs),
    Diversity(diversity::DiversityArgs),
    Calibration(calibration::CalibrationArgs),
    Thresholds(thresholds::ThresholdsArgs),
}

/// Runs the command.
///
/// # Errors
/// For unknown hands, files that cannot be read or written, and settings of no use.
pub(crate) fn run(args: &EvalArgs) -> anyhow::Result<()> {
    match &args.what {
        What::Clear(args) => clear::run(args),
        What::Ap(args) => ap::run(args),
        What::Servo(args) => servo::run(args),
        What::Look(args) => look::run(args),
        What::Contacts(args) => contacts::run(args),
        What::Diversity(args) => diversity::run(args),
        What::Calibration(args) => calibration::run(args),
        What::Thresholds(args) => thresholds::run(args),
    }
}

/// Work that is done at the same time: as asked, or one piece for every core.
pub(crate) fn jobs(asked: Option<u32>) -> usize {
    let cores = || std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    asked.map_or_else(cores, |jobs| jobs as usize)
}

/// Hands by id or folder.
fn hands(names: &[String]) -> anyhow::Result<Vec<Arc<Hand>>> {
    names.iter().map(|name| Ok(Arc::new(hand_source::resolve(name)?))).collect()
}
