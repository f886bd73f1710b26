//! One grasp from depth frame to lifted object, as a strip of pictures (portable pixmap, PPM): pre-grasp, contact, end.
//! `cargo run --release -p graspd-training --example grasp -- OUT.ppm [HAND [SEED [OBJECTS]]]`.

use std::io::Write;
use std::sync::Arc;

use graspd_hands::library;
use graspd_planner::budget::Unlimited;
use graspd_planner::estimator::Geometric;
use graspd_planner::options::{PlanOptions, VolumeKind};
use graspd_planner::{plan, scene};
use graspd_sim::clutter::{Arrangement, arrange};
use graspd_sim::execute::{ExecuteSettings, execute, set_down};
use graspd_sim::render::RgbImage;
use graspd_sim::world::World;
use graspd_training::evaluate::{Station, command, draw, picture};

/// Objects fit a hand that opens this far, metres.
const OPENING_M: f64 = 0.078;
/// Width and height of one picture, pixels.
const PANEL_PX: [usize; 2] = [480, 520];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let word = |i: usize, default: &str| words.get(i).cloned().unwrap_or_else(|| default.to_owned());
    let (out, id) = (word(0, "grasp.ppm"), word(1, "leap"));
    let (seed, count): (u64, usize) = (word(2, "1").parse()?, word(3, "5").parse()?);
    let hand = Arc::new(library::hand(&id).ok_or("a hand of the library is expected")?.clone());

    // The world, and what its camera sees of it.
    let station = Station::tray();
    let mut world = arrange(&station.world, &draw(count, OPENING_M, seed), Arrangement::Pile, seed)?;
    let frame = station.frame(&world, seed);

    // What the planner makes of the frame alone.
    let options = station.scene_options(VolumeKind::Tsdf);
    let seen = scene::prepare(&[frame], &options, &Geometric, &Unlimited)?;
    let plan = plan::plan(&seen, &hand, &PlanOptions { seed, ..PlanOptions::default() }, &Unlimited, None);
    let best = plan.grasps.first().ok_or("the planner found no grasp")?;
    let command = command(best);

    // What physics makes of it.
    let placed = set_down(&mut world, &hand, &command);
    let focus = picture::focus(&world);
    let mut panels = Vec::new();
    let mut watch = |_, world: &World| panels.push(picture::close_up(world, &focus, PANEL_PX));
    let trial = execute(&mut world, placed, &command, &ExecuteSettings::default(), &mut watch);

    let end = trial.failure.map_or_else(|| "success".to_owned(), |failure| format!("{failure:?}"));
    writeln!(
        std::io::stdout(),
        "{id}: {end}, slipped {:.1} mm in the hand, {:.1} simulated seconds",
        trial.slip_m * 1e3,
        trial.duration_s
    )?;
    save(&out, &picture::beside(&panels))?;
    Ok(())
}

/// A picture as a portable pixmap.
fn save(path: &str, image: &RgbImage) -> std::io::Result<()> {
    let mut file = std::io::BufWriter::new(std::fs::File::create(path)?);
    write!(file, "P6\n{} {}\n255\n", image.width, image.height)?;
    file.write_all(image.pixels.as_flattened())
}
