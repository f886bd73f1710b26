//! One grasp from depth frame to lifted object, as a strip of pictures (portable pixmap, PPM): pre-grasp, contact, end.
//! `cargo run --release -p graspd-training --example grasp -- OUT.ppm [HAND [SEED [OBJECTS]]]`.

use std::io::Write;
use std::sync::Arc;

use graspd_hands::{CoordinateKind, library};
use graspd_planner::budget::Unlimited;
use graspd_planner::estimator::Geometric;
use graspd_planner::options::{PlanOptions, VolumeKind};
use graspd_planner::{plan, scene};
use graspd_sim::camera::{Pinhole, look_at};
use graspd_sim::clutter::{Arrangement, arrange};
use graspd_sim::execute::{ExecuteSettings, GraspCommand, execute};
use graspd_sim::render::{RgbImage, picture};
use graspd_sim::world::World;
use graspd_training::evaluate::{Station, draw};
use nalgebra::{Point3, Vector3};

/// Objects fit a hand that opens this far, metres.
const OPENING_M: f64 = 0.078;

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
    let command = GraspCommand {
        world_from_pregrasp: best.world_from_pregrasp,
        world_from_hand: best.world_from_hand,
        open: best.actuators.open.clone(),
        contact: best.actuators.contact.clone(),
        squeezed: best.actuators.squeezed.clone(),
    };

    // What physics makes of it. Adaptive joints start open, actuators as the plan says.
    let mut open = hand.actuation.open();
    let driven = open.iter_mut().zip(&hand.actuation.coordinates);
    let driven = driven.filter(|(_, c)| c.kind == CoordinateKind::Actuator);
    driven.zip(&command.open).for_each(|((value, _), planned)| *value = *planned);
    let placed = world.add_hand(hand, &command.world_from_pregrasp, &open);
    let focus =
        Point3::from(best.world_from_hand.translation.vector.component_mul(&Vector3::new(1.0, 1.0, 0.0)));
    let mut panels = Vec::new();
    let mut watch = |_, world: &World| panels.push(panel(world, &focus));
    let trial = execute(&mut world, placed, &command, &ExecuteSettings::default(), &mut watch);

    let end = trial.failure.map_or_else(|| "success".to_owned(), |failure| format!("{failure:?}"));
    writeln!(
        std::io::stdout(),
        "{id}: {end}, slipped {:.1} mm in the hand, {:.1} simulated seconds",
        trial.slip_m * 1e3,
        trial.duration_s
    )?;
    save(&out, &panels)?;
    Ok(())
}

/// The world from the front, near the grasp.
fn panel(world: &World, focus: &Point3<f64>) -> RgbImage {
    let lens = Pinhole { width: 480, height: 520, fx_px: 640.0, fy_px: 640.0, cx_px: 239.5, cy_px: 259.5 };
    let target = focus + Vector3::new(0.0, 0.0, 0.12);
    picture(world, &lens, &look_at(&(target + Vector3::new(0.3, -0.5, 0.25)), &target, &Vector3::z()))
}

/// Pictures of one size, side by side.
fn save(path: &str, panels: &[RgbImage]) -> std::io::Result<()> {
    let (width, height) =
        (panels.iter().map(|p| p.width).sum::<usize>(), panels.first().map_or(0, |p| p.height));
    let mut file = std::io::BufWriter::new(std::fs::File::create(path)?);
    write!(file, "P6\n{width} {height}\n255\n")?;
    for row in 0..height {
        for panel in panels {
            file.write_all(panel.pixels[row * panel.width..(row + 1) * panel.width].as_flattened())?;
        }
    }
    Ok(())
}
