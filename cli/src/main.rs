//! The `graspd` command: each subcommand a thin call into a crate.
#![allow(dead_code)]

mod clock;
mod demo_scene;
mod input;
mod outcome;
mod view;

fn main() -> anyhow::Result<()> {
    let dir = std::path::PathBuf::from(std::env::args().nth(1).unwrap_or_default());
    let f = demo_scene::clutter(demo_scene::SEED);
    std::fs::write(dir.join("demo_depth.png"), f.to_png()?)?;
    std::fs::write(dir.join("demo_frame.json"), f.to_json())?;
    Ok(())
}
