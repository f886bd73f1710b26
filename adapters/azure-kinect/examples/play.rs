//! Plays a recording and writes its first depth frame as a picture: `cargo run --example play -- FILE.mkv [PICTURE.png]`.
//! Near is bright, far is dark, no depth is black.

use std::error::Error;
use std::fs::File;
use std::time::Duration;

use graspd_adapters_azure_kinect::recording::Recording;
use graspd_adapters_azure_kinect::settings::Pace;
use graspd_adapters_azure_kinect::{KinectCamera, KinectSettings};
use graspd_adapters_core::{DepthCamera, DepthFrame};

const LONG: Duration = Duration::from_secs(10);

#[tokio::main]
async fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let file = arguments.next().ok_or("usage: play FILE.mkv [PICTURE.png]")?;
    let picture = arguments.next().unwrap_or_else(|| "depth.png".into());

    let recording = Recording::open(file.as_ref())?;
    let container = recording.container();
    println!("written by {}, ticks of {} ns", container.writer, container.tick_ns);
    for track in &container.tracks {
        println!(
            "track {} {:8} {} {} x {}",
            track.number, track.name, track.codec, track.size.0, track.size.1
        );
    }
    for tag in &container.tags {
        println!("tag {} = {}", tag.name, tag.text);
    }
    println!("lens {:?}", recording.lens());
    drop(recording);

    let camera = KinectCamera::new(KinectSettings::recording(&file, Pace::AsAsked, false)).await?;
    for finding in camera.check(LONG).await {
        println!("{finding:?}");
    }
    println!("{:?}", camera.info());
    let mut frames = 0;
    loop {
        match camera.capture(LONG, LONG).await {
            Ok(frame) => {
                println!("{}", describe(&frame));
                if frames == 0 {
                    write(&frame, &picture)?;
                    println!("wrote {picture}");
                }
                frames += 1;
            }
            Err(end) => {
                println!("{end}");
                return Ok(());
            }
        }
    }
}

fn describe(frame: &DepthFrame) -> String {
    let mut depth: Vec<f32> = frame.depth_m.iter().copied().filter(|d| *d > 0.0).collect();
    depth.sort_by(f32::total_cmp);
    let share = 100.0 * depth.len() as f64 / frame.depth_m.len() as f64;
    let at = |share: f64| depth.get((share * depth.len() as f64) as usize).copied().unwrap_or(0.0);
    let most = depth.last().copied().unwrap_or(0.0);
    format!(
        "frame {} at {:?}: {share:.1} % with depth, {:.3} to {most:.3} m, median {:.3} m",
        frame.sequence,
        frame.stamp,
        at(0.0),
        at(0.5)
    )
}

fn write(frame: &DepthFrame, path: &str) -> Result<(), Box<dyn Error>> {
    let nearest = frame.depth_m.iter().copied().filter(|d| *d > 0.0).fold(f32::INFINITY, f32::min);
    let farthest = frame.depth_m.iter().copied().fold(0.0, f32::max);
    let shade = |d: &f32| {
        let share = (d - nearest) / (farthest - nearest).max(1e-3);
        if *d > 0.0 { (255.0 - 215.0 * share) as u8 } else { 0 }
    };
    let bytes: Vec<u8> = frame.depth_m.iter().map(shade).collect();
    let mut encoder =
        png::Encoder::new(File::create(path)?, u32::try_from(frame.width)?, u32::try_from(frame.height)?);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.write_header()?.write_image_data(&bytes)?;
    Ok(())
}
