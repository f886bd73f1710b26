//! `graspd eval look`: executes a failed trial again, and draws what happened.

use std::io::Write as _;
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::Context as _;
use clap::Args;
use graspd_sim::execute::Moment;
use graspd_sim::render::{RgbImage, capture, depth_picture};
use graspd_sim::world::World;
use graspd_training::evaluate::{FailedTrial, Replay, Station, picture, plan_again, replay};
use nalgebra::Point3;

use crate::commands::plan::write_file;
use crate::estimators::EstimatorArgs;
use crate::hand_source;

/// Width and height of one picture, pixels.
const PANEL_PX: [usize; 2] = [520, 468];

/// Executes a failed trial of `graspd eval clear --failures` again and says what became of it; draws the world
/// at the pre-grasp, at contact and at the end, and the depth image that was planned from.
#[derive(Debug, Clone, Args)]
pub(crate) struct LookArgs {
    /// File of the trial
    file: PathBuf,
    /// Draw it
    #[arg(long, value_name = "PNG")]
    out: Option<PathBuf>,
    /// The hand's folder, where it is not one of the library
    #[arg(long, value_name = "DIR")]
    hand: Option<String>,
    /// Plan again from the same depth image, as the planner plans today, instead of executing the old grasp
    #[arg(long)]
    plan: bool,
    #[command(flatten)]
    estimator: EstimatorArgs,
}

/// Runs the command.
///
/// # Errors
/// For a file that is no trial, and a picture that cannot be written.
pub(crate) fn run(args: &LookArgs) -> anyhow::Result<()> {
    let at = || format!("{}", args.file.display());
    let text = std::fs::read_to_string(&args.file).with_context(at)?;
    let trial = FailedTrial::from_json(&text).with_context(at)?;
    let hand = Arc::new(hand_source::resolve(args.hand.as_deref().unwrap_or(&trial.attempt.hand))?);
    let estimator = args.estimator.chosen()?;

    let mut panels: Vec<RgbImage> = Vec::new();
    let mut focus = Point3::origin();
    let mut watch = |moment: Moment, world: &World| {
        if args.out.is_some() {
            if moment == Moment::Before {
                focus = picture::focus(world);
            }
            panels.push(picture::close_up(world, &focus, PANEL_PX));
        }
    };
    let result = if args.plan {
        plan_again(&trial, &hand, &*estimator, &mut watch)?
    } else {
        replay(&trial, &hand, &*estimator, &mut watch)?
    };
    let mut out = std::io::stdout().lock();
    write!(out, "{}", describe(&trial, &result))?;
    if trial.hand_revision != hand.revision {
        writeln!(
            out,
            "the hand has changed since: revision {} then, {} now",
            trial.hand_revision, hand.revision
        )?;
    }
    if let Some(path) = &args.out {
        let station = Station::tray();
        let world = trial.world()?;
        let view = capture(&world, &station.sensor.lens, &station.world_from_camera);
        let depth = station.sensor.observe(&view, trial.noise_seed);
        let range = [0.55, 0.85];
        panels.push(scaled(&depth_picture(&depth, range), PANEL_PX[1]));
        write_file(path, &png(&picture::beside(&panels))?)?;
        writeln!(out, "drawn: {} (pre-grasp, contact, end, depth image)", path.display())?;
    }
    Ok(())
}

/// What it was, what it is now, and what the planner thought.
fn describe(trial: &FailedTrial, result: &Replay) -> String {
    let a = &trial.attempt;
    let meant = a.meant.as_deref().unwrap_or("nothing");
    let mut text = format!(
        "{} in {} run {}, attempt {}: {} ({meant}, {} objects in the tray)\n",
        a.hand,
        a.setup.title().to_lowercase(),
        a.run,
        a.number,
        a.class.title(),
        a.objects
    );
    let same = if result.same { "the same" } else { "not the same" };
    text += &format!("now: {}, {same}\n", result.class.title());
    let f = &result.figures;
    text += &format!(
        "score {:.3}, epsilon {:.3}, clearance {:.1} mm, {} grasps, contacts {}\n",
        f.score,
        f.epsilon,
        f.clearance_m * 1e3,
        f.grasps,
        if f.contacts.is_empty() { "none".to_owned() } else { f.contacts.join(", ") }
    );
    let list = |counts: &std::collections::BTreeMap<String, usize>| {
        counts.iter().map(|(name, n)| format!("{name} {n}")).collect::<Vec<_>>().join(", ")
    };
    text += &format!("rejected: {}\n", list(&f.rejected));
    if let Some(nothing) = &f.nothing {
        text += &format!("no grasp: {}: {}\n", nothing.reason, nothing.nearest_fix);
    }
    text
}

/// A picture scaled to a height, by the nearest pixel.
fn scaled(image: &RgbImage, height: usize) -> RgbImage {
    let width = image.width * height / image.height.max(1);
    let pixels = (0..width * height)
        .map(|i| {
            let (v, u) = (i / width * image.height / height, i % width * image.width / width);
            image.pixels[v * image.width + u]
        })
        .collect();
    RgbImage { width, height, pixels }
}

/// A PNG file's bytes.
pub(crate) fn png(image: &RgbImage) -> anyhow::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, image.width as u32, image.height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(image.pixels.as_flattened())?;
    writer.finish()?;
    Ok(bytes)
}
