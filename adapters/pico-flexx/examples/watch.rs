//! Watches a camera: `cargo run --example watch -- SETTINGS.toml [FRAMES]`, with the table that stands under
//! `[camera.settings.pico-flexx]` in a cell's file. One line for each frame: number, stamp in nanoseconds, pixels with depth, their mean in
//! metres, depth of the pixel in the middle, age in milliseconds.

use std::error::Error;
use std::time::Duration;

use graspd_adapters_core::DepthCamera;
use graspd_adapters_pico_flexx::{Finding, FlexxCamera, FlexxSettings};

const LONG: Duration = Duration::from_secs(30);

#[tokio::main]
async fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let file = arguments.next().ok_or("usage: watch SETTINGS.toml [FRAMES]")?;
    let frames: u64 = arguments.next().map_or(Ok(10), |text| text.parse())?;
    let settings: FlexxSettings = toml::from_str(&std::fs::read_to_string(file)?)?;
    let camera = FlexxCamera::new(settings)?;
    println!("{:?}", camera.info());
    for finding in camera.check(LONG).await {
        let Finding { subject, ok, found, advice } = finding;
        if ok {
            println!("good {subject}: {found}");
        } else {
            println!("bad {subject}: {found} -> {advice}");
        }
    }
    for n in 0..frames {
        let frame = camera.capture(LONG, LONG).await?;
        if n == 0 {
            println!("{:?}", frame.lens);
        }
        let seen: Vec<f64> = frame.depth_m.iter().filter(|d| **d > 0.0).map(|d| f64::from(*d)).collect();
        let mean = seen.iter().sum::<f64>() / seen.len().max(1) as f64;
        let middle = frame.depth_m[frame.depth_m.len() / 2];
        let (stamp, age) = (frame.stamp.as_nanos(), frame.age.as_secs_f64() * 1e3);
        println!("frame {} {stamp} {} {mean:.6} {middle:.6} {age:.1}", frame.sequence, seen.len());
    }
    println!("{:?}", camera.counts());
    Ok(())
}
